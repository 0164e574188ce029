"""Which expressions vanish identically, judged at random points: exactly where they are rational.

A rational expression that is zero at a random point is zero everywhere, but for a chance of at most
its degree over the number of points (Schwartz 1980, Zippel 1979). It is evaluated without rounding:
modulo a random prime above 2^30, where numbers stay short however large the expression
(`vanishing`), or in fractions, where a remainder can be compared with the rounding errors of the
model's constants (`remove_zeros`).
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from casid.algebra.prime_field import random_prime, to_field, to_rational
from casid.algebra.symbolic import evaluate_exactly, exact, rational_operations, walk
from casid.errors import ModelError

Expr = Any  # a CasADi SX expression
Operations = Mapping[int, Callable[..., Any]]

POINTS = 3
"""`vanishing`: an expression vanishes if it is zero at this many random points."""

_DIGITS, _ZERO = 60, 1e-30  # of functions such as sin: precision, and what is zero at order 1
_VANISHES = 1e-12  # an entry below this at random points of order 1 is zero, where it is irrational
_RESIDUE = 1e-12  # a constant of few bits below this is the rounding error of two that cancelled


def exact_points(
    expressions: Sequence[Expr],
    p: Expr,
    count: int,
    *,
    seed: int = 5,
    number: Callable[[float], Fraction] = exact,
) -> list[list[Fraction]] | None:
    """Scalar SX expressions at random rational parameter points, without any rounding.

    Parameters
    ----------
    number : reads the constants in the expressions.

    Returns
    -------
    `count` rows, one entry for each expression; None if an expression is not rational in `p`.
    """
    function = ca.Function("e", [p], [ca.densify(ca.vertcat(*expressions))], {"cse": True})
    rng = random.Random(seed)
    rows: list[list[Fraction]] = []
    tries = 0
    while len(rows) < count and tries < 20 * count:
        tries += 1
        point = [Fraction(rng.randint(2, 97), rng.randint(2, 23)) for _ in range(p.numel())]
        try:
            rows.append(evaluate_exactly(function, point, number=number)[0])
        except ModelError:
            return None
        except ZeroDivisionError:
            continue
    return rows if len(rows) == count else None


def float_points(expressions: Sequence[Expr], p: Expr, count: int) -> list[list[float]]:
    """Scalar SX expressions at random parameter points of order 1 where they are finite."""
    function = ca.Function("e", [p], [ca.densify(ca.vertcat(*expressions))], {"cse": True})
    rng = np.random.default_rng(5)
    rows: list[list[float]] = []
    for _ in range(20 * count):
        values = np.array(function(rng.uniform(0.2, 1.7, p.numel()))).ravel()
        if np.isfinite(values).all():
            rows.append([float(v) for v in values])
        if len(rows) == count:
            break
    return rows


# -- up to rounding of the model's constants ------------------------------------------------------


def remove_zeros(expressions: Iterable[Expr], p: Expr) -> list[Expr]:
    """The scalar expressions, with structural zeros where one vanishes for all parameters.

    A rational expression vanishes if at 4 random points it is zero or a rounding error of the
    model's constants, as in 0.1 * 3 * k - 0.3 * k: a value that changes by half when the constants
    change by 1e-14. Other expressions are judged in floating point.
    """
    expressions = [ca.SX(e) for e in expressions]
    doubtful = [e for e in expressions if e.nnz() and not (e.is_constant() and not e.is_zero())]
    if not doubtful:
        return expressions
    points = exact_points(doubtful, p, 4, number=_without_residue)
    moved = exact_points(doubtful, p, 4, number=_perturbed)
    if points is None or moved is None:
        values = np.abs(np.array(float_points(doubtful, p, 4)))
        is_zero = (values <= _VANISHES).all(axis=0) if len(values) else [False] * len(doubtful)
    else:
        is_zero = [
            all(2 * abs(b[k] - a[k]) >= abs(a[k]) for a, b in zip(points, moved, strict=True))
            for k in range(len(doubtful))
        ]
    zeros = {id(e) for e, zero in zip(doubtful, is_zero, strict=True) if zero}
    return [ca.SX(1, 1) if id(e) in zeros else e for e in expressions]


def _without_residue(constant: float) -> Fraction:
    """A constant as `exact` reads it, but 0 for what only a rounding error can be.

    The difference of two nearly equal floats is a few units of their last place: a tiny number of
    few bits, as 0.1 * 3 - 0.3 = 2^-54. A tiny number that somebody wrote, as 1e-13, has all 53.
    """
    if abs(constant) < _RESIDUE and (math.frexp(constant)[0] * 256.0).is_integer():
        return Fraction(0)
    return exact(constant)


def _perturbed(constant: float) -> Fraction:
    """A constant changed by about 1e-14 of itself, the same each time; short ones are exact."""
    value = _without_residue(constant)
    if (constant * 1024.0).is_integer():
        return value
    change = random.Random(repr(constant)).choice([-1, 1]) * random.Random(constant).uniform(1, 2)
    return value * (1 + Fraction(change) / 10**14)


# -- exactly, for expressions of any size ---------------------------------------------------------


def vanishing(
    expressions: Sequence[Expr], *, at: Mapping[str, Fraction] | None = None
) -> list[bool]:
    """For each scalar SX expression: is it zero for (almost) all values of its symbols?

    Rational expressions are evaluated modulo random primes. Functions such as sin and log are
    evaluated in 60 digits, where a value below 1e-30 at points of order 1 leaves no doubt.

    Parameters
    ----------
    at : names of symbols that are held at a value, which may be special.

    Raises
    ------
    ModelError
        If an expression has a pole at every point tried, or is not made of analytic functions.
    """
    held = {k: Fraction(v) for k, v in (at or {}).items()}
    doubtful = [i for i, e in enumerate(expressions) if not _is_settled(ca.SX(e), held)]
    zero = [i in doubtful or bool(ca.SX(e).is_zero()) for i, e in enumerate(expressions)]
    if not doubtful:
        return zero
    vector = ca.densify(ca.vertcat(*[expressions[i] for i in doubtful]))
    symbols = ca.symvar(vector)
    function = ca.Function("zero", [ca.vertcat(*symbols)], [vector], {"cse": True})
    values = [held.get(s.name()) for s in symbols]
    rng = np.random.default_rng(11)
    for _ in range(POINTS):
        found = _zero_at_a_point(function, values, rng)
        if found is None:
            special = ", ".join(f"{k} = {v}" for k, v in held.items())
            raise ModelError(
                "an expression divides by zero at every point that was tried; look for a "
                "denominator that vanishes identically" + (f" or at {special}" if special else "")
            )
        for i, is_zero in zip(doubtful, found, strict=True):
            zero[i] = zero[i] and is_zero
    return zero


def _is_settled(e: Expr, held: Mapping[str, Fraction]) -> bool:
    return bool(e.is_zero() or e.is_constant() or (e.is_symbolic() and e.name() not in held))


def _zero_at_a_point(
    function: ca.Function, values: Sequence[Fraction | None], rng: np.random.Generator
) -> list[bool] | None:
    """Which entries are zero at one random point that is no pole; None if none was found."""
    for _ in range(20):
        try:
            try:
                return _zero_in_a_field(function, values, rng)
            except ModelError:  # not rational
                return _zero_in_many_digits(function, values, rng)
        except (ZeroDivisionError, ValueError):
            continue
    return None


def _zero_in_a_field(
    function: ca.Function, values: Sequence[Fraction | None], rng: np.random.Generator
) -> list[bool]:
    p = random_prime(rng)
    point = [int(rng.integers(1, p)) if v is None else to_field(v, p) for v in values]
    found = walk(function, [point], _field_operations(p), lambda c: to_field(_decimal(c), p))[0]
    return [v % p == 0 for v in found]


def _decimal(constant: float) -> Fraction:
    """A constant to 14 digits, so that 0.1 * 3, folded by CasADi, is the 0.3 it is on paper."""
    return exact(float(f"{constant:.14g}"))


def _field_operations(p: int) -> Operations:
    def inverse(a: int) -> int:
        if a % p == 0:
            raise ZeroDivisionError("zero has no inverse")
        return pow(a, -1, p)

    def power(base: int, exponent: int) -> int:
        """A whole power modulo p, for an exponent that is a small whole number."""
        number = to_rational(exponent, p)
        if number is None or number.denominator != 1 or abs(number) > 1000:
            raise ModelError("not a rational power")
        e = number.numerator
        return pow(base, e, p) if e >= 0 else inverse(pow(base, -e, p))

    return rational_operations(power) | {
        ca.OP_ADD: lambda a, b: (a + b) % p,
        ca.OP_MUL: lambda a, b: a * b % p,
        ca.OP_DIV: lambda a, b: a * inverse(b) % p,
        ca.OP_SQ: lambda a: a * a % p,
        ca.OP_INV: inverse,
    }


def _zero_in_many_digits(
    function: ca.Function, values: Sequence[Fraction | None], rng: np.random.Generator
) -> list[bool]:
    import mpmath

    with mpmath.workdps(_DIGITS):

        def number(value: Fraction) -> Any:
            return mpmath.mpf(value.numerator) / value.denominator

        def drawn() -> Any:  # 40 random digits: no relation between coordinates is hit by chance
            digits = "".join(str(d) for d in rng.integers(0, 10, 40))
            return mpmath.mpf(1) / 5 + mpmath.mpf("0." + digits) * 3 / 2

        point = [drawn() if v is None else number(v) for v in values]
        operations = _analytic_operations(mpmath)
        found = walk(function, [point], operations, lambda c: number(_decimal(c)))[0]
        return [bool(abs(v) < _ZERO) for v in found]


def _analytic_operations(mp: Any) -> Operations:
    named = (
        "sqrt exp log log1p expm1 sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
    ).split()
    return (
        rational_operations(mp.power)
        | {
            ca.OP_ATAN2: lambda a, b: mp.atan(a / b),  # another branch differs by a constant
            ca.OP_HYPOT: lambda a, b: mp.sqrt(a * a + b * b),
            ca.OP_FABS: lambda a: a if mp.re(a) >= 0 else -a,
            ca.OP_SIGN: lambda a: mp.mpf(1 if mp.re(a) >= 0 else -1),
        }
        | {getattr(ca, f"OP_{n.upper()}"): getattr(mp, n) for n in named}
    )
