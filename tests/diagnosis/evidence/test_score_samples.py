"""An effect is scored by the same samples whatever lag of an input stands beside it."""

from __future__ import annotations

import pytest

import casid
from casid.diagnosis.evidence.scores.score_tests import score_test
from casid.model.effects.balances.balance_effects import quadratic_damping
from tests.support.hidden_forces import fitted


def test_the_score_of_an_effect_is_the_same_beside_a_lag_of_an_input_that_is_none_yet():
    """What a lag leaves out is due to the past, which all outputs show, and nothing while it is 0.

    A score is a function of the residual, the fit's sensitivities and its own signature alone.
    """
    at, _ = fitted("quadratic damping", 3)
    model = at.fit.criterion.model
    drag = quadratic_damping(model, "force")
    (alone,) = score_test(at.fit, [drag], input_sd={}).scores
    lag = casid.actuator_lag(model, "F", 1.0)
    beside, _ = score_test(at.fit, [drag, lag], input_sd={}).scores
    assert beside.unrobust == pytest.approx(alone.unrobust, rel=1e-9)
    assert beside.step == pytest.approx(alone.step, rel=1e-9)
