"""What a sensor shows in place of the quantity: its absolute value, or that of another point."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import casadi as ca

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.channels.channel_effects import zeros_of_reading
from casid.model.effects.effect import Effect, Sizes, switched_on
from casid.model.effects.names import OVER_A_RESISTANCE, bracketed
from casid.model.effects.places.place import a_quantity, is_mechanical
from casid.model.effects.search_ranges import RECTIFIED, UNNAMED_EFFECTS
from casid.model.identifiers import made_identifier
from casid.model.model import Model
from casid.model.units import same_dimension, unit_quotient

Expr = Any  # a CasADi expression


def rectified(model: Model, channel: str) -> Effect:
    """An output that shows the absolute value: y + r (|y| - y), r = 1 where it does."""
    p = Parameter(f"rectified_{channel}", "1", 0.0, lower=0.0, upper=1.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        switched_on(new, names[0])
        expression, unit = new.outputs[channel]
        other = expression + new.symbol(names[0]) * (ca.fabs(expression) - expression)
        new.replace_output(channel, other, unit)

    return Effect("rectified", channel, (p,), apply, sided="positive")


def shows_sizes(low: float, high: float) -> bool:
    """True of readings from `low` to `high` that may be absolute values, but for their noise.

    The size of what changes its sign comes near zero: a level that stays above it is no size.
    """
    return high > 0.0 and abs(low) <= RECTIFIED.below_zero * high


def lever_arm(model: Model, channel: str, rate: str) -> Effect:
    """A sensor at a distance r from the assumed point of a body that turns at the state `rate`.

    An acceleration gains r dw/dt, a speed r w, a displacement r times the angle; for small angles,
    along the direction that the output measures.
    """
    p = Parameter(f"arm_{channel}", "m", 0.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        expression, unit = new.outputs[channel]
        turned = _turned(new, channel, rate)
        new.replace_output(channel, expression + new.symbol(names[0]) * turned, unit)

    return Effect("lever_arm", channel, (p,), apply, shape=rate)


def series_resistance(model: Model, channel: str, balance: str) -> Effect | None:
    """An output that shows a store's level and, over a resistance r, what flows into it: y + r f.

    The terminals of a capacitor or a cell have a series resistance, a thermometer on a surface a
    contact, a pressure tap the entry of a pipe. f is the balance's flow, its inertia times the rate
    of the level, with whatever a diagnosis adds to it. None where the output does not show the
    level, or the balance is one of forces: a mass has no such resistance.
    """
    b, (expression, unit) = model.balances[balance], model.outputs[channel]
    if is_mechanical(b.unit) or not ca.jacobian(ca.SX(expression), model.symbol(b.rate)).nnz():
        return None
    of = unit_quotient(unit, b.unit, 1)
    p = Parameter(f"r_{channel}", "ohm" if same_dimension(of, "ohm") else of, 0.0, lower=0.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        shown, own = new.outputs[channel]
        flow = new.balances[balance].inertia * new.der(b.rate)
        new.replace_output(channel, shown + new.symbol(names[0]) * flow, own)

    return Effect(
        "cross_axis",
        channel,
        (p,),
        apply,
        sided="positive",
        priority=2,  # where it is the same as a delay elsewhere, that is named
        shape=balance,
        description=f"the channel {channel} also shows {a_quantity(b.unit, 'flow')} into the "
        f"{balance} balance, {OVER_A_RESISTANCE}",
    )


def curved_reading(model: Model, channel: str, about: float = 0.0) -> Effect:
    """An output whose characteristic is no straight line: y + c (y - `about`)^2.

    `about` (the channel's SI unit) is where it reads right, as `about` of a gain. Without an
    established name: a law of the system curves what it shows in many ways as well.
    """
    unit = model.outputs[channel][1]
    point = carrying_unit(about) if about else 0.0
    p = Parameter(f"curve_{channel}", unit_quotient("1", unit, 1), 0.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        expression, own = new.outputs[channel]
        curved = expression + new.symbol(names[0]) * (expression - point) ** 2
        new.replace_output(channel, curved, own)

    return Effect(
        "unknown",
        channel,
        (p,),
        apply,
        priority=UNNAMED_EFFECTS.priority,
        shape=f"{bracketed(channel)}^2",
        description="an error of the sensor that grows with the square of what it shows",
        constants={"about": about} if about else {},
    )


def sensor_effects_of(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Sensors that may show an absolute value, curve, or sit away from the assumed point."""
    for channel, (_, unit) in model.outputs.items():
        level = sizes.levels.get(channel, 0.0)
        points = zeros_of_reading(model, channel, unit, level)
        yield from (curved_reading(model, channel, a) for a in dict.fromkeys((level, *points)))
        is_shown = made_identifier(f"rectified_{channel}") in model.parameters
        if shows_sizes(*sizes.readings.get(channel, (-1.0, 1.0))) and not is_shown:
            yield rectified(model, channel)
        for balance in model.balances.values():
            if same_dimension(model.states[balance.rate].unit, "rad/s") and (
                _turned(model, channel, balance.rate) is not None
            ):
                yield lever_arm(model, channel, balance.rate)
        for name in model.balances:
            resistance = series_resistance(model, channel, name)
            if resistance is not None:
                yield resistance


def _turned(model: Model, channel: str, rate: str) -> Expr:
    """What a lever arm multiplies in an output, None where the output is no motion of a point."""
    unit = model.outputs[channel][1]
    if not same_dimension(model.states[rate].unit, "rad/s"):
        return None
    if same_dimension(unit, "m/s^2"):
        return model.der(rate)
    if same_dimension(unit, "m/s"):
        return model.symbol(rate)
    angle = model.position_of(rate)
    if same_dimension(unit, "m") and angle is not None:
        return model.symbol(angle)
    return None
