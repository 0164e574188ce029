"""Laws of flow: a flow in proportion to a level, pressure or temperature follows another law of it.

What leaves a tank grows with the root of its level, what a room loses to the sky with the fourth
power of its temperature. The exponent is estimated; its null value is 1. An enzyme's or a cell's
uptake levels off with the concentration, S/(1 + S/K); 1/K is estimated, its null value is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from casid.model.declarations import Parameter
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.balances.balance_effects import force_along
from casid.model.effects.effect import Effect
from casid.model.effects.names import GROWS, RADIATION, bracketed
from casid.model.effects.places.place import Place, a_quantity, is_mechanical, is_zero
from casid.model.effects.places.places import place_named
from casid.model.effects.search_ranges import SMOOTHING, UNNAMED_EFFECTS
from casid.model.model import Model
from casid.model.rate_laws import addends
from casid.model.units import declared_quotient, same_dimension, unit_quotient

Expr = Any  # a CasADi expression


def flow_law(model: Model, where: str | Place, typical: float) -> Effect | None:
    """A flow C d between two stores becomes C d (|d| / d_ref)^(n - 1), d the difference.

    As `power_law`, for a difference of levels, pressures or temperatures, of either sign. `typical`
    is d_ref. None for mechanical places, and where the model has no flow in proportion to d.
    """
    place = place_named(model, where)
    if place.is_mechanical or place.damping is None or typical <= 0.0:
        return None
    d, C, name = place.velocity, place.damping, bracketed(place.velocity_name)

    def apply(new: Model, names: Sequence[str]) -> None:
        place.add(new, C * d * (1 - rounded_power(d, typical, new.symbol(names[0]) - 1)))

    lower, upper = UNNAMED_EFFECTS.lowest_power, UNNAMED_EFFECTS.highest_power
    suffix = "".join(c if c.isalnum() else "_" for c in place.velocity_name)
    return Effect(
        "unknown",
        place.where,
        (Parameter(f"exponent_{suffix}", "1", 1.0, lower=lower, upper=upper),),
        apply,
        shape=f"|{name}|^n",
        description=f"{place.a_quantity('flow')} {GROWS} a power of {name}, not in "
        "proportion to it",
        constants={"reference": typical},
    )


def radiation(model: Model, where: str | Place) -> Effect | None:
    """-sigma A (T_1^4 - T_2^4) between two temperatures that exchange heat, A >= 0.

    A is the emissivity times the area, sigma the constant of Stefan and Boltzmann. None for what is
    no exchange of heat between two temperatures.
    """
    place = place_named(model, where)
    is_heat = same_dimension(place.unit, "W") and same_dimension(place.velocity_unit, "K")
    if not (place.is_relative and is_heat):
        return None
    d = ca.SX(place.velocity)
    ends = ca.symvar(d)
    slopes = [ca.jacobian(d, T) for T in ends]
    if not all(is_zero(ca.fabs(s) - 1) for s in slopes) or len(ends) != 2:
        return None
    sigma = carrying_unit(5.670374419e-8)  # W/(m^2 K^4), CODATA 2018
    fourth = sum(float(s) * T**4 for s, T in zip(slopes, ends, strict=True))
    first, second = place.velocity_name.split("-")[0], place.velocity_name.split("-")[-1]
    return force_along(
        place,
        "unknown",
        Parameter("A_radiation", "m^2", 0.0, lower=0.0),
        lambda A: -sigma * A * fourth,
        sided="positive",
        shape="T^4",
        description=f"{RADIATION} in proportion to {first}^4-{second}^4",
    )


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
            _exchange(new, x, rows, _power(new.symbol(x), level, new.symbol(names[0])))
        new._explicit = None

    lower, upper = UNNAMED_EFFECTS.lowest_power, UNNAMED_EFFECTS.highest_power
    shape = " and ".join(f"|{x}|^n" for x in states)
    them = "it" if len(states) == 1 else "them"
    power = (
        f"a power of {states[0]}" if len(states) == 1 else f"one power of {' and of '.join(states)}"
    )
    return Effect(
        "unknown",
        own[0] if own else states[0],
        (Parameter(f"exponent_{suffix}", "1", 1.0, lower=lower, upper=upper),),
        apply,
        priority=-1,  # in a flow it is the law itself, and a constant its tangent
        shape=shape,
        description=f"{_a_flow_in(model, own)} {GROWS} {power}, not in proportion to {them}",
        constants={"reference": levels[0]},
    )


def saturating_law(
    model: Model, state: str, typical: float, *, of: str | None = None
) -> Effect | None:
    """x becomes x (1 + r x_ref) / (1 + r x), wherever a positive amount x reacts or flows.

    The uptake V x / (K + x) of an enzyme (Michaelis and Menten) or of cells (Monod), where the
    model has one in proportion to x: r is 1/K, its null value 0. As in `power_law` the flow is what
    it was at x_ref, `typical` (x's unit). It is exchanged in every balance and derivative that is
    linear in x, also with a slope that depends on other states (cells and sugar), and not in what a
    recorded flow carries along. Near x = 0 the size of x is rounded at a thousandth of x_ref.
    Where x takes part in several flows, one of them may level off alone: that with the coefficient
    `of` (`coefficients_of_flows`).

    None where x is a temperature, has a position or is one, or is in no such equation.
    """
    unit = model.states[state].unit
    rows = [] if same_dimension(unit, "K") else _flows_linear_in(model, state, is_alone=False)
    if not rows or typical <= 0.0:
        return None
    own = [name for name, b in model.balances.items() if b.rate == state]
    level, small = carrying_unit(typical), carrying_unit((SMOOTHING.power * typical) ** 2)

    def apply(new: Model, names: Sequence[str]) -> None:
        x, r = new.symbol(state), new.symbol(names[0])
        law = x * (1 + r * level) / (1 + r * ca.sqrt(x**2 + small))
        _exchange(new, state, rows, law, of)
        new._explicit = None

    r = Parameter(
        f"inverse_K_{state}",
        unit_quotient("1", unit),
        0.0,
        lower=0.0,
        upper=UNNAMED_EFFECTS.most_saturated / typical,
    )
    declared = model.declared_units.get(state)
    return Effect(
        "unknown",
        own[0] if own else state,
        (r,),
        apply,
        sided="positive",
        priority=-1,  # as a power law
        shape=f"{of or ''} {state}/(K+{state})".strip(),
        description=f"{_a_flow_in(model, own)}{f' {of} {state}' if of else ''} that levels off "
        f"with {state}, as {state}/(K + {state}) does, not in proportion to it; "
        f"{r.name} is 1/K",
        constants={"reference": typical},
        declared_units={r.name: declared_quotient("1", declared)} if declared else {},
    )


def _a_flow_in(model: Model, balances: Sequence[str]) -> str:
    """What passes in the first of these balances, with its article; a flow where there is none."""
    return a_quantity(model.balances[balances[0]].unit, "flow") if balances else "a flow"


def coefficients_of_flows(model: Model, state: str) -> list[str]:
    """Parameters of a flow of `state` beside which it has others.

    Not those of an exchange, in proportion to the difference of two states.
    """
    x, found, parts = model.symbol(state), [], []
    sides = {n: b.total for n, b in model.balances.items()} | dict(model._rates)
    for name in _flows_linear_in(model, state, is_alone=False):
        slopes = addends(ca.jacobian(ca.SX(sides[name]), x))
        parts += [(sides[name], a) for a in slopes if not _is_carried(model, a)]
    for name, p in model.parameters.items():
        own = [(side, a) for side, a in parts if ca.which_depends(a, model.symbol(name))[0]]
        if p.is_constant or not own or len(own) == len(parts):
            continue
        along = [addends(ca.jacobian(ca.SX(side), model.symbol(name))) for side, _ in own]
        if all(len(each) == 1 for each in along):
            found.append(name)
    return found


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


def _flows_linear_in(model: Model, state: str, *, is_alone: bool = True) -> list[str]:
    """`_linear_in` of what is no speed or position of a mechanical motion, else nothing.

    A twist between two bodies is a position of theirs: of all states, its rate depends on their
    speeds alone.
    """
    speeds = {name for name in model.states if model.position_of(name) is not None}
    speeds |= {b.rate for b in model.balances.values() if is_mechanical(b.unit)}
    moved_by = {s.name() for s in ca.symvar(model._rates.get(state, ca.SX(0)))} & set(model.states)
    is_motion = state in speeds or (bool(moved_by) and moved_by <= speeds)
    return [] if is_motion else _linear_in(model, state, is_alone=is_alone)


def rounded_power(x: Expr, typical: float, n: Expr) -> Expr:
    """(|x| / typical)^n, rounded within a thousandth of `typical`, so that it is finite at 0."""
    small = carrying_unit((SMOOTHING.power * typical) ** 2)
    return ((x**2 + small) / (carrying_unit(typical**2) + small)) ** (0.5 * n)


def _power(x: Expr, typical: float, n: Expr) -> Expr:
    """The power of a state in its place (see `power_law`)."""
    return x * rounded_power(x, typical, n - 1)


def _exchange(
    new: Model, state: str, rows: Sequence[str], law: Expr, of: str | None = None
) -> None:
    """Put a law of a state in its place in these rows, but for what a recorded flow carries.

    Only in flows of the coefficient `of`, where that is given.
    """
    x = new.symbol(state)

    def exchanged(term: Expr) -> Expr:
        """A term with the law in the place of the state, in its parts that go with the state."""
        slopes = addends(ca.jacobian(ca.SX(term), x))
        laws = [a for a in slopes if not _is_carried(new, a)]
        if of is not None:
            laws = [a for a in laws if ca.which_depends(a, new.symbol(of))[0]]
        if len(laws) == len(slopes):
            return ca.substitute(term, x, law)
        return term + sum(laws) * (law - x) if laws else term

    for name in rows:
        if name in new.balances:
            b = new.balances[name]
            new.balances[name] = replace(b, terms=tuple(exchanged(t) for t in b.terms))
        else:
            new._rates[name] = sum(exchanged(t) for t in addends(new._rates[name]))


def _is_carried(model: Model, slope: Expr) -> bool:
    """True of the slope of what a recorded flow carries along: an input, with no coefficient.

    What leaves a stirred vessel with the flow F through it is F x, whatever else becomes of x. An
    estimated coefficient that multiplies the flow makes a law of it; a volume divides it.
    """
    symbols = {s.name() for s in ca.symvar(ca.SX(slope))}
    if not symbols & {*model.inputs}:
        return False
    for name in symbols & {n for n, p in model.parameters.items() if not p.is_known}:
        gain = ca.jacobian(ca.SX(slope), model.symbol(name))
        if not any(ca.which_depends(gain, model.symbol(name))):
            return False
    return True


def _linear_in(model: Model, state: str, *, is_alone: bool) -> list[str]:
    """Balances, by name, and states with a derivative whose right-hand side is linear in a state.

    The slope may depend on parameters and inputs alone, or, unless it `is_alone`, on other states.
    """
    x = model.symbol(state)
    states = ca.vertcat(*[model.symbol(name) for name in model.states])
    sides = {name: b.total for name, b in model.balances.items()}
    sides |= {name: e for name, e in model._rates.items() if model.symbol(name) is not x}
    found = []
    for name, side in sides.items():
        slope = ca.jacobian(ca.SX(side), x)
        moved_by = states if is_alone else x
        if not slope.nnz() or any(ca.which_depends(slope, moved_by)):
            continue
        if not all(_is_carried(model, a) for a in addends(slope)):
            found.append(name)
    return found


def is_never_negative(lowest_and_most: tuple[float, float]) -> bool:
    """True if a state is never less than zero, but for a thousandth of its largest value."""
    low, most = lowest_and_most
    return bool(np.isfinite(most)) and most > 0.0 and low >= -SMOOTHING.above_zero * most


def is_positive(lowest_and_most: tuple[float, float]) -> bool:
    """True if a state stays above zero by at least a thousandth of its largest value."""
    low, most = lowest_and_most
    return bool(np.isfinite(most)) and low > SMOOTHING.above_zero * most > 0.0
