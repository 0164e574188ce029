"""The shortest record that decides: a sequence of designs, each begun at the one before.

Information grows about in proportion to the length of a record, so that the length sought follows
from that of one design, and a few more enclose it (regula falsi in the logarithms).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, isfinite, log
from typing import Protocol, TypeVar

import numpy as np

from casid.errors import CasidError, DataError
from casid.experiment_design.aim import Aim
from casid.experiment_design.designed_experiment import energy_for_detection, energy_for_name
from casid.experiment_design.search import Found
from casid.experiment_design.thresholds import DESIGN, DURATION

Duration = float | Sequence[float]
"""Of the record [s], or the shortest and the longest that it may be."""


class HasBest(Protocol):
    """What a design at one duration found."""

    @property
    def best(self) -> Found:
        """The best input found."""
        ...


@dataclass(frozen=True, slots=True)
class Tried:
    """A duration [s] at which a design was made, and by what factor its information was enough."""

    duration: float
    share: float


def ends_of(duration: Duration) -> tuple[float, float]:
    """Shortest and longest duration [s]; the same where there is nothing to choose.

    Raises
    ------
    DataError
        If there are not one or two, positive and in order.
    """
    given = np.atleast_1d(np.asarray(duration, dtype=float))
    if given.size not in (1, 2) or not np.all(np.isfinite(given)) or np.any(given <= 0):
        shown = ", ".join(f"{v:g}" for v in given.tolist())
        raise DataError(
            f"a duration of {shown} s: give a positive number of seconds, or the shortest and the "
            "longest (--duration 5:60)"
        )
    low, high = float(given[0]), float(given[-1])
    if low > high or (given.size > 1 and low == high):
        raise DataError(
            f"a duration from {low:g} to {high:g} s: the shortest has to lie below the longest"
        )
    return low, high


def required_score(aim: Aim) -> float:
    """The score (see `information`) at which an aim is reached.

    Raises
    ------
    DataError
        For an estimate, which is only the better the longer the record.
    """
    if aim.kind == "separate":
        return log(energy_for_name(DESIGN.power))
    if aim.kind == "detect":
        return log(energy_for_detection(DESIGN.power, aim.false_alarm_rate))
    if aim.kind == "identifiable":
        return -2 * log(aim.relative_error)
    raise DataError(
        f"the shortest record to {aim}: an estimate is never exact enough by itself. Say how exact "
        "it has to be, Aim.identifiable(relative_error=0.05) (--identifiable --relative-error "
        "0.05), or give one duration"
    )


A = TypeVar("A", bound=HasBest)


def shortest(
    design: Callable[[float, A | None], A],
    ends: tuple[float, float],
    score: float,
    progress: Callable[[str], None],
) -> tuple[A, tuple[Tried, ...]]:
    """The design of the shortest duration that reaches a score, and what was tried.

    The longest where none does. `design` takes a duration and what it may begin from.
    """
    low, high = ends
    best = design(high, None)
    over = best.best.least - score
    tried = [Tried(high, exp(over))]
    under, was_enough = -np.inf, True  # of `low`, once it was tried
    while over >= 0 and high / low > 1 + DURATION.exact and len(tried) < DURATION.designs:
        length = _between(low, high, under, over)
        progress(f"design for {length:.4g} s")
        try:
            found: A | None = design(length, best)
        except CasidError:  # no input does it in so short a record
            found = None
        now = -np.inf if found is None else found.best.least - score
        tried.append(Tried(length, exp(now)))
        is_enough = found is not None and now >= 0
        if found is not None and is_enough:
            best, high, over = found, length, now
            if length <= ends[0]:
                break
        else:
            low, under = length, now
        # Illinois: an end that stays twice counts half, so that both ends close in.
        if is_enough == was_enough:
            over, under = (over, 0.5 * under) if is_enough else (0.5 * over, under)
        was_enough = is_enough
    return best, tuple(sorted(tried, key=lambda t: t.duration))


def _between(low: float, high: float, under: float, over: float) -> float:
    """The next duration: where the score is expected to be met, inside what is enclosed."""
    if isfinite(under):
        share = over / (over - under)
        inner = min(max(share, DURATION.inside), 1 - DURATION.inside)
        return float(high * (low / high) ** inner)
    # Proportional to the length, or faster: a little longer than that.
    return float(
        min(max(low, high * exp(-over) * (1 + DURATION.exact)), high / (1 + DURATION.exact))
    )
