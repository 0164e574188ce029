"""Sums over time of products of columns, no more of them than the columns need.

Two lists of columns on a few channels need the lagged products of the pairs of channels that meet,
at the offsets that occur; entries that a shift of time relates share their sum but for the ends.
`moments` keeps everything up to a lag, to be added and evaluated later; this is for one use.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence

import numpy as np

from casid.arrays import Array
from casid.linear.sampled.lagged_columns import Column

BLOCK = 16_384  # samples a dot product: two channels stay in the cache


def column_products(
    left: Sequence[Column], right: Sequence[Column], signals: Mapping[str, Array], start: int
) -> Array:
    """Return sum over t = start .. N - 1 of left_t right_t', (len(left), len(right)).

    Parameters
    ----------
    signals : channel -> (N,); `start` is at least the largest lag.
    """
    a, b = (_tables(tuple(columns)) for columns in (left, right))
    highest = max(table.shape[1] for table in (*a.values(), *b.values())) - 1
    N = len(signals[next(iter(a))])
    if not highest <= start <= N:
        raise ValueError(f"start = {start} for lags up to {highest} and {N} samples")
    if N - start < 2 * highest:
        rows = [np.stack([c.samples(signals, start) for c in columns]) for columns in (left, right)]
        return np.asarray(rows[0] @ rows[1].T)
    ends = {c: _ends(signals[c], start, highest) for c in dict.fromkeys([*a, *b])}
    is_square = tuple(left) == tuple(right)
    total: Array = np.zeros((len(left), len(right)))
    for k, (p, weights) in enumerate(a.items()):
        for q, others in list(b.items())[k if is_square else 0 :]:
            sizes = weights.shape[1], others.shape[1]
            is_half = is_square and p == q
            sums = _common(signals[p], signals[q], sizes, (start, N - highest), is_half)
            sums += (ends[p][: sizes[0]] * _taken(highest)[: sizes[0]]) @ ends[q][: sizes[1]].T
            if is_half:
                sums = np.tril(sums) + np.tril(sums, -1).T
            part = weights @ sums @ others.T
            total += part
            if is_square and p != q:
                total += part.T
    return total


def column_means(columns: Sequence[Column], signals: Mapping[str, Array], start: int) -> Array:
    """Mean over t = start .. N - 1 of every column, (len(columns),); `signals` as above."""
    total: Array = np.zeros(len(columns))
    for channel, weights in _tables(tuple(columns)).items():
        x, lags = signals[channel], np.arange(weights.shape[1])
        entering = np.cumsum(x[start - lags[-1] : start][::-1]) if lags[-1] else np.zeros(0)
        leaving = np.cumsum(x[len(x) - lags[-1] :][::-1]) if lags[-1] else np.zeros(0)
        moved = np.concatenate([[0.0], entering - leaving])
        total += weights @ (moved + x[start:].sum())
    return total / (len(next(iter(signals.values()))) - start)


@functools.lru_cache(maxsize=256)  # campaigns use the same columns in every run
def _tables(columns: tuple[Column, ...]) -> dict[str, Array]:
    """Channel -> weight of each column on each lag, (len(columns), largest lag + 1)."""
    highest = max((c.order for c in columns), default=0)
    tables: dict[str, Array] = {}
    for row, column in enumerate(columns):
        for channel, lag, weight in column.taps:
            if channel not in tables:
                tables[channel] = np.zeros((len(columns), highest + 1))
            tables[channel][row, lag] += weight
    cut: dict[str, Array] = {}
    for channel, table in tables.items():
        used = int(np.flatnonzero(table.any(axis=0))[-1]) if table.any() else 0
        cut[channel] = table[:, : used + 1].copy()
        cut[channel].flags.writeable = False
    return cut


def _common(
    x: Array, y: Array, sizes: tuple[int, int], span: tuple[int, int], is_half: bool
) -> Array:
    """Sums of x[t-i] y[t-j] over the s = t - i that all lags share, span[0] .. span[1] - 1.

    `is_half`: for lags i >= j alone, the rest zero.
    """
    low, high = 0 if is_half else 1 - sizes[1], sizes[0] - 1
    blocks = []
    for first in range(*span, BLOCK):
        last = min(first + BLOCK, span[1])
        blocks.append(np.correlate(y[first + low : last + high], x[first:last], "valid"))
    # What rounding leaves here is all that nearly dependent columns have left.
    sums: Array = np.asarray(np.sum(blocks, axis=0, dtype=np.longdouble), dtype=np.float64)
    offset = np.arange(sizes[0])[:, None] - np.arange(sizes[1])
    return np.where(offset >= low, sums[np.maximum(offset - low, 0)], 0.0)


def _ends(signal: Array, start: int, highest: int) -> Array:
    """The samples at lags 0 .. highest of the first and last `highest` t, (highest + 1, 2 highest).

    Lag i has its s = t - i outside the common span at the first i of these t, and at the last of
    them from the i-th on.
    """
    t = np.arange(highest)
    both = np.concatenate([start + t, len(signal) - highest + t])
    return np.asarray(signal[both - np.arange(highest + 1)[:, None]])


@functools.lru_cache(maxsize=64)
def _taken(highest: int) -> Array:
    """Which of the ends each lag takes, (highest + 1, 2 highest)."""
    t, lag = np.arange(highest), np.arange(highest + 1)[:, None]
    return np.hstack([t < lag, t >= lag])
