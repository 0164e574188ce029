"""Numbers of an equation with the units that they are in: `pitch - 2.06 deg`.

The symbols of an equation are quantities, whose values are shown in the units that the model
declares them in. A number that is added to one, compared with it, or that it is divided by is a
quantity, too, and written with a unit. A factor has one where its product with one symbol is added
to another; elsewhere nothing says what it is meant in, and it is left as it is.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import casadi as ca

from casid.errors import UnitError
from casid.model.dimensional_analysis import (
    Dimension,
    DimensionMismatch,
    is_pure_number,
    operation_dimension,
    operation_names,
)
from casid.model.model import Model
from casid.model.units import (
    declared_quotient,
    difference_from_si,
    from_si,
    parse_unit,
    same_dimension,
)

Expr = Any  # a CasADi SX expression

MARK = "~"
"""How the name of a symbol begins that stands for a number: it sorts behind all names."""

GUARD = 1e-100
"""Numbers below it keep a division finite, and are not shown."""

_ONE: tuple[Fraction, ...] = (Fraction(0),) * 7
_COMPARISONS = (ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE)
_SUMS = (ca.OP_ADD, ca.OP_SUB, ca.OP_FMIN, ca.OP_FMAX, ca.OP_HYPOT, *_COMPARISONS)
_SIGNS = (ca.OP_NEG, ca.OP_FABS, ca.OP_TWICE)
_ROOTS = {ca.OP_SQ: Fraction(1, 2), ca.OP_SQRT: Fraction(2), ca.OP_INV: Fraction(-1)}
_OPERATIONS = operation_names()


def with_units(model: Model, expression: Expr, unit: str = "") -> Expr:
    """An expression with symbols like `~2.06 deg` in the place of numbers that are quantities.

    Parameters
    ----------
    unit : of the expression, SI, where it is known.
    """
    try:
        needed = tuple(parse_unit(unit).dimension) if unit else None
        return _Reader(model).read(ca.SX(expression), needed)
    except (UnitError, DimensionMismatch, KeyError):  # a sum of unlike quantities, say
        return expression


class _Reader:
    """Walks an expression of a model from the whole to its parts."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.units = model.symbol_units
        self.known: dict[int, Dimension] = {}
        self.numbers: dict[str, Expr] = {}

    def read(self, e: Expr, needed: Dimension, unit: str = "") -> Expr:
        """The expression, of the dimension `needed`; a number in `unit`, that of its neighbour."""
        if e.is_constant():
            return self._number(float(e), unit)
        if e.is_leaf():
            return e
        parts = [e.dep(i) for i in range(e.n_dep())]
        of_parts = self._needed(e.op(), parts, needed)
        units = [""] * len(parts)
        if e.op() in _SUMS:
            units = [self._unit(part, e.op()) for part in reversed(parts)]
        elif e.op() == ca.OP_DIV and of_parts[1] == self._dimension(parts[0]):
            unit = self._unit(parts[0], ca.OP_DIV)
            if unit and parts[1].is_constant():
                above = self.read(parts[0], of_parts[0])
                return above / self._number(float(parts[1]), unit, "({})")
        elif e.op() == ca.OP_MUL and unit and any(part.is_constant() for part in parts):
            return self._product(parts, unit)
        new = [self.read(*each) for each in zip(parts, of_parts, units, strict=True)]
        return ca.SX.unary(e.op(), *new) if len(new) == 1 else ca.SX.binary(e.op(), *new)

    def _needed(self, op: int, parts: list[Expr], needed: Dimension) -> list[Dimension]:
        """Dimension that the parts of an operation must have; None where any fits."""
        own = [self._dimension(part) for part in parts]
        if op in _SUMS:
            either = next((d for d in own if d is not None), None)
            return [either if op in _COMPARISONS or needed is None else needed] * 2
        if op in _SIGNS:
            return [needed]
        if op in _ROOTS:
            return [None if needed is None else tuple(_ROOTS[op] * x for x in needed)]
        if op in (ca.OP_MUL, ca.OP_DIV):
            a, b = own
            sign = 1 if op == ca.OP_MUL else -1
            if needed is None or (a is None) == (b is None):
                return own
            if a is None:
                return [tuple(n - sign * x for n, x in zip(needed, b or _ONE, strict=True)), b]
            return [a, tuple(sign * (n - x) for n, x in zip(needed, a, strict=True))]
        if op in (ca.OP_POW, ca.OP_CONSTPOW):
            return [own[0] if parts[1].is_constant() else _ONE, _ONE]
        if op == ca.OP_IF_ELSE_ZERO:
            return [own[0], needed]
        return own if op in (ca.OP_SIGN, ca.OP_ATAN2) else [_ONE] * len(parts)

    def _dimension(self, e: Expr) -> Dimension:
        key = e.element_hash()
        if key not in self.known:
            self.known[key] = self._computed(e)
        return self.known[key]

    def _computed(self, e: Expr) -> Dimension:
        if e.is_constant():
            return _ONE if is_pure_number(float(e)) and float(e) else None
        if e.is_symbolic():
            return tuple(parse_unit(self.units[e.name()]).dimension)
        parts = [e.dep(i) for i in range(e.n_dep())]
        values = [float(part) if part.is_constant() else None for part in parts]
        own = [self._dimension(part) for part in parts]
        return operation_dimension(_OPERATIONS[e.op()], own, values)

    def _unit(self, e: Expr, op: int) -> str:
        """The declared unit of what a number is added to or divides; empty where it has none."""
        if e.is_leaf():
            if not e.is_symbolic() or self.units.get(e.name(), "1") == "1":
                return ""
            shown = self.model.declared_units.get(e.name(), self.units[e.name()])
            is_level = op not in (ca.OP_ADD, ca.OP_DIV)
            return shown if is_level or not parse_unit(shown).offset else self.units[e.name()]
        if e.op() in _SIGNS:
            return self._unit(e.dep(0), ca.OP_ADD)
        if e.op() == ca.OP_SQ and (unit := self._unit(e.dep(0), ca.OP_ADD)):
            return declared_quotient(unit, unit, -1)
        if e.op() in _SUMS[:5]:
            units = (self._unit(e.dep(i), ca.OP_ADD) for i in range(2))
            return next(filter(None, units), "")
        return ""

    def _product(self, parts: list[Expr], unit: str) -> Expr:
        """A number times a symbol that is added to something in `unit`."""
        number, other = sorted(parts, key=lambda part: not part.is_constant())
        own = self._unit(other, ca.OP_ADD)
        if not own or not other.is_symbolic() or parse_unit(unit).offset:
            return number * self.read(other, None)
        return self._number(float(number), declared_quotient(unit, own), "({})") * other

    def _number(self, value: float, unit: str, form: str = "{}") -> Expr:
        """A number as it is, or in a unit: a pure one where this is no SI unit of no dimension."""
        is_bare = is_pure_number(value) and (not _is_angle(unit) or parse_unit(unit).is_si)
        if unit in ("", "1") or is_bare or abs(value) < GUARD:
            return ca.SX(value)
        to_unit = from_si if parse_unit(unit).offset else difference_from_si
        shown = float(to_unit(value, unit))
        text = MARK + form.format(f"{abs(shown):.6g} {unit}")
        symbol = self.numbers.setdefault(text, ca.SX.sym(text))
        return -symbol if shown < 0 else symbol


def _is_angle(unit: str) -> bool:
    return bool(unit) and same_dimension(unit, "1")
