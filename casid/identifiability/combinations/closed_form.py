"""Families of equivalent parameters, from the rank at many points: null directions, interpolated.

The basis of the null space that is the identity on a minimal fixing set is a rational function of
parameters and constants: it is evaluated at random points and found by interpolation
(`null_direction`), then integrated where that is possible (`family`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.algebra.factoring import factored
from casid.algebra.prime_field import null_space
from casid.arrays import Array
from casid.errors import IdentifiabilityError, ModelError
from casid.identifiability.combinations.family import Family, family
from casid.identifiability.combinations.fixing_sets import FixingSets
from casid.identifiability.combinations.null_direction import (
    NullDirection,
    normalised,
    null_directions,
)
from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import RankEvaluation
from casid.time_limit import processor_clock


class OutOfTime(Exception):
    """The points that an interpolation needs take too long."""


def families(
    systems: Sequence[System],
    fixing: FixingSets,
    *,
    seed: int = 0,
    time_limit: float = 20.0,
) -> tuple[tuple[Family, ...], tuple[NullDirection, ...], str]:
    """How the parameters that are not identifiable move without a change of any output.

    Parameters
    ----------
    systems : experiments without unknown inputs; the formulas hold the names of their constants.
    fixing : minimal fixing sets of the same systems, at least one of them listed.
    time_limit : seconds of processor time, so that a busy machine finds the same; no family is
        found where it does not suffice for the points, and those not yet integrated then are left
        out. Sympy is not interrupted: what it may take long for is not tried (`family`).

    Returns
    -------
    families : integrated in closed form, in part at least.
    directions : one for each member of a fixing set.
    note : why something was not found, or empty.
    """
    if not fixing.size or not fixing.sets:
        return (), (), ""
    deadline = processor_clock() + time_limit

    def is_over() -> bool:
        return processor_clock() > deadline

    try:
        found = _directions(systems, fixing.sets[0], seed, is_over)
    except OutOfTime:
        return (), (), f"no closed form of the families was found in {time_limit:g} s of computing"
    except (IdentifiabilityError, ModelError, ZeroDivisionError) as error:
        return (), (), f"no closed form of the families was found: {error}"
    directions = tuple(_simplest(d, fixing) for d in found)
    made = []
    for d in directions:
        if is_over():
            break
        made.append(family(d, is_over))
    moving = {n for group in fixing.groups for n in group}
    lost = sorted({n for d in directions for n in d.not_found} & moving)
    notes = [f"no closed form was found for how {', '.join(lost)} move"] if lost else []
    late = [d.free for d in directions[len(made) :]]
    if late:
        notes.append(
            f"{time_limit:g} s of computing did not suffice for the family along {', '.join(late)}"
        )
    return tuple(made), directions, "; ".join(notes)


def _directions(
    systems: Sequence[System], free: Sequence[str], seed: int, is_over: Callable[[], bool]
) -> tuple[NullDirection, ...]:
    """The basis of the null space that is the identity on a fixing set, interpolated.

    Raises
    ------
    OutOfTime
        If `is_over` at one of the points.
    """
    evaluation = RankEvaluation(systems)
    names = evaluation.parameters
    columns = [names.index(n) for n in free]
    rng = np.random.default_rng(seed)

    def null_at(values: Mapping[str, int], p: int) -> Array:
        """The null basis at a point modulo p, normalised to the free columns."""
        if is_over():
            raise OutOfTime
        try:
            point = evaluation.at(p, rng, values=values)
        except ModelError as nowhere:  # a square root exists at every second point only
            raise ZeroDivisionError(str(nowhere)) from nowhere
        null = null_space(point.information, p)
        if len(null) != len(free):  # an unlucky point
            raise ZeroDivisionError("the rank is smaller at this point")
        return normalised(null, columns, p)

    special = {n for s in systems for n in s.at}
    variables = dict.fromkeys(n for s in systems for n in (*s.parameters, *s.constants))
    states = tuple(systems[0].states) if len(systems) == 1 else ()
    return null_directions(
        null_at,
        names,
        free,
        [*(n for n in variables if n not in special), *states],
        initial_states=states,
        seed=seed,
    )


@dataclass(frozen=True, slots=True)
class IdentifiableCombinations:
    """Combinations (sympy) of a confounded group that no family changes."""

    group: tuple[str, ...]
    combinations: tuple[Any, ...]
    is_complete: bool

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "group": list(self.group),
            "combinations": [str(c) for c in self.combinations],
            "complete": self.is_complete,
        }

    def __repr__(self) -> str:
        return (
            f"<IdentifiableCombinations of {', '.join(self.group)}: "
            f"{', '.join(map(str, self.combinations)) or 'none'}>"
        )


def identifiable_combinations(
    families: Sequence[Family], fixing: FixingSets
) -> tuple[IdentifiableCombinations, ...]:
    """Identifiable combinations of every confounded group whose families were found."""
    out = []
    for group, size in zip(fixing.groups, fixing.group_sizes, strict=True):
        inside = [f for f in families if f.free in group]
        if len(inside) == size:
            found, is_complete = joint_invariants(inside)
            moving = {n for g in fixing.groups if g != group for n in g}
            outside = [f for f in families if f.free not in group]
            kept = [k for k in (_unmoved(c, outside, moving) for c in found) if k is not None]
            is_complete = is_complete and len(kept) == len(found)
            out.append(IdentifiableCombinations(group, tuple(kept), is_complete))
    return tuple(out)


def _unmoved(combination: Any, outside: Sequence[Family], moving: Collection[str]) -> Any | None:
    """A group's combination as none of the other groups' families changes it, or None.

    Parameters of other groups may be its coefficients. Where these are scaled, and the combination
    with them by a factor, a power of theirs takes that factor out.
    """
    import sympy

    symbols = {s.name: s for s in combination.free_symbols if s.name in moving}
    touching = [f for f in outside if set(f.moved) & set(symbols)]
    if not set(symbols) <= {n for f in touching for n in f.moved}:
        return None  # a family that moves them was not found
    degrees = []
    for f in touching:
        if any(f.direction.entries[n] is None for n in symbols):
            return None
        rate = sum(
            (sympy.diff(combination, s) * f.direction.entries[n] for n, s in symbols.items()),
            sympy.Integer(0),
        )
        degrees.append(sympy.cancel(rate * sympy.Symbol(f.free) / combination))
    if all(k == 0 for k in degrees):
        return combination
    names = sorted({n for f in touching for n in f.moved})
    weights = [f.weights for f in touching]
    if any(w is None for w in weights) or not all(k.is_Rational for k in degrees):
        return None
    # A family's rate is per unit of its free parameter, whose own weight need not be one.
    rows = sympy.Matrix([[(w or {}).get(n, 0) for n in names] for w in weights])
    wanted = sympy.Matrix(
        [-k * (w or {})[f.free] for k, w, f in zip(degrees, weights, touching, strict=True)]
    )
    pivots = rows.rref()[1]
    if len(pivots) < len(touching):
        return None
    powers = rows[:, list(pivots)].LUsolve(wanted)
    factor = sympy.Mul(*(sympy.Symbol(names[j]) ** k for j, k in zip(pivots, powers, strict=True)))
    return factored(combination * factor)


def joint_invariants(families: Sequence[Family]) -> tuple[tuple[Any, ...], bool]:
    """What no family of a confounded group changes: its identifiable combinations.

    Where parameters move along several curves, an invariant of one of them may move along another.

    Parameters
    ----------
    families : all those of one group, at least one.

    Returns
    -------
    invariants : sympy expressions, independent of each other.
    is_complete : they and the unchanged parameters are all that is identifiable.
    """
    import sympy

    if len(families) == 1:
        return families[0].invariants, families[0].is_closed
    names = list(dict.fromkeys(n for f in families for n in f.moved))
    symbols = [sympy.Symbol(n) for n in names]
    rows = [[_sympified(f.direction.entries[n]) for n in names] for f in families]
    weights = [f.weights for f in families]
    if all(w is not None for w in weights):  # scalings leave monomials
        exponents = [[(w or {}).get(n, 0) for n in names] for w in weights]
        return tuple(
            sympy.Mul(*(s**k for s, k in zip(symbols, v, strict=True)))
            for v in _integer_null_space(exponents)
        ), True
    if all(v is not None and v.is_Rational for row in rows for v in row):
        return tuple(
            sympy.Add(*(k * s for s, k in zip(symbols, v, strict=True)))
            for v in _integer_null_space(rows)
        ), True
    if any(v is None for row in rows for v in row):
        return (), False

    found = list(dict.fromkeys(i for f in families for i in f.invariants))
    occurring = {s for e in (*found, *(v for row in rows for v in row)) for s in e.free_symbols}
    occurring |= set(symbols)
    at = {s: sympy.Rational(k, 97) for k, s in enumerate(sorted(occurring, key=str), 101)}

    def is_invariant(i: Any, row: Sequence[Any]) -> bool:
        """At one point without special values, exactly where it is rational."""
        speed = sum(sympy.diff(i, s) * v for s, v in zip(symbols, row, strict=True))
        value = sympy.sympify(speed).xreplace(at)
        return bool(value == 0 if value.is_Rational else abs(value.evalf(30)) < 1e-15)

    kept = [i for i in found if all(is_invariant(i, row) for row in rows)]
    slopes = sympy.Matrix([[sympy.diff(i, s) for s in symbols] for i in kept])
    independent = slopes.subs(at).T.rref()[1] if kept else ()
    return tuple(kept[i] for i in independent), len(independent) == len(names) - len(families)


def _sympified(entry: Any) -> Any:
    import sympy

    return None if entry is None else sympy.sympify(entry)


def _integer_null_space(rows: Sequence[Sequence[Any]]) -> list[list[int]]:
    """A basis of what is orthogonal to the rows, in integers without a common factor."""
    import sympy

    basis = []
    for vector in sympy.Matrix(rows).nullspace():
        common = math.lcm(*(int(v.q) for v in vector))
        whole = [int(v * common) for v in vector]
        sign = 1 if sum(v > 0 for v in whole) >= sum(v < 0 for v in whole) else -1
        basis.append([sign * v // math.gcd(*whole) for v in whole])
    return basis


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
