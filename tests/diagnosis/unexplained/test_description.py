"""What is left without a name is described: where, on what it depends, when, and how surely."""

from __future__ import annotations

import functools
import json

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.unexplained.description import (
    Unexplained,
    dependence_text,
    going_with,
    unexplained,
)
from casid.diagnosis.unexplained.missing_force import Dependence
from casid.diagnosis.unexplained.variables import variable_words
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.parameter_effects import ramp_over, step_at
from casid.report.figures.unexplained import (
    dependence_figure,
    missing_spectrum_figure,
    missing_time_figure,
)
from problems import pendulum
from tests.support import truth
from tests.support.hidden_forces import RECORDED, fitted


@functools.cache
def on_the_pendulum(kind: str, strength: float, seed: int) -> Unexplained:
    hidden = truth.cart_pendulum(kind, strength, seed=seed, duration=40.0)
    names = [n for n in hidden.columns if n != "t"]
    record = casid.Record(
        {n: hidden.columns[n] for n in names}, {n: hidden.units[n] for n in names}, Ts=hidden.Ts
    )
    made = [casid.Experiment(record, {}, "run")]
    fit = fit_model(pendulum.problem.model, made, FitSettings(starts=1), throw=False)
    at = Weighing(made).weigh(pendulum.problem.model, fit)
    return unexplained(at, made, pendulum.problem.recorded)


@functools.cache
def of(kind: str, seed: int, disturbance: float = 0.0) -> Unexplained:
    at, made = fitted(kind, seed, disturbance)
    return unexplained(at, made, RECORDED)


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ([()], "is constant"),
        ([("v",)], "depends on v (odd)"),
        ([("v",), ("q",)], "depends on v (odd); and on q (odd)"),
        ([("v",), ()], "depends on v (odd), about a constant"),
    ],
)
def test_a_missing_constant_depends_on_nothing(variables: list, words: str) -> None:
    unused = np.zeros(0)
    terms = [
        Dependence(v, 1.0, 0.0, 9.0, "odd" if v else "", None, 1.0, "", (), *[unused] * 3)
        for v in variables
    ]
    assert dependence_text(terms) == words


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "variable"),
    [("cubic_stiffness", "phi"), ("quadratic_damping", "p"), ("coulomb_friction", "p")],
)
def test_on_the_indirect_pendulum_the_variable_is_found_with_a_noisy_input(
    kind: str, variable: str
) -> None:
    """At a misfit of the size of the noise, odd in every case."""
    found = on_the_pendulum(kind, 1.0, 1)
    assert found.where == "torque"
    assert found.best is not None
    leading = found.best.leading
    assert leading is not None
    assert leading.variables == (variable,)
    assert leading.parity == "odd"
    assert f"a missing term in the torque balance that depends on {variable} (odd" in found.sentence


@pytest.mark.slow
def test_a_sine_in_torque_is_told_by_its_frequency():
    found = on_the_pendulum("periodic_disturbance", 1.0, 2)
    hidden = truth.cart_pendulum("periodic_disturbance", 1.0, seed=2, duration=40.0)
    force = found.best.over_time if found.best is not None else None
    assert force is not None
    assert force.spectrum.line == pytest.approx(hidden.truth["frequency"], abs=1 / 40)
    assert found.where == "torque"
    assert "a sine in time" in found.sentence


def test_a_white_disturbance_has_a_place_but_no_dependence():
    found = of("none", 41, 0.05)
    assert found.best is not None
    assert not found.best.dependences
    assert found.where == "force"
    assert "resembles a disturbance" in found.sentence


def test_a_record_without_an_effect_yields_nothing():
    found = of("none", 22)
    assert not found.is_something
    assert found.where == ""
    assert found.sentence.startswith("The remainder is consistent with noise")
    with pytest.raises(ValueError, match="nothing is left beyond the noise"):
        dependence_figure(found)


def test_what_is_told_can_be_written_and_drawn():
    found = of("quadratic damping", 1)
    told = json.loads(json.dumps(found.to_json()))
    assert told["where"] == "force"
    assert told["dependences"][0]["variables"] == ["v_m"]
    assert len(told["over_time"]["series"][0]["t"]) <= 1000
    curve = dependence_figure(found)
    line = next(t for t in curve.data if t.name == "missing part")
    assert found.best is not None
    np.testing.assert_allclose(line.y, found.best.dependences[0].value)
    assert "v_m" in curve.layout.xaxis.title.text
    assert "noise alone" in {t.name for t in missing_spectrum_figure(found).data}
    over_time = missing_time_figure(found)
    assert len({t.yaxis for t in over_time.data}) == 1 + len(found.signals[0])


def test_what_is_made_of_the_time_is_described_by_it() -> None:
    """Not "it is larger when step at 5.71102195 s is large"."""
    step, ramp = step_at(5.71102195).name, ramp_over(1.0, 9.5).name
    assert going_with(step, 0.5) == "It is larger after t = 5.71102 s than before."
    assert going_with(ramp, -0.5) == "It is smaller near t = 1 s and t = 9.5 s than between."
    assert going_with("phi", 0.5) == "It is larger when phi is large."


def test_a_variable_made_of_the_time_is_said_with_the_digits_that_a_reader_wants():
    """It is named by its instant to nine digits, which no sentence needs."""
    step, ramp = step_at(17.435193312), ramp_over(0.0, 3600.0)
    assert variable_words(step.name) == "a step at 17.4352 s"
    assert variable_words(ramp.name) == "the time from 0 to 3600 s"
    assert variable_words("slope of x") == "the slope of x"
    assert variable_words("T") == "T"
