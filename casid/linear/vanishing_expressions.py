"""What vanishes for all parameter values: expressions judged at random points, exactly if rational.

A rational expression that is zero at a random rational point is zero everywhere, but for a chance
that its degree over the number of points bounds (Schwartz 1980, Zippel 1979). Evaluated in
fractions, no tolerance is needed.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from casid.algebra.symbolic import exact, rational_operations, walk
from casid.errors import ModelError

Expr = Any  # a CasADi SX expression

_VANISHES = 1e-12  # an entry below this at random points of order 1 is zero, where it is irrational
_RESIDUE = 1e-12  # a constant of few bits below this is what two others left when they cancelled


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
            rows.append(walk(function, [point], rational_operations(_power), number)[0])
        except ModelError:
            return None
        except ZeroDivisionError:
            continue
    return rows if len(rows) == count else None


def float_points(
    expressions: Sequence[Expr], p: Expr, count: int, *, seed: int = 5
) -> list[list[float]]:
    """Scalar SX expressions at random parameter points of order 1 where they are finite."""
    function = ca.Function("e", [p], [ca.densify(ca.vertcat(*expressions))], {"cse": True})
    rng = np.random.default_rng(seed)
    rows: list[list[float]] = []
    for _ in range(20 * count):
        values = np.array(function(rng.uniform(0.2, 1.7, p.numel()))).ravel()
        if np.isfinite(values).all():
            rows.append([float(v) for v in values])
        if len(rows) == count:
            break
    return rows


def remove_zeros(expressions: Iterable[Expr], p: Expr) -> list[Expr]:
    """The same scalar expressions, structural zeros where one vanishes for all parameters.

    A rational expression vanishes if it is zero at 4 random points, or if what is left there is
    rounding of the model's constants, as in 0.1 * 3 * k - 0.3 * k: a value that changes by half
    when the constants change by 1e-14. Other expressions are judged in floating point.
    """
    expressions = [ca.SX(e) for e in expressions]
    doubtful = [e for e in expressions if e.nnz() and not (e.is_constant() and not e.is_zero())]
    if not doubtful:
        return expressions
    points = exact_points(doubtful, p, 4, number=_read)
    moved = exact_points(doubtful, p, 4, number=_moved)
    if points is None or moved is None:
        values = np.abs(np.array(float_points(doubtful, p, 4)))
        is_zero = (values <= _VANISHES).all(axis=0) if len(values) else [False] * len(doubtful)
    else:
        is_zero = [
            all(2 * abs(b[k] - a[k]) >= abs(a[k]) for a, b in zip(points, moved, strict=True))
            for k in range(len(doubtful))
        ]
    vanishing = {id(e) for e, zero in zip(doubtful, is_zero, strict=True) if zero}
    return [ca.SX(1, 1) if id(e) in vanishing else e for e in expressions]


def _read(constant: float) -> Fraction:
    """A constant as `exact` reads it, but 0 for what only a rounding error can be.

    The difference of two nearly equal floats is a few units of their last place: a tiny number of
    few bits, as 0.1 * 3 - 0.3 = 2^-54. A tiny number that somebody wrote, as 1e-13, has all 53.
    """
    if abs(constant) < _RESIDUE and (math.frexp(constant)[0] * 256.0).is_integer():
        return Fraction(0)
    return exact(constant)


def _moved(constant: float) -> Fraction:
    """A constant changed by about 1e-14 of itself, the same each time; short ones are exact."""
    value = _read(constant)
    if (constant * 1024.0).is_integer():
        return value
    change = random.Random(repr(constant)).choice([-1, 1]) * random.Random(constant).uniform(1, 2)
    return value * (1 + Fraction(change) / 10**14)


def _power(base: Fraction, exponent: Fraction) -> Fraction:
    if exponent.denominator != 1:
        raise ModelError(f"a power with the exponent {exponent} is not rational; evaluate it")
    return base**exponent.numerator
