"""A held command on an uneven clock steps where its samples were taken, not where the clock ticks.

The truth is a store with a slow leak, dx/dt = u - a x, by its exact solution between stamps.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import casid
from casid.data.record import Record
from casid.diagnosis.evidence.recording_faults.steps_in_gaps import with_steps_in_gaps
from casid.errors import DataError
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.records.input_gaps import filled, with_gaps_treated

LEAK, NOISE, N = 0.002, 0.05, 800


def store() -> casid.Problem:
    m = casid.Model("store")
    x, u = m.state("x", "m"), m.input("u", "m/s", hold="zoh", known=True)
    a = m.parameter("a", "1/s", start=0.003, lower=1e-5, upper=1.0)
    g = m.parameter("g", "1", start=0.9, lower=0.1, upper=10.0)
    m.balance(x, "volume", inertia=1, terms=[g * u, -a * x], unit="m/s")
    m.output("level", x, "m")
    return casid.Problem("store", m, channels={"u": "u", "level": "level"}, starts=1)


def written(path: Path, seed: int = 1) -> Path:
    """A pump that runs a while every now and then; rows a fifth of an interval early or late."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(np.r_[0.0, rng.uniform(8.0, 12.5, N - 1)])
    u = np.zeros(N)
    for k in rng.integers(0, N, N // 8):
        u[k : k + rng.integers(1, 4)] = rng.uniform(0.02, 0.05)
    x, level = 3.0, np.empty(N)
    for k in range(N):
        level[k] = x
        if k + 1 < N:
            grow = np.exp(-LEAK * (t[k + 1] - t[k]))
            x = grow * x + (1 - grow) / LEAK * u[k]
    level += NOISE * rng.standard_normal(N)
    rows = [f"{a:.3f},{b:.6f},{c:.6f}" for a, b, c in zip(t, u, level, strict=True)]
    path.write_text("\n".join(["t [s],u [m/s],level [m]", *rows]) + "\n")
    return path


@pytest.fixture
def run(tmp_path: Path) -> casid.Experiment:
    return store().read(written(tmp_path / "run.csv"))


def test_a_record_keeps_by_how_much_its_stamps_are_late(run):
    record = run.record
    assert set(record.late) == {"u", "level"}
    assert np.abs(record.late["u"]).max() <= 0.5 * record.Ts
    assert np.abs(record.late["u"]).max() > 0.4 * record.Ts
    part = record.between(1000.0, 2000.0)
    inside = (record.t >= 1000.0) & (record.t <= 2000.0)
    np.testing.assert_array_equal(part.late["u"], record.late["u"][inside])
    assert set(record.rename({"u": "pump"}).without("level").late) == {"pump"}
    with pytest.raises(DataError, match="lateness of 'u'"):
        Record({"u": np.zeros(3)}, {"u": "1"}, 1.0, late={"u": np.zeros(2)})


def test_a_step_between_two_instants_brings_what_it_brought():
    """Until 2.3 s the input was 1, until 5.8 s it was 3, then 2."""
    gone = np.array([False, True, False, True, True, True, False, True])
    values, late = np.zeros(8), np.zeros(8)
    values[[0, 2, 6]], late[[2, 6]] = [1.0, 3.0, 2.0], [0.3, -0.2]
    record = Record(
        {"u": np.where(gone, np.nan, values)},
        {"u": "1"},
        1.0,
        missing={"u": gone},
        late={"u": late},
    )
    np.testing.assert_allclose(
        filled(record, "u", "zoh"), [1.0, 1.0, 2.4, 3.0, 3.0, 2.8, 2.0, 2.0], atol=1e-12
    )


def test_the_error_of_the_fit_is_the_noise_and_no_step_is_moved(run):
    chosen = with_gaps_treated(store().model, [run])
    fit = fit_model(store().model, chosen, FitSettings(starts=1), throw=False)
    residual = fit.criterion.columns(fit.x, 0)[0] / fit.criterion.weights
    used = fit.criterion.data[0].used
    assert np.sqrt(np.mean(residual[used > 0] ** 2)) == pytest.approx(NOISE, rel=0.1)
    assert fit.values["g"] == pytest.approx(1.0, abs=3 * 0.0025)  # three standard errors
    split = split_records(chosen, 0.3)
    assert with_steps_in_gaps(fit, split) == (split, 0)
