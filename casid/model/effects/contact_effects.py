"""Contacts: a stop that the motion meets, and play that spring and damper share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import casadi as ca
import numpy as np

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balance_effects import clipped_motion, force_along, stiffness_of
from casid.model.effects.effect import Effect, known_while_null
from casid.model.effects.place import Place
from casid.model.effects.places import place_named
from casid.model.effects.search_ranges import CONTACT_RANGES
from casid.model.model import Model
from casid.model.units import unit_quotient

Side = Literal["both", "upper", "lower"]
_VARIANT = {"both": 0.0, "upper": 1.0, "lower": -1.0}


def end_stop(
    model: Model,
    where: str | Place,
    side: Side,
    middle: float,
    reach: float,
    width: float,
    start: float = CONTACT_RANGES.starts[-1],
) -> Effect | None:
    """A stop of stiffness k_stop that acts where the position is `limit` and more from a middle.

    -k_stop r(q - q_0 - limit) on the upper side, r(x) = (x + sqrt(x^2 + e^2)) / 2: nothing before
    the stop, a spring in it, with a corner rounded over e. In a store without a position the stop
    is an overflow: q is the content. None where a mechanical place has no position.

    Parameters
    ----------
    side : where there is one.
    middle : q_0, of the motion met (position's SI unit).
    reach : half of the range met; the limit is searched within.
    width : e.
    start : of `reach`, where the search for the limit starts.
    """
    place = place_named(model, where)
    q = place.position
    unit = place.position_unit
    if q is None:
        if place.is_mechanical or place.velocity is None:
            return None
        q, unit = place.velocity, place.velocity_unit
    lower, upper = (share * reach for share in CONTACT_RANGES.limit)
    parameters = (
        Parameter("k_stop", unit_quotient(place.unit, unit, 1), 0.0, lower=0.0),
        Parameter("limit", unit, start * reach, lower=lower, upper=upper),
    )
    square, q_0 = carrying_unit(width**2), carrying_unit(middle)

    def apply(new: Model, names: Sequence[str]) -> None:
        k, limit = (new.symbol(n) for n in names)
        force = ca.SX(0.0)
        for sign in (1.0, -1.0):
            if _VARIANT[side] * sign >= 0.0:
                into = sign * (q - q_0) - limit
                force = force - sign * k * (into + ca.sqrt(into**2 + square)) / 2
        place.add(new, force)
        known_while_null(new, names)

    return Effect(
        "end_stop",
        place.where,
        parameters,
        apply,
        sided="positive",
        variant=_VARIANT[side],
        cost=len(parameters),
        description=place.words,
        constants={"middle": middle, "width": width},
    )


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
