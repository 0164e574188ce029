"""A matroid given by the columns of a matrix modulo a prime: bases, dependent sets, components.

Everything is enumerated by extending one reduced form, one pivot a choice, and lazily.
Source: J. G. Oxley, Matroid Theory, 2nd ed. (2011).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from casid.algebra.prime_field import echelon
from casid.arrays import Array


@dataclass(frozen=True, slots=True)
class Basis:
    """Rows in reduced echelon form from the right: row i has its pivot at last[i], ascending."""

    rows: Array
    last: tuple[int, ...]
    p: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rank and number of columns."""
        return (len(self.last), self.rows.shape[1])


def components(matrix: Array, p: int) -> list[tuple[list[int], Basis]]:
    """Columns and basis of every connected component, in the order of the first columns.

    Columns that are zero belong to none. The components are those of the bipartite graph of pivots
    and other columns of any reduced echelon form (Oxley 2011, sections 4.1, 4.3).
    """
    n = matrix.shape[1]
    flipped, pivots = echelon(matrix[:, ::-1], p)
    rows, last = flipped[::-1, ::-1], [n - 1 - q for q in pivots[::-1]]
    out: list[tuple[list[int], Basis]] = []
    for columns in _connected(rows != 0):
        members = [i for i, q in enumerate(last) if q in set(columns)]
        local = tuple(columns.index(last[i]) for i in members)
        out.append((columns, Basis(rows[np.ix_(members, columns)], local, p)))
    return out


def _connected(there: Array) -> list[list[int]]:
    """Columns that rows tie together, in the order of the first of each."""
    groups: list[set[int]] = []
    for row in there:
        new = {int(j) for j in np.flatnonzero(row)}
        apart = [g for g in groups if not g & new]
        groups = [*apart, new.union(*(g for g in groups if g & new))]
    return sorted(sorted(g) for g in groups)


def bases(basis: Basis) -> Iterator[tuple[int, ...]]:
    """Bases in lexicographic order, one pivot for each choice and no dead ends.

    Of all bases that with the largest members is `last`; the smallest member of a basis is any
    column that is not zero up to last[0], and taking it leaves a smaller matrix of the same form.
    """
    if not basis.last:
        yield ()
        return
    yield from _extend(basis.rows, basis.last, 0, basis.p)


def _extend(rows: Array, last: tuple[int, ...], start: int, p: int) -> Iterator[tuple[int, ...]]:
    candidates = start + np.flatnonzero(rows[:, start : last[0] + 1].any(axis=0))
    if len(last) == 1:
        yield from ((int(j),) for j in candidates)
        return
    for j in (int(c) for c in candidates):
        column = rows[:, j]
        i = int(np.flatnonzero(column)[0])
        rest = _without(rows, i, j, p)
        for more in _extend(rest, last[:i] + last[i + 1 :], j + 1, p):
            yield (j, *more)


def _without(rows: Array, i: int, j: int, p: int) -> Array:
    """Column j eliminated with row i, and that row left out: the matroid contracted by j."""
    pivot = rows[i] * pow(int(rows[i, j]), -1, p) % p
    others = np.delete(rows, i, axis=0)
    result: Array = (others - others[:, j, None] * pivot) % p
    return result


def dependent(rows: Array, size: int, p: int) -> Iterator[tuple[int, ...]]:
    """Sets of `size` dependent columns, in lexicographic order."""
    n = rows.shape[1]

    def extend(rows: Array, prefix: tuple[int, ...], left: int) -> Iterator[tuple[int, ...]]:
        """All dependent sets that begin with `prefix` and have `left` more columns."""
        start = prefix[-1] + 1 if prefix else 0
        zero: Array = ~np.any(rows[:, start:], axis=0)
        if left == 1:
            yield from ((*prefix, start + int(j)) for j in np.flatnonzero(zero))
            return
        for j in range(start, n - left + 1):
            if zero[j - start]:
                tails = combinations(range(j + 1, n), left - 1)
                yield from ((*prefix, j, *tail) for tail in tails)
            else:
                i = int(np.flatnonzero(rows[:, j])[0])
                yield from extend(_without(rows, i, j, p), (*prefix, j), left - 1)

    return extend(rows, (), size) if size else iter(())
