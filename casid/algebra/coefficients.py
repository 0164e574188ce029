"""Coefficients of rational functions: fractions, and sympy expressions of parameters."""

from __future__ import annotations

from fractions import Fraction
from numbers import Integral, Real
from typing import Any

from casid.algebra import polynomial as poly
from casid.algebra.polynomial import Coefficient, Polynomial
from casid.errors import ModelError


def coefficient(value: Any) -> Coefficient:
    """A number as a Fraction (a float as its shortest decimal), a sympy expression as it is."""
    if isinstance(value, Fraction):
        return value
    if isinstance(value, Integral):
        return Fraction(int(value))
    if isinstance(value, Real):
        return decimal(float(value))
    if hasattr(value, "free_symbols"):
        return _sympy_coefficient(value)
    raise ModelError(
        f"{value!r} is no coefficient; give a real number or a sympy expression of parameters"
    )


def cancelled(above: Polynomial, below: Polynomial) -> tuple[Polynomial, Polynomial]:
    """Common factors of two polynomials with symbolic coefficients cancelled, by sympy."""
    import sympy

    x = sympy.Dummy("x")
    ratio = sympy.cancel(
        sympy.sympify(poly.evaluate([sympy.sympify(c) for c in above], x))
        / sympy.sympify(poly.evaluate([sympy.sympify(c) for c in below], x))
    )
    top, bottom = (coefficients(part, x) for part in sympy.fraction(ratio))
    if isinstance(bottom[0], Fraction):
        top, bottom = tuple(c / bottom[0] for c in top), poly.monic(bottom)
    return top, bottom


def decimal(number: float) -> Fraction:
    """The shortest decimal that reads back as this float."""
    if number != number or number in (float("inf"), float("-inf")):
        raise ModelError(f"{number} is no coefficient of a transfer function; look for a 1/0")
    return Fraction(repr(number))


def _sympy_coefficient(value: Any) -> Coefficient:
    import sympy

    value = sympy.nsimplify(value, rational=True) if value.has(sympy.Float) else value
    if value.is_Rational:
        return Fraction(int(value.p), int(value.q))
    if value.is_number and not value.is_real:
        raise ModelError(f"{value} is no real coefficient of a transfer function; look for a 1/0")
    if value.is_number:  # irrational: as its nearest float
        return decimal(float(value))
    return value


def coefficients(expression: Any, x: Any) -> Polynomial:
    """A sympy polynomial in x."""
    import sympy

    return poly.trimmed(
        _sympy_coefficient(c) for c in sympy.Poly(sympy.expand(expression), x).all_coeffs()
    )
