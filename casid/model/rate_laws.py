"""Stated rates of change as balances, which missing effects enter.

A model may state dx/dt = f with no balance. Where f holds a parameter that is estimated it is a
law, which may lack a term as a balance of forces may; without one it is a definition: a position's
rate, an integral.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from casid.model.model import Model
from casid.model.units import declared_quotient, times_in, unit_quotient


def with_balances(model: Model) -> Model:
    """A copy in which laws of rates are balances of inertia 1, under the names of their states.

    Returns
    -------
    the model itself where it has none.
    """
    free = [model.symbol(n) for n, p in model.parameters.items() if not p.is_known]
    laws = {
        name: rate
        for name, rate in model._rates.items()
        if free and any(ca.which_depends(rate, ca.vertcat(*free)))
    }
    if not laws:
        return model
    new = model.copy()
    for state, rate in laws.items():
        del new._rates[state]
        name = state if state not in new.balances else new.free_name(state)
        unit = _unit_of_rate(new, state, rate)
        new.balance(new.symbol(state), name, inertia=1, terms=addends(rate), unit=unit)
    return new


def _unit_of_rate(model: Model, state: str, rate: Any) -> str:
    """A state's unit over the unit of time that the parameters of its law have, in SI where that
    is the second, or none, or more than one."""
    there = {s.name() for s in ca.symvar(ca.SX(rate))}
    names = [n for n in model.parameters if model.symbol(n).name() in there]
    times = {time for n in names for time in times_in(model.unit_of(n))}
    if len(times) != 1 or times == {"s"}:
        return unit_quotient(model.states[state].unit, "s")
    return declared_quotient(model.unit_of(state), times.pop())


def addends(side: Any) -> list[Any]:
    """The addends of a scalar expression, differences taken apart."""
    if side.n_dep() == 2 and side.op() in (ca.OP_ADD, ca.OP_SUB):
        left, right = side.dep(0), side.dep(1)
        second = addends(right)
        return [*addends(left), *(second if side.op() == ca.OP_ADD else [-a for a in second])]
    if side.n_dep() == 1 and side.op() == ca.OP_NEG:
        return [-a for a in addends(side.dep(0))]
    return [side]
