"""Friction beyond Coulomb's: other in each direction, or larger as the motion begins."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balance_effects import force_along
from casid.model.effects.effect import Effect, known_while_null
from casid.model.effects.place import Place
from casid.model.effects.places import place_named
from casid.model.effects.search_ranges import FRICTION_RANGES
from casid.model.model import Model


def asymmetric_damping(model: Model, where: str | Place) -> Effect:
    """-d_a |v|: viscous friction that is larger in one direction, d + d_a there and d - d_a."""
    place = place_named(model, where)
    p = Parameter("d_a", place.velocity_power(1), 0.0)
    return force_along(
        place,
        "asymmetric_friction",
        p,
        lambda d_a: -d_a * ca.fabs(place.velocity),
        shape="viscous",
    )


def asymmetric_coulomb(model: Model, where: str | Place, speed: float) -> Effect:
    """-F_a tanh(v / v_0)^2: dry friction that is larger in one direction, F_c + F_a and F_c - F_a.

    A constant force but at rest, where it is nothing: an offset where the motion does not rest.
    """
    place = place_named(model, where)
    v_0 = carrying_unit(speed)
    p = Parameter("F_a", place.unit, 0.0)
    return force_along(
        place,
        "asymmetric_friction",
        p,
        lambda F_a: -F_a * ca.tanh(place.velocity / v_0) ** 2,
        shape="dry",
        priority=1,
        constants={"speed": speed},
    )


def stribeck_friction(
    model: Model, where: str | Place, speed: float, decay: float, rms: float
) -> Effect:
    """-F_s tanh(v / v_0) exp(-(v / v_s)^2): friction that falls as the motion begins.

    Beside Coulomb's: F_c + F_s at rest, F_c beyond a few v_s.

    Parameters
    ----------
    speed : v_0, below which the reversal is smoothed (rate's SI unit).
    decay : v_s that the search starts from, the same.
    rms : of the rate, which bounds v_s.
    """
    place = place_named(model, where)
    v_0 = carrying_unit(speed)
    lower, upper = (share * rms for share in FRICTION_RANGES.decay)
    parameters = (
        Parameter("F_s", place.unit, 0.0, lower=0.0),
        Parameter("v_s", place.velocity_unit, decay, lower=lower, upper=upper),
    )

    def apply(new: Model, names: Sequence[str]) -> None:
        F_s, v_s = (new.symbol(n) for n in names)
        v = place.velocity
        place.add(new, -F_s * ca.tanh(v / v_0) * ca.exp(-((v / v_s) ** 2)))
        known_while_null(new, names)

    return Effect(
        "stribeck_friction",
        place.where,
        parameters,
        apply,
        sided="positive",
        variant=decay,
        cost=len(parameters),
        description=place.words,
        constants={"speed": speed},
    )
