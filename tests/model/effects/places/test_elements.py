"""Relative motions: found from the terms of a model, with the balances that their forces enter."""

from __future__ import annotations

import casadi as ca
import pytest

import casid
from casid.diagnosis.verdict.sentences import says
from casid.errors import ModelError
from casid.model.dimensions import check_units
from casid.model.effects.balances.balance_effects import cubic_damping, cubic_stiffness, offset
from casid.model.effects.balances.periodic import periodic_disturbance
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import Sizes
from casid.model.effects.places.elements import elements_of
from casid.model.effects.places.place import balance_place
from casid.model.effects.places.places import place_named, places_of


def rig(ratio: float | None = None) -> casid.Model:
    """Two inertias on a shaft, their angles as states; the second behind a gear of `ratio`."""
    m = casid.Model("rig")
    w1, w2 = m.state("w1", "rad/s"), m.state("w2", "rad/s")
    a, b = m.state("a", "rad"), m.state("b", "rad")
    T = m.input("T", "N m")
    n = 1.0 if ratio is None else m.constant("n", ratio, "1")
    k, c = m.parameter("k", "N m/rad", start=30.0), m.parameter("c", "N m s/rad", start=0.02)
    J1, J2 = m.parameter("J1", "kg m^2", start=0.01), m.parameter("J2", "kg m^2", start=0.02)
    shaft = k * (a - n * b) + c * (w1 - n * w2)
    m.derivative(a, w1)
    m.derivative(b, w2)
    m.balance(w1, "motor", inertia=J1, terms=[T, -shaft])
    m.balance(w2, "load", inertia=J2, terms=[n * shaft])
    m.output("speed", w1, "rad/s")
    return m


def quarter_car() -> casid.Model:
    """Body and wheel, the tyre on a road whose height is an input; no name for its speed."""
    m = casid.Model("quarter car")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    y, w = m.state("y", "m"), m.state("w", "m/s")
    road = m.input("road", "m")
    k, c, t = (m.parameter(n, u) for n, u in (("k", "N/m"), ("c", "N s/m"), ("t", "N/m")))
    m.derivative(x, v)
    m.derivative(y, w)
    # Laid out as matrices would have it.
    body = -k * x + k * y - c * v + c * w
    m.balance(v, "body", inertia=m.parameter("M", "kg"), terms=[body])
    wheel = [k * x - k * y, c * v - c * w, t * (road - y)]
    m.balance(w, "wheel", inertia=m.parameter("m", "kg"), terms=wheel)
    m.output("travel", x - y, "m")
    return m


def car(speed: str) -> casid.Model:
    """The lateral motion of a car on linear tyres: at one speed, one a load case, or a recorded."""
    m = casid.Model("car")
    v, r, steer = m.state("v", "m/s"), m.state("r", "rad/s"), m.input("steer", "rad")
    V = {
        "constant": lambda: m.constant("V", 20.0, "m/s"),
        "load case": lambda: m.parameter("V", "m/s", value=20.0),
        "recorded": lambda: m.input("V", "m/s"),
    }[speed]()
    M, a, b = m.constant("M", 1500.0, "kg"), m.constant("a", 1.2, "m"), m.constant("b", 1.4, "m")
    front = m.parameter("C_f", "N/rad", start=5e4) * (steer - (v + a * r) / V)
    rear = -m.parameter("C_r", "N/rad", start=5e4) * (v - b * r) / V
    m.balance(v, "side", inertia=M, terms=[front, rear, -M * V * r])
    inertia = m.parameter("J", "kg m^2", start=2500.0)
    m.balance(r, "yaw", inertia=inertia, terms=[a * front, -b * rear])
    m.output("yaw_rate", r, "rad/s")
    return m


def walls() -> casid.Model:
    """A room and its wall; the wall's equation is stated as a derivative."""
    m = casid.Model("room")
    T, W = m.state("T", "K"), m.state("W", "K")
    outside, P = m.input("outside", "K"), m.input("P", "W")
    G, H, C = m.parameter("G", "W/K"), m.parameter("H", "W/K"), m.parameter("C", "J/K")
    m.balance(T, "air", inertia=m.parameter("A", "J/K"), terms=[P, G * (W - T), H * (outside - T)])
    m.derivative(W, G * (T - W) / C)
    m.output("room", T, "K")
    return m


def shares(place) -> list[tuple[str, str]]:
    return [(row, str(factor)) for row, factor in place.shares]


def test_a_shaft_is_one_element_of_two_balances_with_opposite_signs():
    (shaft,) = elements_of(rig())
    assert (shaft.where, shaft.position_name) == ("w1-w2", "a-b")
    assert shares(shaft) == [("motor", "1"), ("load", "-1")]
    assert (str(shaft.stiffness), str(shaft.damping)) == ("k", "c")


def test_a_gear_scales_the_motion_and_what_it_transmits_alike():
    """A torque on w1 - n w2 does no work on the gear: it enters the load n times, turned round."""
    (shaft,) = elements_of(rig(20.0))
    assert shaft.where == "w1-n*w2"
    assert shares(shaft) == [("motor", "1"), ("load", "(-n)")]


def test_a_motion_behind_a_gear_reads_as_one_would_write_it():
    m = casid.Model("drive")
    w, load = m.state("w", "rad/s"), m.state("load", "rad/s")
    n, c = m.constant("n", 20.0, "1"), m.parameter("c", "N m s/rad")
    J1, J2 = m.parameter("J1", "kg m^2"), m.parameter("J2", "kg m^2")
    drag = c * (load - w / n)
    m.balance(load, "arm", inertia=J2, terms=[-drag])
    m.balance(w, "motor", inertia=J1, terms=[m.input("T", "N m"), drag / n])
    m.output("speed", w, "rad/s")
    (mesh,) = elements_of(m)
    assert mesh.where == "load-w/n"
    assert mesh.words == "acts on load-w/n in arm and in motor times -1 / n"


def test_a_road_that_moves_makes_the_tyre_an_element_of_one_balance():
    suspension, tyre = elements_of(quarter_car())
    assert (suspension.where, suspension.position_name) == ("v-w", "x-y")
    assert shares(suspension) == [("body", "1"), ("wheel", "-1")]
    assert (tyre.where, tyre.velocity) == ("y-road", None)
    assert shares(tyre) == [("wheel", "1")]
    assert cubic_stiffness(quarter_car(), "y-road") is not None


@pytest.mark.parametrize("speed", ["load case", "recorded"])
def test_tyres_slip_by_an_angle_that_is_the_same_law_at_every_speed(speed):
    """A speed that differs or is recorded stays in the motion; a constant is divided out."""
    model = car(speed)
    front, rear = elements_of(model)
    assert (front.where, rear.where) == ("(v+a*r-V*steer)/V", "(v-b*r)/V")
    assert (front.velocity_unit, front.velocity_power(3), str(front.damping)) == ("1", "N", "C_f")
    assert shares(front) == [("side", "1"), ("yaw", "a")]
    names = ("v", "r", "steer", "V", "a")
    angle = ca.Function("f", [model.symbol(n) for n in names], [front.velocity])
    assert float(angle(1.0, 0.5, 0.1, 20.0, 1.2)) == pytest.approx(1.6 / 20 - 0.1)
    check_units(model.extend(cubic_damping(model, front.where)))
    front, _ = elements_of(car("constant"))
    assert (front.where, front.velocity_unit) == ("v+a*r-V*steer", "m/s")


def test_what_a_recorded_flow_carries_is_no_law_of_a_difference():
    """q (T - T_in) has a second factor, which scales no difference: no friction is in it."""
    m = casid.Model("collector")
    T, inlet, q = m.state("T", "K"), m.input("inlet", "K"), m.input("q", "m^3/s")
    c = m.parameter("c", "J/(m^3 K)", start=4e6)
    m.balance(T, "heat", inertia=m.parameter("C", "J/K"), terms=[-c * q * (T - inlet)])
    m.output("T_out", T, "K")
    assert elements_of(m) == []


def test_a_heat_flow_between_two_stores_enters_a_derivative_too():
    """A store without a balance takes what leaves the other, over its heat capacity."""
    model = walls()
    between, loss = elements_of(model)
    assert between.where == "T-W"
    assert [row for row, _ in between.shares] == ["air", "W"]
    C = model.symbol("C")
    factor = ca.Function("f", [C], [between.shares[1][1]])
    assert float(factor(4.0)) == pytest.approx(-0.25)
    assert loss.where == "T-outside"
    assert shares(loss) == [("air", "1")]


def test_terms_of_single_motions_are_no_elements():
    from problems import pendulum

    assert elements_of(pendulum.problem.model) == []


def test_an_angle_behind_a_gearbox_is_the_position_of_its_motor():
    m = casid.Model("motor")
    w, phi = m.state("w", "rad/s"), m.state("phi", "rad")
    m.derivative(phi, w / 20)
    m.balance(w, "torque", inertia=1.0, terms=[-m.parameter("b", "N m s/rad") * w])
    m.output("angle", phi, "rad")
    assert balance_place(m, "torque").position_name == "phi"


def test_a_place_that_the_model_does_not_have_is_refused_with_those_it_has():
    with pytest.raises(
        ModelError, match=r"no relative motion 'w2-w1'; known are: load, motor, w1-w2"
    ):
        place_named(rig(), "w2-w1")


@pytest.mark.parametrize("model", [rig(), rig(20.0), quarter_car(), walls()], ids=lambda m: m.name)
def test_every_effect_of_a_relative_motion_is_nothing_at_null_and_its_units_agree(model):
    sizes = Sizes(dict.fromkeys(model.states, 1.0), {}, (0.0, 10.0), 0.1, Ts=0.01)
    base = model.explicit()
    places = {p.where: p for p in elements_of(model)}
    found = [e for e in catalogue(model, sizes, {}) if e.where in places]
    assert {e.where for e in found} == set(places)
    for effect in found:
        extended, names = effect.extended(model)
        check_units(extended)
        e = extended.explicit()
        own = ca.vertcat(*[extended.symbol(n) for n in names])
        f = ca.substitute(e.f, own, ca.DM([extended.parameters[n].start for n in names]))
        added = ca.vertcat(ca.SX(0, 1), *[e.x[i] for i in range(base.x.numel(), e.x.numel())])
        symbols = [base.x, base.u, base.p, added]  # wherever a part is that nothing feels
        gap = ca.Function("gap", symbols, [f[: base.f.numel()] - base.f])
        at = [ca.DM([0.3 + 0.2 * i for i in range(s.numel())]) for s in symbols]
        assert float(ca.norm_inf(gap(*at))) < 1e-12


def test_what_a_relative_motion_adds_takes_from_one_body_what_it_gives_the_other():
    model = rig(20.0)
    extended, (name,) = cubic_stiffness(model, "w1-n*w2").extended(model)
    motor, load = (extended.balances[n].terms[-1] for n in ("motor", "load"))
    symbols = [extended.symbol(n) for n in ("a", "b", "n", name)]
    torques = ca.Function("t", symbols, [ca.vertcat(motor, load)])(0.5, 0.02, 20.0, 400.0)
    assert [float(t) for t in ca.vertsplit(torques)] == pytest.approx([-400 * 0.1**3, 20 * 0.4])


def test_a_constant_or_a_periodic_force_between_two_bodies_is_one_of_the_catalogue():
    """What the one gives the other takes; relative to an input it would be one in a balance."""
    model = rig(ratio=3.0)
    for effect in (offset(model, "w1-n*w2"), periodic_disturbance(model, "w1-n*w2", 2.0, (0, 9))):
        extended = model.extend(effect)
        check_units(extended)
        motor, load = (extended.balances[n].terms[-1] for n in ("motor", "load"))
        assert float(ca.evalf(ca.substitute(load / motor, extended.symbol("n"), 3.0))) == -3.0
        assert "in motor and in load times -n" in effect.description
        assert says(effect).endswith("acts in the relative motion w1-n*w2")
    assert [p.has_own_force for p in places_of(model)] == [True, True, True]
    tyre = {p.where: p for p in places_of(quarter_car())}["y-road"]
    assert not tyre.has_own_force


def reaction_wheel() -> casid.Model:
    """A wheel in a satellite: motor and bearing push the body back; it has no angle."""
    m = casid.Model("satellite")
    w, W = m.state("w", "rad/s"), m.state("W", "rad/s")
    T = m.input("T", "N m", known=True)
    Jb, Jw = m.parameter("Jb", "kg m^2", start=8.0), m.parameter("Jw", "kg m^2", start=0.02)
    b = m.parameter("b", "N m s/rad", start=4e-5)
    m.balance(w, "body", inertia=Jb, terms=[-(T - b * W)])
    m.balance(W, "wheel", inertia=Jw, terms=[T - b * W])
    m.output("w", w, "rad/s")
    m.output("W", W, "rad/s")
    return m


def test_friction_of_a_wheel_turns_its_carrier_though_the_wheel_has_no_angle():
    (bearing,) = elements_of(reaction_wheel())
    assert (bearing.where, shares(bearing)) == ("W", [("wheel", "1"), ("body", "-1")])


def test_friction_in_a_bearing_that_never_turns_back_is_a_torque_between_the_two():
    """No constant term of one balance is one: the body is pushed the other way."""
    ranges = {"w": (-1.0, 1.0), "W": (90.0, 110.0)}
    sizes = Sizes({"w": 1e-3, "W": 100.0}, {}, (0.0, 10.0), 0.1, Ts=0.01, ranges=ranges)
    found = [e for e in catalogue(reaction_wheel(), sizes, {}) if e.kind == "coulomb_friction"]
    assert {e.where for e in found} == {"body", "W"}


def test_a_motion_is_not_relative_to_an_input_scaled_by_what_is_estimated():
    """J (T - b w) / B, an addend of one balance, is a torque and friction: no motion w - T / b."""
    m = reaction_wheel()
    w, b, Jb, Jw = (m.symbol(n) for n in ("W", "b", "Jb", "Jw"))
    m.add_term("wheel", Jw / Jb * (m.symbol("T") - b * w))
    assert [p.where for p in elements_of(m)] == ["W"]


def test_a_motion_relative_to_an_input_by_a_quotient_of_constants_is_written_with_their_names():
    """v^2 (R w/v - l)^2 = (R w - l v)^2: the torque of a rotor that turns beside its ideal."""
    m = casid.Model("rotor")
    w, v = m.state("w", "rad/s"), m.input("v", "m/s")
    R, ideal = m.constant("R", 14.0, "m"), m.constant("l", 5.5, "1")
    c = m.parameter("c", "kg m", start=1e-3)
    m.balance(
        w,
        "torque",
        inertia=m.parameter("J", "kg m^2"),
        terms=[-c * v**2 * (R * w / v - ideal) ** 2],
    )
    m.output("speed", w, "rad/s")
    (place,) = elements_of(m)
    assert place.where == "w-l/R*v"
    w, v, R, ideal = (m.symbol(n) for n in ("w", "v", "R", "l"))
    assert ca.is_equal(place.velocity, w - ideal / R * v, 5)


def test_a_spring_is_tested_from_its_own_zero_and_from_where_the_machine_works():
    """A yacht that heels to one side rights itself about upright, not about its mean heel."""
    m = casid.Model("heel")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    m.derivative(phi, p)
    C = m.parameter("C", "1/s^2", start=2.0)
    m.balance(p, "torque", inertia=1, terms=[-C * phi], unit="rad/s^2")
    m.output("phi", phi, "rad")
    ranges = {"phi": (0.1, 0.4), "p": (-1.0, 1.0)}
    sizes = Sizes({"phi": 0.3, "p": 0.1}, {}, (0.0, 10.0), 0.1, Ts=0.01, ranges=ranges)
    found = [e for e in catalogue(m, sizes, {}) if e.kind == "cubic_stiffness"]
    assert {e.constants.get("about", 0.0) > 0 for e in found} == {True, False}


def test_a_twist_between_two_bodies_is_a_position_of_neither_alone():
    """Its spring acts on both; the angle of attack, which a lift of its own moves, is a pitch's."""
    m = casid.Model("drive train")
    w, g, twist = m.state("w", "rad/s"), m.state("g", "rad/s"), m.state("twist", "rad")
    k, J = m.parameter("k", "N m/rad", start=10.0), m.constant("J", 1.0, "kg m^2")
    m.derivative(twist, w - g)
    m.balance(w, "rotor", inertia=J, terms=[-k * twist])
    m.balance(g, "generator", inertia=J, terms=[k * twist])
    assert balance_place(m, "rotor").position is None
    assert balance_place(m, "generator").position is None

    a = casid.Model("aircraft")
    alpha, q = a.state("alpha", "rad"), a.state("q", "rad/s")
    Z, M = a.parameter("Z", "1/s", start=1.0), a.parameter("M", "1/s^2", start=5.0)
    a.balance(alpha, "lift", inertia=1, terms=[q, -Z * alpha])
    a.balance(q, "pitch", inertia=1, terms=[-M * alpha])
    assert balance_place(a, "pitch").position_name == "alpha"
