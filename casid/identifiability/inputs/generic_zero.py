"""Which expressions vanish identically: judged at random points, exactly where they are rational.

A rational function with rational coefficients that is zero at a random point modulo a random prime
is zero everywhere, but for a chance of at most (degree / prime) a point (Schwartz 1980, Zippel
1979); the prime exceeds 2^30. Functions such as sin and log are evaluated in 60 digits, where a
value below 1e-30 at points of order 1 leaves no doubt.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from casid.algebra.prime_field import random_prime, to_field, to_rational
from casid.algebra.symbolic import exact, walk
from casid.errors import ModelError

Expr = Any  # a CasADi SX expression
Operations = Mapping[int, Callable[..., Any]]

POINTS = 3
"""An expression vanishes if it is zero at this many random points."""

_DIGITS = 60
_TINY = 1e-30


def vanishing(
    expressions: Sequence[Expr], *, at: Mapping[str, Fraction] | None = None, seed: int = 11
) -> list[bool]:
    """For each scalar SX expression: is it zero for (almost) all values of its symbols?

    Parameters
    ----------
    at : names of symbols that are held at a value, which may be special.

    Raises
    ------
    ModelError
        If an expression has a pole wherever it is looked at, or is not made of analytic functions.
    """
    zero = [True] * len(expressions)
    held = {k: Fraction(v) for k, v in (at or {}).items()}
    doubtful = [i for i, e in enumerate(expressions) if not _is_settled(ca.SX(e), held)]
    for i, e in enumerate(expressions):
        zero[i] = i in doubtful or bool(ca.SX(e).is_zero())
    if not doubtful:
        return zero
    vector = ca.densify(ca.vertcat(*[expressions[i] for i in doubtful]))
    symbols = ca.symvar(vector)
    function = ca.Function("zero", [ca.vertcat(*symbols)], [vector], {"cse": True})
    names = [s.name() for s in symbols]
    rng = np.random.default_rng(seed)
    for _ in range(POINTS):
        for i, is_zero in zip(doubtful, _at_a_point(function, names, held, rng), strict=True):
            zero[i] = zero[i] and is_zero
    return zero


def _is_settled(e: Expr, held: Mapping[str, Fraction]) -> bool:
    return bool(e.is_zero() or e.is_constant() or (e.is_symbolic() and e.name() not in held))


def _at_a_point(
    function: ca.Function, names: list[str], held: dict[str, Fraction], rng: np.random.Generator
) -> list[bool]:
    """Which entries are zero at one random point that is no pole."""
    for _ in range(20):
        try:
            try:
                return _in_a_field(function, names, held, rng)
            except ModelError:  # not rational
                return _in_many_digits(function, names, held, rng)
        except (ZeroDivisionError, ValueError):
            continue
    raise ModelError(
        "an expression divides by zero at every point that was tried; look for a denominator that "
        "vanishes identically" + (" or at " + _listing(held) if held else "")
    )


def _listing(held: Mapping[str, Fraction]) -> str:
    return ", ".join(f"{k} = {v}" for k, v in held.items())


def _in_a_field(
    function: ca.Function, names: list[str], held: dict[str, Fraction], rng: np.random.Generator
) -> list[bool]:
    p = random_prime(rng)
    point = [to_field(held[n], p) if n in held else int(rng.integers(1, p)) for n in names]
    values = walk(function, [point], _field_operations(p), lambda c: to_field(_read(c), p))[0]
    return [v % p == 0 for v in values]


def _read(constant: float) -> Fraction:
    """A constant to 14 digits, so that 0.1 * 3, folded by CasADi, is the 0.3 it is on paper."""
    return exact(float(f"{constant:.14g}"))


def _field_operations(p: int) -> Operations:
    def inverse(a: int) -> int:
        if a % p == 0:
            raise ZeroDivisionError("zero has no inverse")
        return pow(a, -1, p)

    def power(base: int, exponent: int) -> int:
        number = to_rational(exponent, p)
        if number is None or number.denominator != 1 or abs(number) > 1000:
            raise ModelError("not a rational power")
        e = number.numerator
        return pow(base, e, p) if e >= 0 else inverse(pow(base, -e, p))

    return {
        ca.OP_ASSIGN: lambda a: a,
        ca.OP_ADD: lambda a, b: (a + b) % p,
        ca.OP_SUB: lambda a, b: (a - b) % p,
        ca.OP_MUL: lambda a, b: a * b % p,
        ca.OP_DIV: lambda a, b: a * inverse(b) % p,
        ca.OP_NEG: lambda a: -a % p,
        ca.OP_SQ: lambda a: a * a % p,
        ca.OP_TWICE: lambda a: 2 * a % p,
        ca.OP_INV: inverse,
        ca.OP_POW: power,
        ca.OP_CONSTPOW: power,
    }


def _in_many_digits(
    function: ca.Function, names: list[str], held: dict[str, Fraction], rng: np.random.Generator
) -> list[bool]:
    import mpmath

    with mpmath.workdps(_DIGITS):

        def number(value: Fraction) -> Any:
            return mpmath.mpf(value.numerator) / value.denominator

        # 40 random digits: no relation between the coordinates is hit by chance.
        point = [
            number(held[n]) if n in held else mpmath.mpf(1) / 5 + mpmath.mpf(_random(rng)) * 3 / 2
            for n in names
        ]
        operations = _analytic_operations(mpmath)
        values = walk(function, [point], operations, lambda c: number(_read(c)))[0]
        return [bool(abs(v) < _TINY) for v in values]


def _random(rng: np.random.Generator) -> str:
    return "0." + "".join(str(d) for d in rng.integers(0, 10, 40))


def _analytic_operations(mp: Any) -> Operations:
    named = (
        "sqrt exp log log1p expm1 sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
    ).split()
    return {
        ca.OP_ASSIGN: lambda a: a,
        ca.OP_ADD: lambda a, b: a + b,
        ca.OP_SUB: lambda a, b: a - b,
        ca.OP_MUL: lambda a, b: a * b,
        ca.OP_DIV: lambda a, b: a / b,
        ca.OP_NEG: lambda a: -a,
        ca.OP_SQ: lambda a: a * a,
        ca.OP_TWICE: lambda a: 2 * a,
        ca.OP_INV: lambda a: 1 / a,
        ca.OP_POW: mp.power,
        ca.OP_CONSTPOW: mp.power,
        ca.OP_ATAN2: lambda a, b: mp.atan(a / b),  # another branch differs by a constant
        ca.OP_HYPOT: lambda a, b: mp.sqrt(a * a + b * b),
        ca.OP_FABS: lambda a: a if mp.re(a) >= 0 else -a,
        ca.OP_SIGN: lambda a: mp.mpf(1 if mp.re(a) >= 0 else -1),
    } | {getattr(ca, f"OP_{n.upper()}"): getattr(mp, n) for n in named}
