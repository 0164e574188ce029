"""Every effect is scored by all samples of the fit, whatever stands beside it."""

from __future__ import annotations

import pytest

import casid
from casid.diagnosis.evidence.score_tests import score_test
from casid.model.effects.balance_effects import quadratic_damping
from tests.support.hidden_forces import fitted


@pytest.mark.parametrize("lag", [casid.actuator_lag, casid.sensor_lag])
def test_the_score_of_an_effect_is_the_same_beside_a_lag_that_is_none_yet(lag):
    """A lag leaves out the samples that are due to the past, and none while it is zero.

    A score is a function of the residual, the fit's sensitivities and its own signature alone.
    """
    at, _ = fitted("quadratic damping", 3)
    model = at.fit.criterion.model
    channel = "F" if lag is casid.actuator_lag else next(iter(model.outputs))
    drag = quadratic_damping(model, "force")
    (alone,) = score_test(at.fit, [drag], input_sd={}).scores
    beside, _ = score_test(at.fit, [drag, lag(model, channel, 1.0)], input_sd={}).scores
    assert beside.unrobust == pytest.approx(alone.unrobust, rel=1e-9)
    assert beside.step == pytest.approx(alone.step, rel=1e-9)
