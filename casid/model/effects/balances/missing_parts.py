"""Parts that a model omits and that move along.

Such a part swings beside a body or between two, and where a balance has a position, or its force
relaxes there as that of rubber; elsewhere it follows with a time constant: a second thermal mass,
the branch of eddy currents, a compartment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import casadi as ca
import numpy as np

from casid.errors import ModelError
from casid.model.declarations import Parameter
from casid.model.effects.effect import Effect, Sizes, added_state, is_null, known_while_null
from casid.model.effects.names import RELAXATION, RELAXES
from casid.model.effects.places.place import (
    Expr,
    Place,
    balance_place,
    in_symbols_of,
    is_mechanical,
)
from casid.model.effects.places.places import place_named, places_of
from casid.model.effects.search_ranges import MISSING_MODES, MISSING_STORES
from casid.model.model import Model
from casid.model.units import same_dimension, unit_quotient


def missing_mode(model: Model, where: str | Place, omega: float, *, at_rest: bool = True) -> Effect:
    """A part that swings along: relative motion q of natural frequency `omega` [rad/s] at first.

        q'' + 2 zeta omega q' + omega^2 q = -dv/dt                                           (1)

    and J_m (omega^2 q + 2 zeta omega q') acts back: on the rate v of a balance, or on a relative
    motion v between two bodies, in both. Without J_m nothing shows omega and zeta: they are then
    known, and estimated where the extension starts from a J_m.

    Parameters
    ----------
    at_rest : before the record; else the motion when it begins is estimated as well.

    Raises
    ------
    ModelError
        If the place has no rate, or one that an input enters, of which no derivative is known.
    """
    place = _swinging(model, where)
    unit, shown = _inertia_units(model, place)
    lowest, highest = MISSING_MODES.lower * omega, MISSING_MODES.upper * omega
    least = MISSING_MODES.least_damping
    p = (
        Parameter("J_m", unit, 0.0, lower=0.0),
        Parameter("omega_m", "rad/s", omega, lower=lowest, upper=highest),
        Parameter("zeta_m", "1", MISSING_MODES.damping, lower=least, upper=1.0),
    )

    def apply(new: Model, names: Sequence[str]) -> None:
        """Add an oscillator that the velocity drives, and the force of its spring and damper."""
        J, w0, zeta = (new.symbol(n) for n in names)
        rate = place.velocity_unit
        initial = 0.0 if at_rest or is_null(new, names) else None
        q = added_state(new, "q_m", unit_quotient(rate, "1/s", 1), initial=initial)
        v = added_state(new, "v_m", rate, initial=initial)
        spring = w0**2 * q + 2 * zeta * w0 * v
        new.derivative(q, v)
        new.derivative(v, -spring - _change(new, place.velocity))
        place.add(new, J * spring)
        known_while_null(new, names)

    return Effect(
        "missing_mode",
        place.where,
        p,
        apply,
        sided="positive",
        variant=omega,
        cost=MISSING_MODES.cost if at_rest else MISSING_MODES.cost_in_motion,
        priority=1,
        description=place.words,
        declared_units={"J_m": shown},
    )


def _swinging(model: Model, where: str | Place) -> Place:
    """The place of this name, which has to be one where a part may swing."""
    place = place_named(model, where)
    if not _swings(model, place):
        raise ModelError(
            f"{model.name}: {place.where} has no rate of states alone, which a further part could "
            "follow"
        )
    return place


def _swings(model: Model, place: Place) -> bool:
    """True of a rate of states, of bodies or of what has a position."""
    if place.velocity is None or not place.has_own_force:
        return False
    if any(row not in model.balances for row, _ in place.shares):
        return False  # no inertia
    own = [s.name() for s in ca.symvar(ca.SX(place.velocity))]
    moves = place.is_mechanical or (
        not place.is_relative and model.position_of(model.balances[place.where].rate) is not None
    )
    return moves and all(name in model.states for name in own)


def _change(model: Model, velocity: Expr) -> Expr:
    """The derivative of an expression in states."""
    v = ca.SX(in_symbols_of(model, velocity))
    own = [s for s in ca.symvar(v) if s.name() in model.states]
    return sum(ca.jacobian(v, s) * model.der(s) for s in own)


def missing_store(model: Model, balance: str, tau: float) -> Effect:
    """A store that follows the one of a balance, with a time constant `tau` [s] at first.

    With x the level of the balance and x - r that of the further store,

        r' = dx/dt - r / tau                                                                 (2)

    and C_m r / tau flows into that store. Its level when the record begins is estimated. Without
    C_m nothing shows tau: it is then known, and both stores begin at one level.
    """
    b = model.balances[balance]
    rate = model.states[b.rate].unit
    unit, shown = _inertia_units(model, balance_place(model, balance))
    p = (Parameter("C_m", unit, 0.0, lower=0.0), _time_constant(tau))

    def apply(new: Model, names: Sequence[str]) -> None:
        """Add a store that follows the level with its time constant, and its flow."""
        C, time_constant = (new.symbol(n) for n in names)
        level = 0.0 if is_null(new, names) else None
        r = added_state(new, "r_m", rate, initial=level)
        new.derivative(r, new.der(b.rate) - r / time_constant)
        new.add_term(balance, -C * r / time_constant)
        known_while_null(new, names)

    return Effect(
        "missing_mode",
        balance,
        p,
        apply,
        sided="positive",
        variant=tau,
        cost=MISSING_STORES.cost,
        priority=1,
        description=f"a further store, which the model omits, follows {b.rate} with a time "
        f"constant (in the {balance} balance)",
        declared_units={"C_m": shown},
    )


def relaxing_spring(model: Model, where: str | Place, tau: float) -> Effect:
    """A spring whose force relaxes with a time constant `tau` [s] at first: rubber, creep.

    The spring and a damper stand in series, Maxwell's element: with v the rate of a balance, or a
    relative motion between two bodies, in both,

        r' = v - r / tau                                                                     (3)

    and -k_m r acts on it. The stretch r of the spring when the record begins is estimated. Without
    k_m nothing shows tau: it is then known, and the spring begins without a force.

    Raises
    ------
    ModelError
        If the place has no rate, or one that an input enters, of which no derivative is known.
    """
    place = _swinging(model, where)
    stiffness = unit_quotient(unit_quotient(place.unit, place.velocity_unit, 1), "s", 1)
    p = (Parameter("k_m", stiffness, 0.0, lower=0.0), _time_constant(tau))

    def apply(new: Model, names: Sequence[str]) -> None:
        """Add the stretch of a spring that the velocity drives, and its force."""
        k, time_constant = (new.symbol(n) for n in names)
        length = unit_quotient(place.velocity_unit, "1/s", 1)
        r = added_state(new, "r_m", length, initial=0.0 if is_null(new, names) else None)
        v = in_symbols_of(new, place.velocity)
        new.derivative(r, v - r / time_constant)
        place.add(new, -k * r)
        known_while_null(new, names)

    return Effect(
        "missing_mode",
        place.where,
        p,
        apply,
        sided="positive",
        variant=tau,
        cost=MISSING_STORES.cost,
        priority=1,
        shape=RELAXATION,
        description=f"{place.a_quantity()} that {RELAXES}, as that of rubber, is missing "
        f"({place.words or f'in the {place.where} balance'})",
    )


def _time_constant(tau: float) -> Parameter:
    """The time constant of a further store or spring, searched about `tau` [s]."""
    lower, upper = MISSING_STORES.lower * tau, MISSING_STORES.upper * tau
    return Parameter("tau_m", "s", tau, lower=lower, upper=upper)


def _inertia_units(model: Model, place: Place) -> tuple[str, str]:
    """SI unit of a further inertia at a place, and the unit that it is shown in.

    Both are those of the inertia that the model has there, where it is a quantity with a unit.
    """
    unit = unit_quotient(unit_quotient(place.unit, place.velocity_unit, 1), "1/s", 1)
    balance = model.balances.get(place.shares[0][0])
    own = model.parameters.get(str(balance.inertia)) if balance is not None else None
    if own is None or not same_dimension(own.unit, unit):
        return unit, unit
    return own.unit, model.declared_units.get(own.name, own.unit)


def time_constants(sizes: Sizes) -> list[float]:
    """Time constants [s] from a few samples up to a share of the record."""
    start, stop = sizes.window
    longest = MISSING_STORES.longest * (stop - start)
    shortest = longest / MISSING_STORES.widest
    if sizes.Ts is not None:
        shortest = MISSING_STORES.shortest * sizes.Ts
    if shortest >= longest:
        return []
    return [float(tau) for tau in np.geomspace(shortest, longest, MISSING_STORES.time_constants)]


def mode_frequencies(sizes: Sizes) -> list[float]:
    """Frequencies [rad/s] from four cycles a record up to a third of Nyquist's."""
    start, stop = sizes.window
    low = 2 * math.pi * MISSING_MODES.slowest / (stop - start)
    high = MISSING_MODES.widest * low
    if sizes.Ts is not None:
        high = math.pi / sizes.Ts / MISSING_MODES.fastest
    return [float(w) for w in np.geomspace(low, max(high, 2 * low), MISSING_MODES.frequencies)]


def missing_parts_of(model: Model, places: Sequence[Place], sizes: Sizes) -> list[Effect]:
    """Parts that may move along with every body and store.

    They swing beside a body, between two, and where the rate is the derivative of a position; with
    what has none they follow. All of them together are cheap to test where their first parameters
    are pinned at zero (`Effect.extended` with upper=0).

    Parameters
    ----------
    places : of the model, `places_of`.
    """
    swinging = [p for p in places if _swings(model, p)]
    frequencies, times = mode_frequencies(sizes), time_constants(sizes)
    found = [missing_mode(model, p, omega) for p in swinging for omega in frequencies]
    found += [relaxing_spring(model, p, tau) for p in swinging for tau in times]
    own = {p.where for p in swinging}
    for balance, b in model.balances.items():
        if balance not in own and not is_mechanical(b.unit):
            found += [missing_store(model, balance, tau) for tau in times]
    return found


def modes_at(model: Model, frequencies: Sequence[float]) -> list[Effect]:
    """Parts that may swing along, each with natural frequencies [rad/s] to begin from."""
    if not frequencies:
        return []
    swinging = [p for p in places_of(model) if _swings(model, p)]
    return [missing_mode(model, p, omega) for p in swinging for omega in frequencies]
