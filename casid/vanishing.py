"""What vanishes for all parameter values: expressions judged at random points, exactly if rational.

A rational expression that is zero at a random rational point is zero everywhere, but for a chance
that its degree over the number of points bounds (Schwartz 1980, Zippel 1979). Evaluated in
fractions, no tolerance is needed.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from casid.errors import ModelError
from casid.symbolic import evaluate_exactly

Expr = Any  # a CasADi SX expression

_VANISHES = 1e-12  # an entry below this at random points of order 1 is zero, where it is irrational


def exact_points(
    expressions: Sequence[Expr], p: Expr, count: int, *, seed: int = 5
) -> list[list[Fraction]] | None:
    """Scalar SX expressions at random rational parameter points, without any rounding.

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
            rows.append(evaluate_exactly(function, point)[0])
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

    Exact for rational expressions, but for a probability below 1e-3 an entry at each of 4 points;
    others are judged in floating point.
    """
    expressions = [ca.SX(e) for e in expressions]
    doubtful = [e for e in expressions if e.nnz() and not (e.is_constant() and not e.is_zero())]
    if not doubtful:
        return expressions
    points: Sequence[Sequence[Fraction | float]] = exact_points(doubtful, p, 4) or []
    limit = 0.0 if points else _VANISHES
    points = points or float_points(doubtful, p, 4)
    if not points:
        return expressions
    vanishing = {
        id(e): max(abs(float(row[k])) for row in points) <= limit for k, e in enumerate(doubtful)
    }
    return [ca.SX(1, 1) if vanishing.get(id(e), False) else e for e in expressions]
