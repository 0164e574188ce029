"""Effects in a parameter: it jumps, drifts, or depends on a channel or an input."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.model.clock_signals import RampOver, StepAt
from casid.model.declarations import Input, Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balances.flow_laws import is_never_negative, rounded_power
from casid.model.effects.effect import Effect, Sizes, Spread
from casid.model.effects.names import FOR_A_WHILE
from casid.model.effects.places.place import is_mechanical, is_zero, recorded_inputs
from casid.model.effects.search_ranges import PARAMETER_JUMPS, UNNAMED_EFFECTS
from casid.model.model import Model
from casid.model.quantities import quantity_text
from casid.model.units import declared_quotient, from_si, same_dimension, unit_quotient


def jump_times(window: tuple[float, float], count: int = PARAMETER_JUMPS.times) -> list[float]:
    """The instants that a jump is first searched at."""
    start, stop = window
    return [float(t) for t in np.linspace(start, stop, count + 2)[1:-1]]


def step_at(time: float) -> Input:
    """The generated input that is 1 from `time` on (seconds of the record's clock)."""
    return Input(f"step at {time:.9g} s", "1", "generated", "zoh", StepAt(time, is_held=True))


def ramp_over(start: float, stop: float) -> Input:
    """The generated input that rises by 1 from `start` to `stop`, and is 0 in their middle."""
    name = f"share of the time from {start:.9g} to {stop:.9g} s, from its middle"
    return Input(name, "1", "generated", "foh", RampOver(start, stop))


def since(model: Model, time: float, end: float | None = None) -> Any:
    """An expression that is 1 from `time` on, or until `end` (seconds of the record's clock)."""
    begun = model.add_input(step_at(time))
    return begun if end is None else begun - model.add_input(step_at(end))


def parameter_jump(model: Model, name: str, time: float, end: float | None = None) -> Effect:
    """A parameter that changes its value at `time`, and back at `end` where one is given.

    Both are seconds of the record's clock. A jump at a searched instant costs as much as three
    parameters (Zhang and Siegmund 2007), and each instant as much as two.
    """
    old = model.parameters[name]

    def apply(new: Model, names: Sequence[str]) -> None:
        s = since(new, time, end)
        new.substitute_symbol(name, new.symbol(name) + new.symbol(names[0]) * s)

    p = Parameter(f"jump_{name}", old.unit, 0.0)
    return Effect(
        "parameter_jump",
        name,
        (p,),
        apply,
        variant=time,
        cost=cost_of_instants(end),
        description="" if end is None else f"the parameter {name} changes {FOR_A_WHILE}",
        constants=instants(time, end),
    )


def cost_of_instants(end: float | None) -> int:
    """Parameters that a size at one searched instant costs, or at two."""
    return PARAMETER_JUMPS.cost if end is None else PARAMETER_JUMPS.cost_of_two


def instants(time: float, end: float | None) -> dict[str, float]:
    """The constants of what sets in, and may end."""
    return {"time": time} if end is None else {"time": time, "end": end}


def parameter_drift(model: Model, name: str, window: tuple[float, float]) -> Effect:
    """A parameter p that changes steadily: p + drift (t - t_mid) / (t_1 - t_0).

    `window` is t_0, t_1 in seconds of the record's clock, t_mid its middle: drift, in p's unit, is
    the change over the window, and p the value in its middle. What comes after the window (the end
    that is held out) goes on at the same rate; in a record apart, whose clock says nothing of this
    one's, the parameter has the value of the middle.
    """
    start, stop = window
    old = model.parameters[name]

    def apply(new: Model, names: Sequence[str]) -> None:
        s = new.add_input(ramp_over(start, stop))
        new.substitute_symbol(name, new.symbol(name) + new.symbol(names[0]) * s)

    p = Parameter(f"drift_{name}", old.unit, 0.0)
    chosen = {"start": start, "stop": stop}
    return Effect("parameter_drift", name, (p,), apply, span=(-0.5, 0.5), constants=chosen)


def is_constant_term(model: Model, name: str) -> bool:
    """True for a parameter that a balance adds as it is: with a channel it is an `extra_input`."""
    rows = [b.total for b in model.balances.values()]
    slopes = [ca.jacobian(row, model.symbol(name)) for row in rows]
    inside = [s for s in slopes if s.nnz() and not s.is_zero()]
    return len(inside) == 1 and inside[0].is_constant()


def input_schedules_of(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Parameters that depend on an input of the model, where a law of physics has them do so.

    Parameters of balances of heat or matter, with the inputs that carry their states along: a
    transfer coefficient depends on the flow past it. The gain of an input, with the others: what a
    heat pump makes of its power depends on the temperature outside. What multiplies a state, with
    inputs that keep their sign: a loss goes with the speed of a fan whose power heats as well.
    """
    pairs = (
        *_with_flows(model),
        *_gains_with_other_inputs(model),
        *_of_states_with_levels(model, sizes),
    )
    for name, channel in dict.fromkeys(pairs):
        spread = spread_of_input(sizes, channel)
        if spread.lowest < spread.highest:
            yield scheduled_parameter(model, name, channel, model.inputs[channel].unit, spread)


def spread_of_input(sizes: Sizes, channel: str) -> Spread:
    """The range of an input in the records, about its middle."""
    low, high = sizes.readings.get(channel, (0.0, 0.0))
    return Spread(0.5 * (low + high), low, high)


def _with_flows(model: Model) -> Iterator[tuple[str, str]]:
    states = ca.vertcat(*[model.symbol(s) for s in model.states])
    for b in model.balances.values():
        carried = ca.vec(ca.jacobian(b.total, states))
        for channel in [] if is_mechanical(b.unit) else recorded_inputs(model):
            if any(ca.which_depends(carried, model.symbol(channel))):
                for name, p in model.parameters.items():
                    if not p.is_known and any(ca.which_depends(b.total, model.symbol(name))):
                        yield name, channel


def _gains_with_other_inputs(model: Model) -> Iterator[tuple[str, str]]:
    inputs = recorded_inputs(model)
    for name, p in model.parameters.items():
        slopes = [ca.jacobian(b.total, model.symbol(name)) for b in model.balances.values()]
        beside = {s.name() for slope in slopes for s in ca.symvar(slope)}
        if not p.is_known and beside & {*inputs} and not beside & {*model.states}:
            yield from ((name, channel) for channel in inputs if channel not in beside)


def _of_states_with_levels(model: Model, sizes: Sizes) -> Iterator[tuple[str, str]]:
    """Parameters that multiply states, with the inputs beside them that never change their sign.

    Not with an input that the parameter multiplies as well, nor where the product with the input
    is in the model, with a parameter of its own.
    """
    totals = ca.vertcat(*[b.total for b in model.balances.values()])
    unknown = [n for n, p in model.parameters.items() if not (p.is_known or p.is_constant)]
    slopes = {n: ca.densify(ca.jacobian(totals, model.symbol(n))) for n in unknown}
    for name, slope in slopes.items():
        beside = {s.name() for s in ca.symvar(slope)}
        for channel in recorded_inputs(model) if beside & {*model.states} else ():
            is_level = has_one_sign(spread_of_input(sizes, channel))
            product = slope * model.symbol(channel)
            if is_level and channel not in beside:
                if not any(is_zero(ca.sumsqr(product - other)) for other in slopes.values()):
                    yield name, channel


def scheduled_parameter(model: Model, name: str, channel: str, unit: str, spread: Spread) -> Effect:
    """A parameter p that depends on a recorded channel or an input c: p + s (c - c_mean).

    The mean is that of the fitted records, so that p stays what it is on average there, and its
    estimate and that of s hardly depend on each other. Noise on c makes s too small: a channel that
    is noisy beside its own changes is better smoothed first.
    """
    old = model.parameters[name]
    p = Parameter(f"slope_{name}_{channel}", unit_quotient(old.unit, unit, 1), 0.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        c = _signal(new, channel, unit, spread)
        moved = new.symbol(name) + new.symbol(names[0]) * (c - carrying_unit(spread.mean))
        new.substitute_symbol(name, moved)

    span = spread.lowest - spread.mean, spread.highest - spread.mean
    # Of two that act alike, the one that is estimated is named.
    priority = int(old.is_known)
    return Effect(
        "scheduled_parameter",
        f"{name}~{channel}",
        (p,),
        apply,
        span=span,
        priority=priority,
        constants={"mean": spread.mean},
        declared_units={p.name: unit_per(model, name, channel, unit)},
    )


def power_scheduled_parameter(
    model: Model, name: str, channel: str, unit: str, spread: Spread
) -> Effect:
    """A parameter p that goes with a power of a channel, an input or a state c: p |c / c_mean|^n.

    A heat transfer coefficient goes with the flow past it to the power 0.8 (Dittus and Boelter), a
    drag with the density to the power 1. At the mean of the fitted records p stays what it is. Near
    c = 0 the power is rounded at a thousandth of the mean. The null value is n = 0.
    """
    most = UNNAMED_EFFECTS.highest_power
    n = Parameter(f"exponent_{name}_{channel}", "1", 0.0, lower=-most, upper=most)

    def apply(new: Model, names: Sequence[str]) -> None:
        c = _signal(new, channel, unit, spread)
        power = rounded_power(c, spread.mean, new.symbol(names[0]))
        new.substitute_symbol(name, new.symbol(name) * power)

    shown = model.declared_units.get(channel, unit)
    level = quantity_text(float(from_si(spread.mean, shown)), shown)
    return Effect(
        "scheduled_parameter",
        f"{name}~{channel}",
        (n,),
        apply,
        priority=int(model.parameters[name].is_known),
        description=f"the parameter {name} changes with {channel} as a power of it, "
        f"({channel}/{level})^{n.name}",
        constants={"reference": spread.mean},
    )


def is_scheduled_by_power(effect: Effect) -> bool:
    """True of a parameter that changes with a power of a channel or an input."""
    return effect.kind == "scheduled_parameter" and "reference" in effect.constants


def is_scheduled_by_channel(effect: Effect) -> bool:
    """True of one that changes with a recorded channel or an input, by a line or a power."""
    is_line = effect.kind == "scheduled_parameter" and set(effect.constants) == {"mean"}
    return is_scheduled_by_power(effect) or (is_line and not effect.description)


def has_powers(spread: Spread, unit: str) -> bool:
    """True of a channel a power of which a parameter may go with: it keeps its sign.

    No temperature, which would be counted from absolute zero.
    """
    return has_one_sign(spread) and not same_dimension(unit, "K")


def has_one_sign(spread: Spread) -> bool:
    """True of a channel that is never less than zero, or never more, but for its rounding."""
    ends = (spread.lowest, spread.highest)
    return is_never_negative(ends) or is_never_negative((-ends[1], -ends[0]))


def _signal(new: Model, channel: str, unit: str, spread: Spread) -> Any:
    """The symbol of a channel, which becomes an input where it is none."""
    if channel in new.inputs or channel in new.states:
        return new.symbol(channel)
    return new.add_input(Input(channel, unit, "known", spread.hold))


def unit_per(model: Model, name: str, other: str, unit: str, power: int = 1) -> str:
    """The declared unit of a parameter over that of a signal, or its SI `unit`: uH/A."""
    return declared_quotient(model.unit_of(name), model.declared_units.get(other, unit), power)
