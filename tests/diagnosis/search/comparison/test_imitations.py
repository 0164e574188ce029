"""Beside other causes, a line at the resonance and a third law of friction are no causes."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.comparison.imitations import is_at_resonance, is_further_friction
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    cubic_stiffness,
    offset,
    quadratic_damping,
)
from problems import roll_decay


@functools.cache
def decay() -> Weighted:
    """A linear decay at sqrt(6.06) rad/s = 0.392 Hz with a damping ratio of 0.25 %."""
    record = roll_decay.simulate(duration=40.0, B_2=0.0, C_3=0.0).decimate(5)
    data = [casid.Experiment(record)]
    fit = fit_model(roll_decay.decay_model(), data, casid.FitSettings(starts=1))
    return Weighing(data).weigh(roll_decay.decay_model(), fit)


@pytest.mark.parametrize(
    ("ratio", "is_near"), [(1.0, True), (1.004, True), (1.2, False), (2.0, False)]
)
def test_a_line_is_at_the_resonance_where_its_gain_is_within_a_twentieth_of_the_largest(
    ratio, is_near
):
    """|G|^2 = 1 / ((1 - s^2)^2 + (2 zeta s)^2): at s = 1.2 it is 1/4840 of the peak."""
    assert is_at_resonance(decay(), ratio * np.sqrt(6.06) / (2 * np.pi)) is is_near


def test_a_model_without_a_resonance_has_no_line_at_one():
    """Gain that falls from the lowest frequency on: a first-order lag."""
    at = decay()
    r = at.full.responses[0]
    lag = 1 / (1 + (r.omega / 0.3) ** 2)
    flat = replace(r, gain2=np.repeat(lag[:, None, None], r.gain2.shape[2], axis=2))
    assert not is_at_resonance(replace(at, full=replace(at.full, responses=[flat])), 0.02)


def test_a_third_law_of_friction_in_one_place_is_no_candidate():
    model = roll_decay.decay_model()
    dry, drag = coulomb_friction(model, "torque", 0.004), quadratic_damping(model, "torque")
    first, second = SimpleNamespace(effect=dry), SimpleNamespace(effect=drag)
    third = replace(drag, kind="cubic_damping")
    assert not is_further_friction(drag, [first])
    assert is_further_friction(third, [first, second])
    assert not is_further_friction(replace(third, where="another"), [first, second])
    for other in (offset(model, "torque"), cubic_stiffness(model, "torque")):
        assert not is_further_friction(other, [first, second])
