"""Structural relations between the coefficients of a difference equation.

Some coefficients are bound to each other whatever the parameters are, as b_1 = 0, b_2 = -b_0 for
G(s) = beta s / (s^2 + alpha_1 s + alpha_2) under the bilinear transform. All coefficients of all
parameter values span a linear space (a_0 = 1 is one of them, so affine relations are linear here);
each is written as a combination of the first ones that are independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from casid.algebra import polynomial as poly
from casid.algebra.elimination import row_echelon
from casid.algebra.vanishing import exact_points, float_points
from casid.arrays import Array
from casid.linear.linear_model import TransferMatrix
from casid.linear.sampled.discretisation import DiscreteTransfer, discretise, substitution

Expr = Any  # a CasADi SX expression

_SMALL = 1e-9  # relative size of a relation's error that is rounding, where it is not rational
_LARGEST_DENOMINATOR = 64  # of a relation's coefficient that was found in floating point


def rational_relations(
    polynomials: Sequence[Expr], p: Expr, Ts: float, method: str
) -> tuple[Array, list[int]]:
    """All discrete coefficients as combinations of the first that are independent.

    The continuous coefficients h = (denominator, numerators) of all parameter values span a linear
    space; the substitution maps it onto the span of the discrete ones, exactly. Reducing a basis of
    that to echelon form expresses every later coefficient by earlier ones.
    """
    n = polynomials[0].numel() - 1
    flat = [b[k] for b in polynomials for k in range(n + 1)]
    count = len(flat) + 4
    points = exact_points(flat, p, count)
    rows = points if points is not None else _rationalised(float_points(flat, p, 3 * count))
    found = row_echelon(rows)
    basis = found.rows[: found.rank]
    K = substitution(n, Fraction(repr(float(Ts))), method)
    images = [
        [
            sum((row[b * (n + 1) + k] * K[k][j] for k in range(n + 1)), Fraction(0))
            for b in range(len(polynomials))
            for j in range(n + 1)
        ]
        for row in basis
    ]
    reduced = row_echelon(images)
    independent = reduced.rows[: reduced.rank]
    return np.array([[float(v) for v in row] for row in independent]).T, reduced.pivots


def _dependent(values: Array) -> list[tuple[int, list[int], Array]]:
    """Columns of `values` (K, m) that are combinations of independent columns before them."""
    scale = np.abs(values).max(axis=0)
    scaled = values / np.where(scale > 0, scale, 1.0)
    independent: list[int] = []
    found = []
    for j in range(values.shape[1]):
        weights, *_ = np.linalg.lstsq(scaled[:, independent], scaled[:, j], rcond=None)
        error = scaled[:, j] - scaled[:, independent] @ weights
        if np.abs(error).max() < _SMALL:
            found.append((j, list(independent), weights * scale[j] / scale[independent]))
        else:
            independent.append(j)
    return found


def _rationalised(rows: Sequence[Sequence[float]]) -> list[list[Fraction]]:
    """A rational basis of the space that floating-point rows span."""
    values = np.array(rows)
    m = values.shape[1]
    dependent = {j: (cols, w) for j, cols, w in _dependent(values)}
    independent = [j for j in range(m) if j not in dependent]
    basis = []
    for i in independent:
        row = [Fraction(0)] * m
        row[i] = Fraction(1)
        for j, (cols, w) in dependent.items():
            if i in cols:
                row[j] = _fraction(float(w[cols.index(i)]))
        basis.append(row)
    return basis


def _fraction(value: float) -> Fraction:
    """The small fraction that this is, or else the float itself."""
    small = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    return small if abs(float(small) - value) < 1e-7 * max(1.0, abs(value)) else Fraction(value)


def common_degree(polynomials: Sequence[Expr], p: Expr) -> int:
    """The degree of the factor that polynomials in s share for all parameter values.

    Euclid's algorithm in fractions at one random point; 0 for irrational expressions.
    """
    n = polynomials[0].numel() - 1
    flat = [b[k] for b in polynomials for k in range(n + 1)]
    points = exact_points(flat, p, 1, seed=11)
    if points is None:
        return 0
    rows = [points[0][i * (n + 1) : (i + 1) * (n + 1)] for i in range(len(polynomials))]
    factor = poly.trimmed(rows[0])
    for other in rows[1:]:
        factor = poly.common_divisor(factor, poly.trimmed(other))
    return poly.degree(factor)


def hold_relations(
    transfer: TransferMatrix,
    driven: Sequence[int],
    Ts: float,
    method: str,
    discrete: DiscreteTransfer,
) -> tuple[Array, list[int]]:
    """`rational_relations` for holds, whose coefficients are no rational functions.

    Relations with small fractions, as b_0 + b_1 + b_2 = 0, hold at every sample time: they are
    found in floating point at a sample time that suits the system's poles, and kept if they hold at
    `Ts`. Relations that change with the sample time are not found.
    """
    nominal = transfer.nominal()

    def sample(system: Any, count: int, seed: int) -> Array:
        """(count, n) finite coefficients at random values of the free parameters."""
        rng = np.random.default_rng(seed)
        rows: list[Array] = []
        for _ in range(20 * count):
            point = np.where(nominal == 0.0, rng.uniform(0.1, 1.0, len(nominal)), nominal)
            point = point * np.exp(rng.uniform(-1.0, 1.0, len(nominal)))
            parts = [np.array(v).ravel() for v in system.function.call([point])]
            row = np.concatenate([parts[0], *(parts[1 + j] for j in driven)])
            if np.isfinite(row).all():
                rows.append(row)
            if len(rows) == count:
                break
        return np.array(rows)

    poles = np.abs(np.roots(np.array(transfer.function.call([nominal])[0]).ravel()))
    fast = poles[np.isfinite(poles) & (poles > 0)]
    coarse = discretise(transfer, 1.0 / float(np.median(fast)) if len(fast) else Ts, method)
    m = (1 + len(driven)) * (transfer.order + 1)
    values, check = sample(coarse, 3 * m, 1), sample(discrete, m, 2)
    relations = np.eye(m)
    independent = list(range(m))
    if len(values) == 0 or len(check) == 0:
        return relations, independent
    for j, cols, weights in _dependent(values):
        small = np.array([float(_fraction(float(w))) for w in weights])
        small[np.abs(small) < 1e-7] = 0.0
        terms = check[:, cols] * small
        size = np.abs(terms).sum(axis=1) + np.abs(check[:, j])
        error = np.abs(terms.sum(axis=1) - check[:, j])
        if (error <= _SMALL * np.maximum(size, np.abs(check).max(axis=1) * 1e-6)).all():
            row = np.zeros(m)
            for c, w in zip(cols, small, strict=True):
                row += w * relations[c]
            relations[j] = row
            independent.remove(j)
    return relations[:, independent], independent
