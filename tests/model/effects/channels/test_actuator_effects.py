"""Commands that act up to a limit, or through play."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.errors import ModelError
from casid.estimation.simulation.channels.sensor_dynamics import play
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.actuator_effects import (
    actuator_effects_of,
    actuator_saturation,
    input_backlash,
    input_deadzone,
)
from casid.model.effects.effect import Effect, Sizes

Ts, N = 0.1, 400
T = np.arange(N) * Ts
COMMAND = np.sin(0.6 * T) + 0.4 * np.sin(1.7 * T)


def tank() -> casid.Model:
    """A level that follows a valve, tau dh/dt = u - h."""
    m = casid.Model("valve and tank")
    h = m.state("h", "m", initial=0.0)
    u = m.input("u", "m", known=True, hold="zoh")
    m.derivative(h, (u - h) / m.constant("tau", 2.0, "s"))
    m.output("level", h, "m")
    return m


def criterion(effect: Effect | None, values: tuple[float, ...] = ()) -> SimulationError:
    model, names = (tank(), ()) if effect is None else effect.extended(tank())
    if effect is not None and effect.kind == "actuator_saturation":
        model = model.with_known(**{names[1]: values[1]})
        names = names[:1]
    record = casid.Record({"u": COMMAND, "level": np.zeros(N)}, {"u": "m", "level": "m"}, Ts=Ts)
    start = dict(zip(names, values, strict=False))
    return SimulationError(
        model, [casid.Experiment(record, {}, "r")], weights=np.ones(1), start=start
    )


def simulated(effect: Effect | None, *values: float) -> np.ndarray:
    c = criterion(effect, values)
    return c.simulate(c.start, 0)[0][:, 0]


def level_under(acting: np.ndarray) -> np.ndarray:
    """The exact answer to a held input, sample by sample."""
    decay, h = np.exp(-Ts / 2.0), np.zeros(N)
    for k in range(N - 1):
        h[k + 1] = decay * h[k] + (1 - decay) * acting[k]
    return h


def after_play(gap: float, begins: float = 0.0) -> np.ndarray:
    """What a pin in a slot of half width `gap` does, from `begins` gaps beside the command."""
    w, acting = COMMAND[0] + begins * gap, []
    for u in COMMAND:
        w = min(max(w, u - gap), u + gap)
        acting.append(w)
    return np.array(acting)


def test_a_command_acts_up_to_its_limit():
    effect = actuator_saturation(tank(), "u", 0.7)
    y = simulated(effect, 1.0, 0.7)
    assert y == pytest.approx(level_under(np.clip(COMMAND, -0.7, 0.7)), abs=1e-6)
    assert simulated(effect, 0.0, 0.7) == pytest.approx(simulated(None), abs=1e-12)


def test_the_extended_model_clips_outright_and_estimates_the_limit():
    model, names = actuator_saturation(tank(), "u", 0.7).extended(
        tank(), starts={"saturated_u": 0.4}
    )
    blend, limit = (model.parameters[n] for n in names)
    assert (blend.start, blend.lower, blend.upper) == (1.0, 1.0, 1.0)
    assert not limit.is_known


def test_the_limit_has_a_standard_error_where_one_level_of_the_command_exceeds_it():
    """With the blend free, only its product with the excess would be determined."""
    model, (_, limit) = actuator_saturation(tank(), "u", 0.8).extended(
        tank(), starts={"saturated_u": 1.0}
    )
    command = np.where(T % 10 < 5, 1.0, -0.2)
    level, h = np.zeros(N), 0.0
    for k in range(N):
        level[k] = h
        h += (1 - np.exp(-Ts / 2.0)) * (min(command[k], 0.7) - h)
    level += 0.01 * np.random.default_rng(2).standard_normal(N)
    record = casid.Record({"u": command, "level": level}, {"u": "m", "level": "m"}, Ts=Ts)
    found = casid.identify(model, record)
    assert found.identifiability.undetermined == ""
    assert found.parameter(limit).std_error == pytest.approx(0.001, rel=0.5)
    assert found[limit] == pytest.approx(0.7, abs=4 * found.parameter(limit).std_error)


@pytest.mark.parametrize("gap", [0.1, 0.35])
def test_a_valve_with_play_moves_once_the_command_has_crossed_it(gap: float):
    y = simulated(input_backlash(tank(), "u", 1.0), gap)
    assert y == pytest.approx(level_under(after_play(gap)), abs=1e-6)
    assert np.max(np.abs(y - simulated(None))) > 0.3 * gap


@pytest.mark.parametrize("begins", [-1.0, 0.5, 1.0])
def test_play_begins_anywhere_between_its_contacts(begins: float):
    effect = input_backlash(tank(), "u", 1.0, begins=begins)
    y = simulated(effect, 0.35)
    assert y == pytest.approx(level_under(after_play(0.35, begins)), abs=1e-6)
    assert np.max(np.abs(y - simulated(input_backlash(tank(), "u", 1.0), 0.35))) > 0.01


def test_play_that_begins_beyond_its_contacts_is_refused():
    with pytest.raises(ModelError, match="begins=1.2 gaps beside the command; give -1 to 1"):
        input_backlash(tank(), "u", 1.0, begins=1.2)


def test_without_play_the_command_acts_as_it_is():
    assert simulated(input_backlash(tank(), "u", 1.0), 0.0) == pytest.approx(simulated(None))


@pytest.mark.parametrize(("gap", "begins"), [(0.0, 0.0), (0.2, 0.0), (0.2, -1.0), (0.0, 0.5)])
def test_the_sensitivity_to_play_is_its_derivative(gap: float, begins: float):
    """Of null on the side that exists: contacts change at isolated samples alone."""
    effect = input_backlash(tank(), "u", 1.0, begins=begins)
    c = criterion(effect, (gap,))
    i = c.names.index("gap_u")
    jacobian = c.simulated(c.start, 0).jacobian[:, 0, i]
    h, up = 1e-7, c.start
    up[i] += h
    slope = (c.simulate(up, 0)[0] - c.simulate(c.start, 0)[0])[:, 0] / h
    assert jacobian == pytest.approx(slope, abs=1e-5)
    assert np.max(np.abs(slope)) > 0.5


@pytest.mark.parametrize("gap", [0.0, 0.1, 0.35])
def test_a_valve_with_overlap_passes_what_exceeds_it(gap: float):
    effect = input_deadzone(tank(), "u", 1.0)
    acting = COMMAND - np.clip(COMMAND, -gap, gap)
    assert simulated(effect, gap) == pytest.approx(level_under(acting), abs=1e-6)
    c = criterion(effect, (gap,))
    slope = level_under(-np.sign(COMMAND) * (np.abs(COMMAND) > gap))
    jacobian = c.simulated(c.start, 0).jacobian[:, 0, c.names.index("gap_u")]
    assert jacobian == pytest.approx(slope, abs=1e-5)


@pytest.mark.parametrize(
    ("low", "high", "has_one"),
    [
        (-1.0, 1.0, True),
        (0.0, 1.0, True),
        (-1.0, 0.0, True),
        (0.3, 1.0, False),
        (-1.0, -0.3, False),
    ],
)
def test_a_command_has_a_dead_zone_where_it_comes_to_zero(low: float, high: float, has_one: bool):
    """Of a command that never comes near zero the dead zone would be a bias."""
    sizes = Sizes({"h": 1.0}, {"level": 1.0}, (0.0, 1e2), 1.0, readings={"u": (low, high)})
    found = [e for e in actuator_effects_of(tank(), sizes) if e.kind == "deadzone"]
    assert [e.where for e in found] == ["u"] * has_one


def stepped(seed: int, play: float = 0.0) -> casid.Record:
    """A tank under held levels, each of 20 samples, measured with noise of 0.02 like the tank's."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, 60), 20)
    acting, w = [], u[0]
    for command in u.tolist():
        w = min(max(w, command - play), command + play)
        acting.append(w)
    h, decay = np.zeros(len(u)), np.exp(-Ts / 2.0)
    for k in range(len(u) - 1):
        h[k + 1] = decay * h[k] + (1 - decay) * acting[k]
    noise = rng.standard_normal((2, len(u)))
    return casid.Record(
        {"u": u + 0.02 * noise[0], "level": h + 0.002 * noise[1]}, {"u": "m", "level": "m"}, Ts=Ts
    )


def measured_tank() -> casid.Problem:
    m = casid.Model("measured tank")
    h, u = m.state("h", "m"), m.input("u", "m", hold="zoh")
    m.derivative(h, (u - h) / m.parameter("tau", "s", start=1.5, lower=0.1, upper=20.0))
    m.output("level", h, "m")
    return casid.Problem("measured tank", m)


@pytest.mark.slow
def test_play_that_only_takes_the_noise_out_of_a_measured_command_is_none():
    """Play of some standard deviations smooths steps that were measured, and fits better for it."""
    found = [
        casid.diagnose(measured_tank(), stepped(seed), starts=1, advise=False).causes
        for seed in range(4)
    ]
    assert not any(c.kind in ("backlash", "deadzone") for causes in found for c in causes)
    record = stepped(1, play=0.2)
    named = casid.diagnose(measured_tank(), record, starts=1, max_causes=1, advise=False).causes[0]
    assert (named.kind, named.where) == ("backlash", "u")
    # The pin is taken along by the largest of 20 noises, 1.9 standard deviations on average.
    gap = named.parameters[0]
    assert abs(gap.value - 0.2 - 1.9 * 0.02) < 4 * gap.std_error + 0.02


def in_a_loop(gap: float, seed: int) -> casid.Record:
    """A tank that a controller fills and drains through a valve with overlap, at 1 % of noise.

    The noise of the level is ten times as large in the command, where the valve follows it.
    """
    rng = np.random.default_rng(seed)
    decay, h = np.exp(-Ts / 2.0), 0.0
    command, level = np.zeros(1200), np.zeros(1200)
    for k, target in enumerate(np.repeat(rng.uniform(-0.1, 0.1, 60), 20).tolist()):
        level[k] = h + 0.002 * rng.standard_normal()
        command[k] = 10.0 * (target - level[k])
        acting = command[k] - min(max(command[k], -gap), gap)
        h = decay * h + (1 - decay) * acting
    return casid.Record({"u": command, "level": level}, {"u": "m", "level": "m"}, Ts=Ts)


@pytest.mark.slow
def test_a_gap_narrower_than_the_noise_that_a_controller_feeds_back_is_found():
    """A known command acts as it was recorded, the noise in it too: that is no error of it."""
    m = measured_tank().model.copy("known command")
    m.inputs["u"] = replace(m.inputs["u"], kind="known")
    tank = casid.Problem("tank", m)
    (cause,) = casid.diagnose(tank, in_a_loop(0.05, 1), starts=1, advise=False).causes
    assert (cause.kind, cause.where) == ("deadzone", "u")
    assert abs(cause.parameters[0].value - 0.05) < 4 * cause.parameters[0].std_error


def test_a_contact_is_where_the_command_last_pushed():
    last, sign = play(np.array([0.0, 0.5, 2.0, 1.5, -1.0, -0.8]), 1.0)
    assert last.tolist() == [0, 0, 2, 2, 4, 4]
    assert sign.tolist() == [0.0, 0.0, 1.0, 1.0, -1.0, -1.0]


def test_play_is_refused_twice_and_of_what_is_no_command():
    once = tank().extend(input_backlash(tank(), "u", 1.0))
    with pytest.raises(ModelError, match="acts through play already; extend the model before"):
        input_backlash(once, "u", 1.0)
