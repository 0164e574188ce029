"""Functions without a name are held against the causes that were named.

A linear oscillator with a stiffness that drifts: where the catalogue has no drift, a jump explains
most of it, and the displacement growing in time, which no effect left in it is, explains more.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

import casid
from casid.diagnosis.diagnosis import Cause
from casid.diagnosis.evidence.residual.candidate_functions import functions_of
from casid.diagnosis.thresholds import COMPARISON
from casid.diagnosis.verdict.unknown_cause import with_the_unnamed_alternative
from casid.diagnosis.verdict.unnamed_alternatives import UnnamedAlternative
from casid.errors import ModelError
from casid.model.effects.balances.balance_effects import extra_input
from casid.model.effects.channels.actuator_effects import actuator_lag
from casid.model.effects.effect import KINDS
from problems import pendulum
from tests.diagnosis.test_diagnose import record_of
from tests.support import truth


def names(cause: Cause) -> set[tuple[str, str]]:
    return {(cause.kind, cause.where), *((a.kind, a.where) for a in cause.alternatives)}


@functools.cache
def drifting() -> casid.Record:
    """The stiffness drifts; the misfit is 0.35 of the noise: a few hundred of energy."""
    hidden = truth.cart_pendulum("parameter_drift", 0.35, seed=7, duration=60.0, Ts=0.02, where="k")
    return record_of(hidden)


@pytest.mark.slow
def test_a_drift_that_the_catalogue_has_is_named_and_no_function_stands_beside_it():
    d = casid.diagnose(pendulum.problem, drifting(), advise=False)
    (cause,) = d.causes
    assert (cause.kind, cause.where) == ("parameter_drift", "k")
    assert "unknown" not in {kind for kind, _ in names(cause)}
    assert d.unexplained is None


@pytest.mark.slow
def test_a_drift_that_the_catalogue_has_not_is_no_jump():
    d = casid.diagnose(
        pendulum.problem,
        drifting(),
        without=("parameter_drift", "scheduled_parameter"),
        advise=False,
    )
    first = d.causes[0]
    assert "unknown" in {kind for kind, _ in names(first)}


@pytest.mark.slow
def test_with_no_effect_left_in_the_catalogue_the_misfit_is_unknown():
    hidden = truth.cart_pendulum("cubic_stiffness", 1.0, seed=3, duration=30.0, Ts=0.02)
    d = casid.diagnose(pendulum.problem, record_of(hidden), without=sorted(KINDS), advise=False)
    assert d.verdict == "deficient"
    assert {c.kind for c in d.causes} == {"unknown"}


CAUSE = Cause("parameter_jump", "k", 1e-6, (), share=1.0, sentence="k jumps")


def test_a_function_as_good_as_the_cause_is_one_of_its_alternatives():
    rival = UnnamedAlternative(
        "torque", "phi growing in time", gain=50.0, ahead=COMPARISON.strong, own=0.2
    )
    (cause,) = with_the_unnamed_alternative([CAUSE], rival)
    assert cause.kind == "parameter_jump"
    (other,) = cause.alternatives
    assert (other.kind, other.where) == ("unknown", "torque")
    assert "phi growing in time" in other.why


def test_a_function_better_than_the_cause_takes_its_place():
    rival = UnnamedAlternative(
        "torque", "phi growing in time", gain=50.0, ahead=COMPARISON.strong + 1, own=0.2
    )
    (cause,) = with_the_unnamed_alternative([CAUSE], rival)
    assert (cause.kind, cause.where) == ("unknown", "torque")
    assert [(a.kind, a.where) for a in cause.alternatives] == [("parameter_jump", "k")]
    assert "phi growing in time" in cause.sentence


def test_what_was_spoilt_stays_beside_the_function():
    outliers = Cause("outliers", "gyro", 1e-6, (), share=0.1, sentence="outliers in gyro")
    rival = UnnamedAlternative(
        "torque", "phi growing in time", gain=50.0, ahead=COMPARISON.strong + 1, own=0.2
    )
    assert with_the_unnamed_alternative([CAUSE, outliers], rival)[1:] == [outliers]


def test_functions_are_evaluated_as_they_are_named():
    t = np.arange(5.0)
    table = {"time": t, "x": t - 2, "u": -t, "slope of y": np.ones(5)}
    by_name = dict(functions_of(["x"], ["u"], [], "y"))
    expected = {
        "x |x|": [-4.0, -1.0, 0.0, 1.0, 4.0],
        "sign(x)": [-1.0, -1.0, 0.0, 1.0, 1.0],
        "x growing in time": [4.0, 1.0, 0.0, 1.0, 4.0],
        "x turned at half time": [2.0, 1.0, 0.0, 1.0, 2.0],
        "slope of y growing in time": [-2.0, -1.0, 0.0, 1.0, 2.0],
        "|x| u": [0.0, -1.0, 0.0, -3.0, -8.0],
    }
    for name, values in expected.items():
        assert by_name[name].columns(table)[:, 0] == pytest.approx(values), name


def test_a_cause_that_needs_another_one_s_input_says_so():
    """A lag of `ref` means nothing before `ref` drives anything."""
    model = pendulum.problem.model
    driven = extra_input(model, "torque", "ref", "m/s^2").extend(model)
    effect = actuator_lag(driven, "ref", 0.1)
    with pytest.raises(ModelError, match=r"needs 'ref'.*apply the effect that adds it first"):
        effect.extend(model)
