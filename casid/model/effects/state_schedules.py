"""Effects in a parameter that depends on a state or an input beside it, by its size or a power."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.effect import Effect, Motion, Sizes, Spread
from casid.model.effects.parameter_effects import has_powers, power_scheduled_parameter, unit_per
from casid.model.effects.places.place import is_amount, is_mechanical, is_zero, recorded_inputs
from casid.model.effects.search_ranges import SATURATIONS, UNNAMED_EFFECTS
from casid.model.model import Model
from casid.model.units import unit_quotient

_INVERSE = "inverse_K_"


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
    p + s (x^2 - m), of which the same share is left. Where the store of x holds p x, its inertia
    is the slope of that: iron that saturates bends the flux of a coil.
    """
    old = model.parameters[name]
    stores = _stores_that_hold(model, name, state)
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
        for store in stores:
            b = new.balances[store]
            slope = b.inertia + x * ca.jacobian(ca.SX(b.inertia), x)
            least = SATURATIONS.left * model.balances[store].inertia
            new.balances[store] = replace(b, inertia=ca.fmax(slope, least))

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
        declared_units={p.name: unit_per(model, name, state, model.symbol_units[state], power)},
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
            c.name: unit_per(model, name, state, of, 2),
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
    """A coefficient p that falls with an amount or an input x beside it: p / (1 + r x).

    That of an enzyme, which its product inhibits; the gain of light, of which leaves take up less
    where it is strong. r, one over the x that halves p, is negative where x helps. As
    p (1 + r m) / (1 + r x), m the mean of x (`size`), p stays what it is there.
    """
    unit = model.symbol_units[state]
    own = Parameter(
        f"{_INVERSE}{state}",
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


def is_inhibited(effect: Effect) -> bool:
    """True of a parameter that falls with a signal as 1/(1 + x/K) does."""
    return any(p.name.startswith(_INVERSE) for p in effect.parameters[:1])


def state_schedules_of(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Parameters that no force in one place expresses, with the states of their own equations.

    Such a parameter stands in several equations out of proportion (a motor's constant in torque and
    voltage), in an inertia of no mass (an inductance), beside an input (the gain of an actuator
    that falls with the speed), in what a sensor shows alone (a battery's resistance), or in a flow
    that a sensor shows as well (a valve's coefficient); or it is that of a reaction, which its
    product inhibits. Elsewhere it is a force that grows with its state, and tested as one. With a
    state that keeps its sign what a sensor shows as well also goes as a power of it, and so does
    the rate of a reaction with the amount of what reacts: its order. The gain of an input that is
    never negative may level off with it, and one of a force that is no straight line of the input
    changes with it in any way.
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
        several, gained = _of_several(model, symbol, inside), _gained(model, name, inside)
        reactants = [x for x in several if is_amount(model.symbol_units[x])]
        states = (
            *several,
            *_of_inertias(model, symbol),
            *_of_gains(model, symbol, inside),
            *_shown(model, symbol, inside),
            *(beside := _shown_as_well(model, symbol, inside)),
            *(channel for channel in gained if _is_bent(model, inside, channel)),
        )
        for state in dict.fromkeys(states):
            for power in range(1, SATURATIONS.powers + 1):
                size = sizes.motion_of(ca.fabs(model.symbol(state)) ** power)
                if size.mean > 0.0:
                    yield state_scheduled_parameter(model, name, state, size, power)
        for state in (*beside, *reactants):
            unit, spread = model.states[state].unit, spread_of_state(model, sizes, state)
            if has_powers(spread, unit):
                yield power_scheduled_parameter(model, name, state, unit, spread)
        for state in _possible_inhibitors(model, symbol, inside):
            size = sizes.motion_of(model.symbol(state))
            if size.is_signed and size.low > 0.0:
                yield inhibited_parameter(model, name, state, size)
        for channel in gained:
            size = sizes.motion_of(model.symbol(channel))
            if size.low >= 0.0 and size.mean > 0.0:
                yield inhibited_parameter(model, name, channel, size)


def _possible_inhibitors(model: Model, symbol: Any, inside: Mapping[str, Any]) -> list[str]:
    """Amounts in the balances of a reaction on which its rate does not depend in the model.

    The rate is what the parameter `symbol` multiplies in the balances `inside`.
    """
    shapes = [ca.jacobian(ca.SX(side), symbol) for side in inside.values()]
    felt = {s.name() for shape in shapes for s in ca.symvar(shape)}
    if len(inside) < 2 or not felt & {*inside}:
        return []
    return [s for s in inside if s not in felt and is_amount(model.states[s].unit)]


def _gained(model: Model, name: str, inside: Mapping[str, Any]) -> list[str]:
    """The input whose gain in the balances a parameter is, where they have it nowhere else.

    Alone, or as the force of a magnet, whose iron saturates with the current, depends on its gap.
    """
    symbol = model.symbol(name)
    slope = ca.jacobian(ca.SX(ca.vertcat(*inside.values())), symbol)
    felt = {s.name() for s in ca.symvar(slope)} & {*recorded_inputs(model)}
    is_gain = len(felt) == 1 and not any(ca.which_depends(slope, symbol))
    if not is_gain or model.parameters[name].is_known:
        return []
    ends = ca.substitute(slope, model.symbol(*felt), 0.0)  # no input, no force
    return [*felt] if is_zero(ca.sumsqr(ends)) else []


def _is_bent(model: Model, inside: Mapping[str, Any], channel: str) -> bool:
    """True where balances are no straight line of an input, whose force a linear gain gives."""
    u = model.symbol(channel)
    slope = ca.jacobian(ca.SX(ca.vertcat(*inside.values())), u)
    return any(ca.which_depends(slope, ca.vertcat(u, *(model.symbol(s) for s in model.states))))


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


def _stores_that_hold(model: Model, name: str, state: str) -> list[str]:
    """Balances of a state x whose inertia is the parameter p, while p x stands elsewhere, too.

    An inductance is the flux per current, and a motor's torque and voltages show that flux: where
    it bends, the inertia of the current is its slope, and not the flux per current. Where p stands
    in the inertia alone, it is the slope whatever it is called.
    """
    p, x = model.symbol(name), model.symbol(state)
    stores = [b for b in model.balances.values() if b.rate == state and not is_mechanical(b.unit)]
    stores = [b for b in stores if is_zero(ca.jacobian(ca.SX(b.inertia), p) * p - b.inertia)]
    shown = ca.vertcat(*(b.total for b in model.balances.values()))
    carries = any(ca.which_depends(ca.jacobian(shown, p), x))
    return [b.name for b in stores] if carries else []


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


def _shown(model: Model, symbol: Any, inside: Mapping[str, Any]) -> list[str]:
    """States and inputs in the outputs that hold a parameter, where no equation of motion does."""
    stated = [*model._rates.values(), *(b.inertia for b in model.balances.values())]
    if inside or any(ca.which_depends(ca.vertcat(*stated), symbol)):
        return []
    outputs = [ca.SX(e) for e, _ in model.outputs.values()]
    seen = [e for e in outputs if any(ca.which_depends(e, symbol))]
    felt = {s.name() for e in seen for s in ca.symvar(e)}
    return sorted(felt & {*model.states, *recorded_inputs(model)})


def _shown_as_well(model: Model, symbol: Any, inside: Mapping[str, Any]) -> list[str]:
    """States that a parameter multiplies both in one balance and in an output.

    The flow through a valve fills a tank, and its meter shows it: a law of the balance alone would
    leave what the meter shows as it is.
    """
    outputs = [ca.SX(e) for e, _ in model.outputs.values()]
    seen = [e for e in outputs if any(ca.which_depends(e, symbol))]
    if len(inside) != 1 or not seen:
        return []
    there, here = (
        {s.name() for side in sides for s in ca.symvar(ca.jacobian(ca.SX(side), symbol))}
        for sides in (seen, inside.values())
    )
    return [state for state in model.states if state in there & here]


def spread_of_state(model: Model, sizes: Sizes, state: str) -> Spread:
    """The range of a state in the simulation, about its middle."""
    motion = sizes.motion_of(model.symbol(state))
    return Spread(0.5 * (motion.low + motion.high), motion.low, motion.high)
