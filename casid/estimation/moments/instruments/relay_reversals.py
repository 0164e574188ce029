"""What switches a reference between two levels: its own clock, or an output?

A relay has only a few reversals, too few for a regression. But each has a time. If
a threshold of an output y sets them off, reversals come when s y = c, s = +-1 the side that is
left, and the times (s y - c)/(s dy/dt) by which they miss that instant hardly scatter; if the
reference has a clock of its own, it is the times for which a level is held that scatter little:

    F = var(hold) / var(miss)                                                                 (1)

Without dependence a reversal that comes late by its clock also comes late by the threshold, so that
`miss` scatters at least as `hold` does, and F is below Fisher's with n - 1 and n - 1 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casid.arrays import FloatArray

_NEAR = 0.1  # of the swing: within this of a level counts as standing there (a heuristic)


@dataclass(frozen=True, slots=True, eq=False)
class Reversals:
    """Where a two-level reference leaves one level for the other.

    Attributes
    ----------
    start : (n,) last sample at the level that is left.
    side : (n,) +1 where that is the upper level, -1 where the lower.
    hold : (n,) samples since the reference came to that level.
    standing : share of the record at either level.
    """

    start: NDArray[np.intp]
    side: FloatArray
    hold: FloatArray
    standing: float


def reversals(reference: FloatArray) -> Reversals:
    """Find the reversals of a reference between its 2nd and 98th percentile, (N,) samples.

    A level that is held from the first sample on has no known beginning, and its end is left out.
    """
    low, high = np.percentile(reference, [2.0, 98.0])
    near = _NEAR * (high - low)
    at = np.where(reference >= high - near, 1, np.where(reference <= low + near, -1, 0))
    if high <= low:
        empty = np.zeros(0)
        return Reversals(np.zeros(0, dtype=np.intp), empty, empty, 1.0)
    where = np.flatnonzero(at)
    changes = np.flatnonzero(np.diff(at[where]))
    starts, sides, holds = [], [], []
    for j in changes:
        first = 0 if j == 0 else int(np.max(changes[changes < j], initial=-1)) + 1
        came, left = int(where[first]), int(where[j])
        if came > 0:
            starts.append(left)
            sides.append(float(at[left]))
            holds.append(float(left - came))
    return Reversals(
        np.array(starts, dtype=np.intp),
        np.array(sides),
        np.array(holds),
        float(np.mean(at != 0)),
    )


def switching_p_value(found: Reversals, output: FloatArray, span: int) -> tuple[float, float]:
    """p-value of (1) for one output, and the threshold c.

    Parameters
    ----------
    output : (N,) samples; thresholds lie symmetrically about zero.
    span : samples on either side over which its slope is taken.

    Returns
    -------
    (1, nan) where there are fewer than two reversals, or the output is constant at one.
    """
    from scipy.stats import f

    n = len(found.start)
    if n < 2:
        return 1.0, float("nan")
    before, after = found.start - span, found.start + span
    before, after = np.maximum(before, 0), np.minimum(after, len(output) - 1)
    y = found.side * output[found.start]
    slope = found.side * (output[after] - output[before]) / (after - before)
    if np.min(np.abs(slope)) <= 1e-9 * np.ptp(output) / len(output):
        return 1.0, float("nan")
    c = float(np.average(y, weights=1 / slope**2))
    # A reversal is timed to a sample, whatever set it off.
    miss = np.sum(((y - c) / slope) ** 2) / (n - 1) + 1 / 12
    hold = np.var(found.hold, ddof=1) + 1 / 12
    return float(f.sf(hold / miss, n - 1, n - 1)), c
