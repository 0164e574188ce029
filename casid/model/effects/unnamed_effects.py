"""Effects without an established name: neighbours of named ones, called "unknown" with a shape.

Where the truth is none of the named effects, the nearest named one would explain part of it and be
taken for the cause. These stand beside them in every test: one that wins says that something acts,
and how it grows, but nothing that a textbook names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balance_effects import force_along
from casid.model.effects.effect import Effect, known_while_null
from casid.model.effects.place import Place, is_zero
from casid.model.effects.places import place_named
from casid.model.effects.search_ranges import SMOOTHING, UNNAMED_EFFECTS
from casid.model.model import Model
from casid.model.units import quantity_of, unit_quotient

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
    v_, q_ = _bracketed(place.velocity_name), _bracketed(place.position_name)
    what = f"a {quantity_of(place.unit)}"

    def term(shape: str, says: str, of: Expr, v_power: int, q_power: int = 0) -> Effect:
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


def flow_law(model: Model, where: str | Place, typical: float) -> Effect | None:
    """A flow C d between two stores becomes C d (|d| / d_ref)^(n - 1), d the difference.

    As `power_law`, for a difference of levels, pressures or temperatures, of either sign. `typical`
    is d_ref. None for mechanical places, and where the model has no flow in proportion to d.
    """
    place = place_named(model, where)
    if place.is_mechanical or place.damping is None or typical <= 0.0:
        return None
    small = carrying_unit((SMOOTHING.power * typical) ** 2)
    whole = carrying_unit(typical**2 + small)
    d, C, name = place.velocity, place.damping, _bracketed(place.velocity_name)

    def apply(new: Model, names: Sequence[str]) -> None:
        power = ca.exp(0.5 * (new.symbol(names[0]) - 1) * ca.log((d**2 + small) / whole))
        place.add(new, C * d * (1 - power))

    lower, upper = UNNAMED_EFFECTS.lowest_power, UNNAMED_EFFECTS.highest_power
    suffix = "".join(c if c.isalnum() else "_" for c in place.velocity_name)
    return Effect(
        "unknown",
        place.where,
        (Parameter(f"exponent_{suffix}", "1", 1.0, lower=lower, upper=upper),),
        apply,
        shape=f"|{name}|^n",
        description=f"a flow that grows with a power of {name}, not in proportion to it",
        constants={"reference": typical},
    )


def linear_loss(model: Model, where: str | Place, about: float) -> Effect | None:
    """-c (v - v_0), in a balance whose rate no estimated parameter of its own resists yet.

    A loss or viscous friction that the model leaves out: drag, or a valve that an input opens, is
    another resistance. Of a rate that stays away from zero, about
    which `about` is searched first, v_0 is estimated, as the temperature of a room; where the rest
    of the balance vanishes with v, as growth does with the cells, v_0 is zero. What passes to
    another balance is no loss.
    """
    place = place_named(model, where)
    rows = {n: b.total for n, b in model.balances.items()}
    if place.where in rows and _vanishes_with(rows[place.where], place.velocity):
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
        priority=1,
        cost=2 if about else 1,
        shape=place.velocity_name,
        description=f"a {quantity_of(place.unit)} in proportion to {place.velocity_name}{beyond}, "
        "which the model leaves out",
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
        description=f"a {quantity_of(place.unit)} in proportion to {place.position_name}, "
        "which the model leaves out",
    )


def uptakes_of(model: Model, ranges: Mapping[str, tuple[float, float]]) -> Iterator[Effect]:
    """-c x in the balance of another quantity, where x so far acts with that quantity alone.

    Of a reaction between the two, as growth is of cells and sugar: what cells use up to stay alive,
    or make of nothing that is modelled. `ranges` are the lowest and highest values of states, of
    which x has to stay positive.
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
            unit = unit_quotient(place.unit, model.states[name].unit)
            yield force_along(
                place,
                "unknown",
                Parameter(f"c_{name}", unit, 0.0),
                _taken(x),
                priority=UNNAMED_EFFECTS.priority,
                shape=name,
                description=f"a {quantity_of(place.unit)} in proportion to {name}, which the "
                "model leaves out",
            )


def _taken(x: Expr) -> Callable[[Any], Expr]:
    """What takes c x away, as a function of c."""
    return lambda c: -c * x


def _vanishes_with(side: Expr, symbol: Expr) -> bool:
    """True if an expression is zero wherever a symbol is, against what it is at random points."""
    others = ca.symvar(ca.veccat(side, symbol))
    both = ca.Function("sides", others, [ca.substitute(side, symbol, 0.0), side])
    rng = np.random.default_rng(3)
    draws = [both(*rng.uniform(0.2, 1.7, len(others))) for _ in range(3)]
    return all(abs(float(at_zero)) <= 1e-12 * abs(float(there)) for at_zero, there in draws)


def _symbols(expression: Any) -> set[str]:
    """The names that an expression depends on."""
    return {s.name() for s in ca.symvar(ca.SX(expression))}


def _bracketed(name: str) -> str:
    """A name, or a sum of names in brackets."""
    return name if name.replace("_", "").isalnum() or not name else f"({name})"


def power_law(
    model: Model, state: str | Sequence[str], typical: float | Sequence[float]
) -> Effect | None:
    """x becomes x (|x| / x_ref)^(n - 1) in the equations that are linear in a positive state x.

    What leaves a tank in proportion to its level is met again downstream: x is exchanged in every
    balance and derivative whose right-hand side has it with a slope that depends on no state, and
    not in outputs. `typical` is x_ref (x's unit), at which the flow is what it was: the estimates
    of the flow's coefficient and of n then hardly depend on each other. Near x = 0 the power is
    rounded at a thousandth of x_ref. The null value is n = 1. Several states (see
    `states_with_one_law`) have one n, each its own x_ref.

    None where x has a position, is one (a spring is no flow), or is in no such equation.
    """
    states = [state] if isinstance(state, str) else list(state)
    places = [_flows_linear_in(model, x) for x in states]
    if not all(places):
        return None
    levels = [float(x) for x in np.atleast_1d(typical)]
    own = [name for name, b in model.balances.items() if b.rate in states]
    suffix = "_".join(states)

    def apply(new: Model, names: Sequence[str]) -> None:
        for x, rows, level in zip(states, places, levels, strict=True):
            _exchange(new, x, rows, level, new.symbol(names[0]))
        new._explicit = None

    lower, upper = UNNAMED_EFFECTS.lowest_power, UNNAMED_EFFECTS.highest_power
    shape = " and ".join(f"|{x}|^n" for x in states)
    them = "it" if len(states) == 1 else "them"
    flow = (
        f"a power of {states[0]}" if len(states) == 1 else f"one power of {' and of '.join(states)}"
    )
    return Effect(
        "unknown",
        own[0] if own else states[0],
        (Parameter(f"exponent_{suffix}", "1", 1.0, lower=lower, upper=upper),),
        apply,
        priority=-1,  # in a flow it is the law itself, and a constant its tangent
        shape=shape,
        description=f"a flow that grows with {flow}, not in proportion to {them}",
        constants={"reference": levels[0]},
    )


def states_with_one_law(model: Model) -> list[tuple[str, ...]]:
    """States whose flows have one coefficient: tanks, cells or rooms that the model takes as alike.

    Their own right-hand sides have the same slope in parameters, so that what is wrong with the law
    of one is wrong with those of all.
    """
    groups: list[tuple[Expr, list[str]]] = []
    for state, own in _own_slopes(model).items():
        for slope, members in groups:
            if is_zero(slope - own):
                members.append(state)
                break
        else:
            groups.append((own, [state]))
    return [tuple(members) for _, members in groups if len(members) > 1]


def _own_slopes(model: Model) -> dict[str, Expr]:
    """The slope of each state's own right-hand side, where it is an estimated flow's."""
    unknown = [model.symbol(n) for n, p in model.parameters.items() if not p.is_known]
    sides = {n: (b.rate, b.total) for n, b in model.balances.items()}
    sides |= {n: (n, side) for n, side in model._rates.items()}
    found = {}
    for state in model.states:
        for name in _flows_linear_in(model, state):
            owner, side = sides[name]
            slope = ca.jacobian(ca.SX(side), model.symbol(state))
            if owner == state and any(any(ca.which_depends(slope, q)) for q in unknown):
                found[state] = slope
    return found


def _flows_linear_in(model: Model, state: str) -> list[str]:
    """`_linear_in` of what is no speed or position of a mechanical motion, else nothing."""
    is_rate = model.position_of(state) is not None
    is_position = any(model.position_of(rate) == state for rate in model.states)
    return [] if is_rate or is_position else _linear_in(model, state)


def _exchange(new: Model, state: str, rows: Sequence[str], typical: float, n: Expr) -> None:
    """Put the power of a state in its place in these rows (see `power_law`)."""
    x = new.symbol(state)
    small = carrying_unit((SMOOTHING.power * typical) ** 2)
    whole = carrying_unit(typical**2 + small)
    law = x * ca.exp(0.5 * (n - 1) * ca.log((x**2 + small) / whole))
    for name in rows:
        if name in new.balances:
            b = new.balances[name]
            terms = tuple(ca.substitute(t, x, law) for t in b.terms)
            new.balances[name] = replace(b, terms=terms)
        else:
            new._rates[name] = ca.substitute(new._rates[name], x, law)


def _linear_in(model: Model, state: str) -> list[str]:
    """Balances, by name, and states with a derivative whose right-hand side is linear in a state.

    The slope may depend on parameters and inputs alone.
    """
    x = model.symbol(state)
    states = ca.vertcat(*[model.symbol(name) for name in model.states])
    sides = {name: b.total for name, b in model.balances.items()}
    sides |= {name: e for name, e in model._rates.items() if model.symbol(name) is not x}
    found = []
    for name, side in sides.items():
        slope = ca.jacobian(ca.SX(side), x)
        if slope.nnz() and not any(ca.which_depends(slope, states)):
            found.append(name)
    return found


def is_positive(lowest_and_most: tuple[float, float]) -> bool:
    """True if a state stays above zero by at least a thousandth of its largest value."""
    low, most = lowest_and_most
    return bool(np.isfinite(most)) and low > SMOOTHING.above_zero * most > 0.0
