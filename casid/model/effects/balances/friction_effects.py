"""Friction beyond Coulomb's: other in each direction, larger at rest, or with a memory."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balances.balance_effects import force_along
from casid.model.effects.effect import (
    HYSTERESIS_SHAPE,
    Effect,
    added_state,
    is_null,
    known_while_null,
)
from casid.model.effects.places.place import Place, in_symbols_of
from casid.model.effects.places.places import place_named
from casid.model.effects.search_ranges import FRICTION_RANGES, HYSTERESIS
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


def hysteresis(
    model: Model, where: str | Place, travel: float, bounds: tuple[float, float]
) -> Effect | None:
    """-F_h z with a memory z of the motion before, as rubber, wire rope and preloaded joints have.

        z' = (v - b |v| |z|^(n-1) z - (1 - b) v |z|^n) / x_h,    |z| <= 1                      (1)

    Bouc and Wen's equation; with b = 1 and n = 1 it is Dahl's friction. Where the motion
    turns, the force is a spring F_h / x_h; beyond a few x_h it is dry friction F_h. Its memory when
    the record begins is estimated. Without F_h nothing shows x_h, b and n, which are then known.

    Parameters
    ----------
    travel : x_h that the search starts from (position's SI unit).
    bounds : of x_h, the same.

    None for places without a position and its rate.

    Source
    ------
    Ismail, Ikhouane, Rodellar (2009), The hysteresis Bouc-Wen model, a survey, eq. (3).
    """
    place = place_named(model, where)
    if place.position is None or place.velocity is None:
        return None
    lower, upper = bounds
    (least, most), (blunt, sharp) = HYSTERESIS.shape, HYSTERESIS.exponent
    parameters = (
        Parameter("F_h", place.unit, 0.0, lower=0.0),
        Parameter("x_h", place.position_unit, travel, lower=lower, upper=upper),
        Parameter("b_h", "1", HYSTERESIS.start, lower=least, upper=most),
        Parameter("n_h", "1", blunt, lower=blunt, upper=sharp),
    )

    def apply(new: Model, names: Sequence[str]) -> None:
        """Add a Bouc-Wen state of the velocity, and its hysteretic force."""
        F_h, x_h, b, n = (new.symbol(n) for n in names)
        v = in_symbols_of(new, place.velocity)
        at_rest = 0.0 if is_null(new, names) else None
        z = added_state(new, "z_h", "1", initial=at_rest, lower=-1.0, upper=1.0)
        before = (z**2 + HYSTERESIS.rounding) ** (0.5 * (n - 1)) * z  # |z|^(n - 1) z
        along, against = v * ca.sign(z) * before, ca.fabs(v) * before
        new.derivative(z, (v - b * against - (1 - b) * along) / x_h)
        place.add(new, -F_h * z)
        known_while_null(new, names)

    return Effect(
        "unknown",
        place.where,
        parameters,
        apply,
        sided="positive",
        variant=travel,
        cost=HYSTERESIS.cost,
        shape=HYSTERESIS_SHAPE,
        description=f"hysteresis along {place.position_name} (Bouc-Wen), a force that depends on "
        "the motion before",
    )
