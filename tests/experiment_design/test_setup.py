"""What a design takes from the result of a diagnosis: the model with the causes, or without."""

from __future__ import annotations

from dataclasses import replace

import pytest

import casid
from casid.experiment_design.setup import nominal_of
from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    quadratic_damping,
)
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.parameter_effects import parameter_jump
from tests.support.fitted_models import driven_mass, fitted_model

VALUES = {"d": 1.5, "k": 50.0}


def diagnosed(effects, values):
    """The mass on a spring as a diagnosis leaves it: with causes, and what it was before."""
    problem = casid.Problem("mass", driven_mass(), noise={"position": 1e-3})

    def made(effects, values):
        return fitted_model(problem, effects, {**VALUES, **values}, x0=(0, 0), Ts=0.05, N=40)

    return replace(made(effects, values), baseline=made([], {}))


def test_parameters_are_estimated_in_the_model_with_the_causes_and_causes_separated_without():
    """The motion that a design predicts, and its limits, are those of the model with the drag."""
    result = diagnosed([lambda m: quadratic_damping(m, "force")], {"d_2": 4.0})
    with_causes, without = nominal_of(result, with_causes=True), nominal_of(result)
    assert with_causes.free == ("d", "k", "d_2")
    assert with_causes.values["d_2"] == 4.0
    assert with_causes.note.endswith("found: quadratic damping in the force balance.")
    assert without.free == ("d", "k")
    assert "d_2" not in without.model.parameters
    assert without.note == ""


def test_a_parameter_of_a_cause_can_be_what_the_next_record_is_for():
    result = diagnosed([lambda m: coulomb_friction(m, "force", speed=0.05)], {"F_c": 1.0})
    found = casid.design_experiment(
        result,
        casid.Aim.estimate("F_c"),
        {"force": (-5, 5)},
        duration=2.0,
        noise={"position": 1e-3},
        intervals=8,
        candidates=5,
        starts=1,
    )
    assert {p.name for p in found.parameters} == {"d", "k", "F_c"}
    assert "dry friction in the force balance" in str(found)


def test_what_sets_in_at_an_instant_is_none_of_the_next_record():
    """Its clock is another one: a step at 1 s of the old record is not there to be estimated."""
    step = [lambda m: parameter_jump(m, "k", 1.0), lambda m: quadratic_damping(m, "force")]
    found = nominal_of(diagnosed(step, {"jump_k": 10.0, "d_2": 4.0}), with_causes=True)
    assert found.free == ("d", "k", "d_2")
    assert "jump" not in found.note


def test_a_delay_that_was_found_is_left_out_with_a_note():
    result = diagnosed([lambda m: time_delay(m, "position", 0.5)], {"delay_position": 0.1})
    found = nominal_of(result, with_causes=True)
    assert found.free == ("d", "k")
    assert "without what the diagnosis found" in found.note
    with pytest.raises(casid.ModelError, match="delay of position is computed beside"):
        nominal_of(replace(result, baseline=None), with_causes=True)
