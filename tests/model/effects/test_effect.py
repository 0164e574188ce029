"""The catalogue follows the model's structure, and every effect acts as its physics says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import casid
from casid.diagnosis.verdict.sentences import says
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    cubic_stiffness,
    extra_input,
    extra_inputs_of,
    further_places_of_inputs,
    offset,
    quadratic_damping,
)
from casid.model.effects.catalogue import catalogue
from casid.model.effects.channels.actuator_effects import actuator_lag
from casid.model.effects.channels.channel_effects import saturation, sensor_bias
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.effect import Sizes, Spread, extend_all
from casid.model.effects.parameter_effects import jump_times, parameter_jump, scheduled_parameter
from casid.model.effects.search_ranges import PARAMETER_JUMPS
from problems import pendulum

SIZES = Sizes(
    rates={"phi": 0.1, "p": 0.5, "v": 1.0}, largest={"gyro": 2.0}, window=(0.0, 60.0),
    longest_delay=0.1,
)  # fmt: skip


SPREAD = Spread(1.5, 1.0, 2.0)


def oscillator(hold: str = "foh") -> casid.Model:
    m = casid.Model("oscillator")
    x, v = m.state("x", "m", initial=0.1), m.state("v", "m/s", initial=0.0)
    force = m.input("force", "N", hold=hold)
    k = m.parameter("k", "N/m", start=50.0)
    m.derivative(x, v)
    m.balance(v, "force balance", inertia=2.0, terms=[-k * x, -1.5 * v, force])
    m.output("position", x, "m")
    return m


def simulated(model: casid.Model, force: np.ndarray, Ts: float = 0.01, **values: float):
    record = casid.Record(
        {"force": force, "position": np.zeros_like(force)},
        {"force": "N", "position": "m"},
        Ts=Ts,
    )
    known = {n: values.get(n, p.start) for n, p in model.parameters.items()}
    model = model.with_known(**known)
    criterion = SimulationError(model, [casid.Experiment(record, {}, "r")], weights=np.ones(1))
    return criterion.simulate(criterion.start, 0)[0][:, 0]


def test_the_catalogue_has_every_kind_in_every_place_that_the_structure_allows():
    """Of balances and parameters: effects in channels and in the structure have their own tests."""
    effects = catalogue(pendulum.problem.model, SIZES, {"ref": "m/s^2", "speed": "m/s"})
    found = {e.key for e in effects}
    torque = {"quadratic_damping", "cubic_damping", "coulomb_friction", "stribeck_friction"}
    torque |= {"cubic_stiffness", "quadratic_stiffness", "deadzone", "end_stop", "offset"}
    wanted = {(kind, "torque") for kind in torque}
    wanted |= {("asymmetric_friction", f"torque: {shape}") for shape in ("dry", "viscous")}
    shapes = ("p^2", "sqrt|p|", "phi^5", "phi p", "phi^2 p", "hysteresis")
    wanted |= {("unknown", f"torque: {shape}") for shape in shapes} | {("unknown", "gyro: gyro^2")}
    wanted |= {("extra_input", "ref"), ("extra_input", "speed")}
    wanted |= {("offset", "torque: step")}
    # A known load may still appear; constants of nature and of geometry never jump.
    wanted |= {("parameter_jump", name) for name in ("k", "d", "I_x", "m")}
    wanted |= {("parameter_drift", name) for name in ("k", "d", "I_x")}
    families = {kind for kind, _ in wanted}
    assert {key for key in found if key[0] in families} == wanted
    wanted = {("saturation", "gyro")}
    wanted |= {(kind, c) for kind in ("sensor_bias", "time_delay") for c in ("gyro", "accel")}
    assert found >= wanted


def test_kinds_are_left_out_and_effects_of_a_users_own_put_in():
    model = pendulum.problem.model
    mine = dataclasses.replace(offset(model, "torque"), kind="my_own")
    every = catalogue(model, SIZES, {}, extra=[mine], without=["parameter_jump", "unknown"])
    kinds = {e.kind for e in every}
    assert "my_own" in kinds
    assert not kinds & {"parameter_jump", "unknown"}
    assert "deadzone" in kinds


def test_every_parameter_that_is_there_may_depend_on_every_recorded_channel():
    """The load is known to be absent: its product with a channel would be another effect."""
    sizes = dataclasses.replace(SIZES, channels={"speed": SPREAD})
    found = catalogue(pendulum.problem.model, sizes, {"speed": "m/s"})
    places = [e.where for e in found if e.kind == "scheduled_parameter"]
    assert sorted(places) == ["I_x~speed", "d~speed", "k~speed"]
    known = pendulum.problem.model.with_known(k=10.0)
    again = catalogue(known, sizes, {"speed": "m/s"})
    assert ("scheduled_parameter", "k~speed") in {e.key for e in again}


def test_jumps_are_searched_evenly_inside_the_window():
    times = jump_times((10.0, 36.0))
    assert len(times) == PARAMETER_JUMPS.times
    assert np.diff([10.0, *times, 36.0]) == pytest.approx(2.0)


def test_a_balance_without_a_position_has_no_stiffness():
    m = casid.Model("sliding mass")
    v = m.state("v", "m/s")
    m.balance(v, "force", inertia=1.0, terms=[-m.parameter("d", "N s/m") * v])
    m.output("speed", v, "m/s")
    assert cubic_stiffness(m, "force") is None


@pytest.mark.parametrize(
    ("make", "unit"),
    [
        (lambda m: quadratic_damping(m, "torque"), "N m s^2/rad^2"),
        (lambda m: coulomb_friction(m, "torque", 0.01), "N m"),
        (lambda m: cubic_stiffness(m, "torque"), "N m/rad^3"),
        (lambda m: offset(m, "torque"), "N m"),
        (lambda m: time_delay(m, "accel", 0.1), "s"),
        (lambda m: sensor_bias(m, "gyro"), "rad/s"),
        (lambda m: sensor_bias(m, "accel"), "m/s^2"),
        (lambda m: parameter_jump(m, "k", 3.0), "N m/rad"),
        (lambda m: scheduled_parameter(m, "d", "speed", "m/s", SPREAD), "N s^2/rad"),
    ],
)
def test_parameters_of_effects_have_the_unit_that_their_balance_needs(make, unit):
    from casid.model.units import parse_unit

    effect = make(pendulum.problem.model)
    assert parse_unit(effect.parameters[0].unit) == parse_unit(unit)


def test_dissipation_and_delays_have_one_sign():
    model = pendulum.problem.model
    for effect in (
        quadratic_damping(model, "torque"),
        coulomb_friction(model, "torque", 0.01),
        time_delay(model, "gyro", 0.1),
    ):
        assert effect.sided == "positive"
        assert effect.parameters[0].lower == 0.0
    assert cubic_stiffness(model, "torque").sided == "both"  # softening exists


def test_a_constant_force_at_rest_moves_the_mass_by_its_static_deflection():
    m = oscillator()
    model = m.extend(offset(m, "force balance"))
    y = simulated(model, np.zeros(3000), F_0=5.0)
    assert y[-1] == pytest.approx(5.0 / 50.0, rel=1e-4)  # exp(-0.375 * 30) = 1e-5 is left


def test_dry_friction_stops_a_decay_and_drag_never_does():
    """Friction takes 4 F_c / k an oscillation, drag a share that falls with the amplitude."""
    m = oscillator()
    frictional = m.extend(coulomb_friction(m, "force balance", 1e-3))
    force = np.zeros(600)
    y = simulated(frictional, force, F_c=0.5)
    free = simulated(m, force)
    period = round(2 * np.pi / 5 / 0.01)
    fall = (free - y)[period]
    assert fall == pytest.approx(4 * 0.5 / 50, rel=0.2)  # viscous damping weakens it in half a turn


def test_a_delayed_output_is_the_output_moved():
    m = oscillator()
    model = m.extend(time_delay(m, "position", 0.2))
    force = np.sin(np.arange(400) * 0.03)
    y, late = simulated(m, force), simulated(model, force, delay_position=0.05)
    assert late[20:] == pytest.approx(y[15:-5], abs=1e-12)


def test_an_input_that_was_recorded_late_is_moved_back():
    m = oscillator()
    model = m.extend(time_delay(m, "force", 0.2))
    force = np.sin(np.arange(400) * 0.03)
    recorded = np.concatenate([np.zeros(5), force[:-5]])
    y, back = simulated(m, force), simulated(model, recorded, delay_force=0.05)
    assert back[:390] == pytest.approx(y[:390], abs=1e-12)


def test_an_output_is_clipped_at_plus_and_minus_its_limit():
    m = oscillator()
    model = m.extend(saturation(m, "position", 0.05))
    y = simulated(m, np.zeros(300))
    clipped = simulated(model, np.zeros(300), limit_position=0.05)
    assert clipped == pytest.approx(np.clip(y, -0.05, 0.05), abs=1e-12)


def test_a_parameter_jumps_at_its_instant_and_not_before():
    m = oscillator()
    model = m.extend(parameter_jump(m, "k", 1.5))
    force = np.ones(300)
    y, jumped = simulated(m, force), simulated(model, force, jump_k=10.0)
    assert jumped[:150] == pytest.approx(y[:150], abs=1e-12)
    after = simulated(model, np.ones(4000), jump_k=10.0)
    assert after[-1] == pytest.approx(1.0 / 60.0, rel=1e-4)


def test_a_recorded_channel_acts_with_its_gain():
    m = oscillator()
    effect = extra_input(m, "force balance", "wind", "m/s")
    model = m.extend(effect)
    assert model.inputs["wind"].kind == "known"
    e = model.explicit()
    import casadi as ca

    slope = ca.jacobian(e.f, e.u[e.inputs.index("wind")])
    b = e.p[e.parameters.index("b_wind")]
    assert float(ca.substitute(slope[1], b, 3.0)) == pytest.approx(3.0 / 2.0)


def test_a_recorded_channel_in_another_unit_is_si_inside_and_has_its_own_unit_outside():
    model = oscillator().extend(extra_input(oscillator(), "force balance", "heat", "degC"))
    assert model.inputs["heat"].unit == "K"
    assert model.unit_of("heat") == "degC"


@pytest.mark.parametrize(
    ("unit", "reading", "points"),
    [
        ("m/s", Spread(0.5, -2.0, 6.0), [0.0]),
        ("m/s", Spread(5.0, 3.0, 8.0), [0.0, 5.0]),
        ("K", Spread(300.0, 295.0, 304.0), [300.0]),
    ],
)
def test_a_recorded_channel_acts_from_its_zero_or_from_an_operating_point(unit, reading, points):
    """Both where it stays away from zero; the zero of a temperature means nothing to a force."""
    m = oscillator()
    found = list(extra_inputs_of(m, "force balance", "beside", unit, reading))
    assert [e.constants.get("about", 0.0) for e in found] == points
    for effect, point in zip(found, points, strict=True):
        import casadi as ca

        e = m.extend(effect).explicit()
        u = e.u[e.inputs.index("beside")]
        at_rest = ca.substitute(e.f[1], ca.vertcat(e.x, u, e.u[0]), ca.vertcat(0, 0, point, 0))
        assert float(ca.substitute(at_rest, e.p, ca.DM.ones(e.p.numel()))) == pytest.approx(0.0)


def test_a_parameter_follows_a_channel_about_its_mean():
    """At the mean the model is as it was; x = F/k at rest, with k larger by 4 N/m for 2 m/s."""
    import casadi as ca

    m = oscillator()
    effect = scheduled_parameter(m, "k", "wind", "m/s", Spread(3.0, 1.0, 6.0))
    model = m.extend(effect)
    e = model.explicit()
    stiffness = -2.0 * ca.jacobian(e.f, e.x[e.states.index("x")])[1]
    wind, slope = e.u[e.inputs.index("wind")], e.p[e.parameters.index("slope_k_wind")]
    k = e.p[e.parameters.index("k")]
    for at, value in ((3.0, 50.0), (5.0, 54.0)):
        given = ca.substitute(stiffness, ca.vertcat(k, slope, wind), ca.DM([50.0, 2.0, at]))
        assert float(given) == pytest.approx(value)
    assert effect.span == (-2.0, 3.0)
    assert model.inputs["wind"].kind == "known"


def test_a_bias_of_an_input_is_taken_off_before_the_input_acts():
    m = oscillator()
    model = m.extend(sensor_bias(m, "force"))
    force = np.sin(np.arange(200) * 0.05)
    y = simulated(m, force)
    assert simulated(model, force + 0.7, bias_force=0.7) == pytest.approx(y, abs=1e-12)


def test_an_effect_added_twice_gets_names_of_its_own():
    m = oscillator()
    once, first = offset(m, "force balance").extended(m)
    _, second = offset(once, "force balance").extended(once)
    assert first == ("F_0",)
    assert second == ("F_0_2",)


def test_all_effects_together_at_their_null_values_are_the_model():
    m = oscillator()
    sizes = Sizes({"x": 0.1, "v": 1.0}, {}, (0.0, 3.0), 0.1, Ts=0.01)
    model, names = extend_all(m, catalogue(m, sizes, {}))
    assert len(set(names)) == len(names)
    force = np.sin(np.arange(300) * 0.05)
    assert simulated(model, force) == pytest.approx(simulated(m, force), abs=1e-9)


def test_extending_leaves_the_model_alone():
    m = oscillator()
    before = dict(m.parameters)
    m.extend(quadratic_damping(m, "force balance"))
    assert m.parameters == before


def test_a_channel_that_may_act_in_two_balances_is_two_candidates():
    """Of effects with one key the search refits only the most promising."""
    m = casid.Model("two rooms")
    T1, T2 = m.state("T1", "K"), m.state("T2", "K")
    C, G = m.parameter("C", "J/K", value=1e6), m.parameter("G", "W/K", start=50.0)
    m.balance(T1, "room", inertia=C, terms=[-G * (T1 - T2)], unit="W")
    m.balance(T2, "hall", inertia=C, terms=[G * (T1 - T2)], unit="W")
    m.output("T", T1, "K")
    sun = [extra_input(m, balance, "sun", "W/m^2") for balance in ("room", "hall")]
    assert [e.key for e in sun] == [("extra_input", "sun: room"), ("extra_input", "sun: hall")]
    assert says(sun[1]).endswith("the model omits, acts in the hall balance")
    assert {e.where for e in sun} == {"sun"}


@pytest.mark.parametrize(
    ("units", "shown"),
    [(("ms",), "ms"), (("h", "h"), "h"), (("s",), None), (("ms", "h"), None), ((), None)],
)
def test_a_delay_is_shown_in_the_unit_that_all_times_of_the_model_have(units, shown):
    m = casid.Model("store")
    x, u = m.state("x", "V"), m.input("u", "V", known=True)
    for i, unit in enumerate(units):
        m.parameter(f"tau_{i}", unit, start=3.0)
    tau = m.symbol("tau_0") if units else 3.0
    m.derivative(x, (u - x) / tau)
    m.output("y", x, "mV")
    for effect in (time_delay(m, "y", 1.0), time_delay(m, "u", 1.0), actuator_lag(m, "u", 1.0)):
        new, (name,) = effect.extended(m)
        assert new.declared_units.get(name) == shown


@pytest.mark.parametrize(
    ("lowest", "squared", "heats"), [(-3.0, True, True), (0.5, True, False), (-3.0, False, False)]
)
def test_a_current_that_heats_by_its_square_may_heat_by_its_direction_too(
    lowest: float, squared: bool, heats: bool
):
    """The Peltier heat, and the reversible heat of a cell, change their sign with the current.

    Of a current of one direction the two are nearly one; what a balance has in proportion to an
    input is scaled by its own parameters.
    """
    m = casid.Model("resistor")
    T, i = m.state("T", "K"), m.input("i", "A")
    R, h = m.parameter("R", "ohm", start=1.0), m.parameter("h", "W/K", start=1.0)
    V = m.constant("V", 1.0, "V")
    C = m.constant("C", 50.0, "J/K")
    m.balance(T, "heat", inertia=C, terms=[R * i * i if squared else V * i, -h * (T - 290.0)])
    m.output("T", T, "K")
    sizes = Sizes({"T": 300.0}, {}, (0.0, 1.0), 0.1, readings={"i": (lowest, 7.0)})
    found = list(further_places_of_inputs(m, sizes))
    assert [(e.kind, e.where) for e in found] == [("extra_input", "i")] * heats
    if heats:
        assert found[0].parameters[0].unit == "W/A"
        assert says(found[0]) == "the input i acts in the heat balance in proportion, too"
