"""Balances whose rates are the components of one vector, and what opposes it as a whole."""

from __future__ import annotations

import casadi as ca
import pytest

import casid
from casid.diagnosis.verdict.sentences import says
from casid.model.dimensions import check_units
from casid.model.effects.balances.balance_effects import coulomb_friction, quadratic_damping
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import Sizes
from casid.model.effects.places.elements import elements_of
from casid.model.effects.places.places import place_named
from casid.model.effects.places.planes import planes_of

SIZES = Sizes({}, {}, (0.0, 10.0), 0.1)


def puck(*, is_joined: bool = False, is_square: bool = True) -> casid.Model:
    """A body that slides in a plane, on springs; or two bodies of one mass on one line."""
    m = casid.Model("puck")
    x, y = m.state("x", "m"), m.state("y", "m")
    vx, vy = m.state("vx", "m/s"), m.state("vy", "m/s")
    fx, fy = m.input("fx", "N"), m.input("fy", "N")
    mass, k = m.parameter("mass", "kg", start=2.0), m.parameter("k", "N/m", start=3.0)
    other = mass if is_square else m.constant("other", 3.0, "kg")
    m.derivative(x, vx)
    m.derivative(y, vy)
    pull = k * (x - y) if is_joined else k * x
    m.balance(vx, "along", inertia=mass, terms=[fx, -pull])
    m.balance(vy, "across", inertia=other, terms=[fy, pull if is_joined else -k * y])
    m.output("px", x, "m")
    m.output("py", y, "m")
    return m


def machine() -> casid.Model:
    """A winding in axes that turn with its shaft, with one inductance in each."""
    m = casid.Model("machine")
    i_d, i_q, w = m.state("i_d", "A"), m.state("i_q", "A"), m.state("w", "rad/s")
    vd, vq = m.input("vd", "V"), m.input("vq", "V")
    R = m.parameter("R", "ohm", start=0.6)
    Ld, Lq = m.parameter("Ld", "H", start=3e-3), m.parameter("Lq", "H", start=5e-3)
    psi, J = m.parameter("psi", "Wb", start=0.1), m.parameter("J", "kg m^2", start=2e-3)
    m.balance(i_d, "d_axis", inertia=Ld, terms=[vd, -R * i_d, w * Lq * i_q])
    m.balance(i_q, "q_axis", inertia=Lq, terms=[vq, -R * i_q, -w * Ld * i_d, -w * psi])
    m.balance(w, "shaft", inertia=J, terms=[psi * i_q])
    m.output("id", i_d, "A")
    return m


def test_currents_that_a_rotation_couples_are_one_vector():
    (plane,) = planes_of(machine(), elements_of(machine()))
    assert plane.where == "i_d and i_q"
    assert [row for row, _ in plane.shares] == ["d_axis", "q_axis"]
    dead = [e for e in catalogue(machine(), SIZES, {}) if e.where == plane.where]
    assert [e.kind for e in dead] == ["coulomb_friction"]
    assert "dead voltage" in says(dead[0])


def test_a_body_in_a_plane_has_one_friction_and_one_drag_for_its_whole_motion():
    found = [e for e in catalogue(puck(), SIZES, {}) if e.where == "vx and vy"]
    assert {e.kind for e in found} == {"coulomb_friction", "quadratic_damping"}
    for effect in found:
        check_units(effect.extend(puck(), starts={effect.parameters[0].name: 1.0}))


@pytest.mark.parametrize("model", [puck(), machine()])
def test_a_vector_is_found_in_the_model_that_has_its_friction_too(model: casid.Model):
    """The sharpness of its reversal is sought there."""
    (plane,) = planes_of(model, elements_of(model))
    dry = coulomb_friction(model, plane, 0.1)
    again = place_named(dry.extend(model, starts={dry.parameters[0].name: 1.0}), plane.where)
    assert [row for row, _ in again.shares] == [row for row, _ in plane.shares]


@pytest.mark.parametrize("model", [puck(is_joined=True), puck(is_square=False)])
def test_two_bodies_on_one_line_are_no_vector(model: casid.Model):
    assert planes_of(model, elements_of(model)) == []


@pytest.mark.parametrize(("law", "size"), [(coulomb_friction, 1.0), (quadratic_damping, 25.0)])
def test_a_resistance_along_a_vector_opposes_its_direction(law, size):
    """At the velocity (3, 4) the force is (3, 4)/5 times that of the speed 5."""
    m = puck()
    plane = place_named(m, "vx and vy")
    effect = law(m, plane, 0.01) if law is coulomb_friction else law(m, plane)
    at = {"vx": 3.0, "vy": 4.0, effect.parameters[0].name: 1.0}
    new = effect.extend(m)
    for name, share in (("along", 0.6), ("across", 0.8)):
        force = new.balances[name].terms[-1]
        symbols = ca.symvar(force)
        f = ca.Function("f", symbols, [force])
        values = [at[s.name()] for s in symbols]
        assert float(f(*values)) == pytest.approx(-share * size, rel=1e-9)
