"""What sets in at an instant, or grows: a load taken on, a knocked or drifting sensor, a gain."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca

from casid.errors import ModelError
from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balances.balance_effects import offset
from casid.model.effects.balances.moving_media import moving_media_of, moving_medium
from casid.model.effects.channels.channel_effects import scaled_input, sensor_bias, sensor_scale
from casid.model.effects.effect import Effect, known_while_null
from casid.model.effects.names import (
    DURING_THE_RECORD,
    FOR_A_WHILE,
    FOR_ONE_SAMPLE,
    GAIN_OF_INPUT,
    GROWS_STEADILY,
    RISING_MEDIUM,
    SETS_IN,
    TOGETHER,
    WIND,
)
from casid.model.effects.parameter_effects import (
    cost_of_instants,
    instants,
    jump_times,
    parameter_jump,
    ramp_over,
    since,
    step_at,
)
from casid.model.effects.places.place import (
    Place,
    a_constant,
    a_quantity,
    is_mechanical,
    is_zero,
    recorded_inputs,
)
from casid.model.effects.places.places import place_named
from casid.model.effects.search_ranges import PARAMETER_JUMPS
from casid.model.model import Model
from casid.model.units import same_dimension, unit_quotient

STEP, KNOCK, DRIFT = "step", "knock", "drift"


def offset_step(model: Model, where: str | Place, time: float, end: float | None = None) -> Effect:
    """A constant force or voltage from `time` on, or until `end` (s of the record's clock).

    In a balance, or between two bodies or stores, as where a coupling slips.
    """
    place = place_named(model, where)
    made = _set_in(offset(model, place), time, end)
    what = a_constant(place.unit, place.velocity_unit)
    there = place.words or f"acts in the {place.where} balance"
    if end is not None:
        return replace(made, description=f"{what} {there} {FOR_A_WHILE}")
    there = there.removeprefix("acts ")
    return replace(made, description=f"{what} {SETS_IN} {DURING_THE_RECORD}, {there}")


def medium_step(model: Model, balance: str, time: float, end: float | None = None) -> Effect:
    """A medium that moves from `time` on, or until `end` [s]: a wind that rises.

    Raises
    ------
    ModelError
        If no drag of the balance grows faster than its rate (`moving_medium`).
    """
    made = moving_medium(model, balance)
    if made is None:
        raise ModelError(f"no drag in the {balance} balance of {model.name} grows with a speed")
    drag = made.description.removeprefix(f"{WIND} ")
    how = f"{SETS_IN} {DURING_THE_RECORD}, and {drag}"
    how = how if end is None else f"{drag}, {FOR_A_WHILE}"
    made = replace(_set_in(made, time, end), description=f"{WIND} {how}")
    return replace(made, shape=RISING_MEDIUM)


def joint_offset_step(
    model: Model, where: Sequence[str], ratio: float, time: float, end: float | None = None
) -> Effect:
    """One constant force that sets in at `time` in two balances, and ends at `end` [s].

    A gust pushes a car and turns it. The first balance has the force F_0, the other one F_0 times a
    ratio, a lever arm, which is estimated from `ratio` (SI).
    """
    one, other = where
    single = offset_step(model, one, time, end)
    b, o = (model.balances[name] for name in where)
    arm = Parameter(f"ratio_{other}", unit_quotient(o.unit, b.unit, 1), ratio)

    def apply(new: Model, names: Sequence[str]) -> None:
        known_while_null(new, names)
        F_0, share = (new.symbol(n) for n in names)
        course = since(new, time, end)
        new.add_term(one, F_0 * course)
        new.add_term(other, F_0 * share * course)

    what = a_constant(b.unit, model.states[b.rate].unit)
    there = f"in the {one} and {other} balances"
    says = f"{what} {SETS_IN} {DURING_THE_RECORD}, {there}"
    if end is not None:
        says = f"{what} acts {there} {FOR_A_WHILE}"
    return replace(
        single,
        where=TOGETHER.join(where),
        parameters=(*single.parameters, arm),
        apply=apply,
        cost=single.cost + 1,
        description=says,
    )


def knock(model: Model, balance: str, time: float, Ts: float) -> Effect:
    """An impulse J at `time` [s]: a force J / Ts over one sample of Ts [s].

    Much shorter than the motion that it starts, so that its shape does not show. It has no name
    among the kinds; without it what rings on afterwards would be taken for a force that stays.
    """
    b = model.balances[balance]
    unit = "J" if same_dimension(b.unit, "W") else unit_quotient(b.unit, "s", -1)
    J = Parameter(f"J_{balance}", unit, 0.0)
    rate = model.states[b.rate].unit
    what = "a knock, a force" if is_mechanical(b.unit) else a_quantity(b.unit, rate_unit=rate)

    def apply(new: Model, names: Sequence[str]) -> None:
        first, last = (new.add_input(step_at(t)) for t in (time, time + Ts))
        new.add_term(balance, new.symbol(names[0]) * (first - last) / carrying_unit(Ts))

    return Effect(
        "unknown",
        balance,
        (J,),
        apply,
        priority=2,
        variant=time,
        cost=PARAMETER_JUMPS.cost,
        shape=KNOCK,
        description=f"{what} that acts for an instant",
        constants={"time": time, "duration": Ts},
    )


def with_duration(effect: Effect, Ts: float) -> Effect:
    """The effect, whose description says so where it is over again after one sample of Ts [s]."""
    if effect.end is None or round((effect.end - effect.constants["time"]) / Ts) > 1:
        return effect
    says = effect.description.removesuffix(FOR_A_WHILE) + FOR_ONE_SAMPLE
    return replace(effect, description=says)


def bias_step(model: Model, channel: str, time: float, end: float | None = None) -> Effect:
    """A bias of a measured channel from `time` on, or until `end` (s of the record's clock)."""
    made = _set_in(sensor_bias(model, channel), time, end)
    says = f"the channel {channel} gets a constant bias {DURING_THE_RECORD}"
    if end is not None:
        says = f"the channel {channel} has a constant bias {FOR_A_WHILE}"
    return replace(made, description=says)


def bias_drift(model: Model, channel: str, window: tuple[float, float]) -> Effect:
    """A bias of a measured channel that grows steadily from nothing, as after switching on.

    Its size is what it grows to over `window`, the fitted part in seconds of the record's clock.
    """
    start, stop = window
    made = _times(
        sensor_bias(model, channel), lambda new: new.add_input(ramp_over(start, stop)) + 0.5
    )
    p = replace(made.parameters[0], name=f"drift_{channel}")
    return replace(
        made,
        parameters=(p,),
        shape=DRIFT,
        description=f"the channel {channel} drifts: its bias {GROWS_STEADILY}",
        constants={"start": start, "stop": stop},
    )


def gain_step(model: Model, channel: str, time: float, end: float | None = None) -> Effect:
    """A gain that changes at `time`, and back at `end` (s of the record's clock).

    A sensor shows y (1 + scale) from then on. A recorded input u acts as u (1 + gain): an actuator
    that loses a fifth of its effect has a gain of -0.2, and one that fails has -1.
    """
    if channel in model.outputs:
        made = sensor_scale(model, channel)
        what = f"the gain of the sensor of {channel}"
    else:
        made = _input_gain(channel)
        what = f"{GAIN_OF_INPUT} {channel} acts"
    when = DURING_THE_RECORD if end is None else FOR_A_WHILE
    return replace(_set_in(made, time, end), description=f"{what} changes {when}")


def _input_gain(channel: str) -> Effect:
    """A recorded input u that acts as u (1 + gain)."""

    def apply(new: Model, names: Sequence[str]) -> None:
        scaled_input(new, channel, 1 + new.symbol(names[0]))

    p = Parameter(f"gain_{channel}", "1", 0.0)
    return Effect("sensor_scale", channel, (p,), apply, priority=2)


def at_instant(effect: Effect, model: Model, time: float, end: float | None = None) -> Effect:
    """The `effect`, which sets in at an instant, at another instant [s]; it ends at `end` [s]."""
    if effect.shape == KNOCK:
        return knock(model, effect.where, time, effect.constants["duration"])
    if effect.kind == "offset" and len(effect.parameters) > 1:
        pair, (_, arm) = effect.where.split(TOGETHER), effect.parameters
        return joint_offset_step(model, pair, arm.start, time, end)
    made = {
        "parameter_jump": parameter_jump,
        "offset": medium_step if effect.shape == RISING_MEDIUM else offset_step,
        "sensor_bias": bias_step,
        "sensor_scale": gain_step,
    }
    return made[effect.kind](model, effect.where, time, end)


def clock_effects_of(
    model: Model,
    window: tuple[float, float],
    events: Sequence[float] = (),
    elements: Sequence[Place] = (),
) -> Iterator[Effect]:
    """Steps of forces, of biases and of gains, and drifts of biases.

    Biases are those of outputs and measured inputs, gains those of outputs and recorded inputs.

    A knock is none of them: the search puts it in the place of a force that sets in.

    Parameters
    ----------
    window : the fitted part, in seconds of the record's clock.
    events : instants beside those that are evenly inside the window [s].
    elements : relative motions, on which a force may act in two balances.
    """
    biases = [*jump_times(window, PARAMETER_JUMPS.times_of_biases), *events]
    forces = [*jump_times(window), *events]
    places: list[str | Place] = [*model.balances, *(p for p in elements if p.has_own_force)]
    for place in places:
        yield from (offset_step(model, place, t) for t in forces)
    for medium in moving_media_of(model):
        yield from (medium_step(model, medium.where, t) for t in forces)
    measured = [n for n, u in model.inputs.items() if u.kind == "measured"]
    for channel in (*model.outputs, *measured):
        yield from (bias_step(model, channel, t) for t in biases)
        yield bias_drift(model, channel, window)
    for channel in _channels_with_a_gain(model):
        yield from (gain_step(model, channel, t) for t in forces)


def _channels_with_a_gain(model: Model) -> list[str]:
    """Outputs and recorded inputs whose gain is no parameter, which would jump itself.

    A parameter p is the gain of an input u where all that depends on either does so by p u, and
    that of an output where it multiplies nothing else. The zero of a temperature scale means
    nothing to a gain.
    """
    recorded = recorded_inputs(model)
    units = {n: unit for n, (_, unit) in model.outputs.items()}
    units |= {n: model.inputs[n].unit for n in recorded}
    of_scales = [n for n, unit in units.items() if not same_dimension(unit, "K")]
    rows = [ca.SX(residual) for _, residual, _ in model.equations()]
    sides = ca.vertcat(*rows, *(ca.SX(e) for e, _ in model.outputs.values()))
    moved = {n: _in_proportion(sides, model.symbol(n)) for n in recorded}
    for i, n in enumerate(model.outputs, len(rows)):
        moved[n] = ca.SX.zeros(sides.shape)
        moved[n][i] = sides[i]
    jumping = [model.symbol(n) for n, p in model.parameters.items() if not p.is_constant]
    of_gains = [_in_proportion(sides, p) for p in jumping]
    return [n for n in of_scales if not any(is_zero(ca.sumsqr(moved[n] - g)) for g in of_gains)]


def _in_proportion(sides: Any, symbol: Any) -> Any:
    """How sides of equations (n,) move with a share of a symbol: p df/dp."""
    return ca.jacobian(sides, symbol) * symbol


def _set_in(effect: Effect, time: float, end: float | None) -> Effect:
    """An effect from an instant on, or between two, which is charged as that of a jump is."""
    made = _times(effect, lambda new: since(new, time, end))
    cost, constants = cost_of_instants(end), instants(time, end)
    return replace(made, variant=time, cost=cost, shape=STEP, constants=constants)


def _times(effect: Effect, course: Callable[[Model], Any]) -> Effect:
    """An effect in proportion to its parameter, times what `course` adds to a model."""

    def apply(new: Model, names: Sequence[str]) -> None:
        effect.apply(new, names)
        s = course(new)
        new.substitute_symbol(names[0], new.symbol(names[0]) * s)

    # What holds all the time is met more often, and named where the two are the same.
    return replace(effect, apply=apply, priority=effect.priority + 1)
