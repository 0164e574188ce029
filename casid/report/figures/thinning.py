"""Records thinned for drawing: a browser drags long ones, and a spike must stay in the figure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from casid.arrays import Array
from casid.estimation.estimate import RecordView

POINTS = 2000  # most points drawn in one trace: two a pixel of a wide figure
MOST_POINTS = 4500  # of all its traces: a page of ten figures stays below 1 MB


def thinned(values: Array, limit: int = POINTS) -> Array:
    """Indices of at most about `limit` samples that keep every extreme of `values`.

    Parameters
    ----------
    values : (N,) array
        NaN and Inf count as gaps; a stretch of gaps stays a gap.
    limit : int
        Most indices wanted, 4 or more.

    Returns
    -------
    (M,) int array, increasing, M <= limit + 2
        All of them when N <= limit; else first and last sample, and the smallest and the largest of
        each of limit / 2 equal stretches, so that a spike of one sample stays in the figure.
    """
    n = values.size
    if n <= limit:
        return np.arange(n)
    width = math.ceil(n / (limit // 2))
    stretches = math.ceil(n / width)
    padded = np.full(stretches * width, np.nan)
    padded[:n] = np.where(np.isfinite(values), values, np.nan)
    blocks = padded.reshape(stretches, width)
    first = np.arange(stretches) * width
    low = first + np.argmin(np.where(np.isnan(blocks), np.inf, blocks), axis=1)
    high = first + np.argmax(np.where(np.isnan(blocks), -np.inf, blocks), axis=1)
    indices: Array = np.unique(np.concatenate([[0, n - 1], low, high]))
    return indices


def points_a_trace(traces: int) -> int:
    """Points drawn in each of so many traces, so that the figure stays light."""
    return max(300, min(POINTS, MOST_POINTS // max(1, traces)))


def thinning_note(views: Sequence[RecordView], limit: int) -> str:
    """What the caption says of the thinning, nothing where nothing was thinned."""
    longest = max(v.t.size for v in views)
    if longest <= limit:
        return ""
    return (
        f" Thinned for drawing from {longest} samples to about {limit} points a curve; "
        "every peak is kept."
    )
