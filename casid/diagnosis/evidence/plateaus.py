"""Clipping: samples of a channel that lie exactly at its limit while the motion goes beyond it.

Values of a continuous channel hardly ever repeat. Many equal ones at the very top are a limit of
the sensor or logger, unless the system itself rests there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import poisson
from scipy.stats import t as student

from casid.arrays import TINY, Array
from casid.diagnosis.thresholds import CLIPPING


@dataclass(frozen=True, slots=True, eq=False)
class Plateaus:
    """Samples of one channel that its limits have cut off."""

    channel: str
    masks: tuple[Array, ...]  # a record (N,) bool
    lower: float | None  # limits in the channel's unit, None where that end is free
    upper: float | None
    count: int
    energy: float  # sum of squares of what the limits cut off, as the simulation has it
    p_value: float

    @property
    def limit(self) -> float:
        """The limit that cut off most, or the only one."""
        return float(max(abs(x) for x in (self.lower, self.upper) if x is not None))


def find_plateaus(
    channel: str,
    measured: Sequence[Array],
    simulated: Sequence[Array],
    used: Sequence[Array],
    alpha: float,
) -> Plateaus | None:
    """Plateaus at the ends of a channel's range, where the simulation goes beyond them.

    Ties at the end are compared with those of the values next to it (Poisson): a coarse converter
    repeats all of them. What rests at the end of its travel repeats as well, so one of
    two more must hold. The simulation lies beyond the limit on those samples, by more than its
    error elsewhere explains (a t-test), and moves there. Or the channel runs into the limit and out
    of it at half its usual speed or more, where a motion that comes to rest slows down.

    Parameters
    ----------
    measured, simulated : (N,) a record, channel's unit. used : (N,) bool.
    alpha : of both tests.
    """
    values = np.concatenate([y[u] for y, u in zip(measured, used, strict=True)])
    if len(values) < CLIPPING.samples_per_plateau * CLIPPING.fewest or np.ptp(values) == 0.0:
        return None
    ends: dict[float, float | None] = {1.0: None, -1.0: None}
    smallest = 1.0
    masks = [np.zeros(len(y), dtype=bool) for y in measured]
    energy = 0.0
    for side in ends:
        level = float(np.max(side * values))
        at = [u & (side * y >= level) for y, u in zip(measured, used, strict=True)]
        p = 1.0 if _stands_apart(measured, used, at) else max(_ties(side * values), TINY)
        beyond = np.concatenate([side * y[m] - level for y, m in zip(simulated, at, strict=True)])
        if p >= alpha or not np.all(np.isfinite(beyond)):
            continue
        elsewhere = np.concatenate(
            [(y - s)[u & ~m] for y, s, u, m in zip(measured, simulated, used, at, strict=True)]
        )
        size = float(1.4826 * np.median(np.abs(elsewhere - np.median(elsewhere))))
        mean, spread = float(beyond.mean()), float(beyond.std(ddof=1))
        error = np.hypot(spread, size) / np.sqrt(len(beyond))
        is_beyond = float(student.sf(mean / max(error, TINY), len(beyond) - 1)) < alpha
        is_beyond = (
            is_beyond and mean >= CLIPPING.beyond * size and spread >= CLIPPING.motion * mean
        )
        if not (is_beyond or _runs_in(measured, at)):
            continue
        ends[side] = side * level
        smallest = min(smallest, p)
        energy += float(np.sum(np.maximum(beyond, 0.0) ** 2))
        for mask, m in zip(masks, at, strict=True):
            mask |= m
    if smallest >= 1.0:
        return None
    return Plateaus(
        channel=channel,
        masks=tuple(masks),
        lower=ends[-1.0],
        upper=ends[1.0],
        count=int(sum(m.sum() for m in masks)),
        energy=energy,
        p_value=smallest,
    )


def _stands_apart(measured: Sequence[Array], used: Sequence[Array], at: Sequence[Array]) -> bool:
    """True of single samples that are further from the next ones than any others from theirs.

    A sensor's or logger's value for a fault: a motion that is cut off comes near the limit.
    """
    jumps, steps = [np.zeros(0)], [np.zeros(0)]
    for y, u, m in zip(measured, used, at, strict=True):
        values, is_at = y[u], m[u]
        if np.any(is_at[1:] & is_at[:-1]):
            return False
        step, is_edge = np.abs(np.diff(values)), is_at[1:] | is_at[:-1]
        jumps.append(step[is_edge])
        steps.append(step[~is_edge])
    jump, step = np.concatenate(jumps), np.concatenate(steps)
    least = CLIPPING.apart * float(np.max(step, initial=0.0))
    return bool(len(jump)) and float(jump.min()) > least


def _runs_in(measured: Sequence[Array], at: Sequence[Array]) -> bool:
    """True if the channel keeps its speed up to the plateau and takes it up behind."""
    steps, into, out_of = [], [], []
    for y, m in zip(measured, at, strict=True):
        step = np.abs(np.diff(y))
        steps.append(step[~(m[1:] & m[:-1])])
        into.append(step[m[1:] & ~m[:-1]])
        out_of.append(step[m[:-1] & ~m[1:]])
    usual = np.concatenate(steps)
    usual = usual[usual > 0.0]
    edges = [np.concatenate(x) for x in (into, out_of)]
    if not len(usual) or not all(len(x) for x in edges):
        return False
    # A body that hits its stop comes fast and leaves slowly: each side counts.
    return min(float(np.median(x)) for x in edges) >= CLIPPING.fast * float(np.median(usual))


def _ties(values: Array) -> float:
    """How likely chance repeats the largest value as often, from the values next to it."""
    distinct, counts = np.unique(values, return_counts=True)
    if counts[-1] < CLIPPING.fewest or len(distinct) < CLIPPING.beside // 2:
        return 1.0
    usual = float(np.mean(counts[-CLIPPING.beside - 1 : -1] - 1)) + CLIPPING.repeats
    return float(poisson.sf(counts[-1] - 2, usual))
