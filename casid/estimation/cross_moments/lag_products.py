"""Sums of products of lagged samples over one stretch of data, exact to rounding.

The entries of the matrix sum v_t v_t' that a shift of time relates share their sum but for products
at the two ends: one sum for each pair of channels and offset, and the rest is edges.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

import numpy as np

from casid.arrays import Array

BLOCK = 65_536  # samples a dot product: fits the cache, and bounds the rounding


# Sums that overflow are refused when the moments are made of them.
_overflowing = np.errstate(over="ignore", invalid="ignore")


class Core:
    """Compensated sums over the samples that every shift of a stretch shares.

    For channels a <= b and offsets o the sums x_a[s] x_b[s + o] over s, then, with `constant`, the
    sums x_a[s].
    """

    def __init__(self, nc: int, lags: int, constant: bool) -> None:
        self.nc, self.lags, self.constant = nc, lags, constant
        size = nc * (lags + 1) + nc * (nc - 1) // 2 * (2 * lags + 1) + nc
        self.high: Array = np.zeros(size)
        self.low: Array = np.zeros(size)
        self._new: Array = np.zeros(size)

    def clear(self) -> None:
        """Forget the sums."""
        self.high = np.zeros_like(self.high)
        self.low = np.zeros_like(self.low)

    @_overflowing
    def add(self, rows: Sequence[Array], start: int, stop: int) -> None:
        """Add s = start .. stop - 1; the rows reach `lags` samples further on either side."""
        L, place, new = self.lags, 0, self._new
        for a, x in enumerate(rows):
            own = x[start:stop]
            new[place : place + L + 1] = np.correlate(x[start - L : stop], own, "valid")
            place += L + 1
            for y in rows[a + 1 :]:
                both = np.correlate(y[start - L : stop + L], own, "valid")
                new[place : place + 2 * L + 1] = both
                place += 2 * L + 1
        if self.constant:
            new[place:] = [_sum_of(x[start:stop]) for x in rows]
        self.high, error = two_sum(self.high, new)
        self.low = self.low + error

    @_overflowing
    def joined(self, N: int, ends: Array) -> tuple[Array, Array]:
        """The matrix of the whole stretch; `ends` (nc, 4 lags): its first and last 2 lags samples.

        Entry (lag j of a, lag i of b) runs over s = t - j = L - j .. N - 1 - j: the core
        s = L .. N - 1 - L, j samples before it, and L - j behind.
        """
        index, upper, shift, taken = _layout(self.nc, self.lags)
        high, low = self.high[index], self.low[index]
        v = _lagged(ends, shift, self.constant)
        outside = (v * taken) @ v.T
        high, error = two_sum(high, np.where(upper, outside, outside.T))
        low += error
        high[-1, -1], low[-1, -1] = N - self.lags, 0.0
        return fast_two_sum(high, low)


def _sum_of(x: Array) -> float:
    whole = x.size // _ONES.size * _ONES.size
    if whole == 0:
        return float(np.add.reduce(x))
    # A matrix times ones is faster than a sum.
    total = float(np.add.reduce(x[:whole].reshape(-1, _ONES.size) @ _ONES))
    return total if whole == x.size else total + float(np.add.reduce(x[whole:]))


_ONES = np.ones(512)


@functools.lru_cache(maxsize=64)
def _layout(nc: int, L: int) -> tuple[Array, Array, Array, Array]:
    """Where each entry of the matrix lies among the core sums, and what it takes from the ends.

    Returns index (m + 1, m + 1), the upper triangle as bool, and for the columns v_t at the ends
    their samples (L + 1, 2 L) at each lag, and which of them each row takes (m + 1, 2 L).
    """
    size = nc * (L + 1)
    index = np.zeros((size + 1, size + 1), dtype=np.intp)
    place = 0
    lag = np.arange(L + 1)
    for a in range(nc):
        rows = slice(a * (L + 1), (a + 1) * (L + 1))
        index[rows, rows] = place + L - np.abs(lag[:, None] - lag)
        place += L + 1
        for b in range(a + 1, nc):
            columns = slice(b * (L + 1), (b + 1) * (L + 1))
            index[rows, columns] = place + L + lag[:, None] - lag
            index[columns, rows] = index[rows, columns].T
            place += 2 * L + 1
    index[:-1, -1] = index[-1, :-1] = place + np.repeat(np.arange(nc), L + 1)
    t = np.arange(L, 2 * L)
    shift = np.hstack([t, t + 2 * L]) - lag[:, None]
    of_lag = np.hstack([t < L + lag[:, None], t >= L + lag[:, None]])
    taken = np.vstack([np.tile(of_lag, (nc, 1)), np.zeros((1, 2 * L))])
    return index, np.triu(np.ones(index.shape, dtype=bool)), shift, taken


def _lagged(rows: Array, shift: Array, constant: bool) -> Array:
    """v_t, (m + 1, n), from rows (nc, ...) whose samples at each lag are `shift` (L + 1, n)."""
    v = np.empty((len(rows) * len(shift) + 1, shift.shape[1]))
    v[:-1] = rows[:, shift].reshape(len(v) - 1, shift.shape[1])
    v[-1] = constant
    return v


@_overflowing
def short_stretch(rows: Array, L: int, constant: bool) -> tuple[Array, Array]:
    """The matrix of a stretch (nc, N) too short to have a core."""
    t = np.arange(L, rows.shape[1])
    v = _lagged(rows, t - np.arange(L + 1)[:, None], constant)
    total = v @ v.T
    total[-1, -1] = len(t)
    return total, np.zeros_like(total)


class Window:
    """Blocks of `step` new samples of each channel behind `overlap` old ones."""

    def __init__(self, nc: int, step: int, overlap: int) -> None:
        self.step, self.overlap = step, overlap
        self.data = np.empty((nc, step + overlap))
        self.fill = 0

    @property
    def held(self) -> Array:
        """The samples not yet in a full block, the overlap before them included."""
        return self.data[:, : self.fill]

    def push(self, rows: Sequence[Array]) -> Iterator[list[Array]]:
        """Yield each full block, one (step + overlap,) array a channel; valid until the next."""
        place, n, width = 0, rows[0].size, self.step + self.overlap
        while place < n:
            if self.fill <= self.overlap and place >= self.fill and n - place >= width - self.fill:
                # The old samples precede the new ones in the rows themselves: no copy.
                start = place - self.fill
                yield [row[start : start + width] for row in rows]
                place = start + width
                for data, row in zip(self.data, rows, strict=True):
                    data[: self.overlap] = row[place - self.overlap : place]
                self.fill = self.overlap
                continue
            take = min(n - place, width - self.fill)
            for data, row in zip(self.data, rows, strict=True):
                data[self.fill : self.fill + take] = row[place : place + take]
            self.fill += take
            place += take
            if self.fill == width:
                yield list(self.data)
                self.data[:, : self.overlap] = self.data[:, self.step :]
                self.fill = self.overlap


def two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """a + b rounded, and exactly what rounding left out (Knuth; Higham 2002, section 4.3)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def fast_two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Sum and rounding error, as `two_sum`, for |a| >= |b| (Dekker)."""
    total = a + b
    return total, b - (total - a)
