"""Contacts: a stop that the motion meets, and play that spring and damper share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import casadi as ca
import numpy as np

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balances.balance_effects import clipped_motion, force_along, stiffness_of
from casid.model.effects.effect import Effect, known_while_null
from casid.model.effects.names import CLAMP, OVERFLOW
from casid.model.effects.places.place import Place, is_electrical
from casid.model.effects.places.places import place_named
from casid.model.effects.search_ranges import CONTACT_RANGES
from casid.model.model import Model
from casid.model.units import unit_quotient

Side = Literal["both", "symmetric", "upper", "lower"]
_VARIANT: Mapping[Side, float] = {"both": 0.0, "symmetric": 2.0, "upper": 1.0, "lower": -1.0}
_LIMITS: Mapping[Side, Mapping[str, float]] = {
    "upper": {"limit": 1.0},
    "lower": {"limit": -1.0},
    "symmetric": {"limit": 1.0},
    "both": {"limit_lower": -1.0, "limit_upper": 1.0},
}
"""Positions of the stops of each side, and the direction in which each is met."""
_ACTS: Mapping[Side, str] = {
    "upper": "where {q} is above limit",
    "lower": "where {q} is below limit",
    "symmetric": "where {q} is farther from zero than limit",
    "both": "where {q} is below limit_lower or above limit_upper",
}


def end_stop(
    model: Model,
    where: str | Place,
    side: Side,
    middle: float,
    reach: float,
    width: float,
    start: float = CONTACT_RANGES.starts[-1],
) -> Effect | None:
    """A stop of stiffness k_stop that acts beyond a position q = limit.

    -k_stop r(q - limit) on the upper side, r(x) = (x + sqrt(x^2 + e^2)) / 2: nothing before the
    stop, a spring in it, with a corner rounded over e. Stops on both sides have a position each,
    `limit_lower` and `limit_upper`, symmetric ones are at limit and -limit. In a store without a
    position the stop is an overflow: q is the content. None where a mechanical place has no
    position, and for symmetric stops of a motion about elsewhere than zero.

    Parameters
    ----------
    side : where there is one.
    middle : of the motion met (position's SI unit).
    reach : half of the range met; the positions are searched within.
    width : e.
    start : of `reach`, how far from the middle the search for the positions starts.
    """
    place = place_named(model, where)
    q, _, unit = _content_of(place)
    if q is None:
        return None
    if side == "symmetric":
        if abs(middle) > CONTACT_RANGES.two * reach:
            return None
        middle = 0.0
    stiffness = Parameter("k_stop", unit_quotient(place.unit, unit, 1), 0.0, lower=0.0)
    positions = _positions(side, unit, middle, reach, start)
    return _stop_of(model, place, side, (stiffness, *positions), width)


def rounded_stop(model: Model, stop: Effect, width: float) -> Effect:
    """The stop with its corner rounded over `width` (position's SI unit)."""
    side = next(side for side, variant in _VARIANT.items() if variant == stop.variant)
    return _stop_of(model, place_named(model, stop.where), side, stop.parameters, width)


def _content_of(place: Place) -> tuple[ca.SX | None, str, str]:
    """What a stop limits, its name and its unit: a position, or what a store contains."""
    if place.position is None and not place.is_mechanical:
        return place.velocity, place.velocity_name, place.velocity_unit
    return place.position, place.position_name, place.position_unit


def _stop_of(
    model: Model, place: Place, side: Side, parameters: tuple[Parameter, ...], width: float
) -> Effect:
    """The effect; its parameters are the stiffness and the positions."""
    q, name, _ = _content_of(place)
    square = carrying_unit(width**2)

    def apply(new: Model, names: Sequence[str]) -> None:
        """Add the force of each stop, smooth about its limit."""
        k = new.symbol(names[0])
        force = ca.SX(0.0)
        for limit, sign in _stops(side, [new.symbol(n) for n in names[1:]]):
            into = sign * (q - limit)
            force = force - sign * k * (into + ca.sqrt(into**2 + square)) / 2
        place.add(new, force)
        known_while_null(new, names)

    law = CLAMP if is_electrical(place.unit) else OVERFLOW
    first = place.words if place.is_mechanical else law
    acts = ", ".join(w for w in (first, _ACTS[side].format(q=name or place.where)) if w)
    shown = model.declared_units.get(name)
    return Effect(
        "end_stop",
        place.where,
        parameters,
        apply,
        sided="positive",
        variant=_VARIANT[side],
        cost=len(parameters),
        description=acts,
        constants={"width": width},
        declared_units={p.name: shown for p in parameters[1:]} if shown else {},
    )


def _positions(side: Side, unit: str, middle: float, reach: float, start: float) -> list[Parameter]:
    """The positions of the stops, as parameters, within the range that is searched."""
    nearest = (CONTACT_RANGES.one if side in ("upper", "lower") else CONTACT_RANGES.two) * reach
    found = []
    for limit, sign in _LIMITS[side].items():
        low, high = sorted((sign * nearest, sign * reach))
        at = middle + sign * start * reach
        low, high = middle + low, middle + high
        found.append(Parameter(limit, unit, at, lower=low, upper=high, is_searched=True))
    return found


def _stops(side: Side, positions: Sequence[Any]) -> list[tuple[Any, float]]:
    """Every stop with the direction in which it is met."""
    stops = list(zip(positions, _LIMITS[side].values(), strict=True))
    if side == "symmetric":
        stops += [(-position, -sign) for position, sign in stops]
    return stops


def backlash(
    model: Model, where: str | Place, width: float, largest: float = np.inf
) -> Effect | None:
    """Play between two bodies whose spring and damper part contact together, gap >= 0.

    The gap takes up s(q, gap) of the relative position (`deadzone`), so that the coupling transmits
    K (q - s) + C d(q - s)/dt: nothing in the gap, where play in the spring alone leaves the damper.
    None where the model's coupling has not both.
    """
    place = place_named(model, where)
    if place.position is None or place.velocity is None or place.damping is None:
        return None
    K, C, q, v = stiffness_of(model, place), place.damping, place.position, place.velocity
    if K is None:
        return None
    square = carrying_unit(width**2)

    def force(gap: Any) -> Any:
        """Force of a spring and a damper behind a gap, smooth about its ends."""

        def slope(x: Any) -> Any:
            return x / ca.sqrt(x**2 + square)

        taken = clipped_motion(q, gap, width)
        rate = (slope(q + gap) - slope(q - gap)) / 2 * v
        return K * taken + C * rate

    p = Parameter("gap", place.position_unit, 0.0, lower=0.0, upper=largest)
    return force_along(
        place,
        "backlash",
        p,
        force,
        sided="positive",
        priority=1,
        limit=largest if np.isfinite(largest) else None,
        constants={"width": width},
    )
