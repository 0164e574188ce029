"""Identifiability at a point: the rank of the sensitivities, and what is not identifiable.

A direction along which no output changes is described relative to the parameters' values, with
the power products that stay constant along it: what the record determines instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from casid.arrays import TINY, Array, require_finite
from casid.estimation.unknowns import Variable


@dataclass(frozen=True, slots=True, eq=False)
class LocalRank:
    """Rank of the scaled sensitivities at a point, and the directions that are not determined."""

    rank: int
    unknowns: int
    smallest: float  # smallest singular value of the columns scaled to length one
    null: tuple[Mapping[str, float], ...]  # relative directions, largest entry 1

    @property
    def is_full(self) -> bool:
        """True if every direction is identifiable."""
        return self.rank == self.unknowns


def local_rank(hessian: Array, x: Array, names: Sequence[str], scale: Array) -> LocalRank:
    """Rank of J from J'J with columns of unit length; directions relative to the values."""
    require_finite("the sensitivities", hessian)
    length = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    largest = float(np.max(length * scale, initial=0.0))
    seen = length * scale > 1e-9 * max(largest, TINY)
    null: list[Mapping[str, float]] = [{names[i]: 1.0} for i in np.flatnonzero(~seen).tolist()]
    index = np.flatnonzero(seen)
    smallest = 0.0
    if index.size:
        # One after the other: the product of two lengths may overflow.
        unit = hessian[np.ix_(index, index)] / length[index] / length[index][:, None]
        values, vectors = np.linalg.eigh(unit)
        smallest = float(np.sqrt(max(values[0], 0.0))) if not null else 0.0
        for value, vector in zip(values, vectors.T, strict=True):
            if value < 1e-11 * index.size:
                size = np.where(np.abs(x[index]) > 0, np.abs(x[index]), scale[index])
                step = vector / length[index] / size * np.sign(np.where(x[index] == 0, 1, x[index]))
                step = step / step[np.argmax(np.abs(step))]
                null.append(
                    {
                        names[i]: float(s)
                        for i, s in zip(index.tolist(), step, strict=True)
                        if abs(s) > 1e-3
                    }
                )
    return LocalRank(len(x) - len(null), len(x), smallest, tuple(null))


def rank_of(variables: Sequence[Variable], hessian: Array, x: Array) -> LocalRank:
    """`local_rank` of the unknowns; one that its bounds fix is known, as a switched-on blend is."""
    free = [i for i, v in enumerate(variables) if v.lower < v.upper]
    names, scale = [variables[i].name for i in free], [variables[i].scale for i in free]
    return local_rank(hessian[np.ix_(free, free)], x[free], names, np.array(scale))


_DESCRIBED, _NAMED = 6, 12  # directions in a message, and unknowns in a direction, at most

_EXPONENT = 4  # numerator and denominator of an exponent, at most: a law of physics has no 283/4


def describe_null(rank: LocalRank) -> str:
    """Sentences on what is not identifiable, what is determined instead, and the remedy."""
    parts = []
    for direction in rank.null[:_DESCRIBED]:
        names = list(direction)
        if len(names) == 1:
            parts.append(
                f"{names[0]} does not move any output in this record: give it a known value, or "
                "record an experiment that excites it"
            )
            continue
        if len(names) > _NAMED:
            parts.append(
                f"{', '.join(names[:_NAMED])} and {len(names) - _NAMED} others are not separately "
                "identifiable: give one of them a known value"
            )
            continue
        together = ", ".join(f"{n} {100 * v:+.3g} %" for n, v in direction.items())
        combos = _invariants(direction)
        instead = f"; the record determines {', '.join(combos)} instead" if combos else ""
        parts.append(
            f"{' and '.join(names)} are not separately identifiable ({together} changes nothing)"
            f"{instead}: give one of them a known value"
        )
    more = len(rank.null) - _DESCRIBED
    rest = [f"and {more} more directions are not determined"] if more > 0 else []
    return "; ".join([*dict.fromkeys(parts), *rest])


def _invariants(direction: Mapping[str, float]) -> list[str]:
    """Power products that stay constant along a relative direction, with small exponents."""
    items = list(direction.items())
    base, b = items[0]
    out = []
    for name, v in items[1:]:
        q = Fraction(b / v).limit_denominator(_EXPONENT)
        is_small = 0 < abs(q) <= _EXPONENT and abs(q.numerator) <= _EXPONENT
        if not is_small or abs(float(q) - b / v) > 1e-3 * abs(b / v):
            return []
        sign = "/" if q > 0 else " "
        power = "" if abs(q) == 1 else f"^({abs(q)})"
        out.append(f"{base}{sign}{name}{power}")
    return out
