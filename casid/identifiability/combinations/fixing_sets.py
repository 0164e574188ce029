"""Minimal fixing sets and confounded groups: the matroid of a null space.

The columns of a basis N (d, n) of the parameters' null space carry a matroid. A parameter is
identifiable if its column is zero. A set of parameters, once known, makes all others identifiable
exactly if its columns span, so minimal fixing sets are the bases, maximal identifiable subsets
their complements (the bases of the dual matroid, that of the information matrix), and parameters
are confounded with each other within a connected component.
Source: J. G. Oxley, Matroid Theory, 2nd ed. (2011), sections 1.2, 2.1, 4.1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np

from casid.algebra.matroid import Basis, bases, components, dependent
from casid.algebra.prime_field import echelon, null_space
from casid.arrays import Array
from casid.errors import IdentifiabilityError, nearest


@dataclass(frozen=True, slots=True)
class FixingSets:
    """Minimal sets of parameters that, once known, make all others identifiable.

    Attributes
    ----------
    sets : the sets, each in the order of declaration; all have `size` members.
    size : deficiency of the parameters; 0 where all are identifiable (one set, the empty one).
    count : how many there are; at least that many where not `is_count_exact`.
    is_cut : True if `sets` does not list them all.
    groups : confounded groups; a fixing set has `group_sizes[i]` members in `groups[i]`, in one of
        `group_counts[i]` ways.
    """

    sets: tuple[tuple[str, ...], ...]
    size: int
    count: int
    is_count_exact: bool
    is_cut: bool
    groups: tuple[tuple[str, ...], ...]
    group_sizes: tuple[int, ...]
    group_counts: tuple[int, ...]

    def __str__(self) -> str:
        if self.size == 0:
            return "nothing needs to be known: all parameters are identifiable"
        many = f"{self.count}" if self.is_count_exact else f"at least {self.count}"
        lines = [f"{many} minimal fixing set{'s' * (self.count != 1)} of {self.size}"]
        for group, k, ways in zip(self.groups, self.group_sizes, self.group_counts, strict=True):
            possible = math.comb(len(group), k)
            which = "" if ways == possible else f" ({ways} of the {possible} choices)"
            lines.append(f"  {k} of {', '.join(group)}{which}")
        if self.is_cut:
            lines.append(f"  the first {len(self.sets)} are listed; raise limit to list more")
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Exclusion:
    """All subsets of one size, and those that are not identifiable with all others known."""

    size: int
    total: int
    failing: tuple[tuple[str, ...], ...]

    @property
    def count(self) -> int:
        """Number of subsets that are not identifiable."""
        return len(self.failing)

    def __str__(self) -> str:
        return f"{self.count} of {self.total} sets of {self.size} are not identifiable"


def confounded_groups(
    information: Array, names: Sequence[str], p: int
) -> tuple[tuple[str, ...], ...]:
    """Parameters that are not identifiable, grouped by what they can be traded for.

    Two parameters are in one group if a circuit of the matroid contains both: a minimal set of
    parameters that can move together without a change of any output.

    Parameters
    ----------
    information : (r, n) rows modulo p over the parameters, initial states eliminated.
    names : n names of parameters.

    Returns
    -------
    groups in the order of their first member, each in the order of `names`.
    """
    return tuple(
        tuple(names[j] for j in columns) for columns, _ in _components(information, names, p)
    )


def fixing_sets(
    information: Array, names: Sequence[str], p: int, *, limit: int = 10_000
) -> FixingSets:
    """All minimal sets of parameters to know, so that all others become identifiable.

    Parameters
    ----------
    information : (r, n) rows modulo p over the parameters, initial states eliminated.
    names : n names of parameters.
    limit : at most so many sets are listed, and counted within each confounded group. The total is
        the product over the groups, hence exact also where the list is cut, unless a single group
        has more.
    """
    parts = _components(information, names, p)
    counts = [sum(1 for _ in islice(bases(basis), limit + 1)) for _, basis in parts]
    count = math.prod(counts)
    listed = tuple(islice(_fixing_sets(parts, names), limit))
    return FixingSets(
        sets=listed,
        size=sum(basis.shape[0] for _, basis in parts),
        count=count,
        is_count_exact=all(c <= limit for c in counts),
        is_cut=count > len(listed),
        groups=tuple(tuple(names[j] for j in columns) for columns, _ in parts),
        group_sizes=tuple(basis.shape[0] for _, basis in parts),
        group_counts=tuple(counts),
    )


def joined(full: Sequence[Array], n_states: Sequence[int], p: int) -> tuple[Array, int]:
    """The rows of several experiments as one matrix over [all initial states | parameters].

    Parameters
    ----------
    full : by experiment, (r_i, n_states[i] + n) rows over [its initial states | parameters].

    Returns
    -------
    (sum of r_i, sum of n_states + n) rows, each experiment with its own states; the number of
    states.
    """
    total, done, rows = sum(n_states), 0, []
    for matrix, n in zip(full, n_states, strict=True):
        row = np.zeros((matrix.shape[0], total + matrix.shape[1] - n), dtype=np.int64)
        row[:, done : done + n] = matrix[:, :n]
        row[:, total:] = matrix[:, n:]
        rows.append(row)
        done += n
    return np.vstack(rows) % p, total


def count_not_identifiable(
    full: Array,
    n_states: int,
    names: Sequence[str],
    size: int,
    p: int,
    *,
    among: Sequence[str] | None = None,
    limit: int = 1_000_000,
) -> Exclusion:
    """Every subset of a size, and which are not identifiable although all others are known.

    The criterion is rank O[:, x U S] = n + len(S), with the columns of the known parameters left
    out (thesis, section 8.3). The initial states are eliminated once, then subsets are extended
    member by member, one pivot each.

    Parameters
    ----------
    full : (r, n_states + n) rows modulo p over [initial states | parameters].
    among : the parameters the subsets are taken from (all).
    limit : most subsets that are examined.

    Raises
    ------
    IdentifiabilityError
        If `among` names no parameter, or there are more subsets than `limit`.
    """
    chosen = _positions(names if among is None else among, names)
    total = math.comb(len(chosen), size)
    if total > limit:
        raise IdentifiabilityError(
            f"there are {total} subsets of {size} among {len(chosen)} parameters, more than "
            f"{limit}; use fixing_sets, narrow them with among, or raise limit"
        )
    labels = [names[j] for j in chosen]
    reduced, pivots = echelon(full[:, [*range(n_states), *(n_states + j for j in chosen)]], p)
    observable = sum(q < n_states for q in pivots)
    if observable < n_states:  # a state is unobservable whatever is known
        failing = list(combinations(range(len(chosen)), size))
    else:
        failing = list(dependent(reduced[observable:, n_states:], size, p))
    return Exclusion(size, total, tuple(tuple(labels[j] for j in s) for s in failing))


def _positions(subset: Sequence[str], names: Sequence[str]) -> list[int]:
    where = {n: j for j, n in enumerate(names)}
    for n in subset:
        if n not in where:
            raise IdentifiabilityError(f"there is no parameter {n!r}{nearest(n, names)}")
    return sorted(where[n] for n in set(subset))


def _components(information: Array, names: Sequence[str], p: int) -> list[tuple[list[int], Basis]]:
    """Columns and null basis of every confounded group."""
    if information.ndim != 2 or information.shape[1] != len(names):
        raise IdentifiabilityError(
            f"an information matrix of shape {information.shape} does not fit {len(names)} names; "
            "give one column for each parameter"
        )
    return components(null_space(information, p), p)


def _fixing_sets(
    parts: Sequence[tuple[list[int], Basis]], names: Sequence[str]
) -> Iterator[tuple[str, ...]]:
    """One basis of every component, all combinations, lazily."""

    def choices(k: int) -> Iterator[tuple[int, ...]]:
        """Choices of columns from component `k` on, one basis of each."""
        if k == len(parts):
            yield ()
            return
        columns, basis = parts[k]
        for chosen in bases(basis):
            here = [columns[j] for j in chosen]
            for rest in choices(k + 1):
                yield (*here, *rest)

    for chosen in choices(0):
        yield tuple(names[j] for j in sorted(chosen))
