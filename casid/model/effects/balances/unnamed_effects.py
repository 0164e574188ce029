"""Effects without an established name: neighbours of named ones, called "unknown" with a shape.

Where the truth is none of the named effects, the nearest named one would explain part of it and be
taken for the cause. These stand beside them in every test: one that wins says that something acts,
and how it grows, but nothing that a textbook names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balances.balance_effects import force_along
from casid.model.effects.balances.flow_laws import is_positive
from casid.model.effects.effect import Effect, Sided, known_while_null
from casid.model.effects.names import bracketed
from casid.model.effects.places.elements import are_joined
from casid.model.effects.places.place import Place, is_amount, is_mechanical, is_zero
from casid.model.effects.places.places import place_named
from casid.model.effects.search_ranges import UNNAMED_EFFECTS
from casid.model.model import Model
from casid.model.units import same_dimension, unit_quotient

Expr = Any  # a CasADi expression


def unnamed_effects(
    model: Model, where: str | Place, speed: float, *, is_signed: bool = False
) -> list[Effect]:
    """Terms in the velocity v and the position q of a place that have no name of their own.

    v^2 of one sign and |v|^1/2 sign(v), and with a position q also q^5, q v and q^2 v. `speed` (v's
    unit) is where the root is rounded, small against the speeds met; its factor is what acts there.
    Of a velocity that keeps its sign the square has a name.
    """
    place = place_named(model, where)
    v, q = place.velocity, place.position
    v_, q_ = bracketed(place.velocity_name), bracketed(place.position_name)
    what = place.a_quantity()

    def term(shape: str, says: str, of: Expr, v_power: int, q_power: int = 0) -> Effect:
        """The effect -c `of` along the place, with the unit of `of` in its powers."""
        suffix = "".join(c for c in shape.replace("^", "") if c.isalnum() or c == "_")
        return force_along(
            place,
            "unknown",
            Parameter(f"c_{suffix}", place.velocity_power(v_power, q_power), 0.0),
            lambda c: -c * of,
            priority=UNNAMED_EFFECTS.priority,
            shape=shape,
            description=f"{what} {says}",
            constants={"speed": speed} if shape.startswith("sqrt") else {},
        )

    found = []
    if v is not None:
        w = v / carrying_unit(speed)
        root = w / ca.sqrt(ca.sqrt(1 + w**2))
        found = [
            term(f"{v_}^2", f"that grows with {v_} squared, of one sign", v**2, 2),
            term(f"sqrt|{v_}|", f"that grows with the root of |{v_}|", root, 0),
        ][is_signed:]
    if q is not None:
        found.append(term(f"{q_}^5", f"that grows with the fifth power of {q_}", q**5, 0, 5))
    if v is not None and q is not None:
        found += [
            term(f"{q_} {v_}", f"that grows with {q_} times {v_}", q * v, 1, 1),
            term(f"{q_}^2 {v_}", f"of damping that grows with {q_} squared", q**2 * v, 1, 2),
        ]
    return found


def linear_loss(
    model: Model, where: str | Place, about: float, *, sided: Sided = "both"
) -> Effect | None:
    """-c (v - v_0), in a balance whose rate no estimated parameter of its own resists yet.

    A loss or viscous friction that the model leaves out: drag, or a valve that an input opens, is
    another resistance. Of a rate that stays away from zero, about
    which `about` is searched first, v_0 is estimated, as the temperature of a room; where the rest
    of the balance vanishes with v, as growth does with the cells, v_0 is zero. What passes to
    another balance is no loss.

    Parameters
    ----------
    about : what v_0 is searched from, the rate's SI unit; 0: it vanishes with v.
    sided : "positive" from far away, where c of the other sign is a valley of its own.
    """
    place = place_named(model, where)
    rows = {n: b.total for n, b in model.balances.items()}
    if place.where in rows and vanishes_with(rows[place.where], place.velocity):
        about = 0.0
    slopes = {n: ca.jacobian(row, place.velocity) for n, row in (rows | model._rates).items()}
    own = slopes.pop(place.where)
    others, moving = ca.vertcat(*slopes.values()), {*model.states, *model.inputs}
    for q in [model.symbol(n) for n, p in model.parameters.items() if not p.is_known]:
        passes_on = bool(slopes) and any(ca.which_depends(others, q))
        resists = any(ca.which_depends(own, q)) and not moving & _symbols(ca.jacobian(own, q))
        if resists and not passes_on:
            return None
    v, c = place.velocity, Parameter(f"c_{place.velocity_name}", place.velocity_power(1), 0.0)
    rest = Parameter(f"rest_{place.velocity_name}", place.velocity_unit, about)
    beyond = f" less {rest.name}" if about else ""

    def apply(new: Model, names: Sequence[str]) -> None:
        known_while_null(new, names)
        level = new.symbol(names[1]) if about else 0.0
        place.add(new, -new.symbol(names[0]) * (v - level))

    return Effect(
        "unknown",
        place.where,
        (c, rest) if about else (c,),
        apply,
        sided=sided,
        priority=1,
        cost=2 if about else 1,
        shape=place.velocity_name,
        description=f"{place.a_quantity()} in proportion to {place.velocity_name}{beyond}, "
        "which the model leaves out",
    )


def saturating_force(model: Model, where: str | Place, typical: float) -> Effect | None:
    """-C v between two bodies becomes -C v sqrt((1 + r v_ref^2) / (1 + r v^2)), v their slip.

    The force of a belt, a tyre or a clutch grows with the slip and levels off. r is one over the
    square of the slip at which it bends, its null value 0; at v_ref, `typical` (v's SI unit), the
    force is what it was. None where the model has no damping between two bodies.
    """
    place = place_named(model, where)
    if not (place.is_mechanical and place.is_relative) or place.damping is None or typical <= 0.0:
        return None
    v, C, v_ = place.velocity, place.damping, bracketed(place.velocity_name)
    square = carrying_unit(typical**2)

    def apply(new: Model, names: Sequence[str]) -> None:
        r = new.symbol(names[0])
        place.add(new, C * v * (1 - ca.sqrt((1 + r * square) / (1 + r * v**2))))

    name = "".join(c for c in place.velocity_name if c.isalnum() or c == "_")
    r = Parameter(
        f"r_{name}",
        unit_quotient("1", place.velocity_unit, 2),
        0.0,
        lower=0.0,
        upper=UNNAMED_EFFECTS.most_saturated / typical**2,
    )
    return Effect(
        "unknown",
        place.where,
        (r,),
        apply,
        sided="positive",
        priority=UNNAMED_EFFECTS.priority,
        shape=f"{v_}/sqrt(1+r{v_}^2)",
        description=f"{place.a_quantity()} that levels off with {v_}, as "
        f"{v_}/sqrt(1 + {r.name} {v_}^2) does, not in proportion to it",
        constants={"reference": typical},
    )


def linear_restoring_force(model: Model, where: str | Place) -> Effect | None:
    """-k q, in a mechanical place with a position that nothing of the model pulls back.

    A spring, a tether or a cable that the model leaves out.
    """
    place = place_named(model, where)
    if place.position is None or not place.is_mechanical or place.where not in model.balances:
        return None
    if any(ca.which_depends(model.balances[place.where].total, place.position)):
        return None
    return force_along(
        place,
        "unknown",
        Parameter(f"k_{place.position_name}", place.velocity_power(0, 1), 0.0),
        lambda k: -k * place.position,
        priority=1,
        shape=place.position_name,
        description=f"{place.a_quantity()} in proportion to {place.position_name}, "
        "which the model leaves out",
    )


def uptakes_of(model: Model, ranges: Mapping[str, tuple[float, float]]) -> Iterator[Effect]:
    """-c x in the balance of another quantity y, where x so far acts with that quantity alone.

    Of a reaction between the two, as growth is of cells and sugar: what cells use up to stay alive,
    or make of nothing that is modelled. Where all that x does there ends with y, and the record
    has y used up, the uptake ends, too: no concentration falls below zero. `ranges` are the lowest
    and highest values of states, of which x has to stay positive.
    """
    states = ca.vertcat(*[model.symbol(name) for name in model.states])
    for place in (place_named(model, balance) for balance in model.balances):
        for name, ends in ranges.items():
            x, rate = model.symbol(name), model.balances[place.where].rate
            if place.is_mechanical or name == rate or not is_positive(ends):
                continue
            slope = ca.jacobian(model.balances[place.where].total, x)
            if not any(ca.which_depends(slope, states)):
                continue
            low, high = ranges.get(rate, (0.0, 0.0))
            trace = UNNAMED_EFFECTS.used_up * high
            y = model.symbol(rate)
            ends_with_it = abs(low) < trace and is_zero(ca.sumsqr(ca.substitute(slope, y, 0.0)))
            there = y / ca.sqrt(y**2 + carrying_unit(trace**2)) if ends_with_it else 1.0
            yield force_along(
                place,
                "unknown",
                Parameter(f"c_{name}", unit_quotient(place.unit, model.states[name].unit), 0.0),
                _taken(x * there),
                priority=UNNAMED_EFFECTS.priority,
                shape=name,
                description=f"{place.a_quantity()} in proportion to {name}"
                f"{f' as long as there is {rate}' * ends_with_it}, which the model leaves out",
                constants={"trace": trace} if ends_with_it else {},
            )


def missing_links(model: Model, elements: Sequence[Place]) -> Iterator[Effect]:
    """c (x2 - x1) in the balance of x1, and the opposite in that of x2: stores that nothing joins.

    What the model keeps apart may exchange all the same: a seal leaks from one chamber of a
    cylinder to the other, heat passes between two rooms. The levels are of one kind (temperatures,
    pressures, the levels of tanks), and both balances are of what passes: of concentrations, lags
    and rates of change nothing says how much of one is how much of the other.

    Parameters
    ----------
    elements : of the model, `elements_of`.
    """
    for (one, a), (other, b) in combinations(model.balances.items(), 2):
        level, unit = model.states[a.rate].unit, a.unit
        if not (same_dimension(unit, b.unit) and same_dimension(level, model.states[b.rate].unit)):
            continue
        if is_mechanical(unit) or is_amount(level) or same_dimension(unit, "V"):
            continue
        if same_dimension(unit, level) or same_dimension(unit, unit_quotient(level, "s")):
            continue
        if are_joined(elements, one, other):
            continue
        name = f"{a.rate}-{b.rate}"
        place = Place(
            where=name,
            unit=unit,
            velocity=model.symbol(a.rate) - model.symbol(b.rate),
            velocity_unit=level,
            position=None,
            position_unit="1",
            shares=((one, ca.SX(1.0)), (other, ca.SX(-1.0))),
            velocity_name=name,
            position_name="",
        )
        yield force_along(
            place,
            "unknown",
            Parameter(f"c_{a.rate}_{b.rate}", place.velocity_power(1), 0.0),
            _taken(place.velocity),
            sided="positive",
            priority=UNNAMED_EFFECTS.priority,
            shape=name,
            description=f"{place.a_quantity()} in proportion to {name} from {one} to {other}, "
            "which the model leaves out",
        )


def _taken(x: Expr) -> Callable[[Any], Expr]:
    """What takes c x away, as a function of c."""
    return lambda c: -c * x


def vanishes_with(side: Expr, symbol: Expr) -> bool:
    """True if an expression is zero wherever a symbol is, against what it is at random points."""
    others = ca.symvar(ca.veccat(side, symbol))
    both = ca.Function("sides", others, [ca.substitute(side, symbol, 0.0), side])
    rng = np.random.default_rng(3)
    draws = [both(*rng.uniform(0.2, 1.7, len(others))) for _ in range(3)]
    return all(abs(float(at_zero)) <= 1e-12 * abs(float(there)) for at_zero, there in draws)


def _symbols(expression: Any) -> set[str]:
    """The names that an expression depends on."""
    return {s.name() for s in ca.symvar(ca.SX(expression))}
