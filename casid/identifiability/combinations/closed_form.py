"""Families of equivalent parameters, from the rank at many points: null directions, interpolated.

The basis of the null space that is the identity on a minimal fixing set is a rational function of
parameters and constants: it is evaluated at random points and found by interpolation
(`null_direction`), then integrated where that is possible (`family`).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from casid.errors import IdentifiabilityError
from casid.identifiability.combinations.family import Family, family
from casid.identifiability.combinations.null_direction import (
    NullDirection,
    normalised,
    null_directions,
)
from casid.identifiability.combinations.subsets import FixingSets
from casid.identifiability.rank.observability import Search
from casid.identifiability.rank.prime_field import null_space
from casid.identifiability.rank.system import System

Array = np.ndarray[Any, Any]


class OutOfTime(Exception):
    """The points that an interpolation needs take too long."""


def families(
    systems: Sequence[System],
    fixing: FixingSets,
    *,
    seed: int = 0,
    time_limit: float = 20.0,
) -> tuple[tuple[Family, ...], tuple[NullDirection, ...], str]:
    """How the parameters that are not identifiable move together unseen.

    Parameters
    ----------
    systems : experiments without unknown inputs; the names of their constants stand in the
        formulas.
    fixing : minimal fixing sets of the same systems, at least one of them listed.
    time_limit : seconds for the points; None are found where it does not suffice.

    Returns
    -------
    families : integrated in closed form, in part at least.
    directions : one for each member of a fixing set.
    note : why something was not found, or empty.
    """
    if not fixing.size or not fixing.sets:
        return (), (), ""
    search = Search(systems)
    free = fixing.sets[0]
    names = search.parameters
    columns = [names.index(n) for n in free]
    moving = {n for group in fixing.groups for n in group}
    rng = np.random.default_rng(seed)
    deadline = time.monotonic() + time_limit

    def null_at(values: Mapping[str, int], p: int) -> Array:
        if time.monotonic() > deadline:
            raise OutOfTime
        point = search.at(p, rng, values=values)
        null = null_space(point.information, p)
        if len(null) != len(free):  # an unlucky point
            raise ZeroDivisionError("the rank is smaller at this point")
        return normalised(null, columns, p)

    special = {n for s in systems for n in s.at}
    variables = [
        n
        for n in dict.fromkeys(n for s in systems for n in (*s.parameters, *s.constants))
        if n not in special
    ]
    states = tuple(search.systems[0].states) if len(search.systems) == 1 else ()
    try:
        found = null_directions(
            null_at, names, free, [*variables, *states], initial_states=states, seed=seed
        )
    except OutOfTime:
        return (), (), f"no closed form of the families was found within {time_limit:g} s"
    except (IdentifiabilityError, ZeroDivisionError) as error:
        return (), (), f"no closed form of the families was found: {error}"
    directions = tuple(_simplest(d, fixing) for d in found)
    made = tuple(family(d) for d in directions)
    lost = sorted({n for d in directions for n in d.not_found} & moving)
    note = f"no closed form was found for how {', '.join(lost)} move" if lost else ""
    return made, directions, note


def _simplest(direction: NullDirection, fixing: FixingSets) -> NullDirection:
    """The direction normalised to the parameter that makes it shortest, where there is a choice."""
    group, size = next(
        (g, k)
        for g, k in zip(fixing.groups, fixing.group_sizes, strict=True)
        if direction.free in g
    )
    if size > 1 or direction.not_found:
        return direction
    choices = [direction.following(n) for n in group if n in direction.moved]
    return min(choices, key=_length)


def _length(direction: NullDirection) -> int:
    return sum(v.count_ops() for v in direction.entries.values() if v is not None)
