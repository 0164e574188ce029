"""Estimates from additive sums are those from the records they were made of."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from analysis.pendulum_study.records import PendulumRecords
from casid.estimation.cross_moments.moments import Moments, moments, of_record
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.identification.estimate_from_moments import estimate_from_moments
from casid.identification.moment_estimators import least_squares
from casid.linear.sampled.lagged_columns import lagged
from problems.pendulum import TABLE_7_2, indirect_model

INSTRUMENTS = lagged("ref", range(0, 60, 4))


@pytest.fixture(scope="module")
def records() -> list[casid.Experiment]:
    return PendulumRecords(0.5, N=30_000, seed=4).experiments(0)


def model() -> casid.Model:
    return indirect_model().with_unknown(d=0.09, I_x=0.15, m=0.1, z_m=-0.2).with_known(k=10.39)


def sums_of(experiment: casid.Experiment, parts: int, lags: int) -> Moments:
    """The record cut into pieces that overlap by the lags, their moments added."""
    record = experiment.record
    cuts = np.linspace(lags, record.N, parts + 1).astype(int)
    total = None
    for a, b in zip(cuts[:-1], cuts[1:], strict=True):
        piece = moments({n: record[n][a - lags : b] for n in record.names}, lags)
        total = piece if total is None else total + piece
    assert total is not None
    return total


def test_least_squares_from_sums_is_least_squares_from_records(records) -> None:
    sums = {e.name: of_record(e.record, 2) for e in records}
    known = {"nominal": {"m": 0.0}}
    a = estimate_from_moments(model(), sums, Ts=0.01, known=known)
    b = least_squares(model(), records)
    for name in ("I_x", "d", "m", "z_m"):
        assert a[name] == pytest.approx(b[name], rel=1e-6)
    assert "white equation errors" in a.estimate.assumes


def test_where_the_record_is_cut_does_not_matter(records) -> None:
    known = {"nominal": {"m": 0.0}}
    found = [
        estimate_from_moments(
            model(),
            {e.name: sums_of(e, parts, 56) for e in records},
            Ts=0.01,
            known=known,
            instruments=INSTRUMENTS,
        )
        for parts in (1, 7)
    ]
    for name in ("I_x", "d", "m", "z_m"):
        assert found[1][name] == pytest.approx(found[0][name], rel=1e-8)
    assert found[0]["I_x"] == pytest.approx(TABLE_7_2["I_x"], rel=0.02)


def test_sums_that_do_not_fit_are_refused_with_their_mend(records) -> None:
    nominal = records[:1]
    sums = {"nominal": of_record(nominal[0].record, 1)}
    with pytest.raises(casid.DataError, match="make them again with lags=2"):
        estimate_from_moments(model(), sums, Ts=0.01, free=["I_x", "d"])
    short = {"nominal": moments({"gyro": nominal[0].record["gyro"]}, 2)}
    with pytest.raises(casid.DataError, match="lack channel 'accel'"):
        estimate_from_moments(model(), short, Ts=0.01, free=["I_x", "d"])
    with pytest.raises(casid.DataError, match="no sums"):
        estimate_from_moments(model(), sums, Ts=0.01, known={"nomnal": {"m": 0.0}})
    with pytest.raises(casid.ModelError, match="estimate from records"):
        estimate_from_moments(model(), sums, Ts=0.01, settings=MomentSettings(noise_model=(0, 4)))
