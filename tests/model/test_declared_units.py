"""Units of a model: numbers are given and shown in the unit beside them, and are SI inside."""

from __future__ import annotations

import numpy as np
import pytest

from casid.errors import ModelError, UnitError
from casid.estimation.noise.forces import shown_force
from casid.model.declarations import Parameter
from casid.model.declared_units import unit_in_balance
from casid.model.dimensions import check_units
from casid.model.effects.balances.balance_effects import coulomb_friction, deadzone, offset
from casid.model.effects.channels.channel_effects import sensor_bias
from casid.model.effects.user_effects import balance_effect, user_effects
from casid.model.model import Model
from casid.model.units import same_dimension


def test_numbers_are_kept_in_si_and_the_declared_unit_is_remembered():
    m = Model("spring")
    x = m.state("x", "mm", start=2.0)
    m.parameter("k", "N/mm", start=15.0, lower=1.0, upper=40.0)
    m.constant("T", 20.0, "degC")
    m.output("gauge", x, "mm")
    k = m.parameters["k"]
    assert (k.start, k.lower, k.upper, k.unit) == (15e3, 1e3, 40e3, "N/m")
    assert m.parameters["T"].value == 293.15
    assert m.states["x"].start == pytest.approx(2e-3)
    assert m.outputs["gauge"][1] == "m"
    assert m.declared_units == {"x": "mm", "k": "N/mm", "T": "degC", "gauge": "mm"}
    assert m.unit_of("k") == "N/mm"


def test_a_state_that_starts_at_nothing_starts_at_zero_of_its_own_unit():
    m = Model("room")
    m.state("T", "degC")
    assert m.states["T"].start == 273.15


def test_values_by_name_are_in_the_declared_unit():
    m = Model("spring")
    m.parameter("k", "N/mm", start=15.0)
    m.parameter("m", "kg", start=2.0)
    assert m.with_known(k=12.0, m=3.0).parameters["k"].value == 12e3
    assert m.with_unknown(k=9.0).parameters["k"].start == 9e3
    assert m.in_declared_units(m.in_si({"k": 12.0, "m": 3.0})) == {"k": 12.0, "m": 3.0}
    assert m.taking_si().with_known(k=12e3).parameters["k"].value == 12e3


@pytest.mark.parametrize(
    ("state", "inertia", "input_unit", "coefficient", "expected"),
    [
        ("m/s", "kg", "N", "N s/m", "N"),
        ("rpm", "kg m^2", "N m", "N m s/rad", "N m"),
        ("deg/s", "kg m^2", "mNm", "N m s/rad", "N m"),
        ("degC", "kWh/K", "kW", "W/K", "W"),
        ("A", "mH", "V", "ohm", "V"),
        ("bar", "L/bar", "L/min", "L/(min bar)", "m^3/s"),
    ],
)
def test_a_balance_has_the_unit_of_its_terms(state, inertia, input_unit, coefficient, expected):
    m = Model("first order")
    x, u = m.state("x", state), m.input("u", input_unit)
    C, c = m.parameter("C", inertia), m.parameter("c", coefficient)
    m.balance(x, "balance", inertia=C, terms=[u, -c * x])
    assert m.balances["balance"].unit == expected
    check_units(m)


def test_the_odd_one_out_is_the_term_that_is_refused():
    m = Model("room")
    T, P = m.state("T", "degC"), m.input("P", "kW")
    C, H = m.parameter("C", "J/K"), m.parameter("H", "W/m")
    m.balance(T, "heat", inertia=C, terms=[P, -H * T])
    with pytest.raises(ModelError, match=r"term 2 of balance 'heat' .* should be in W"):
        check_units(m)


def test_an_output_that_converts_itself_is_refused():
    """Expressions are in SI: the factor would be applied twice."""
    m = Model("shaft")
    w = m.state("w", "rad/s")
    with pytest.raises(ModelError, match=r"multiplies by 9\.5493.*leave the factor out"):
        m.output("speed", w * 30 / np.pi, "rpm")
    m.output("speed", w, "rpm")


def test_a_unit_that_cannot_be_read_is_refused_where_it_is_declared():
    with pytest.raises(UnitError, match="Nearest"):
        Model("m").parameter("k", "newtons/mm")


def rotor() -> Model:
    m = Model("rotor")
    phi, w = m.state("phi", "deg"), m.state("w", "rpm")
    J, k = m.parameter("J", "kg m^2"), m.parameter("k", "N m/rad")
    m.derivative(phi, w)
    m.balance(w, "torque", inertia=J, terms=[-k * phi])
    m.output("angle", phi, "deg")
    return m


@pytest.mark.parametrize("size", [0.5, 1.0, 2.0, 0.037])
def test_whole_and_half_sizes_of_rounding_agree_with_the_units(size):
    m = rotor()
    check_units(m.extend(coulomb_friction(m, "torque", speed=size)))
    play = deadzone(m, "torque", width=size)
    assert play is not None
    check_units(m.extend(play))


def test_a_bias_is_shown_in_the_unit_of_its_channel():
    extended, (name,) = sensor_bias(rotor(), "angle").extended(rotor())
    assert extended.parameters[name].unit == "rad"
    assert extended.unit_of(name) == "deg"


def test_a_users_effect_may_have_units_of_its_own():
    m = rotor()
    shape = Parameter("w_0", "rpm", 60.0, value=60.0)
    made = balance_effect(
        "drag", "torque", lambda s: -s.c * s.w / s.w_0, parameter="c", unit="mNm", further=[shape]
    )
    (effect,) = user_effects(m, [made])
    assert effect.parameters[1].value == pytest.approx(2 * np.pi)
    extended, names = effect.extended(m, starts={"c": 2e-3})
    assert extended.parameters[names[0]].start == 2e-3
    assert [extended.unit_of(n) for n in names] == ["mNm", "rpm"]


def compartment(**given: str) -> Model:
    """Of volume V, emptied in proportion to its concentration."""
    m = Model("compartment")
    c, dose = m.state("c", "mg/L"), m.input("dose", "mg/h", known=True, hold="zoh")
    V, CL = m.parameter("V", "L", start=12.0), m.parameter("CL", "L/h", start=3.0)
    m.balance(c, "plasma", inertia=V, terms=[dose, -CL * c], **given)
    m.output("conc", c, "mg/L")
    return m


@pytest.mark.parametrize(("given", "unit"), [({}, "mg/h"), ({"unit": "g/h"}, "g/h")])
def test_what_acts_in_a_balance_is_shown_in_its_declared_unit(given, unit):
    """By default in that of an input among the terms; kept in SI, as all numbers are."""
    m = compartment(**given)
    assert (m.balances["plasma"].unit, m.balances["plasma"].shown_unit) == ("kg/s", unit)
    assert m.shown_units["plasma"] == unit
    new, (name,) = offset(m, "plasma").extended(m)
    assert (new.unit_of(name), new.parameters[name].unit) == (unit, "kg/s")
    size, shown = shown_force(m, "plasma", 1 / 3.6e9)  # 1 mg/h
    assert (size, shown) == (pytest.approx(1.0 if unit == "mg/h" else 1e-3), unit)


@pytest.mark.parametrize(
    ("si", "force", "coordinate", "of_force", "expected"),
    [
        ("kg/s", "mg/h", "mg/L", "kg/s", "mg/h"),
        ("m^3/s", "mg/h", "mg/L", "kg/s", "L/h"),
        ("m^6/(kg s)", "mg/h", "mg/L", "kg/s", "L^2/(mg h)"),
        ("N s^2/m^2", "kN", "mm/s", "N", "kN s^2/mm^2"),
        ("K", "mg/h", "mg/L", "kg/s", None),
        # An angle has no dimension, and is counted: a cube's coefficient is no torque.
        ("N m/rad^3", "kN m", "deg", "N m", "kN m/deg^3"),
        ("N m", "kN m", "deg", "N m", "kN m"),
        ("1/(rad^2 s^2)", "deg/s^2", "deg", "rad/s^2", "1/(deg^2 s^2)"),
        ("1/(rad^3 s^2)", "deg/s^2", "deg", "1/s^2", "1/(deg^2 s^2)"),
        ("1/s^2", "deg/s^2", "deg", "1/s^2", "deg/s^2"),
    ],
)
def test_the_unit_of_a_law_follows_from_force_and_coordinate(
    si, force, coordinate, of_force, expected
):
    found = unit_in_balance(si, force, [coordinate], of_force)
    assert found == expected
    assert found is None or same_dimension(found, si)


def test_a_balance_without_a_signal_is_shown_as_one_stated_before_it():
    """What flows between two compartments is shown in the unit of what flows into the first."""
    m = Model("two compartments")
    c1, c2, rate = m.state("c1", "mg/L"), m.state("c2", "mg/L"), m.input("rate", "mg/h")
    V, Q = m.parameter("V", "L", start=10.0), m.parameter("Q", "L/h", start=5.0)
    m.balance(c1, "central", inertia=V, terms=[rate, -Q * (c1 - c2)])
    m.balance(c2, "peripheral", inertia=V, terms=[Q * (c1 - c2)])
    m.output("conc", c1, "mg/L")
    assert [b.shown_unit for b in m.balances.values()] == ["mg/h", "mg/h"]


def test_a_derivative_alone_in_a_balance_has_no_unit_of_its_own():
    m = Model("coupled")
    r, p = m.state("r", "deg/s"), m.state("p", "deg/s")
    m.balance(p, "roll", inertia=m.constant("I", 2.0, "1"), terms=[-p / m.constant("T", 1.0, "s")])
    m.balance(r, "yaw", inertia=m.constant("J", 3.0, "1"), terms=[m.der(p), -m.der(r)])
    assert m.balances["yaw"].shown_unit == "deg/s^2"


@pytest.mark.parametrize(
    ("unit", "inertia", "expected"),
    [("deg/s", "1", "deg/s^2"), ("rpm", "1", "rpm/s"), ("rad/s", "1", ""), ("deg/s", "kg m^2", "")],
)
def test_an_angular_acceleration_is_shown_in_the_unit_of_its_rate(unit, inertia, expected):
    """A torque is in N m, and what turns a rate in deg/s without an inertia in deg/s^2."""
    m = Model("pitch")
    q = m.state("q", unit)
    J, T = m.constant("J", 1.0, inertia), m.constant("T", 1.0, "s")
    m.balance(q, "moment", inertia=J, terms=[-J * q / T])
    b = m.balances["moment"]
    assert b.shown_unit == (expected or b.unit)
    size, shown = shown_force(m, "moment", 2.0)
    factor = {"deg/s^2": 180 / np.pi, "rpm/s": 30 / np.pi}.get(shown, 1.0)
    assert size == pytest.approx(2.0 * factor)


def test_a_balance_in_si_leaves_the_units_of_effects_as_they_were():
    m = Model("spring")
    x, v = m.state("x", "mm"), m.state("v", "mm/s")
    m.derivative(x, v)
    m.balance(v, "force", inertia=m.parameter("M", "kg"), terms=[-m.parameter("k", "N/mm") * x])
    assert m.balances["force"].declared == ""
    assert m.shown_units == m.declared_units
