"""Effects in a parameter: it jumps, drifts, or depends on a channel that the model leaves out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.model.clock_signals import RampOver, StepAt
from casid.model.declarations import Input, Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balances.flow_laws import is_never_negative, rounded_power
from casid.model.effects.effect import Effect, Motion, Sizes, Spread
from casid.model.effects.names import FOR_A_WHILE
from casid.model.effects.places.place import is_amount, is_mechanical, is_zero, recorded_inputs
from casid.model.effects.search_ranges import PARAMETER_JUMPS, SATURATIONS, UNNAMED_EFFECTS
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


def state_scheduled_parameter(
    model: Model, name: str, state: str, size: Motion, power: int = 1, *, is_straight: bool = False
) -> Effect:
    """A parameter p that falls or grows with the size of a state or an input x.

    Iron that saturates lowers a motor's constant or an inductance with the current, and the force
    factor of a voice coil falls with its displacement. `size` is the motion of |x|^power in the
    records (x's unit to that power), m its mean, so that p stays what it is there. With power 1 it
    is p + s (|x| - m), and of a p that is no less than zero a share is left, so that an inertia
    never vanishes; with power 2 it is p (p - s m) / (p - s x^2), which is smooth where x is zero
    and keeps the sign of p however far it falls, or where it `is_straight` the parabola
    p + s (x^2 - m), of which the same share is left.
    """
    old = model.parameters[name]
    unit = old.unit
    for _ in range(power):
        unit = unit_quotient(unit, model.symbol_units[state], 1)
    label = "slope" if power == 1 else "curvature"
    p = Parameter(f"{label}_{name}_{state}", unit, 0.0)
    m = carrying_unit(size.mean)

    is_straight |= power == 1

    def apply(new: Model, names: Sequence[str]) -> None:
        """Replace the parameter by one that goes with the state."""
        x, value, s = new.symbol(state), new.symbol(name), new.symbol(names[0])
        if is_straight:
            moved = _with_share(value + s * (ca.fabs(x) ** power - m), value, old)
        else:
            # A parameter may be zero, in a load case say: it stays zero.
            moved = value * (value - s * m) / (value - s * x**2 + carrying_unit(1e-150))
        new.substitute_symbol(name, moved)

    # The slope at which p is zero, or near a pole, is p over minus these.
    span = (-size.mean, size.mean)
    if not is_straight:
        span = (-SATURATIONS.poles * size.high, size.mean / SATURATIONS.falls)
    return Effect(
        "scheduled_parameter",
        f"{name}~{state}",
        (p,),
        apply,
        variant=float(power),
        priority=int(old.is_known),
        span=span,
        constants={"mean": size.mean, "power": float(power), "straight": float(is_straight)},
        declared_units={p.name: _per(model, name, state, model.symbol_units[state], power)},
    )


def parabolic_schedule(
    model: Model, name: str, state: str, line: Motion, square: Motion, about: float
) -> Effect:
    """A parameter p that changes along a parabola of a state or an input x, about any vertex x_0.

    p + c ((x - x_0)^2 - its mean), so that p stays what it is on average there: a resistance that
    grows as a cell runs empty, a force factor that is highest beside the zero of the displacement.
    Of a p that is no less than zero the same share is left as of one that falls straight.

    Parameters
    ----------
    line, square : the motion of x and of x^2 in the records.
    about : where x_0 is searched from, x's SI unit.
    """
    old, of = model.parameters[name], model.symbol_units[state]
    c = Parameter(f"curvature_{name}_{state}", unit_quotient(old.unit, of, 2), 0.0)
    x_0 = Parameter(f"vertex_{name}_{state}", of, about)
    m, m_2 = carrying_unit(line.mean), carrying_unit(square.mean)

    def apply(new: Model, names: Sequence[str]) -> None:
        x, value, vertex = new.symbol(state), new.symbol(name), new.symbol(names[1])
        moved = value + new.symbol(names[0]) * (x**2 - m_2 - 2 * vertex * (x - m))
        new.substitute_symbol(name, _with_share(moved, value, old))

    return Effect(
        "scheduled_parameter",
        f"{name}~{state}",
        (c, x_0),
        apply,
        priority=int(old.is_known),
        cost=2,
        description=f"the parameter {name} changes along a parabola of {state} about {x_0.name}",
        constants={"mean": line.mean, "mean_square": square.mean},
        declared_units={
            c.name: _per(model, name, state, of, 2),
            x_0.name: model.declared_units.get(state, of),
        },
    )


def _with_share(moved: Any, value: Any, p: Parameter) -> Any:
    """A changed value, of what is no less than zero at least a share of the value without it."""
    return ca.fmax(moved, SATURATIONS.left * value) if p.lower >= 0.0 else moved


def is_scheduled_by_state(effect: Effect) -> bool:
    """True of a parameter that changes with a power of a state or an input."""
    return effect.kind == "scheduled_parameter" and "power" in effect.constants


def inhibited_parameter(model: Model, name: str, state: str, size: Motion) -> Effect:
    """The coefficient p of a reaction that falls with an amount x beside it: p / (1 + r x).

    An enzyme that its product inhibits; r, one over the amount that halves p, is negative where x
    helps. As p (1 + r m) / (1 + r x), m the mean of x (`size`), p stays what it is there.
    """
    unit = model.states[state].unit
    own = Parameter(
        f"inverse_K_{state}",
        unit_quotient("1", unit),
        0.0,
        lower=-2.0 / (SATURATIONS.poles * size.largest),
        upper=UNNAMED_EFFECTS.most_saturated / size.largest,
    )
    m = carrying_unit(size.mean)

    def apply(new: Model, names: Sequence[str]) -> None:
        x, r = new.symbol(state), new.symbol(names[0])
        new.substitute_symbol(name, new.symbol(name) * (1 + r * m) / (1 + r * ca.fabs(x)))

    return Effect(
        "scheduled_parameter",
        f"{name}~{state}",
        (own,),
        apply,
        priority=int(model.parameters[name].is_known),
        description=f"{name} changes with {state} as 1/(1 + {state}/K) does ({own.name} is 1/K)",
        constants={"mean": size.mean},
    )


def state_schedules_of(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Parameters that no force in one place expresses, with the states of their own equations.

    Such a parameter stands in several equations out of proportion (a motor's constant in torque and
    voltage), in an inertia of no mass (an inductance), beside an input (the gain of an actuator
    that falls with the speed), or in what a sensor shows alone (a battery's resistance); or it is
    that of a reaction, which its product inhibits. Elsewhere it is a force that grows with its
    state, and tested as one.
    """
    for name, p in model.parameters.items():
        if p.is_constant or (p.is_known and p.value == 0.0):
            continue
        symbol = model.symbol(name)
        inside = {
            b.rate: b.total
            for b in model.balances.values()
            if any(ca.which_depends(b.total, symbol))
        }
        states = (
            *_of_several(model, symbol, inside),
            *_of_inertias(model, symbol),
            *_of_gains(model, symbol, inside),
            *_shown(model, symbol, inside),
        )
        for state in dict.fromkeys(states):
            for power in range(1, SATURATIONS.powers + 1):
                size = sizes.motion_of(ca.fabs(model.symbol(state)) ** power)
                if size.mean > 0.0:
                    yield state_scheduled_parameter(model, name, state, size, power)
        for state in _possible_inhibitors(model, symbol, inside):
            size = sizes.motion_of(model.symbol(state))
            if size.is_signed and size.low > 0.0:
                yield inhibited_parameter(model, name, state, size)


def _possible_inhibitors(model: Model, symbol: Any, inside: Mapping[str, Any]) -> list[str]:
    """Amounts in the balances of a reaction on which its rate does not depend in the model.

    The rate is what the parameter `symbol` multiplies in the balances `inside`.
    """
    shapes = [ca.jacobian(ca.SX(side), symbol) for side in inside.values()]
    felt = {s.name() for shape in shapes for s in ca.symvar(shape)}
    if len(inside) < 2 or not felt & {*inside}:
        return []
    return [s for s in inside if s not in felt and is_amount(model.states[s].unit)]


def _of_several(model: Model, symbol: Any, inside: Mapping[str, Any]) -> list[str]:
    """The rates that a parameter of several equations multiplies there, and their positions."""
    shapes = [ca.jacobian(ca.SX(side), symbol) for side in inside.values()]
    felt = {s.name() for shape in shapes for s in ca.symvar(shape) if s.name() in model.states}
    rates = sorted(felt & {b.rate for b in model.balances.values()})
    if len(inside) < 2 or len(rates) < 2:
        return []
    positions = [model.position_of(rate) for rate in rates]
    return [*rates, *(p for p in positions if p is not None)]


def _of_inertias(model: Model, symbol: Any) -> list[str]:
    """The rates that a parameter is the inertia of, or divides as a whole; no masses."""
    return [
        b.rate
        for b in model.balances.values()
        if not is_mechanical(b.unit)
        and (any(ca.which_depends(ca.SX(b.inertia), symbol)) or _divides(b.total, symbol))
    ]


def is_constant_term(model: Model, name: str) -> bool:
    """True for a parameter that a balance adds as it is: with a channel it is an `extra_input`."""
    rows = [b.total for b in model.balances.values()]
    slopes = [ca.jacobian(row, model.symbol(name)) for row in rows]
    inside = [s for s in slopes if s.nnz() and not s.is_zero()]
    return len(inside) == 1 and inside[0].is_constant()


def _of_gains(model: Model, symbol: Any, inside: Mapping[str, Any]) -> list[str]:
    """The rate of its balance and those of bodies, for a parameter that multiplies an input."""
    inputs = [model.symbol(n) for n in recorded_inputs(model)]
    shape = ca.jacobian(ca.SX(ca.vertcat(*inside.values())), symbol)
    if len(inside) != 1 or not any(any(ca.which_depends(shape, u)) for u in inputs):
        return []
    return [b.rate for b in model.balances.values() if b.rate in inside or is_mechanical(b.unit)]


def _divides(side: Any, symbol: Any) -> bool:
    """True for a side p^-1 f, f without p: a rate that is stated divided by its inertia p."""
    slope = ca.jacobian(ca.SX(side), symbol)
    return bool(slope.nnz()) and is_zero(slope * symbol + side)


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


def _shown(model: Model, symbol: Any, inside: Mapping[str, Any]) -> list[str]:
    """States and inputs in the outputs that hold a parameter, where no equation of motion does."""
    stated = [*model._rates.values(), *(b.inertia for b in model.balances.values())]
    if inside or any(ca.which_depends(ca.vertcat(*stated), symbol)):
        return []
    outputs = [ca.SX(e) for e, _ in model.outputs.values()]
    seen = [e for e in outputs if any(ca.which_depends(e, symbol))]
    felt = {s.name() for e in seen for s in ca.symvar(e)}
    return sorted(felt & {*model.states, *recorded_inputs(model)})


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
        declared_units={p.name: _per(model, name, channel, unit)},
    )


def power_scheduled_parameter(
    model: Model, name: str, channel: str, unit: str, spread: Spread
) -> Effect:
    """A parameter p that grows or falls with a power of a channel or an input: p |c / c_mean|^n.

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
    if channel in new.inputs:
        return new.symbol(channel)
    return new.add_input(Input(channel, unit, "known", spread.hold))


def _per(model: Model, name: str, other: str, unit: str, power: int = 1) -> str:
    """The declared unit of a parameter over that of a signal, or its SI `unit`: uH/A."""
    return declared_quotient(model.unit_of(name), model.declared_units.get(other, unit), power)
