"""Signals of a system: free names, time derivatives, and what unknown inputs act on."""

from __future__ import annotations

import itertools
from collections.abc import Container, Mapping
from typing import Any

import casadi as ca

from casid.identifiability.equations.system import System

Expr = Any  # a CasADi SX expression


def free_name(system: System, wanted: str, *more: str) -> str:
    """`wanted`, or `wanted_2`, `wanted_3`, ... where a symbol of the system (or `more`) has it."""
    return unused_name(wanted, {*system.declared, *more})


def unused_name(wanted: str, taken: Container[str]) -> str:
    """`wanted`, or `wanted_2`, `wanted_3`, ... where it is taken."""
    candidates = itertools.chain([wanted], (f"{wanted}_{n}" for n in itertools.count(2)))
    return next(name for name in candidates if name not in taken)


def derivative_name(signal: str, order: int) -> str:
    """Name of the derivative of a signal: ``u``, ``du``, ``d2u``, ..."""
    return signal if order == 0 else f"d{'' if order == 1 else order}{signal}"


def differentiated(
    system: System, expression: Expr, *, known_as: Mapping[str, tuple[str, int]] | None = None
) -> tuple[System, Expr]:
    """The total time derivative of a scalar expression in states, parameters and known inputs.

    Parameters
    ----------
    known_as : input -> (signal, order), where the input is itself the derivative of a signal, after
        which the new symbols are named.

    Returns
    -------
    The system, with the derivatives of known inputs declared that now appear, and the derivative.
    """
    total = ca.SX(0)
    if system.states:
        x = ca.vertcat(*[system.symbols[s] for s in system.states])
        total = ca.jtimes(expression, x, system.f)
    inside = {s.name() for s in ca.symvar(expression)}
    for name in (*system.inputs, *system.input_derivatives):
        if name in inside:
            slope = ca.jacobian(expression, system.symbols[name])
            source, order = system.input_derivatives.get(name, (name, 0))
            system, rate = _input_derivative(system, source, order + 1, known_as or {})
            total = total + slope * rate
    return system, ca.cse(total)


def _input_derivative(
    system: System, source: str, order: int, known_as: Mapping[str, tuple[str, int]]
) -> tuple[System, Expr]:
    """The symbol of a known input's derivative, declared if it is not yet."""
    for name, what in system.input_derivatives.items():
        if what == (source, order):
            return system, system.symbols[name]
    signal, before = known_as.get(source, (source, 0))
    name = free_name(system, derivative_name(signal, before + order))
    symbol = ca.SX.sym(name)
    return system.where(
        symbols={**system.symbols, name: symbol},
        input_derivatives={**system.input_derivatives, name: (source, order)},
    ), symbol


def reached_by_unknown_inputs(system: System) -> set[str]:
    """Unknown inputs, and the states that they act on through a chain of equations."""
    enters = [{s.name() for s in ca.symvar(system.f[i])} for i in range(len(system.states))]
    reached = set(system.unknown_inputs)
    while True:
        new = {s for s, e in zip(system.states, enters, strict=True) if e & reached} - reached
        if not new:
            return reached
        reached |= new
