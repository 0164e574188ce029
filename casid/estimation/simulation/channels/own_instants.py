"""Simulated outputs at the instants at which their samples were taken.

A record with an irregular clock lies on an even one, on which a sample stands up to half a step
from its own instant. The simulated output there is taken from the straight line between the two
instants of the clock: the error is at most Ts^2/8 times its curvature, where that of the nearest
instant is up to Ts/2 times its slope. A held input that steps between the two, as at a dose, bends
the output there: before the step the line of the interval before is continued, behind it that of
the one after.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.data.record import Record
from casid.estimation.simulation.channels.sensor_dynamics import Before

ROUNDING = 1e-6
"""Samples by which the same stamp may differ as one of a step and one of an output."""


@dataclass(frozen=True, slots=True, eq=False)
class Instants:
    """Where between the instants of its clock a record was taken, in samples."""

    late: Array  # (N, ny) how much after its instant each output was taken, at most half either way
    bend: Array  # (N,) how much after an instant a held input stepped before the next, NaN: none


def own_instants(record: Record, outputs: Sequence[str], held: Sequence[str]) -> Instants | None:
    """Instants of a record's outputs and held inputs; None where all are those of the clock."""
    if not any(name in record.late for name in outputs):
        return None
    none, bend = np.zeros(record.N), np.full(record.N, np.nan)
    for name in [n for n in held if n in record.late]:
        late = lateness_of_steps(record, name) / record.Ts
        rows = np.flatnonzero(late)
        bend[np.where(late[rows] > 0, rows, rows - 1)] = late[rows] % 1.0
    late = np.column_stack([record.late.get(name, none) for name in outputs]) / record.Ts
    return Instants(late, bend)


def lateness_of_steps(record: Record, name: str) -> Array:
    """(N,) by how much after its instant a held input stepped [s], zero where it did not step."""
    there = np.flatnonzero(~record.is_missing(name))
    rows = there[1:][np.diff(record[name][there]) != 0]
    late = np.zeros(record.N)
    late[rows] = record.late[name][rows]
    return late


def at_own_instants(
    y: Array, jac: Array | None, at: Instants | None, steps: Mapping[int, Before], cuts: Array
) -> None:
    """Move simulated outputs to the instants of their samples, in place.

    Parameters
    ----------
    y : (N, ny) simulated at the instants of the clock.
    jac : (N, ny, n) sensitivities there, None where not requested.
    at : where they were taken; None leaves all where they are.
    steps : of outputs that step with a held input, what they were before each step.
    cuts : (parts + 1,) where parts that are simulated apart begin, and N.
    """
    if at is None:
        return
    for c in range(y.shape[1]):
        rows = np.flatnonzero(at.late[:, c])
        part = np.searchsorted(cuts, rows, side="right") - 1
        first, last = np.asarray(cuts)[part], np.asarray(cuts)[part + 1] - 1
        rows, first, last = (of[last > first] for of in (rows, first, last))
        place = rows + at.late[rows, c]
        begin = np.clip(np.where(place > rows, rows, rows - 1), first, last - 1)
        before = steps.get(c)
        if before is None:
            begin = _off_bends(begin, place, at.bend, first, last)
        sides = _sides_of_bends(begin, place, at.bend, first)
        moved = _on_lines(y[:, c], None if before is None else before.y, begin, place, sides)
        if jac is not None:
            ends = None if before is None else before.jac
            jac[rows, c] = _on_lines(jac[:, c], ends, begin, place, sides)
        y[rows, c] = moved


def _on_lines(
    at: Array, ends: Array | None, begin: Array, place: Array, sides: tuple[Array, Array]
) -> Array:
    """Columns (N, ...) at places (M,), on the straight lines of the intervals that begin (M,).

    Parameters
    ----------
    ends : (N, ...) of an output that steps, what it was at the end of each sample; None for others.
    sides : as of `_sides_of_bends`.
    """
    share = (place - begin).reshape(-1, *[1] * (at.ndim - 1))
    if ends is None:
        return np.asarray(at[begin] + share * (at[begin + 1] - at[begin]))
    moved = at[begin] + share * (ends[begin] - at[begin])
    is_before, is_behind = sides
    k = begin[is_before]
    moved[is_before] -= at[k] - ends[k - 1]
    k = begin[is_behind]
    moved[is_behind] += at[k + 1] - ends[k]
    return np.asarray(moved)


def _sides_of_bends(begin: Array, place: Array, bend: Array, first: Array) -> tuple[Array, Array]:
    """Which places (M,) lie before a held input's step in their interval, and which behind it.

    A place at the step is behind it: a held input acts from its sample on. Neither, where the
    neighbour on that side has a step of its own, or belongs to another part. A place behind the
    last sample has no interval of its own: there the step is that of this sample.
    """
    share, step = place - begin, bend[begin]
    is_before = (share < step - ROUNDING) & (begin > first) & np.isnan(bend[begin - 1])
    is_behind = (share >= step - ROUNDING) & np.isnan(bend[begin + 1])
    is_at_end = (share > 1.0) & (share - 1.0 >= bend[begin + 1] - ROUNDING)
    return is_before, is_behind | is_at_end


def _off_bends(begin: Array, place: Array, bend: Array, first: Array, last: Array) -> Array:
    """First samples (M,) of the intervals whose straight lines are taken at the places (M,).

    Where the output bends inside an interval, the line of the neighbour on the same side of the
    bend is taken, if that one is within the part and has no bend.
    """
    is_before = place - begin <= bend[begin]  # False where there is no bend
    is_behind = place - begin > bend[begin]
    beside = begin - is_before + is_behind
    is_there = (beside >= first) & (beside < last)
    beside = np.where(is_there, beside, begin)
    return np.asarray(np.where(np.isnan(bend[beside]), beside, begin))
