"""A proper and stable left inverse of a tall transfer matrix, by a free observer gain.

With a realisation x+ = A x + E u, y = C x + F u, F of full column rank, K F = I and N F = 0,

    x+ = (A - E K C) x + E K y + H N (y - C x),   u = K (y - C x)                            (1)

is a left inverse for every H; one with stable poles exists where there are no unstable zeros. H is
designed in floating point and rounded; everything else is exact, so that f G = I exactly.

Where F has not, because measurements come late, every row is advanced by its own relative degree
first: f is then stable, and looks ahead by no more than that.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from casid.algebra import polynomial as poly
from casid.algebra.elimination import row_echelon
from casid.algebra.leverrier import fractions, transfer_polynomials
from casid.algebra.rational import Rational
from casid.algebra.transfer_matrix import RationalMatrix
from casid.arrays import TINY, Array
from casid.unknown_inputs.indirect.blocks import frequency_grid, is_stable


def observer_inverse(G: RationalMatrix) -> RationalMatrix | None:
    """A stable f with f G = I, proper if it can be, or None where this way finds none.

    Parameters
    ----------
    G : (m, n), m > n, without parameters.
    """
    if G.parameters:
        return None
    if G.is_proper:
        found = _inverse_of_proper(G)
        if found is not None:
            return found
    step = _advance(G)
    late = [min((g.relative_degree for g in row if not g.is_zero), default=0) for row in G.rows]
    rows = tuple(tuple(g * step**k for g in row) for row, k in zip(G.rows, late, strict=True))
    found = _inverse_of_proper(RationalMatrix(rows, G.outputs, G.inputs))
    if found is None:
        return None
    ahead = tuple(tuple(g * step**k for g, k in zip(row, late, strict=True)) for row in found.rows)
    return RationalMatrix(ahead, G.inputs, G.outputs)


def _advance(G: RationalMatrix) -> Rational:
    """q, or s/a + 1 with a among the poles' and zeros' frequencies."""
    variable, Ts = G.time
    if variable != "s":
        return Rational.shift(Ts)
    w = frequency_grid([G])
    return Rational.derivative() / Fraction(f"{np.sqrt(w[0] * w[-1]):.3g}") + 1


def _inverse_of_proper(G: RationalMatrix) -> RationalMatrix | None:
    A, E, C, F = exact_realisation(G)
    basis = _left_inverse_and_null_space(F)
    if basis is None:
        return None
    K, N = basis
    NC, EK = N @ C, E @ K
    inner = A - EK @ C
    variable, Ts = G.time
    H = _gain(inner, NC, variable == "s")
    if H is None:
        return None
    above, below = transfer_polynomials(inner - H @ NC, EK + H @ N, -K @ C, K)
    f = tuple(tuple(Rational(a, below, variable, Ts) for a in row) for row in above)
    out = RationalMatrix(f, G.inputs, G.outputs)
    return out if is_stable(out) else None


def exact_realisation(G: RationalMatrix) -> tuple[Array, Array, Array, Array]:
    """(A, B, C, D) in fractions: every row in observer form over its least common denominator."""
    m, n = G.shape
    denominators = [poly.common_multiple(g.denominator for g in row) for row in G.rows]
    total = sum(poly.degree(below) for below in denominators)
    A, B, C = (fractions(np.zeros(s)) for s in ((total, total), (total, n), (m, total)))
    start = 0
    for i, (row, below) in enumerate(zip(G.rows, denominators, strict=True)):
        order = poly.degree(below)
        for k in range(order):
            A[start + k, start] = -below[k + 1]
            if k + 1 < order:
                A[start + k, start + k + 1] = Fraction(1)
        for k, g in enumerate(row):
            fill = poly.divide(below, g.denominator)[0]
            rest = poly.add(poly.multiply(g.numerator, fill), poly.scale(below, -g.direct))
            for j, c in enumerate(rest):
                B[start + order - len(rest) + j, k] = c
        if order:
            C[i, start] = Fraction(1)
        start += order
    return A, B, C, fractions([[g.direct for g in row] for row in G.rows])


def _left_inverse_and_null_space(F: Array) -> tuple[Array, Array] | None:
    """K with K F = I and N with N F = 0, rows of N a basis; None where F lacks column rank."""
    m, n = F.shape
    found = row_echelon(np.hstack([F, fractions(np.eye(m))]).tolist(), columns=n, size=abs)
    rows = np.array(found.rows, dtype=object)[:, n:]
    return (rows[:n], rows[n:]) if found.rank == n else None


def _gain(A: Array, C: Array, is_continuous: bool) -> Array | None:
    """H that makes A - H C stable: least variance for noise of size one on states and outputs."""
    from scipy import linalg

    n = len(A)
    if n == 0 or not len(C):
        return fractions(np.zeros((n, len(C))))
    a, c = A.astype(float), C.astype(float)
    size = max(float(np.linalg.norm(c)), TINY)
    try:
        if is_continuous:
            P = linalg.solve_continuous_are(a.T, c.T / size, np.eye(n), np.eye(len(c)))
            H = P @ c.T / size**2
        else:
            P = linalg.solve_discrete_are(a.T, c.T / size, np.eye(n), np.eye(len(c)))
            H = a @ P @ c.T @ np.linalg.inv(c @ P @ c.T + size**2 * np.eye(len(c)))
    except (linalg.LinAlgError, ValueError):
        return None
    return fractions([[f"{x:.4g}" for x in row] for row in H.tolist()])
