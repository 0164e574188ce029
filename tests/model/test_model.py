"""The model: solved as its equations stand, extended without change, refused with a mend."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from casid.errors import ModelError
from casid.model.declarations import Parameter
from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    cubic_stiffness,
    offset,
    quadratic_damping,
)
from casid.model.explicit_form import solved_for
from casid.model.model import Model


def oscillator() -> Model:
    m = Model("oscillator")
    q, v = m.state("q", "m"), m.state("v", "m/s")
    F = m.input("F", "N")
    M, d, k = m.parameter("M", "kg"), m.parameter("d", "N s/m"), m.parameter("k", "N/m")
    m.derivative(q, v)
    m.balance(v, "force", inertia=M, terms=[F, -d * v, -k * q])
    m.output("q", q, "m")
    return m


def rates(model: Model, x, u, **values):
    e = model.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    return np.array(f(x, u, [values[n] for n in e.parameters])).ravel()


def test_a_balance_divided_by_its_inertia_is_the_rate():
    got = rates(oscillator(), [0.3, -0.7], [1.1], M=2.0, d=0.5, k=3.0)
    np.testing.assert_allclose(got, [-0.7, (1.1 + 0.5 * 0.7 - 3.0 * 0.3) / 2.0], rtol=1e-15)


def test_coupled_inertias_are_solved_together():
    """[[a, c], [c, b]] [v1'; v2'] = [F; 0]: derivatives may stand in each other's balances."""
    m = Model("two masses joined by a massive link")
    v, w = m.state("v", "m/s"), m.state("w", "m/s")
    F = m.input("F", "N")
    a, b, c = m.parameter("a", "kg"), m.parameter("b", "kg"), m.parameter("c", "kg")
    m.balance(v, "first", inertia=a, terms=[F, -c * m.der(w)])
    m.balance(w, "second", inertia=b, terms=[-c * m.der(v)])
    m.output("v", v, "m/s")
    got = rates(m, [0.0, 0.0], [1.3], a=2.0, b=3.0, c=0.5)
    np.testing.assert_allclose(got, np.linalg.solve([[2.0, 0.5], [0.5, 3.0]], [1.3, 0.0]))


def test_a_derivative_in_an_output_is_the_solved_one():
    m = oscillator()
    m.output("accel", m.der("v"), "m/s^2")
    e = m.explicit()
    h = ca.Function("h", [e.x, e.u, e.p], [e.h])
    p = [{"M": 2.0, "d": 0.5, "k": 3.0}[n] for n in e.parameters]
    assert float(h([0.3, -0.7], [1.1], p)[1]) == pytest.approx((1.1 + 0.35 - 0.9) / 2.0)


@pytest.mark.parametrize("make", [quadratic_damping, offset, cubic_stiffness])
def test_an_extended_model_at_the_null_value_is_the_model(make):
    base = oscillator()
    effect = make(base, "force")
    extended = base.extend(effect)
    name = effect.parameters[0].name
    values = {"M": 2.0, "d": 0.5, "k": 3.0}
    np.testing.assert_allclose(
        rates(extended, [0.3, -0.7], [1.1], **values, **{name: 0.0}),
        rates(base, [0.3, -0.7], [1.1], **values),
        rtol=1e-15,
    )
    assert name not in base.parameters


def test_friction_smoothed_below_no_speed_is_the_sign_of_the_rate():
    extended = oscillator().extend(coulomb_friction(oscillator(), "force", speed=1e-9))
    values = {"M": 2.0, "d": 0.0, "k": 0.0, "F_c": 0.4}
    for v in (-0.7, 0.7):
        assert rates(extended, [0.0, v], [0.0], **values)[1] == pytest.approx(-np.sign(v) * 0.2)


def test_copies_with_known_or_unknown_parameters_leave_the_model_alone():
    m = oscillator()
    known = m.with_known(M=2.0)
    assert known.parameters["M"].is_known
    assert not m.parameters["M"].is_known
    again = known.with_unknown("M")
    assert not again.parameters["M"].is_known
    assert again.parameters["M"].start == 2.0


def test_the_position_of_a_rate_is_the_state_it_is_the_derivative_of():
    assert oscillator().position_of("v") == "q"
    assert oscillator().position_of("q") is None


def test_a_constant_is_known_and_marked_as_one():
    m = Model("falling")
    m.constant("g", 9.81, "m/s^2")
    assert m.parameters["g"].is_known
    assert m.parameters["g"].is_constant


def test_a_model_prints_its_equations():
    text = str(oscillator())
    assert "1 input" in text
    assert "force" in text
    assert "[N]" in text


# -- refusals ----------------------------------------------------------------------------------


def test_a_state_without_an_equation_is_refused():
    m = Model("half a model")
    x = m.state("x", "m")
    m.output("x", x, "m")
    with pytest.raises(ModelError, match=r"state x has no equation; state one with derivative"):
        m.explicit()


def test_a_model_without_a_state_is_refused_with_what_fits_it():
    m = Model("static")
    u = m.input("u", "V")
    m.output("y", m.parameter("a", "1") * u, "V")
    with pytest.raises(ModelError, match="has no state.*casid.regress"):
        m.explicit()


def test_two_equations_for_a_state_are_refused():
    m = oscillator()
    with pytest.raises(ModelError, match=r"state v has two equations; drop one"):
        m.derivative(m.symbol("v"), m.symbol("F"))


def test_a_name_declared_twice_is_refused():
    m = oscillator()
    with pytest.raises(ModelError, match=r"'k' declared twice; give it another name"):
        m.parameter("k", "N/m")


def test_an_inertia_that_vanishes_is_refused():
    m = Model("massless")
    v = m.state("v", "m/s")
    F, M = m.input("F", "N"), m.parameter("M", "kg")
    m.balance(v, "force", inertia=M - M, terms=[F])
    m.output("v", v, "m/s")
    with pytest.raises(ModelError, match=r"do not determine der_v.*inertia must not be zero"):
        m.explicit()


@pytest.mark.parametrize("size", [1e-15, 1.0, 1e15])
def test_an_inertia_is_judged_in_whatever_unit_and_rounding_errors_are_none(size):
    """A volume over the modulus of its oil is 1e-15 m^3/Pa; a sum that cancels leaves as much."""
    m = Model("cylinder")
    p = m.state("p", "Pa")
    q, V, A = m.input("q", "m^3/s"), m.parameter("V", "m^3"), m.parameter("A", "m^3")
    m.balance(p, "flow", inertia=size * (V + A), terms=[q])
    m.output("p", p, "Pa")
    assert m.explicit().states == ("p",)
    m = Model("no volume")
    p = m.state("p", "Pa")
    q, V, A = m.input("q", "m^3/s"), m.parameter("V", "m^3"), m.parameter("A", "m^3")
    m.balance(p, "flow", inertia=size * ((V + A) / 3 - V / 3 - A / 3), terms=[q])
    m.output("p", p, "Pa")
    with pytest.raises(ModelError, match="inertia must not be zero"):
        m.explicit()


def test_a_mistyped_parameter_is_answered_with_the_nearest():
    m = Model("long names")
    m.parameter("stiffness", "N/m")
    with pytest.raises(ModelError, match=r"did you mean 'stiffness'"):
        m.with_known(stifness=1.0)


def test_a_hold_that_is_none_is_refused():
    with pytest.raises(ModelError, match=r"use 'zoh', 'foh' or 'bandlimited'"):
        Model("m").input("F", "N", hold="linear")  # type: ignore[arg-type]


def test_bounds_are_checked_when_a_parameter_is_declared():
    with pytest.raises(ModelError, match=r"above the upper bound .*exchange them"):
        Parameter("k", "N/m", 1.0, 2.0, 0.0)
    with pytest.raises(ModelError, match=r"outside its bounds .*move the start inside"):
        Parameter("k", "N/m", 5.0, 0.0, 2.0)


def test_only_an_unknown_input_is_eliminated():
    m = oscillator()
    with pytest.raises(ModelError, match=r"'F' is not an unknown input; declare it with"):
        m.eliminate("F", using="q")


def test_an_input_that_moves_what_is_measured_later_is_not_eliminated_and_says_what_to_do():
    m = Model("belt drive")
    angle, rate = m.state("angle", "rad"), m.state("rate", "rad/s")
    torque = m.unknown_input("torque", "N m")
    m.derivative(angle, rate)
    m.balance(rate, "motor", inertia=m.parameter("J", "kg m^2"), terms=[torque])
    m.output("motor", angle, "rad")
    with pytest.raises(ModelError, match=r"as an accelerometer.*--disturbance torque:first"):
        m.eliminate(torque, using="motor")


def test_a_rate_of_an_input_is_an_input_of_its_own():
    m = oscillator()
    with pytest.raises(ModelError, match=r"'F' is not a state; .*recorded or computed from it"):
        m.der("F")


def test_an_unknown_input_left_in_a_model_is_refused_before_estimating():
    from casid.data.experiment import Experiment
    from casid.data.record import Record
    from casid.estimation.simulation.records.signals import signals_of

    m = Model("mass in the wind")
    v, w = m.state("v", "m/s"), m.unknown_input("w", "N")
    m.balance(v, "force", inertia=m.parameter("M", "kg"), terms=[w])
    m.output("v", v, "m/s")
    record = Record({"v": np.zeros(50)}, {"v": "m/s"}, Ts=0.1)
    with pytest.raises(ModelError, match=r"input w is unknown; eliminate it"):
        signals_of(m, Experiment(record, {}, "r"))


def test_an_input_is_eliminated_with_an_output_that_feels_it_through_a_derivative_alone() -> None:
    """An accelerometer on mass 1 shows the unknown force on it, once the balance is read back."""
    m = Model("two masses")
    x1, v1 = m.state("x1", "m"), m.state("v1", "m/s")
    x2, v2 = m.state("x2", "m"), m.state("v2", "m/s")
    f = m.unknown_input("f", "N")
    k, M1, M2 = m.parameter("k", "N/m"), m.parameter("M1", "kg"), m.parameter("M2", "kg")
    m.derivative(x1, v1)
    m.derivative(x2, v2)
    m.balance(v1, "first", inertia=M1, terms=[k * (x2 - x1), f])
    m.balance(v2, "second", inertia=M2, terms=[k * (x1 - x2)])
    m.output("accel", m.der(v1), "m/s^2")
    m.output("position", x2, "m")
    e = m.eliminate(f, using="accel").explicit()
    rates = ca.Function("f", [e.x, e.u, e.p], [e.f])
    x = [0.1, 0.2, 0.3, 0.4]
    assert np.array(rates(x, [5.0], [2.0, 3.0, 4.0])).ravel() == pytest.approx(
        [0.2, 5.0, 0.4, 2.0 * (0.1 - 0.3) / 4.0]
    )


def test_an_output_that_takes_the_place_of_an_input_has_a_course_between_its_samples() -> None:
    """An accelerometer behind an anti-alias filter is band-limited, whatever it is solved for."""
    m = Model("two floors")
    v, w = m.state("v", "m/s"), m.state("w", "m/s")
    f, d = m.unknown_input("f", "N"), m.parameter("d", "N s/m")
    m.balance(v, "lower", inertia=m.constant("m_1", 2.0, "kg"), terms=[f])
    m.balance(w, "upper", inertia=m.constant("m_2", 1.0, "kg"), terms=[-d * w, -m.der(v)])
    m.output("a", m.der(v), "m/s^2")
    m.output("w", w, "m/s")
    assert m.eliminate(f, using="a").inputs["a"].hold == "foh"
    assert m.eliminate(f, using="a", hold="bandlimited").inputs["a"].hold == "bandlimited"
    with pytest.raises(ModelError, match=r"input a: hold='smooth' is not known; use 'zoh', 'foh'"):
        m.eliminate(f, using="a", hold="smooth")  # type: ignore[arg-type]


def test_a_position_measured_from_a_moving_ground_is_said_to_cancel() -> None:
    """The floor's accelerometer shows the sum of its own and of the ground's acceleration.

    So does its balance, which holds neither once the one is solved for the other.
    """
    m = Model("floor on a shaking ground")
    x, v, ground = m.state("x", "m"), m.state("v", "m/s"), m.unknown_input("ground", "m/s^2")
    k, M = m.parameter("k", "N/m"), m.constant("M", 2.0, "kg")
    m.derivative(x, v)
    m.balance(v, "floor", inertia=M, terms=[-k * x, -M * ground])
    m.output("accel", m.der(v) + ground, "m/s^2")
    m.output("x", x, "m")
    with pytest.raises(ModelError, match=r"with ground eliminated it cancels.*from a fixed point"):
        m.eliminate(ground, using="accel")


def test_an_inertia_that_is_nearly_zero_at_one_point_by_chance_is_no_zero():
    """A determinant of coupled inertias is a difference, which some values all but annul.

    Of these differences many are nearly zero at a point where the elimination looks, and none of
    them vanishes.
    """
    rate, force, inertia = (ca.SX.sym(name) for name in ("rate", "force", "inertia"))
    for chance in np.arange(1.35, 1.40, 2e-4):
        solution = solved_for(rate, [(inertia - chance) * rate - force], "near zero", 0)
        assert ca.is_equal(solution, force / (inertia - chance), 4)
