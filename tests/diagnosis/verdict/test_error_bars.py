"""The estimates of a diagnosis are those of `identify`, with their error bars."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.verdict.error_bars import ROUNDED
from casid.estimation.simulation_estimate import CORRECTED
from problems import pendulum


def test_a_record_that_lacks_nothing_has_the_estimates_of_identify():
    """Noise on the measured input biases least squares, of a diagnosis as of an estimate."""
    record = pendulum.simulate(duration=20.0, seed=2)
    found = casid.diagnose(pendulum.problem, record, advise=False)
    assert found.verdict == "adequate"
    assert found.baseline.uncertainty.assumes == CORRECTED
    alone = casid.identify(pendulum.problem, record, hold_out=0.3)
    for mine, its in zip(found.baseline.parameters, alone.parameters, strict=True):
        if its.std_error is not None and mine.std_error is not None:
            assert mine.value == pytest.approx(its.value, abs=0.05 * its.std_error)
            assert mine.std_error == pytest.approx(its.std_error, rel=0.02)


@pytest.mark.slow
def test_the_size_of_a_cause_is_without_the_bias_of_the_inputs_noise():
    record = pendulum.simulate(duration=40.0, d_2=0.3, seed=2)
    found = casid.diagnose(pendulum.problem, record, advise=False)
    assert [c.kind for c in found.causes] == ["quadratic_damping"]
    assert found.extended is not None
    assert found.extended.uncertainty.assumes == CORRECTED
    assert ROUNDED not in found.extended.uncertainty.assumes
    for name, true in (("k", 10.39), ("I_x", 0.1385), ("d_2", 0.3)):
        row = next(p for p in found.extended.parameters if p.name == name)
        assert row.std_error is not None
        assert row.value == pytest.approx(true, abs=3 * row.std_error)


@pytest.mark.slow
def test_a_channel_with_the_wrong_sign_leaves_the_estimates_and_their_errors_as_they_are():
    """Values and errors are both those of the root, also where the sign is all that is wrong."""
    record = pendulum.simulate(duration=20.0, seed=2)
    turned = record.with_channel("gyro", -np.array(record["gyro"]), record.units["gyro"])
    found = casid.diagnose(pendulum.problem, turned, advise=False)
    alone = casid.identify(pendulum.problem, record, hold_out=0.3)
    assert [(c.kind, c.where) for c in found.causes] == [("sensor_scale", "gyro")]
    assert found.extended is not None
    for name in ("k", "d", "I_x"):
        mine, its = found.extended.parameter(name), alone.parameter(name)
        assert mine.std_error == pytest.approx(its.std_error, rel=1e-6)
        assert mine.value == pytest.approx(its.value, rel=1e-6)
