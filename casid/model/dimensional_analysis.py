"""Dimensional analysis of an expression: sums add like to like, functions take numbers.

The CasADi expressions are walked as straight-line programs with a dimension for every node. A
literal number is taken as dimensionless where it is an integer or a simple fraction; any other
literal (9.81) may carry whatever dimension its place requires: give it a unit with
`model.constant` to have it checked.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from casid.model.units import describe_dimension, parse_unit, unit_of_dimension

Dimension = tuple[Fraction, ...] | None  # None: whatever fits
_ONE: tuple[Fraction, ...] = (Fraction(0),) * 7

_SAME = {"OP_ADD", "OP_SUB", "OP_FMIN", "OP_FMAX", "OP_HYPOT"}
_COMPARE = {"OP_LT", "OP_LE", "OP_EQ", "OP_NE"}
_KEEP = {"OP_NEG", "OP_FABS", "OP_ASSIGN", "OP_FLOOR", "OP_CEIL", "OP_TWICE"}
_FREE = {"OP_SIGN", "OP_NOT", "OP_AND", "OP_OR"}


class DimensionMismatch(Exception):
    """An expression adds, compares or takes a function of unlike quantities.

    Attributes
    ----------
    remedy : where one of them is a bare number.
    """

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.remedy = remedy


_PAIRED = {
    **{name: "adds {} to {}" for name in ("OP_ADD", "OP_SUB", "OP_HYPOT")},
    "OP_FMIN": "takes the minimum of {} and {}",
    "OP_FMAX": "takes the maximum of {} and {}",
    "OP_ATAN2": "takes atan2 of {} and {}",
    **{name: "compares {} with {}" for name in _COMPARE},
}
"""Operations on two quantities of one dimension, as they are described."""


def _require_like(op: str, sides: list[Dimension], numbers: list[float | None]) -> None:
    a, b = sides
    if a is None or b is None or a == b:
        return
    shown = [
        dimension_text(d) if n is None else f"the bare number {n:g}"
        for d, n in zip(sides, numbers, strict=True)
    ]
    bare, other = (numbers[0], b) if numbers[1] is None else (numbers[1], a)
    remedy = ""
    if bare is not None:
        remedy = (
            "a bare number is dimensionless: give it the unit that it is meant in, "
            f'm.constant("name", {bare:g}, "{unit_of_dimension(other)}")'
        )
    raise DimensionMismatch(_PAIRED[op].format(*shown), remedy)


def operation_names() -> dict[int, str]:
    """CasADi's number of an operation -> its name, `OP_ADD`."""
    return {getattr(ca, n): n for n in dir(ca) if n.startswith("OP_")}


def is_pure_number(value: float) -> bool:
    """True for a literal that is taken as dimensionless: an integer or a simple fraction."""
    return float(value * 12).is_integer() and abs(value) < 1e6


def carrying_unit(value: float) -> float:
    """A literal that carries the unit which its place requires: `value`, or the next number.

    0.5 would be taken for a number without a unit; its neighbour 0.5000000000000001 is not.
    """
    return float(np.nextafter(value, np.inf)) if is_pure_number(value) else value


def dimension_text(d: Dimension) -> str:
    """Base units of a dimension, or "any"."""
    return "any" if d is None else describe_dimension(tuple(d))


def dimension_of(expression: Any, symbols: list[Any], units: dict[str, str]) -> Dimension:
    """Dimension of a scalar SX expression; `units` gives each symbol's. None where any fits.

    Raises
    ------
    DimensionMismatch
        Where a sum, comparison or function is not consistent.
    """
    function = ca.Function("d", symbols, [expression])
    known = [tuple(parse_unit(units[s.name()]).dimension) for s in symbols]
    ops = operation_names()
    work: dict[int, Dimension] = {}
    numbers: dict[int, float] = {}
    result: Dimension = _ONE
    for k in range(function.n_instructions()):
        op = ops[function.instruction_id(k)]
        ins, outs = function.instruction_input(k), function.instruction_output(k)
        if op == "OP_INPUT":
            work[outs[0]] = known[ins[0]]
            numbers.pop(outs[0], None)
            continue
        if op == "OP_OUTPUT":
            result = work[ins[0]]
            continue
        if op == "OP_CONST":
            value = float(function.instruction_constant(k))
            work[outs[0]] = _ONE if is_pure_number(value) and value != 0.0 else None
            numbers[outs[0]] = value
            continue
        args = [work[i] for i in ins]
        value_of = [numbers.get(i) for i in ins]
        work[outs[0]] = operation_dimension(op, args, value_of)
        numbers.pop(outs[0], None)
    return result


def operation_dimension(op: str, args: list[Dimension], values: list[float | None]) -> Dimension:
    """Dimension of one operation of CasADi; `values` are those of arguments that are literals.

    Raises
    ------
    DimensionMismatch
        Where the arguments are unlike, or a function takes a quantity.
    """
    a = args[0]
    b = args[1] if len(args) > 1 else None
    if op in _SAME:
        _require_like(op, args, values)
        return a if a is not None else b
    if op in _COMPARE:
        _require_like(op, args, values)
        return _ONE
    if op in _KEEP:
        return a
    if op in _FREE:
        return _ONE
    if op == "OP_MUL":
        return None if a is None or b is None else tuple(x + y for x, y in zip(a, b, strict=True))
    if op == "OP_DIV":
        return None if a is None or b is None else tuple(x - y for x, y in zip(a, b, strict=True))
    if op == "OP_INV":
        return None if a is None else tuple(-x for x in a)
    if op == "OP_SQ":
        return None if a is None else tuple(2 * x for x in a)
    if op == "OP_SQRT":
        return None if a is None else tuple(x / 2 for x in a)
    if op in ("OP_CONSTPOW", "OP_POW"):
        exponent = values[1]
        if a is None or a == _ONE:
            return a
        if exponent is None:
            raise DimensionMismatch(f"raises {dimension_text(a)} to a power that is not a number")
        q = Fraction(exponent).limit_denominator(12)
        return tuple(x * q for x in a)
    if op == "OP_IF_ELSE_ZERO":
        return b
    if op == "OP_COPYSIGN":
        return a
    if op == "OP_ATAN2":
        _require_like(op, args, values)
        return _ONE
    # sin, exp, tanh ... take numbers and give numbers.
    for d in args:
        if d is not None and d != _ONE:
            name = op.removeprefix("OP_").lower()
            raise DimensionMismatch(f"takes {name} of {dimension_text(d)}")
    return _ONE
