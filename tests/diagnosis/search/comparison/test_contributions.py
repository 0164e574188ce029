"""What each of several causes contributes: the misfit that returns when it alone is taken out."""

from __future__ import annotations

import pytest

import casid
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.comparison.contributions import contributions_of
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.balances.balance_effects import cubic_stiffness, quadratic_damping
from problems import roll_decay
from tests.support.moved_fits import with_value

ONCE = casid.FitSettings(starts=1)


@pytest.fixture(scope="module")
def fits():
    """Three minutes of decay at 10 Hz: linear, hardening alone, drag alone, and with both."""
    record = roll_decay.simulate(duration=180.0).decimate(5)
    experiments = [casid.Experiment(record)]
    linear = roll_decay.decay_model()
    hard = linear.extend(cubic_stiffness(linear, "torque"))
    drag = linear.extend(quadratic_damping(linear, "torque"))
    both = hard.extend(quadratic_damping(hard, "torque"))
    start = {"B_1": 0.012, "C_1": 6.06, "k_3": 4.0, "d_2": 0.07}
    return experiments, {
        name: fit_model(
            model,
            experiments,
            ONCE,
            start={k: v for k, v in start.items() if k in model.parameters},
        )
        for name, model in {"linear": linear, "hard": hard, "drag": drag, "both": both}.items()
    }


@pytest.fixture(scope="module")
def contributions(fits):
    experiments, found = fits
    weighing = Weighing(experiments)
    return contributions_of(weighing, causes(weighing, found), found["both"], Attempts())


def causes(weighing, found):
    """Hardening, adopted into the linear model, and drag beside it."""
    refitting = Refitting(weighing)
    start = weighing.weigh(found["linear"].criterion.model, found["linear"])
    hardening = cubic_stiffness(start.model, "torque")
    first = refitting.refit(start, hardening, 4.0)
    beside = weighing.weigh(first.model, first.fit)
    second = refitting.refit(beside, quadratic_damping(first.model, "torque"), 0.07)
    return [Adopted(first, 0.0, (), start), Adopted(second, 0.0, (), beside)]


def test_a_contribution_is_the_loss_of_the_model_without_that_cause(fits, contributions):
    """Least squares of nested models: the fits are converged to 1e-6 of their minimum."""
    values = {name: fit.solution.value for name, fit in fits[1].items()}
    hardening, drag = contributions
    assert hardening == pytest.approx(values["drag"] - values["both"], rel=1e-3)
    assert drag == pytest.approx(values["hard"] - values["both"], rel=1e-3)


def test_no_cause_contributes_more_than_all_of_them_together(fits, contributions):
    """A model without one cause contains the model without any."""
    values = {name: fit.solution.value for name, fit in fits[1].items()}
    assert 0.0 < max(contributions) < values["linear"] - values["both"]


def test_a_share_is_known_where_the_other_causes_diverge_alone(fits, contributions):
    """A restoring moment that falls so fast with the heel that the ship turns over."""
    experiments, found = fits
    weighing, attempts = Weighing(experiments), Attempts()
    capsizing = with_value(found["both"], "k_3", -400.0)
    shares = contributions_of(weighing, causes(weighing, found), capsizing, attempts)
    assert not attempts.failed
    assert shares == pytest.approx(contributions, rel=1e-3)
