"""Lie derivatives: the time derivatives of the outputs, in readable algebra.

The state is extended by the parameters, dtheta/dt = 0, and known inputs and all their derivatives
are free numbers:

    y^(k) = L^k h,   L = sum_i f_i d/dx_i + sum_j u^(j+1) d/du^(j)                              (1)

For models small enough to be read; `casid.assess_identifiability` has no such limit.
Source: Linder (2017), section 2.7, (2.62)-(2.63).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NoReturn

from casid.algebra.symbolic import to_sympy
from casid.errors import ModelError
from casid.identifiability.equations.system import System
from casid.identifiability.symbolic.reduced_form import derivative_name
from casid.identifiability.symbolic.symbolic_rank import tidy
from casid.time_limit import processor_clock

Expr = Any  # a sympy expression
Matrix = Any  # a sympy matrix

MOST_OPERATIONS = 30_000
"""An output derivative with more operations than this is not readable, and is refused."""


def lie_derivatives(
    system: System, order: int, *, limit_seconds: float = 30.0
) -> dict[str, tuple[Expr, ...]]:
    """Time derivatives 0..order of every output, (1), as sympy expressions.

    Symbols have the system's names; the derivatives of an input u are the symbols "u'", "u''",
    "u'''", "u^(4)" and so on (see `derivative_name`), those of unknown inputs likewise.

    Returns
    -------
    output -> (order + 1,) expressions.

    Raises
    ------
    ModelError
        If a function has no derivative everywhere (abs, sign, a branch), or the expressions
        outgrow what can be read, or `limit_seconds` are over.
    """
    if order < 0:
        raise ModelError(f"{system.name}: order = {order}; a derivative's order is 0 or more")
    steps = output_derivatives(system, Budget(system.name, limit_seconds))
    columns = [next(steps) for _ in range(order + 1)]
    return {y: tuple(c[i] for c in columns) for i, y in enumerate(system.outputs)}


class Budget:
    """Time limit of a derivation."""

    def __init__(self, system: str, seconds: float) -> None:
        self.system, self.seconds = system, seconds
        self.start = processor_clock()

    def check(self, stage: str) -> None:
        """Refuse if the time is over."""
        if processor_clock() - self.start > self.seconds:
            self.refuse(f"{stage} took it past limit_seconds = {self.seconds:g}")

    def refuse(self, why: str) -> NoReturn:
        """Refuse the system as too large."""
        raise ModelError(
            f"{self.system}: too large for symbolic Lie derivatives: {why}; "
            "casid.assess_identifiability has the exact rank and the verdicts without them"
        )


def output_derivatives(system: System, budget: Budget) -> Iterator[Matrix]:
    """The outputs and their time derivatives (1), (ny, 1) at a time, without end."""
    import sympy

    inputs = (*system.inputs, *system.unknown_inputs)
    names = {s: derivative_name(u, k) for s, (u, k) in system.input_derivatives.items()}
    symbols = {s: sympy.Symbol(n) for s, n in names.items()}
    f = to_sympy(system.f, symbols, exact_numbers=True)
    current = to_sympy(system.h, symbols, exact_numbers=True)
    _refuse_corners(system.name, f, current)
    rates = dict(zip(map(sympy.Symbol, system.states), f, strict=True))
    highest = max((k for _, k in system.input_derivatives.values()), default=0)
    order = 0
    while True:
        current = current.applyfunc(lambda e: _readable(e, budget))
        budget.check(f"derivative {order}")
        yield current
        for u in inputs:
            for k in range(highest + order + 1):
                before = sympy.Symbol(derivative_name(u, k))
                rates[before] = sympy.Symbol(derivative_name(u, k + 1))
        current = current.applyfunc(lambda e: _rate(e, rates))
        order += 1


def _rate(expression: Expr, rates: Mapping[Any, Expr]) -> Expr:
    """Time derivative of an expression of symbols with these rates; all others are constant."""
    import sympy

    moving = sorted(expression.free_symbols & rates.keys(), key=str)
    return sympy.Add(*[expression.diff(s) * rates[s] for s in moving])


def _readable(expression: Expr, budget: Budget) -> Expr:
    size = int(expression.count_ops())
    if size > MOST_OPERATIONS:
        budget.refuse(f"an output derivative has {size} operations (at most {MOST_OPERATIONS})")
    return tidy(expression)


def _refuse_corners(system: str, *matrices: Matrix) -> None:
    """Refuse functions that have no derivative everywhere."""
    import sympy

    corners = (
        sympy.Abs,
        sympy.sign,
        sympy.floor,
        sympy.ceiling,
        sympy.Min,
        sympy.Max,
        sympy.Piecewise,
    )
    for matrix in matrices:
        found = sorted({type(e).__name__ for e in matrix.atoms(*corners)})
        if found:
            raise ModelError(
                f"{system}: {found[0]} has no derivative everywhere, so there are no Lie "
                "derivatives; write the branch of interest, x for abs(x) where x > 0"
            )
