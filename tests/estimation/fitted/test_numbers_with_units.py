"""A number in a printed equation is in the unit that stands beside it, as its symbols are."""

from __future__ import annotations

from typing import Any

import casadi as ca
import pytest

import casid
from casid.estimation.fitted.equations import ModelEquation, equations_of
from casid.model.effects.balances.balance_effects import coulomb_friction, extra_input
from casid.model.effects.effect import Effect, Motion, Spread
from casid.model.effects.parameter_effects import scheduled_parameter
from casid.model.effects.state_schedules import state_scheduled_parameter

DEGREE = 0.017453292519943295  # rad


def room() -> casid.Model:
    """A vane in a wind, and a room: angles in degrees, speeds in rpm, temperatures in degC."""
    m = casid.Model("vane and room")
    w, th, T = m.state("w", "rpm"), m.state("th", "deg"), m.state("T", "degC")
    J, k = m.parameter("J", "kg m^2", start=1.0), m.parameter("k", "N m/rad", start=1.0)
    C, UA = m.parameter("C", "J/K", start=1.0), m.parameter("UA", "W/K", start=1.0)
    m.derivative(th, w)
    m.balance(w, "torque", inertia=J, terms=[-k * th])
    m.balance(T, "heat", inertia=C, terms=[-UA * (T - 291.3)], unit="W")
    m.output("speed", w, "rpm")
    m.output("room", T, "degC")
    m.declared_units |= {"pitch": "deg", "outside": "degC"}
    return m


def only_new(effect: Effect) -> ModelEquation:
    (equation,) = equations_of(effect.extend(room()), room()).changed
    return equation


def test_a_slope_per_degree_stands_beside_degrees() -> None:
    spread = Spread(2.0553 * DEGREE, 0.01, 0.06)
    equation = only_new(scheduled_parameter(room(), "k", "pitch", "rad", spread))
    assert "(k + slope_k_pitch * (pitch - 2.0553 deg))" in str(equation)
    assert r"\left(\mathrm{pitch} - \text{2.0553 deg}\right)" in equation.latex()
    assert "<mi>pitch</mi><mo>\u2212</mo><mi>2.0553 deg</mi>" in equation.terms[-1].mathml


@pytest.mark.parametrize(
    ("effect", "text"),
    [
        (lambda m: coulomb_friction(m, "torque", 0.1), "tanh(w / (0.95493 rpm))"),
        (lambda m: extra_input(m, "torque", "outside", "K", 283.15), "(outside - 10 degC)"),
        (lambda m: bent(m, "k", "th", (10.0 * DEGREE) ** 2), "(k - (100 deg^2) * curvature_k_th)"),
        (lambda m: bent(m, "UA", "T", 4.0, power=1), "slope_UA_T * (|T| - 4 K)"),
    ],
)
def test_numbers_have_the_units_of_their_neighbours(effect: Any, text: str) -> None:
    """Of a level that is subtracted degC, of the size of a difference K."""
    assert text in str(only_new(effect(room())))


def bent(m: casid.Model, name: str, state: str, mean: float, power: int = 2) -> Effect:
    return state_scheduled_parameter(m, name, state, Motion(mean, 0.0, 3 * mean, mean), power)


def test_the_models_own_numbers_have_units_too_and_factors_have_none() -> None:
    m = room()
    T, x = m.symbol("T"), m.symbol("th")
    m.add_term("heat", 0.37 * m.symbol("UA") * ca.fmax(T, 303.15) * (1 + ca.sin(x)))
    heat = next(e for e in equations_of(m).after if e.name == "heat")
    assert [t.text for t in heat.terms] == [
        "-UA * (T - 18.15 degC)",
        "0.37 * UA * max(T, 30 degC) * (1 + sin(th))",
    ]
