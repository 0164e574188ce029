"""Minors of a transfer matrix: rank, inverse, and the Smith-McMillan poles and zeros."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from casid.algebra import polynomial as poly
from casid.algebra.elimination import row_echelon, solve
from casid.algebra.polynomial import Polynomial
from casid.algebra.rational import Rational
from casid.errors import ModelError

Rows = Sequence[Sequence[Rational]]


def determinant(rows: Rows) -> Rational:
    """The determinant of a square matrix of rational functions, by elimination."""
    found = row_echelon(rows, is_zero=_is_zero, reduced=False)
    value = Rational(poly.ONE if found.rank == len(rows) else poly.ZERO)
    for k in range(found.rank):
        value = value * found.rows[k][k]
    return value if found.sign > 0 else -value


def normal_rank(rows: Rows) -> int:
    """The rank over rational functions."""
    return row_echelon(rows, is_zero=_is_zero, reduced=False).rank


def inverse(rows: Rows) -> tuple[tuple[Rational, ...], ...]:
    """The inverse of a square matrix of rational functions.

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
    eye = [[one if i == k else zero for k in range(n)] for i in range(n)]
    found = solve(rows, eye, is_zero=_is_zero)
    if found is None:
        pivots = row_echelon(rows, is_zero=_is_zero, reduced=False).pivots
        column = next(k for k in range(n) if k not in pivots)
        raise ModelError(
            f"the {n} x {n} transfer matrix is singular at every q (normal rank {len(pivots)}): "
            f"column {column} depends on the columns before it. Leave it out"
        )
    return tuple(map(tuple, found))


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


def _is_zero(g: Rational) -> bool:
    return g.is_zero


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
