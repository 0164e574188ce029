"""Sympy expressions in a form that reads well."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

from casid.algebra.factoring import factored

Expr: TypeAlias = Any  # a sympy expression


def neat(expression: Expr, by: set[Expr]) -> Expr:
    """Factored, and sums in a numerator ordered by the parameters that move."""
    import sympy

    if not expression.is_rational_function(*expression.free_symbols):
        return sympy.powdenest(expression)
    top, bottom = sympy.fraction(factored(sympy.together(expression)))
    return sympy.Mul(*(_grouped(f, by) for f in sympy.Mul.make_args(top))) / bottom


def _grouped(expression: Expr, by: set[Expr]) -> Expr:
    """A sum with the coefficient of each product of some symbols factored."""
    import sympy

    inside = sorted(expression.free_symbols & by, key=str)
    if not expression.is_Add or not inside:
        return expression
    return sympy.Add(
        *(
            factored(c) * sympy.Mul(*(s**n for s, n in zip(inside, powers, strict=True)))
            for powers, c in sympy.Poly(expression, *inside).terms()
        )
    )


def tidy(constant: Expr, theta: Expr, moving: set[Expr]) -> Expr:
    """A multiple or power of theta's invariant with nothing in it that need not be."""
    import sympy

    if not constant.is_rational_function(*constant.free_symbols):
        constant = sympy.powsimp(constant)
    parts = [f.as_base_exp() for f in sympy.Mul.make_args(factored(constant))]
    parts = [(base, e) for base, e in parts if (base**e).free_symbols & moving]
    if all(e.is_Rational for _, e in parts):
        parts = [(base, e * math.lcm(*(x.q for _, x in parts))) for base, e in parts]
        common = math.gcd(*(int(e) for _, e in parts))
        parts = [(base, e / common) for base, e in parts]
        if all(e < 0 for _, e in parts):
            parts = [(base, -e) for base, e in parts]
    return sympy.Mul(*(_signed(base, theta, moving) ** e for base, e in parts))


def _signed(base: Expr, theta: Expr, moving: set[Expr]) -> Expr:
    """A factor of an invariant, up to sign: theta comes with a plus."""
    import sympy

    if base.is_Add and base.is_polynomial(theta) and base.has(theta):
        leading = sympy.Poly(base, theta).LC()
        if leading.could_extract_minus_sign():
            base = sympy.expand(-base)
    polynomial = base.is_polynomial(*base.free_symbols)
    return _grouped(base, moving) if polynomial else base
