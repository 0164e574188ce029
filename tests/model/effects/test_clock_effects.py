"""What sets in, grows or knocks, against what it is on the clock of a record."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.clock_effects import (
    at_instant,
    bias_drift,
    bias_step,
    clock_effects_of,
    gain_step,
    knock,
    offset_step,
)
from casid.model.effects.effect import Effect
from casid.model.effects.parameter_effects import parameter_jump
from casid.model.effects.search_ranges import PARAMETER_JUMPS

Array = np.ndarray

TS, N, MASS, AT = 0.1, 200, 2.0, 7.0
T = TS * np.arange(N)
UNITS = {"push": "N", "speed": "m/s"}


def cart() -> casid.Model:
    """A mass that nothing holds, from rest: what acts on it shows as its velocity."""
    m = casid.Model("cart")
    v = m.state("v", "m/s", initial=0.0)
    m.balance(v, "force", inertia=MASS, terms=[0.0 * v], unit="N")
    m.output("speed", v, "m/s")
    return m


def speed(model: casid.Model, **values: float) -> Array:
    record = casid.Record({"speed": np.zeros(N)}, {"speed": "m/s"}, TS)
    known = {n: values.get(n, p.start) for n, p in model.parameters.items()}
    fixed = model.with_known(**known)
    criterion = SimulationError(fixed, [casid.Experiment(record, {}, "r")], weights=np.ones(1))
    return criterion.simulate(criterion.start, 0)[0][:, 0]


def test_a_force_that_sets_in_is_a_slope_from_its_instant_on():
    got = speed(offset_step(cart(), "force", AT).extend(cart()), F_0=3.0)
    # Held between samples, the instant is met to within half of one.
    assert got == pytest.approx(3.0 / MASS * np.maximum(T - AT, 0.0), abs=3.0 / MASS * TS)
    assert got[-1] == pytest.approx(3.0 / MASS * (T[-1] - AT), abs=3.0 / MASS * TS)


def test_a_force_that_ends_leaves_the_speed_that_it_gave():
    effect = offset_step(cart(), "force", AT, AT + 5.0)
    assert (effect.end, effect.cost) == (AT + 5.0, PARAMETER_JUMPS.cost_of_two)
    got = speed(effect.extend(cart()), F_0=3.0)
    assert got == pytest.approx(3.0 / MASS * np.clip(T - AT, 0.0, 5.0), abs=3.0 / MASS * TS)
    moved = at_instant(effect, cart(), 2.0, 3.0)
    assert (moved.variant, moved.end, moved.key) == (2.0, 3.0, effect.key)


def test_a_parameter_changes_back():
    pushed = casid.Model("pushed cart")
    v, F = pushed.state("v", "m/s", initial=0.0), pushed.parameter("F", "N", start=1.0)
    pushed.balance(v, "force", inertia=MASS, terms=[F], unit="N")
    pushed.output("speed", v, "m/s")
    effect = parameter_jump(pushed, "F", AT, AT + 5.0)
    got = speed(effect.extend(pushed), jump_F=3.0)
    expected = T / MASS + 3.0 / MASS * np.clip(T - AT, 0.0, 5.0)
    assert got == pytest.approx(expected, abs=3.0 / MASS * TS)
    assert effect.description == "the parameter F changes for a while"


def test_a_knock_leaves_its_impulse_over_the_mass():
    got = speed(knock(cart(), "force", AT, TS).extend(cart()), J_force=0.5)
    assert got[T < AT - TS] == pytest.approx(0.0)
    assert got[T > AT + 2 * TS] == pytest.approx(0.5 / MASS)


@pytest.mark.parametrize(
    ("unit", "impulse", "words"),
    [
        ("N", "N s", "a knock, a force that acts for an instant"),
        ("W", "J", "a heat flow that acts for an instant"),
        ("V", "V s", "a voltage that acts for an instant"),
    ],
)
def test_an_impulse_is_called_by_what_acts_for_an_instant(unit: str, impulse: str, words: str):
    m = casid.Model("store")
    z = m.state("z", "K" if "heat" in words else "1")
    m.balance(z, "store", inertia=1.0, terms=[m.input("f", unit)], unit=unit)
    effect = knock(m, "store", AT, TS)
    assert (effect.parameters[0].unit, effect.description) == (impulse, words)


def test_a_bias_sets_in_at_its_instant_or_grows_from_nothing():
    stepped = speed(bias_step(cart(), "speed", AT).extend(cart()), bias_speed=0.2)
    assert stepped[T < AT - TS] == pytest.approx(0.0)
    assert stepped[T > AT + TS] == pytest.approx(0.2)
    drifting = speed(bias_drift(cart(), "speed", (0.0, 10.0)).extend(cart()), drift_speed=0.4)
    assert drifting == pytest.approx(0.04 * T)


def pushed(*, known: bool = True, gain: bool = False) -> casid.Model:
    """The cart with a recorded push of 1 N, of which a parameter may say how much acts."""
    m = cart()
    push = m.input("push", "N", hold="zoh", known=known)
    b = m.parameter("b", "1", start=1.0) if gain else 1.0
    m.add_term("force", b * push)
    return m


def test_an_input_that_loses_a_fifth_of_its_effect_pushes_by_four_fifths_from_then_on():
    for known in (True, False):
        model = gain_step(pushed(known=known), "push", AT).extend(pushed(known=known))
        record = casid.Record({"push": np.ones(N), "speed": np.zeros(N)}, UNITS, TS)
        fixed = model.with_known(gain_push=-0.2)
        criterion = SimulationError(fixed, [casid.Experiment(record, {}, "r")], weights=np.ones(1))
        got = criterion.simulate(criterion.start, 0)[0][:, 0]
        expected = np.minimum(T, AT) / MASS + 0.8 * np.maximum(T - AT, 0.0) / MASS
        assert got == pytest.approx(expected, abs=0.2 * TS / MASS)


def test_a_sensor_whose_gain_changes_shows_more_of_its_reading_and_no_constant():
    moving = offset_step(cart(), "force", 0.0).extend(cart())
    plain = speed(moving, F_0=1.0)
    back = gain_step(moving, "speed", AT, AT + 5.0).extend(moving)
    got = speed(back, F_0=1.0, scale_speed=0.1)
    inside = (AT + TS < T) & (T < AT + 5.0 - TS)
    outside = (AT - TS > T) | (AT + 5.0 + TS < T)
    assert got[inside] == pytest.approx(1.1 * plain[inside])
    assert got[outside] == pytest.approx(plain[outside])


def test_a_gain_that_is_a_parameter_jumps_as_one():
    """b u with another b and b u with another gain of u are one thing, and listed once."""
    bare, own = (pushed(gain=gain) for gain in (False, True))
    gains = [[e.where for e in clock_effects_of(m, (0.0, 20.0)) if is_gain(e)] for m in (bare, own)]
    assert gains[0].count("push") == gains[0].count("speed") == PARAMETER_JUMPS.times
    assert set(gains[1]) == {"speed"}


def test_a_sensor_whose_gain_is_a_parameter_has_no_other():
    m = cart()
    c = m.parameter("c", "1", start=1.0)
    m.replace_output("speed", c * m.symbol("v"), "m/s")
    assert not any(is_gain(e) for e in clock_effects_of(m, (0.0, 20.0)))


def test_the_gain_of_a_temperature_has_no_zero_to_change_about():
    m = casid.Model("oven")
    temperature, outside = m.state("T", "K"), m.input("outside", "K")
    power = m.input("power", "W", known=True)
    m.balance(temperature, "heat", inertia=1e3, terms=[power, -2.0 * (temperature - outside)])
    m.output("thermometer", temperature, "K")
    assert {e.where for e in clock_effects_of(m, (0.0, 20.0)) if is_gain(e)} == {"power"}


def is_gain(effect: Effect) -> bool:
    return effect.kind == "sensor_scale"


@pytest.mark.parametrize(
    "effect",
    [
        gain_step(cart(), "speed", AT),
        offset_step(cart(), "force", AT),
        bias_step(cart(), "speed", AT),
        knock(cart(), "force", AT, TS),
    ],
    ids=["gain", "offset", "bias", "knock"],
)
def test_the_same_effect_at_another_instant_is_itself_there(effect):
    moved = at_instant(effect, cart(), AT + 2.0)
    assert (moved.key, moved.variant) == (effect.key, AT + 2.0)
    assert at_instant(moved, cart(), AT).constants == effect.constants
    assert moved.sets_in
    assert moved.is_on_the_clock


def test_a_jump_of_a_parameter_sets_in_too():
    model = cart()
    model.parameter("c", "N", start=1.0)
    assert at_instant(parameter_jump(model, "c", AT), model, 9.0).variant == 9.0


def test_a_measured_input_may_get_a_bias_and_a_known_one_has_none():
    m = cart()
    push, command = m.input("push", "N"), m.input("command", "N", known=True)
    m.add_term("force", push + command)
    every = clock_effects_of(m, (0.0, 20.0))
    found = [(e.where, e.shape) for e in every if e.kind == "sensor_bias"]
    assert found.count(("push", "step")) == PARAMETER_JUMPS.times_of_biases
    assert found.count(("push", "drift")) == 1
    assert "command" not in dict(found)


def test_every_balance_and_every_output_has_its_instants():
    found = [(e.kind, e.shape) for e in clock_effects_of(cart(), (0.0, 20.0))]
    assert found.count(("offset", "step")) == PARAMETER_JUMPS.times
    assert found.count(("sensor_bias", "step")) == PARAMETER_JUMPS.times_of_biases
    assert found.count(("sensor_bias", "drift")) == 1
