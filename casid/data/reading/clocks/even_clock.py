"""Whether a record's clock runs evenly."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from casid.arrays import BoolArray, FloatArray
from casid.data.reading.faults import Fault, Survey
from casid.model.quantities import count_text, window_text

if TYPE_CHECKING:
    import pandas as pd

UNIFORM = 0.01  # every interval within 1 % of the median
RARE = 0.01  # of all intervals: as many may be less even, each stamp within
OFF_GRID = 0.1  # of the median off the even grid: the error is that of so small a delay
GAP = 1.5  # an interval longer than this many medians is a gap


def jitter_text(times: FloatArray) -> str | None:
    """What is uneven in stamps (N,) [s] that are even enough, or empty; None if they are not.

    Every interval is within 1 % of the median, or a few are not and all stamps lie next to an even
    grid: its step is then the mean interval.
    """
    intervals = np.diff(times)
    median = float(np.median(intervals))
    off = np.abs(intervals - median) > UNIFORM * abs(median) * (1 + 1e-9)
    if not off.any():
        return ""
    away = float(np.abs(times - np.linspace(times[0], times[-1], times.size)).max())
    if off.mean() > RARE or away > OFF_GRID * median or not (intervals > 0).all():
        return None
    worst = float(np.abs(intervals - median).max()) / median
    return (
        f"{off.sum()} of {off.size} intervals are up to {100 * worst:.2g} % off the median of "
        f"{median:.6g} s, stamps up to {away / median:.2g} samples off an even clock: read as even"
    )


def even_step(times: FloatArray) -> float:
    """The mean interval [s] of stamps (N,), in the digits that they determine.

    It is the shortest decimal that leaves the last stamp within half of the last digit that the
    clock shows: floating-point noise of a difference is no sample time.
    """
    step = float(times[-1] - times[0]) / (times.size - 1)
    slack = 0.5 * _last_digit(times) / (times.size - 1)
    shorter = (float(f"{step:.{digits}e}") for digits in range(17))
    return next((s for s in shorter if 0 < s and abs(s - step) <= slack), step)


def _last_digit(times: FloatArray) -> float:
    """The decimal place [s] of stamps, at most a second: 0.001 for milliseconds."""
    noise = float(np.spacing(np.abs(times).max()))
    places = range(max(0, math.ceil(-math.log10(noise))))
    shown = (k for k in places if np.abs(times - np.round(times, k)).max() <= 2 * noise)
    return next((10.0**-k for k in shown), noise)


def time_faults(
    times: FloatArray, name: str, place: Callable[[int], str] = lambda k: f"k = {k}"
) -> list[Fault]:
    """Judge time stamps: doubled or backward ones, gaps, irregular intervals.

    Parameters
    ----------
    times : (N,) array [s], finite
    name : str
        The record's name, for the messages.
    place : function of k
        The place of sample k in the file, as text.

    Returns
    -------
    list of Fault, empty where the clock is even but for the jitter of `jitter_text`
    """
    intervals = np.diff(times)
    backward = np.flatnonzero(intervals < 0)
    doubled = np.flatnonzero(intervals == 0)
    faults = []
    if doubled.size or backward.size:
        first = int(min([*doubled[:1], *backward[:1]])) + 1
        coarse = None if backward.size else _coarse_clock(times)
        text = (
            f"{name}: {_disorder(doubled.size, backward.size)}, first at {place(first)} "
            f"(t = {times[first]:.9g} s after {times[first - 1]:.9g} s)"
        )
        remedy = "Sort the file and drop doubled rows, or cut it where the clock was reset."
        if coarse is not None:
            text += f": {coarse.text}"
            remedy = (
                f"--sample-time {coarse.step:.6g} (Ts={coarse.step:.6g}) reads rows that were "
                "recorded evenly, as the counts say; or export the time with more digits."
            )
        faults.append(Fault("order", f"{text}.", remedy))
        return faults
    median = float(np.median(intervals))
    off = np.abs(intervals - median) > UNIFORM * median * (1 + 1e-9)
    if jitter_text(times) is not None:
        return faults
    gaps = np.flatnonzero(intervals > GAP * median)
    if gaps.size:
        faults.append(_gap_fault(times, gaps, median, name, place))
    rest = off & ~(intervals > GAP * median)
    if rest.any():
        faults.append(
            Fault(
                "irregular",
                f"{name}: sampling is irregular: intervals min {intervals.min():.6g}, median "
                f"{median:.6g}, max {intervals.max():.6g} s; {100 * off.mean():.3g} % of them "
                f"outside 1 % of the median, the first after t = {times[np.argmax(off)]:.6g} s.",
                f"Resample with read_record(..., resample={median:.6g}) or --resample "
                f"{median:.6g}; nothing is resampled unasked.",
            )
        )
    return faults


class _CoarseClock(NamedTuple):
    """A clock whose stamps several rows in a row share, as many each time.

    Attributes
    ----------
    text : what it lacks, in words.
    step : sample time that the counts give [s].
    """

    text: str
    step: float


def _coarse_clock(times: FloatArray) -> _CoarseClock | None:
    """Stamps that run forward evenly, each shared by the same number of rows, or by one more."""
    starts = np.flatnonzero(np.diff(times) > 0) + 1  # of every stamp but the first
    counts, ticks = np.diff(starts), np.diff(times[starts])
    if counts.size < 2 or counts.min() < 2 or np.ptp(counts) > 1:
        return None
    if max(starts[0], times.size - starts[-1]) > counts.max():
        return None
    tick = float(np.median(ticks))
    if (np.abs(ticks - tick) > UNIFORM * tick).any():
        return None
    lack = "no fractions of a second" if tick == 1 else "too few digits"
    shared = " to ".join(str(n) for n in sorted({int(counts.min()), int(counts.max())}))
    text = f"the clock has {lack}, {shared} rows share each of its stamps, {tick:.6g} s apart"
    return _CoarseClock(text, tick * counts.size / int(counts.sum()))


def _disorder(doubled: int, backward: int) -> str:
    """Stamps that stand still, or run backward, in words."""
    parts = [f"time stands still {_times(doubled)} (duplicate stamps)"] if doubled else []
    if backward:
        parts.append(f"{'' if doubled else 'time '}runs backward {_times(backward)}")
    return " and ".join(parts)


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def repeated_rows(frame: pd.DataFrame, times: FloatArray) -> BoolArray | None:
    """Rows (N,) that hold the row before once more, stamp and all: they say nothing new.

    None where there are none, or where other rows share a stamp without being the same: which of
    those counts is not in the file.
    """
    doubled = np.concatenate(([False], np.diff(times) == 0))
    if not doubled.any():
        return None
    again = frame.duplicated().to_numpy() & doubled
    return again if np.array_equal(again, doubled) else None


def _gap_fault(
    times: FloatArray,
    gaps: NDArray[np.intp],
    median: float,
    name: str,
    place: Callable[[int], str],
) -> Fault:
    """The fault of intervals `gaps`, the first three shown, and the longest stretch without one."""
    shown = "; ".join(
        f"{times[k + 1] - times[k]:.4g} s from t = {times[k]:.6g} s ({place(int(k))})"
        for k in gaps[:3]
    )
    edges = [0, *(int(k) + 1 for k in gaps), times.size]
    longest = int(np.argmax(np.diff(edges)))
    a, b = edges[longest], edges[longest + 1] - 1
    return Fault(
        "gap",
        f"{name}: {count_text(gaps.size, 'gap')} longer than {GAP:g} times "
        f"the median interval of {median:.6g} s: {shown}{' ...' if gaps.size > 3 else ''}.",
        f"Take the longest stretch with the window {times[a]:.6g}:{times[b]:.6g}, or "
        f"resample with resample={median:.6g} (--resample {median:.6g}), which marks the "
        "gaps missing; in Python mark_missing=True takes every sample at its own instant.",
    )


def window_rows(
    name: str, times: FloatArray, window: tuple[float, float], found: Survey
) -> NDArray[np.intp] | None:
    """Samples inside a window [s]; None, with a fault noted, where it cannot be had."""
    start, stop = window
    low, high = float(times.min()), float(times.max())
    slack = (high - low) / max(times.size - 1, 1)
    counted = f", counted {found.counted}" if found.counted else ""
    span = f"{name} runs from {low:.9g} to {high:.9g} s of its own clock{counted}"
    label = f"window {window_text(start, stop)} s"
    problem = remedy = ""
    tiny = 1e-6 * slack
    inside = np.flatnonzero((times >= start - tiny) & (times <= stop + tiny))
    if not start < stop:
        problem, remedy = "is empty or backward", "Give the earlier time first."
    elif any(np.isfinite(x) and not low - slack <= x <= high + slack for x in window):
        problem = "reaches outside the record"
        remedy = "Give a window inside that span, or leave an end open (12: or :194)."
    elif inside.size < 2:
        problem = f"keeps {count_text(int(inside.size), 'sample')}"
        remedy = "Widen the window to at least two samples."
    if problem:
        found.faults.append(Fault("window", f"{label} {problem}; {span}.", remedy))
        return None
    return inside
