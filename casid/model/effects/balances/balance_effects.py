"""Effects in a balance, or on a relative motion: forces that a model often omits.

A place (`places`) is a balance by its name or a relative motion that a term of the model acts on; a
force there enters every equation of the place. v is the place's velocity, q its position.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.model.declarations import Hold, Input, Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.effect import (
    Effect,
    Sizes,
    Spread,
    is_one_sided,
    known_while_null,
)
from casid.model.effects.names import GROWS, OPPOSES
from casid.model.effects.places.place import Place, a_constant, is_zero
from casid.model.effects.places.places import place_named
from casid.model.model import Model
from casid.model.quantity_names import letter_of
from casid.model.units import is_comparable, same_dimension, unit_quotient

Expr = Any  # a CasADi expression


def force_along(
    place: Place,
    kind: str,
    parameter: Parameter,
    force: Callable[[Any], Expr],
    **more: Any,
) -> Effect:
    """An effect that is a force with one parameter along a place; `more` as `Effect` takes it."""

    def apply(new: Model, names: Sequence[str]) -> None:
        place.add(new, force(new.symbol(names[0])))

    more.setdefault("description", place.words)
    return Effect(kind, place.where, (parameter,), apply, **more)


def quadratic_damping(model: Model, where: str | Place, about: float = 0.0) -> Effect:
    """-d_2 |v| v (drag, eddies), d_2 >= 0; of a temperature, say, -d_2 |v - v_0| (v - v_0).

    `about` is what v_0 is estimated from, in the rate's SI unit: the level that a loss by natural
    convection goes to is not known, and the mean of a record is none.
    """
    place = place_named(model, where)
    d_2 = Parameter("d_2", place.velocity_power(2), 0.0, lower=0.0)
    level = Parameter(f"level_{place.velocity_name}", place.velocity_unit, about)

    def apply(new: Model, names: Sequence[str]) -> None:
        known_while_null(new, names)
        v = place.velocity - (new.symbol(names[1]) if about else 0.0)
        place.add(new, -new.symbol(names[0]) * ca.fabs(v) * v)

    shown = model.declared_units.get(place.velocity_name)
    return Effect(
        "quadratic_damping",
        place.where,
        (d_2, level) if about else (d_2,),
        apply,
        sided="positive",
        cost=2 if about else 1,
        description=_law_words(place, "square", place.velocity_name, level.name if about else ""),
        declared_units={level.name: shown} if about and shown else {},
    )


def cubic_damping(model: Model, where: str | Place, about: float = 0.0) -> Effect:
    """-d_3 v^3, or -d_3 (v - v_0)^3 with `about` v_0 (rate's SI unit)."""
    place = place_named(model, where)
    v = _about(place.velocity, about)
    p = Parameter("d_3", place.velocity_power(3), 0.0)
    constants = {"about": about} if about else {}
    return force_along(
        place,
        "cubic_damping",
        p,
        lambda d_3: -d_3 * v**3,
        constants=constants,
        description=_law_words(place, "cube", place.velocity_name, "its mean" if about else ""),
    )


def _law_words(place: Place, power: str, name: str, level: str) -> str:
    """What a law of damping or of a spring is called where the balance is no force's."""
    if place.is_mechanical:
        return place.words
    of = f"{name or place.where}{f' from {level}' if level else ''}"
    return f"{place.a_quantity('flow')} {GROWS} the {power} of {of}"


def _opposing_words(place: Place) -> str:
    """What takes the place of dry friction where the balance is no force's."""
    if place.is_mechanical:
        return place.words
    what = place.a_quantity("flow").partition(" ")[2]
    example = ", as a dead voltage or a brush drop does" if what == "voltage" else ""
    return f"a constant {what} {OPPOSES} {place.velocity_name or place.where}{example}"


def coulomb_friction(model: Model, where: str | Place, speed: float) -> Effect:
    """-F_c tanh(v / v_0): dry friction, smoothed below `speed` = v_0 (rate's SI unit).

    The smoothing keeps the simulation differentiable; it is small against the speeds met. In a
    balance of voltages it is the dead voltage V_c of a converter, or the drop over brushes or
    diodes.
    """
    place = place_named(model, where)
    v_0 = carrying_unit(speed)
    letter = "F" if place.is_mechanical else letter_of(place.unit, place.velocity_unit)
    p = Parameter(f"{letter}_c", place.unit, 0.0, lower=0.0)
    return force_along(
        place,
        "coulomb_friction",
        p,
        lambda F_c: -F_c * ca.tanh(place.velocity / v_0),
        sided="positive",
        description=_opposing_words(place),
        constants={"speed": speed},
    )


def cubic_stiffness(model: Model, where: str | Place, about: float = 0.0) -> Effect | None:
    """-k_3 (q - q_0)^3, q the position; hardening or softening. None without a position.

    `about` is q_0 in the position's SI unit: zero, or the middle of a motion that stays away from
    zero, where a cube about zero would be a line and a parabola.
    """
    return _restoring(model, where, "cubic_stiffness", 3, about)


def quadratic_stiffness(model: Model, where: str | Place, about: float = 0.0) -> Effect | None:
    """-k_2 (q - q_0)^2: a spring that is stiffer to one side; `about` as for `cubic_stiffness`."""
    return _restoring(model, where, "quadratic_stiffness", 2, about)


_DEGREES = {2: "square", 3: "cube"}


def _restoring(
    model: Model, where: str | Place, kind: str, power: int, about: float
) -> Effect | None:
    place = place_named(model, where)
    if place.position is None:
        return None
    q = _about(place.position, about)
    unit = unit_quotient(place.unit, place.position_unit, power)
    p = Parameter(f"k_{power}", unit, 0.0)
    constants = {"about": about} if about else {}
    level = "its mean" if about else ""
    words = _law_words(place, _DEGREES[power], place.position_name, level)
    return force_along(
        place, kind, p, lambda k: -k * q**power, constants=constants, description=words
    )


def deadzone(
    model: Model, where: str | Place, width: float, largest: float = np.inf
) -> Effect | None:
    """Play in the restoring force: the position q acts as q - clip(q, -gap, gap), gap >= 0.

    The term is K s(q, gap) with K the effective stiffness and

        s = (sqrt((q + gap)^2 + e^2) - sqrt((q - gap)^2 + e^2)) / 2,

    which is clip(q, -gap, gap) but for rounded corners of `width` e (position's SI unit, small
    against the motion): zero at gap = 0, with the slope q / sqrt(q^2 + e^2) there.

    Parameters
    ----------
    largest : largest |q| met; a gap as wide as the motion leaves no restoring force to see.
    """
    place = place_named(model, where)
    if place.position is None:
        return None
    K = stiffness_of(model, place)
    if K is None:
        return None
    p = Parameter("gap", place.position_unit, 0.0, lower=0.0, upper=largest)
    return force_along(
        place,
        "deadzone",
        p,
        lambda gap: K * clipped_motion(place.position, gap, width),
        sided="positive",
        limit=largest if np.isfinite(largest) else None,
        constants={"width": width},
    )


def clipped_motion(q: Expr, gap: Expr, width: float) -> Expr:
    """s(q, gap) of `deadzone`: clip(q, -gap, gap) with corners rounded over `width`."""
    square = carrying_unit(width**2)
    return (ca.sqrt((q + gap) ** 2 + square) - ca.sqrt((q - gap) ** 2 + square)) / 2


def stiffness_of(model: Model, place: Place) -> Expr | None:
    """The stiffness K that a force along a place has beside it, None where there is none."""
    if place.where in model.balances:
        symbol = ca.symvar(place.position)
        return effective_stiffness(model, place.where, symbol[0].name())
    return place.stiffness


def effective_stiffness(model: Model, balance: str, position: str) -> Any | None:
    """K = -(df/dq) / (df/dtau) at q = 0, in the balance's unit over the position's; None if zero.

    f is the rate's derivative in the explicit equations, q the position, and tau a force added to
    the balance: K q is the force that acts as the restoring force does. Where an unknown input has
    been eliminated it is the remaining stiffness: k of the indirect pendulum, not k + S g.
    """
    probe = model.copy()
    tau = ca.SX.sym("tau")
    probe.add_term(balance, tau)
    e = probe.explicit()
    f = e.f[e.states.index(model.balances[balance].rate)]
    q = model.symbol(position)
    K = -ca.jacobian(f, q) / ca.jacobian(f, tau)
    K = ca.substitute(ca.substitute(ca.SX(K), tau, 0), q, 0)
    symbols = ca.symvar(K)
    value = ca.Function("K", [ca.vertcat(ca.SX(0, 1), *symbols)], [ca.densify(K)])
    rng = np.random.default_rng(5)
    points = [ca.DM(rng.uniform(0.2, 1.7, (len(symbols), 1))) for _ in range(3)]
    sizes = [abs(float(value.call([point])[0])) for point in points]
    finite = [size for size in sizes if np.isfinite(size)]
    return K if finite and max(finite) > 1e-12 else None


def offset(model: Model, where: str | Place) -> Effect:
    """A constant force, voltage or flow in a balance, or between two bodies or stores."""
    place = place_named(model, where)
    is_known = place.unit == "N m" or not place.is_mechanical
    p = Parameter(
        f"{letter_of(place.unit, place.velocity_unit) if is_known else 'F'}_0", place.unit, 0.0
    )
    words = f"{a_constant(place.unit, place.velocity_unit)} {place.words}".rstrip()
    return force_along(place, "offset", p, lambda F_0: F_0, description=words)


def extra_input(
    model: Model, balance: str, channel: str, unit: str, about: float = 0.0, hold: Hold = "foh"
) -> Effect:
    """b u: a recorded channel that acts in a balance although the model does not use it.

    A channel of the rate's own kind in a balance of no force (a temperature beside a heat balance)
    exchanges: what acts is its difference to the rate, b (c - x). Any other acts from its zero, or
    with `about` u_0 (SI unit) from an operating point, b (u - u_0): the record's constants, fitted
    at that point, hold the rest. Between its samples it does what `hold` says.
    """
    b = model.balances[balance]
    p = Parameter(f"b_{channel}", unit_quotient(b.unit, unit, 1), 0.0)
    exchanges = _exchanges(model, balance, unit)

    def apply(new: Model, names: Sequence[str]) -> None:
        """Add a term that goes with the channel to the balance."""
        if channel in new.inputs:
            u = new.symbol(channel)
        else:
            u = new.add_input(Input(channel, unit, "known", hold))
        acts = u - new.symbol(b.rate) if exchanges else _about(u, about)
        new.add_term(balance, new.symbol(names[0]) * acts)

    constants = {"about": about} if about else {}
    reverses = channel in model.inputs and any(ca.which_depends(b.total, model.symbol(channel)))
    also = f"the input {channel} acts in the {balance} balance{' in proportion' * reverses}, too"
    # A late sensor acts much as what drives the system does, and is met more often.
    return Effect(
        "extra_input",
        channel,
        (p,),
        apply,
        priority=3,
        constants=constants,
        shape=balance if len(model.balances) > 1 else "",
        description=also if channel in model.inputs else "",
    )


def further_places_of_inputs(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Inputs of the model in the balances that they do not act in: couplings that it leaves out.

    In a balance that does not depend on an input's sign, as a heat balance in which a current acts
    by its square, what reverses with the input is left out as well (a Peltier heat).
    """
    for balance, b in model.balances.items():
        side = b.total
        for channel, (low, high) in sizes.readings.items():
            entry = model.inputs.get(channel)
            if entry is None:
                continue
            u = model.symbol(channel)
            reverses = low < 0 < high and is_zero(side - ca.substitute(side, u, -u))
            if any(ca.which_depends(side, u)) and not reverses:
                continue
            spread = Spread(sizes.levels.get(channel, 0.0), low, high)
            yield from extra_inputs_of(model, balance, channel, entry.unit, spread)


def extra_inputs_of(
    model: Model, balance: str, channel: str, unit: str, reading: Spread | None
) -> Iterator[Effect]:
    """A recorded channel in a balance, from its zero and from the mean of what stays away from it.

    The zero of a temperature scale means nothing to a force: from there it would be a constant.
    """
    hold = reading.hold if reading else "foh"
    if (
        reading is None
        or not is_one_sided(reading.lowest, reading.highest)
        or _exchanges(model, balance, unit)
    ):
        yield extra_input(model, balance, channel, unit, hold=hold)
        return
    if not same_dimension(unit, "K"):
        yield extra_input(model, balance, channel, unit, hold=hold)
    yield extra_input(model, balance, channel, unit, reading.mean, hold)


def _exchanges(model: Model, balance: str, unit: str) -> bool:
    """True of a channel of the rate's own kind in a balance of no force."""
    rate_unit = model.states[model.balances[balance].rate].unit
    return not place_named(model, balance).is_mechanical and is_comparable(unit, rate_unit)


def _about(coordinate: Expr, point: float) -> Expr:
    """A coordinate counted from an operating point."""
    return coordinate - carrying_unit(point) if point else coordinate
