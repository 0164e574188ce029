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
from casid.algebra.polynomial import Polynomial
from casid.algebra.rational import Rational
from casid.algebra.transfer_matrix import RationalMatrix
from casid.arrays import TINY
from casid.unknown_inputs.indirect.blocks import frequency_grid, is_stable

Exact = list[list[Fraction]]


def free_gain_inverse(G: RationalMatrix) -> RationalMatrix | None:
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
    basis = _echelon_of_transpose(F)
    if basis is None:
        return None
    K, N = basis
    NC = _times(N, C)
    inner = _minus(A, _times(_times(E, K), C))
    variable, Ts = G.time
    H = _gain(inner, NC, variable == "s")
    if H is None:
        return None
    A_f = _minus(inner, _times(H, NC))
    B_f = _plus(_times(E, K), _times(H, N))
    minus_KC = [[-x for x in row] for row in _times(K, C)]
    f = _transfer(A_f, B_f, minus_KC, K, variable, Ts)
    out = RationalMatrix(f, G.inputs, G.outputs)
    return out if is_stable(out) else None


def exact_realisation(G: RationalMatrix) -> tuple[Exact, Exact, Exact, Exact]:
    """(A, B, C, D) in fractions: every row in observer form over its least common denominator."""
    n = G.shape[1]
    parts: list[tuple[Exact, Exact]] = []
    for row in G.rows:
        below = poly.common_multiple(g.denominator for g in row)
        order = poly.degree(below)
        A = [[Fraction(0)] * order for _ in range(order)]
        B = [[Fraction(0)] * n for _ in range(order)]
        for i in range(order):
            A[i][0] = -below[i + 1]
            if i + 1 < order:
                A[i][i + 1] = Fraction(1)
        for k, g in enumerate(row):
            fill = poly.divide(below, g.denominator)[0]
            rest = poly.add(poly.multiply(g.numerator, fill), poly.scale(below, -g.direct))
            for i, c in enumerate(rest):
                B[order - len(rest) + i][k] = c
        parts.append((A, B))
    total = sum(len(A) for A, _ in parts)
    A_all = [[Fraction(0)] * total for _ in range(total)]
    B_all: Exact = []
    C = [[Fraction(0)] * total for _ in parts]
    start = 0
    for i, (A, B) in enumerate(parts):
        for r, row_A in enumerate(A):
            A_all[start + r][start : start + len(A)] = row_A
        B_all += B
        if A:
            C[i][start] = Fraction(1)
        start += len(A)
    D = [[Fraction(g.direct) for g in row] for row in G.rows]
    return A_all, B_all, C, D


def _echelon_of_transpose(F: Exact) -> tuple[Exact, Exact] | None:
    """K with K F = I and N with N F = 0, rows of N a basis; None where F lacks column rank."""
    m, n = len(F), len(F[0])
    work = [[*row, *(Fraction(int(i == k)) for k in range(m))] for i, row in enumerate(F)]
    for k in range(n):
        pivot = max(range(k, m), key=lambda i: abs(work[i][k]), default=None)
        if pivot is None or work[pivot][k] == 0:
            return None
        work[k], work[pivot] = work[pivot], work[k]
        head = work[k][k]
        work[k] = [x / head for x in work[k]]
        for i in range(m):
            if i != k and work[i][k] != 0:
                factor = work[i][k]
                work[i] = [a - factor * b for a, b in zip(work[i], work[k], strict=True)]
    return [row[n:] for row in work[:n]], [row[n:] for row in work[n:]]


def _gain(A: Exact, C: Exact, is_continuous: bool) -> Exact | None:
    """H that makes A - H C stable: least variance for noise of size one on states and outputs."""
    from scipy import linalg

    n = len(A)
    if n == 0:
        return []
    a, c = (np.array([[float(x) for x in row] for row in M]) for M in (A, C))
    if not len(c):
        return [[] for _ in range(n)]
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
    return [[Fraction(f"{x:.4g}") for x in row] for row in H.tolist()]


def _transfer(
    A: Exact, B: Exact, C: Exact, D: Exact, variable: str, Ts: float | None
) -> tuple[tuple[Rational, ...], ...]:
    """C (z I - A)^-1 B + D, by the recursion of Faddeev and LeVerrier in fractions."""
    n, columns = len(A), len(D[0])
    below, M = [Fraction(1)], [[Fraction(int(i == k)) for k in range(n)] for i in range(n)]
    above: list[Exact] = []
    for k in range(1, n + 1):
        above.append(_times(_times(C, M), B))
        AM = _times(A, M)
        c = -sum((AM[i][i] for i in range(n)), Fraction(0)) / k
        below.append(c)
        M = [[AM[i][j] + (c if i == j else 0) for j in range(n)] for i in range(n)]
    denominator: Polynomial = tuple(below)
    rows = []
    for i in range(len(D)):
        row = []
        for j in range(columns):
            numerator = poly.trimmed(X[i][j] for X in above)
            total = poly.add(numerator, poly.scale(denominator, D[i][j]))
            row.append(Rational(total, denominator, variable, Ts))
        rows.append(tuple(row))
    return tuple(rows)


def _times(a: Exact, b: Exact) -> Exact:
    columns = len(b[0]) if b else 0
    return [
        [sum((x * b[k][j] for k, x in enumerate(row)), Fraction(0)) for j in range(columns)]
        for row in a
    ]


def _minus(a: Exact, b: Exact) -> Exact:
    if not a or not b or not b[0]:
        return a
    return [[x - y for x, y in zip(p, q, strict=True)] for p, q in zip(a, b, strict=True)]


def _plus(a: Exact, b: Exact) -> Exact:
    if not a or not b or not b[0]:
        return a
    return [[x + y for x, y in zip(p, q, strict=True)] for p, q in zip(a, b, strict=True)]
