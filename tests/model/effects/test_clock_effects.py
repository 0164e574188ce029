"""Constants that set in or grow, and knocks, against what they are on the clock of a record."""

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
    knock,
    offset_step,
)
from casid.model.effects.parameter_effects import parameter_jump
from casid.model.effects.search_ranges import PARAMETER_JUMPS

Array = np.ndarray

TS, N, MASS, AT = 0.1, 200, 2.0, 7.0
T = TS * np.arange(N)


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


def test_a_bias_sets_in_at_its_instant_or_grows_from_nothing():
    stepped = speed(bias_step(cart(), "speed", AT).extend(cart()), bias_speed=0.2)
    assert stepped[T < AT - TS] == pytest.approx(0.0)
    assert stepped[T > AT + TS] == pytest.approx(0.2)
    drifting = speed(bias_drift(cart(), "speed", (0.0, 10.0)).extend(cart()), drift_speed=0.4)
    assert drifting == pytest.approx(0.04 * T)


@pytest.mark.parametrize(
    "effect",
    [
        offset_step(cart(), "force", AT),
        bias_step(cart(), "speed", AT),
        knock(cart(), "force", AT, TS),
    ],
    ids=["offset", "bias", "knock"],
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
    found = [(e.where, e.shape) for e in clock_effects_of(m, (0.0, 20.0))]
    assert found.count(("push", "step")) == PARAMETER_JUMPS.times_of_biases
    assert found.count(("push", "drift")) == 1
    assert "command" not in dict(found)


def test_every_balance_and_every_output_has_its_instants():
    found = [(e.kind, e.shape) for e in clock_effects_of(cart(), (0.0, 20.0))]
    assert found.count(("offset", "step")) == PARAMETER_JUMPS.times
    assert found.count(("sensor_bias", "step")) == PARAMETER_JUMPS.times_of_biases
    assert found.count(("sensor_bias", "drift")) == 1
