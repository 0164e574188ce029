"""What an input did in a gap that was filled shows in the samples behind it: no outliers."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.recording_faults.corrupted_samples import without_corrupted
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.records.input_gaps import with_gaps_treated

N, TS, LAG, NOISE, SPIKE = 600, 1.0, 0.6, 0.02, 100


def model() -> casid.Model:
    m = casid.Model("pipe")
    T, u = m.state("T", "1"), m.input("u", "1")
    m.derivative(T, (u - T) / m.parameter("tau", "s", start=1.0, lower=0.05, upper=20.0))
    m.output("T", T, "1")
    return m


def record(lost: slice | np.ndarray) -> casid.Record:
    """A lag behind straight lines, solved exactly; a peak of u at 303 s, and a spike of T."""
    rng = np.random.default_rng(4)
    u = np.convolve(rng.standard_normal(N + 40), np.ones(41) / 41, "valid")
    u[303] += 3.0
    decay, T = np.exp(-TS / LAG), np.zeros(N)
    for k in range(N - 1):
        slope = (u[k + 1] - u[k]) / TS
        T[k + 1] = decay * (T[k] - u[k] + slope * LAG) + u[k + 1] - slope * LAG
    y = T + NOISE * rng.standard_normal(N)
    y[SPIKE] += 0.5
    missing = np.zeros(N, dtype=bool)
    missing[lost] = True
    channels = {"u": np.where(missing, np.nan, u), "T": y}
    return casid.Record(channels, {"u": "1", "T": "1"}, TS, missing={"u": missing})


@pytest.mark.parametrize("clock", ["one", "slower"])
def test_samples_behind_a_gap_are_left_out_and_no_outliers(clock: str) -> None:
    """The response of a gap of four samples is gone there; the spike elsewhere is a spike.

    An input that was read in every other sample has intervals, not gaps.
    """
    gap = slice(300, 304) if clock == "one" else np.arange(N) % 2 == 1
    m = model()
    treated = with_gaps_treated(m, [casid.Experiment(record(gap), {}, "pipe")])
    split = split_records(treated, 0.0)
    fit = fit_model(m, split.fitted, FitSettings(starts=1))
    found, left = without_corrupted(fit, split, 0.05)
    (spikes,) = found.spikes
    assert spikes.masks[0][SPIKE]
    missing = left.fitted[0].record.is_missing("T")
    if clock == "one":
        assert np.flatnonzero(spikes.masks[0]).tolist() == [SPIKE]
        assert 1 <= found.behind_gaps == missing.sum() - 1
        assert missing[300:306].any()
    else:
        assert found.behind_gaps == 0
