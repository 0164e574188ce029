"""Row reduction over any field: fractions, rational functions, elements of a sympy field, floats.

Entries are numbers with + - * /; what counts as zero is the caller's to say. Modulo a prime that
fits in a machine word, `casid.algebra.prime_field.echelon` does the same on whole arrays, some
hundred times faster.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

Element: TypeAlias = Any  # a number of the field
Rows: TypeAlias = Sequence[Sequence[Element]]


def _equals_zero(x: Element) -> bool:
    return bool(x == 0)


@dataclass(frozen=True, slots=True)
class RowEchelon:
    """Rows in echelon form.

    Attributes
    ----------
    rows : all m rows; those after the first `rank` are zero in the columns that were reduced.
    pivots : columns of the pivots, ascending; row i has its pivot in pivots[i].
    origin : (m,) which of the given rows was moved to each place.
    sign : of the determinant, by the exchanges of rows.
    """

    rows: list[list[Element]]
    pivots: list[int]
    origin: list[int]
    sign: int

    @property
    def rank(self) -> int:
        """Number of pivots."""
        return len(self.pivots)


def row_echelon(
    rows: Rows,
    *,
    columns: int | None = None,
    is_zero: Callable[[Element], bool] = _equals_zero,
    size: Callable[[Element], Any] | None = None,
    reduced: bool = True,
) -> RowEchelon:
    """Eliminate column after column (Gauss; Gauss and Jordan where `reduced`).

    Parameters
    ----------
    rows : (m, n).
    columns : so many of the first columns are reduced; all by default.
    is_zero : whether an entry cannot be a pivot.
    size : for rounded numbers: the largest entry of a column becomes its pivot, and a column
        without one is set to zero. By default the first entry that is not zero is taken.
    reduced : pivots become one and the only entry of their column; else only what is below a pivot
        is eliminated.
    """
    work = [list(row) for row in rows]
    origin, pivots, sign = list(range(len(work))), list[int](), 1
    for k in range(len(work[0]) if work and columns is None else columns or 0):
        rank = len(pivots)
        column = [row[k] for row in work[rank:]]
        candidates = range(len(column))
        if size is not None and column:
            largest = max(candidates, key=[size(x) for x in column].__getitem__)
            candidates = range(largest, largest + 1)
        place = next((rank + i for i in candidates if not is_zero(column[i])), None)
        if place is None:
            if size is not None:
                for row in work[rank:]:
                    row[k] = 0 * row[k]
            continue
        work.insert(rank, work.pop(place))
        origin.insert(rank, origin.pop(place))
        sign = -sign if (place - rank) % 2 else sign
        lead = work[rank][k]
        if reduced:
            work[rank][k:] = [x / lead for x in work[rank][k:]]
        head = work[rank][k:]
        for i in range(0 if reduced else rank + 1, len(work)):
            factor = work[i][k]
            if i != rank and not is_zero(factor):
                factor = factor if reduced else factor / lead
                work[i][k:] = [x - factor * y for x, y in zip(work[i][k:], head, strict=True)]
        pivots.append(k)
    return RowEchelon(work, pivots, origin, sign)


def solve(
    matrix: Rows, right: Rows, *, is_zero: Callable[[Element], bool] = _equals_zero
) -> list[list[Element]] | None:
    """The x with matrix @ x = right, (n, n) and (n, m); None where the matrix is singular."""
    n = len(matrix)
    joined = [[*row, *more] for row, more in zip(matrix, right, strict=True)]
    found = row_echelon(joined, columns=n, is_zero=is_zero)
    return [row[n:] for row in found.rows] if found.rank == n else None


def null_space(rows: Rows, one: Element) -> list[list[Element]]:
    """A basis of all x with rows @ x = 0, one vector for each column without a pivot."""
    found = row_echelon(rows)
    n = len(rows[0]) if rows else 0
    basis = []
    for j in (j for j in range(n) if j not in found.pivots):
        vector = [one - one] * n
        vector[j] = one
        for row, pivot in zip(found.rows, found.pivots, strict=False):
            vector[pivot] = -row[j]
        basis.append(vector)
    return basis
