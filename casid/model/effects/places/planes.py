"""Motions in a plane or in space, whose friction opposes the direction of the whole of them.

The rates of two or three balances are then the components of one vector: of a puck on ice or a load
that is carried, along fixed axes with one mass, or of a current in axes that turn with a shaft.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from casid.model.declarations import Balance
from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.names import TOGETHER
from casid.model.effects.places.elements import are_joined
from casid.model.effects.places.place import Expr, Place, is_electrical, is_mechanical, is_zero
from casid.model.effects.search_ranges import FRICTION_RANGES, SMOOTHING
from casid.model.model import Model
from casid.model.rate_laws import addends


def planes_of(model: Model, elements: Sequence[Place]) -> list[Place]:
    """The vectors whose components are the rates of two or three balances of a model.

    The coordinate is the size v of the vector, and a force f(v) along it gives each balance its
    component, f(v) x/v.

    Parameters
    ----------
    elements : of the model, `elements_of`: what one of them joins is no vector.
    """
    return [_plane(model, group) for group in _groups(model, elements)]


def _groups(model: Model, elements: Sequence[Place]) -> list[list[str]]:
    """Balances whose rates are components of one vector, each in one group at most."""
    groups: list[list[str]] = []
    for name in model.balances:
        for group in groups:
            if all(_is_one_vector(model, one, name, elements) for one in group):
                group.append(name)
                break
        else:
            groups.append([name])
    return [group for group in groups if 1 < len(group) <= FRICTION_RANGES.directions]


def _is_one_vector(model: Model, one: str, other: str, elements: Sequence[Place]) -> bool:
    """True of two balances in one unit that turn into each other, or have one inertia.

    Two bodies of one mass that something joins have a relative motion instead.
    """
    a, b = model.balances[one], model.balances[other]
    units = [(x.unit, model.states[x.rate].unit) for x in (a, b)]
    if units[0] != units[1] or not (is_mechanical(a.unit) or is_electrical(a.unit)):
        return False
    if are_joined(elements, one, other):
        return False
    if _turn(model, one, other):
        return True
    moves = all(model.position_of(x.rate) is not None for x in (a, b))
    is_free = not any(
        ca.which_depends(ca.SX(x.total), model.symbol(str(q)), 1)[0]
        for x, q in ((a, model.position_of(b.rate)), (b, model.position_of(a.rate)))
        if q is not None
    )
    return a.unit == "N" and moves and is_free and is_zero(ca.SX(a.inertia) - ca.SX(b.inertia))


def _turn(model: Model, one: str, other: str) -> bool:
    """True where each drives the other by what a rotation gives it: of two signs, by one speed."""
    a, b = model.balances[one], model.balances[other]
    to_one, to_other = _turned(model, a, b.rate), _turned(model, b, a.rate)
    for speed in to_one.keys() & to_other.keys() - {a.rate, b.rate}:
        product = ca.densify(to_one[speed] * to_other[speed])
        symbols = ca.symvar(product)
        function = ca.Function("turn", [ca.vertcat(ca.SX(0, 1), *symbols)], [product])
        if float(function(ca.DM.ones(len(symbols)))) < 0.0:
            return True
    return False


def _turned(model: Model, balance: Balance, rate: str) -> dict[str, Expr]:
    """State -> the slope in another balance's rate of the terms that this state multiplies."""
    found: dict[str, Expr] = {}
    for addend in addends(ca.SX(balance.total)):
        slope = ca.jacobian(addend, model.symbol(rate))
        states = [s.name() for s in ca.symvar(slope) if s.name() in model.states]
        if slope.nnz() and len(states) == 1:
            found[states[0]] = found.get(states[0], 0.0) + slope
    return found


def _plane(model: Model, group: Sequence[str]) -> Place:
    """The vector of the rates of some balances as a place."""
    first = model.balances[group[0]]
    rates = [model.balances[name].rate for name in group]
    parts: list[Expr] = [model.symbol(rate) for rate in rates]
    size = ca.sqrt(sum(x**2 for x in parts) + carrying_unit(SMOOTHING.at_rest**2))
    return Place(
        where=TOGETHER.join(rates),
        unit=first.unit,
        velocity=size,
        velocity_unit=model.states[first.rate].unit,
        position=None,
        position_unit="1",
        shares=tuple((name, x / size) for name, x in zip(group, parts, strict=True)),
        velocity_name=f"the vector of {TOGETHER.join(rates)}",
        position_name="",
        is_vector=True,
    )
