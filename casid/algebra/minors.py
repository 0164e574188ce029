"""Minors of a transfer matrix: rank, inverse, and the Smith-McMillan poles and zeros."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from casid.algebra import polynomial as poly
from casid.algebra.polynomial import Polynomial
from casid.algebra.rational import Rational
from casid.errors import ModelError

Rows = Sequence[Sequence[Rational]]


def determinant(rows: Rows) -> Rational:
    """The determinant of a square matrix of rational functions, by elimination."""
    work = [list(row) for row in rows]
    value = Rational(poly.ONE)
    for k in range(len(work)):
        pivot = next((i for i in range(k, len(work)) if not work[i][k].is_zero), None)
        if pivot is None:
            return Rational(poly.ZERO)
        if pivot != k:
            work[k], work[pivot] = work[pivot], work[k]
            value = -value
        value = value * work[k][k]
        for i in range(k + 1, len(work)):
            if not work[i][k].is_zero:
                factor = work[i][k] / work[k][k]
                work[i] = [a - factor * b for a, b in zip(work[i], work[k], strict=True)]
    return value


def normal_rank(rows: Rows) -> int:
    """The rank over rational functions."""
    work, rank = [list(row) for row in rows], 0
    for k in range(len(work[0]) if work else 0):
        pivot = next((i for i in range(rank, len(work)) if not work[i][k].is_zero), None)
        if pivot is None:
            continue
        work[rank], work[pivot] = work[pivot], work[rank]
        for i in range(rank + 1, len(work)):
            if not work[i][k].is_zero:
                factor = work[i][k] / work[rank][k]
                work[i] = [a - factor * b for a, b in zip(work[i], work[rank], strict=True)]
        rank += 1
    return rank


def inverse(rows: Rows) -> tuple[tuple[Rational, ...], ...]:
    """The inverse of a square matrix of rational functions, by Gauss and Jordan.

    Raises
    ------
    ModelError
        If it is not square, or singular.
    """
    n = len(rows)
    if any(len(row) != n for row in rows):
        raise ModelError(
            f"a {n} x {len(rows[0])} transfer matrix has no inverse; a tall one has left inverses"
        )
    one, zero = Rational(poly.ONE), Rational(poly.ZERO)
    work = [[*row, *(one if i == k else zero for k in range(n))] for i, row in enumerate(rows)]
    for k in range(n):
        pivot = next((i for i in range(k, n) if not work[i][k].is_zero), None)
        if pivot is None:
            raise ModelError(
                f"the {n} x {n} transfer matrix is singular at every q (normal rank "
                f"{normal_rank(rows)}): column {k} depends on the columns before it. Leave it out"
            )
        work[k], work[pivot] = work[pivot], work[k]
        work[k] = [a / work[k][k] for a in work[k]]
        for i in range(n):
            if i != k and not work[i][k].is_zero:
                factor = work[i][k]
                work[i] = [a - factor * b for a, b in zip(work[i], work[k], strict=True)]
    return tuple(tuple(row[n:]) for row in work)


def pole_polynomial(rows: Rows) -> Polynomial:
    """Least common denominator of all minors of every order; its degree counts finite poles.

    Its degree is the McMillan degree of a proper matrix.

    Raises
    ------
    ModelError
        If parameters have no value.
    """
    _refuse_symbols(rows)
    found = poly.ONE
    for order in range(1, min(len(rows), len(rows[0])) + 1):
        found = poly.common_multiple(
            [found, *(d.denominator for d in _minors(rows, order) if not d.is_zero)]
        )
    return found


def zero_polynomial(rows: Rows) -> Polynomial:
    """Common divisor of the minors of the highest order, all over the pole polynomial.

    Its roots are the transmission zeros (MacFarlane & Karcanias 1976, section 5).

    Raises
    ------
    ModelError
        If parameters have no value.
    """
    below, rank, found = pole_polynomial(rows), normal_rank(rows), poly.ZERO
    for minor in _minors(rows, rank):
        if not minor.is_zero:
            fill = poly.divide(below, minor.denominator)[0]
            found = poly.common_divisor(found, poly.multiply(minor.numerator, fill))
    return found or poly.ONE


def _minors(rows: Rows, order: int) -> Iterator[Rational]:
    for chosen in combinations(rows, order):
        for columns in combinations(range(len(rows[0])), order):
            yield determinant([[row[k] for k in columns] for row in chosen])


def _refuse_symbols(rows: Rows) -> None:
    names = sorted({n for row in rows for g in row for n in g.parameters})
    if names:
        raise ModelError(
            f"poles and zeros of a transfer matrix need numbers: no value is given for "
            f"{', '.join(names)}; give them with substitute({{name: value}})"
        )
