"""Cross moments: sums over time of products of lagged samples.

A criterion that is linear in its parameters depends on a record through these sums alone. They are
computed where the data lie, in any number of pieces, and added.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import Array
from casid.errors import DataError
from casid.estimation.cross_moments.gram import CONSTANT, Moments, checked_channels, checked_lags
from casid.estimation.cross_moments.lag_products import BLOCK, Core, Window, short_stretch, two_sum
from casid.linear.sampled.lagged_columns import Column
from casid.linear.stability import largest_root

if TYPE_CHECKING:
    from casid.data.fir_filter import FirFilter
    from casid.data.reading.columns import Columns, ColumnSpec
    from casid.data.record import Record

__all__ = ["CONSTANT", "Accumulator", "Moments", "moments", "of_file", "of_record", "weighted"]

Rational = tuple[ArrayLike, ArrayLike]


class Options(TypedDict, total=False):
    """Filters of the samples, and whether offsets are wanted; see `Accumulator`."""

    prefilter: FirFilter | None
    rational: Rational | None
    settle: int
    constant: bool


def moments(
    signals: Mapping[str, ArrayLike],
    lags: int,
    *,
    prefilter: FirFilter | None = None,
    rational: Rational | None = None,
    settle: int = 0,
    constant: bool = False,
) -> Moments:
    """Compute the cross moments of signals held in memory, as one stretch.

    (2 lags + 1) dot products on views for each pair of channels, lags + 1 on the diagonal; the
    entries that a shift of time relates differ by products at the two ends alone. Nothing of the
    signals' length is allocated.

    Parameters
    ----------
    signals : mapping of channel to (N,) array, N > lags
    lags : the largest lag, >= 0
    prefilter, rational, settle, constant
        As `Accumulator`.

    Raises
    ------
    DataError
        For signals of different lengths, too short, or not finite.
    """
    rows = _checked_signals(signals)
    channels, lags, N = tuple(signals), checked_lags(lags), rows[0].size
    if prefilter is not None or rational is not None or settle:
        _refuse_non_finite(channels, rows)
        stream = Accumulator(
            channels,
            lags,
            prefilter=prefilter,
            rational=rational,
            settle=settle,
            constant=constant,
        )
        stream.add_rows(rows)
        return _filled(stream.moments, f"a record of {N} samples")
    if N < max(2 * lags, 1):
        sums = short_stretch(np.stack(rows), lags, constant)
    else:  # as the accumulator has it, without its buffers
        core = Core(len(rows), lags, constant)
        for start in range(lags, N - lags, BLOCK):
            core.add(rows, start, min(start + BLOCK, N - lags))
        ends = [np.concatenate([row[: 2 * lags], row[N - 2 * lags :]]) for row in rows]
        sums = core.joined(N, np.stack(ends))
    if not np.isfinite(sums[0]).all():
        _refuse_non_finite(channels, rows)
    return _filled(Moments(channels, lags, *sums, constant), f"a record of {N} samples")


def weighted(
    left: Sequence[Column],
    right: Sequence[Column],
    signals: Mapping[str, ArrayLike],
    weights: ArrayLike,
    start: int | None = None,
) -> Array:
    """Return sum over t of w_t left_t right_t', t = start .. N - 1, (len(left), len(right)).

    For robust criteria, whose weights follow the residuals. Weights leave nothing for a shift of
    time to relate: every entry is a sum of its own.

    Parameters
    ----------
    signals : mapping of channel to (N,) array
        A tap on the channel "1" is a constant.
    weights : (N - start,) array
    start : the first t; the largest lag of the columns where not given

    Raises
    ------
    DataError
        If the weights do not fit, a channel is not given, `start` is less than a lag, or a number
        is not finite.
    """
    rows = dict(zip(signals, _checked_signals(signals), strict=True))
    N = next(iter(rows.values())).size
    order = max((column.order for column in (*left, *right)), default=0)
    start = order if start is None else start
    w = np.asarray(weights, dtype=np.float64)
    if not order <= start <= N or w.shape != (N - start,):
        raise DataError(
            f"weights of shape {w.shape} from t = {start} do not fit columns that reach to lag "
            f"{order} of {N} samples. Give one weight for each t = start .. N - 1, start >= "
            f"{order}."
        )
    for column in (*left, *right):
        for channel, _, _ in column.taps:
            if channel not in rows and channel != CONSTANT:
                raise DataError(
                    f"column {column.name} needs channel {channel!r}; there are "
                    f"{', '.join(rows)}. Give it among the signals."
                )
    rows[CONSTANT] = np.broadcast_to(1.0, N)
    high: Array = np.zeros((len(left), len(right)))
    low = np.zeros_like(high)
    a, b = np.empty((len(left), _SHORT_BLOCK)), np.empty((len(right), _SHORT_BLOCK))
    part = np.empty(_SHORT_BLOCK)
    for first in range(start, N, _SHORT_BLOCK):
        n = min(_SHORT_BLOCK, N - first)
        for into, columns in ((a, left), (b, right)):
            for row, column in zip(into[:, :n], columns, strict=True):
                _write(column, rows, first, row, part[:n])
        a[:, :n] *= w[first - start : first - start + n]
        high, error = two_sum(high, a[:, :n] @ b[:, :n].T)
        low += error
    if not np.isfinite(high).all():
        _refuse_non_finite((*rows, "weights"), (*rows.values(), w))
        raise DataError("weighted moments overflow. Scale the signals to their physical range.")
    return np.asarray(high + low)


_SHORT_BLOCK = 4096  # samples of every column at once stay in the cache


def _write(column: Column, rows: Mapping[str, Array], start: int, row: Array, part: Array) -> None:
    """Write the column's samples from t = start on into `row` (n,); `part` (n,) is scratch."""
    row.fill(0.0)
    for channel, lag, weight in column.taps:
        samples = rows[channel][start - lag : start - lag + row.size]
        row += samples if weight == 1.0 else np.multiply(samples, weight, out=part)


# ---------------------------------------------------------------------- streaming


class Accumulator:
    """Cross moments of data in chunks; memory does not grow with their number.

    The result does not depend on where the chunks are cut, to the last bit: blocks are counted
    from the start of a stretch. A sample that is not finite in any channel ends a stretch, as
    `gap` does; nothing is carried across.

    Parameters
    ----------
    channels : names
    lags : the largest lag, >= 0
    prefilter : FirFilter, optional
        Applied to all channels alike, zero phase; each stretch loses `half` samples at either end.
    rational : (numerator, denominator), optional
        A causal filter for all channels alike, ascending powers of q^-1, as ([1], c) for 1/C(q);
        it comes before `prefilter` and starts from rest in each stretch.
    settle : int
        Samples of `rational`'s output left out at the start of each stretch.
    constant : bool
        Take the sums of the channels themselves as well, for offsets: a sixth more time.

    Raises
    ------
    DataError
        If the denominator has a root on or outside the unit circle.
    """

    def __init__(
        self,
        channels: Sequence[str],
        lags: int,
        *,
        prefilter: FirFilter | None = None,
        rational: Rational | None = None,
        settle: int = 0,
        constant: bool = False,
    ) -> None:
        self.channels = checked_channels(channels)
        self.lags = checked_lags(lags)
        self.prefilter = prefilter
        self._rational = None if rational is None else _checked_rational(rational)
        self._settle = checked_lags(settle, "settle")
        nc = len(self.channels)
        self._taps = None if prefilter is None else prefilter.taps
        self._raw = None if prefilter is None else Window(nc, BLOCK, 2 * prefilter.half)
        self._window = Window(nc, BLOCK, 2 * self.lags)
        self._core = Core(nc, self.lags, constant)
        m = nc * (self.lags + 1) + 1
        zero = np.zeros((m, m))
        self._nothing = Moments(self.channels, self.lags, zero, zero, constant)
        self._closed = self._nothing
        self._begin()

    def _begin(self) -> None:
        self._is_open = False
        self._count = 0  # samples that reached the sums
        self._skip = self._settle
        self._head = np.zeros((len(self.channels), 2 * self.lags))
        self._core.clear()
        self._window.fill = 0
        if self._raw is not None:
            self._raw.fill = 0
        order = 0 if self._rational is None else len(self._rational[1]) - 1
        self._state: Array = np.zeros((len(self.channels), order))

    def add(self, chunk: Mapping[str, ArrayLike]) -> None:
        """Take the next samples; other channels are ignored.

        Parameters
        ----------
        chunk : mapping of channel to (n,) array, any n >= 0

        Raises
        ------
        DataError
            If a channel is absent, or the channels differ in length.
        """
        absent = [name for name in self.channels if name not in chunk]
        if absent:
            raise DataError(
                f"the chunk holds no channel {', '.join(map(repr, absent))}; it holds "
                f"{', '.join(chunk)}. Rename its channels, or leave these out."
            )
        self.add_rows(_checked_signals({name: chunk[name] for name in self.channels}))

    def add_rows(self, rows: Sequence[Array]) -> None:
        """Take the next samples as one (n,) float array a channel, in the order of `channels`."""
        with np.errstate(over="ignore", invalid="ignore"):
            # A finite sum of squares has finite terms: one pass, and no array of marks.
            finite = all(np.isfinite(np.dot(row, row)) for row in rows)
        if finite:
            self._add_finite(rows)
            return
        bad = ~np.isfinite(rows[0])
        for row in rows[1:]:
            bad |= ~np.isfinite(row)
        edges = [-1, *np.flatnonzero(bad).tolist(), bad.size]
        for a, b in zip(edges, edges[1:], strict=False):
            if a >= 0:
                self.gap()
            if b > a + 1:
                self._add_finite([row[a + 1 : b] for row in rows])

    def gap(self) -> None:
        """End the stretch: what comes next is not a continuation."""
        if not self._is_open:
            return
        self._closed = self._closed + self._stretch()
        self._begin()

    def clear(self) -> None:
        """Forget all samples; the buffers are used again."""
        self._closed = self._nothing
        self._begin()

    @property
    def moments(self) -> Moments:
        """The moments of all samples so far; more may be added afterwards."""
        return self._closed + self._stretch()

    def _add_finite(self, rows: Sequence[Array]) -> None:
        self._is_open = self._is_open or rows[0].size > 0
        if self._rational is None:
            self._add_settled(rows)
            return
        for start in range(0, rows[0].size, BLOCK):
            self._add_settled(self._recursion([row[start : start + BLOCK] for row in rows]))

    def _recursion(self, rows: Sequence[Array]) -> list[Array]:
        from scipy.signal import lfilter

        assert self._rational is not None
        b, a = self._rational
        outputs = [lfilter(b, a, x, zi=z) for x, z in zip(rows, self._state, strict=True)]
        self._state = np.stack([z for _, z in outputs])
        return [y for y, _ in outputs]

    def _add_settled(self, rows: Sequence[Array]) -> None:
        if self._skip:
            cut = min(self._skip, rows[0].size)
            self._skip -= cut
            rows = [row[cut:] for row in rows]
        if self._raw is None:
            self._sum(rows)
            return
        for block in self._raw.push(rows):
            self._sum(self._smooth(block))

    def _smooth(self, rows: Sequence[Array]) -> list[Array]:
        from casid.data.fir_filter import convolved

        assert self._taps is not None
        return [convolved(row, self._taps) for row in rows]

    def _sum(self, rows: Sequence[Array]) -> None:
        room = self._head.shape[1] - self._count
        if room > 0:
            for head, row in zip(self._head, rows, strict=True):
                head[self._count : self._count + row.size] = row[:room]
        self._count += rows[0].size
        for block in self._window.push(rows):
            self._core.add(block, self.lags, self.lags + BLOCK)

    def _stretch(self) -> Moments:
        """The moments of the stretch that is open, which stays as it is."""
        last = copy.copy(self)
        last._core = copy.copy(self._core)  # its sums are replaced, not written into
        if self._raw is not None and self._raw.fill > self._raw.overlap:
            last._window, last._head = copy.deepcopy(self._window), self._head.copy()
            last._sum(self._smooth(list(self._raw.held)))
        return Moments(self.channels, self.lags, *last._ended(), self._core.constant)

    def _ended(self) -> tuple[Array, Array]:
        held, L = self._window.held, self.lags
        if self._count < max(2 * L, L + 1):
            return short_stretch(held, L, self._core.constant)
        if held.shape[1] > 2 * L:
            self._core.add(list(held), L, held.shape[1] - L)
        ends = np.hstack([self._head, held[:, held.shape[1] - 2 * L :]])
        return self._core.joined(self._count, ends)


def of_record(
    record: Record,
    lags: int,
    channels: Sequence[str] | None = None,
    **options: Unpack[Options],
) -> Moments:
    """Compute the cross moments of a record; missing samples are gaps.

    Parameters
    ----------
    channels : names; all of the record's where not given
    lags, options
        As `Accumulator`.

    Raises
    ------
    DataError
        If a channel is not there, the prefilter is made for another sample time, or no stretch
        is long enough.
    """
    names = record.names if channels is None else tuple(channels)
    total = Accumulator(names, lags, **options)
    _check_sample_time(record.name, total.prefilter, record.Ts)
    for start in range(0, record.N, BLOCK):
        cut = slice(start, start + BLOCK)
        rows = []
        for name in names:
            row, mask = record[name][cut], record.missing.get(name)
            marked = mask is not None and mask[cut].any()
            rows.append(np.where(mask[cut], np.nan, row) if mask is not None and marked else row)
        total.add_rows(rows)
    return _filled(total.moments, record.name)


def of_file(
    path: str | Path,
    columns: Columns,
    lags: int,
    *,
    time: str | ColumnSpec | Sequence[str | None] | None = None,
    chunk: int = 100_000,
    **options: Unpack[Options],
) -> Moments:
    """Compute the cross moments of a CSV or Parquet file, `chunk` rows at a time.

    Samples that are not finite, and rows that the clock leaves out, are gaps.

    Parameters
    ----------
    columns : mapping of channel to column of the file, as `casid.data.reading.chunks.iter_chunks`
        With units converted to SI.
    time : the column of the time stamps, as `casid.data.reading.chunks.iter_chunks`
    lags, options
        As `Accumulator`.

    Raises
    ------
    DataError
        As `casid.data.reading.chunks.iter_chunks`, and as `of_record`.
    """
    from casid.data.reading.chunks import iter_chunks

    path = Path(path)
    total = Accumulator(tuple(columns), lags, **options)
    for index, part in enumerate(iter_chunks(path, columns, chunk, time=time, gaps=True)):
        if index == 0 and "t" in part and "t" not in columns and part["t"].size > 1:
            _check_sample_time(path.name, total.prefilter, float(np.nanmedian(np.diff(part["t"]))))
        total.add(part)
    return _filled(total.moments, path.name)


# ---------------------------------------------------------------------- checks


def _checked_signals(signals: Mapping[str, ArrayLike]) -> list[Array]:
    checked_channels(tuple(signals))
    rows = []
    for name, values in signals.items():
        row = np.asarray(values)
        if row.ndim != 1 or row.dtype.kind not in "fiub":
            raise DataError(
                f"signal {name} is an array of shape {row.shape} and type {row.dtype}. Give one "
                "number for each sample, (N,)."
            )
        rows.append(row.astype(np.float64, copy=False))
    sizes = {name: row.size for name, row in zip(signals, rows, strict=True)}
    if len(set(sizes.values())) > 1:
        raise DataError(
            f"signals differ in length: {', '.join(f'{n} has {k}' for n, k in sizes.items())}. "
            "Cut them to the same samples."
        )
    return rows


def _refuse_non_finite(channels: Sequence[str], rows: Sequence[Array]) -> None:
    for name, row in zip(channels, rows, strict=True):
        bad = np.flatnonzero(~np.isfinite(row))
        if bad.size:
            raise DataError(
                f"{name}: {bad.size} samples are not finite, the first at k = {bad[0]}. Cut them "
                "out, or pass the signals through Accumulator of "
                "casid.estimation.cross_moments.moments, which takes them as gaps."
            )


def _checked_rational(rational: Rational) -> tuple[Array, Array]:
    b, a = (np.atleast_1d(np.asarray(x, dtype=np.float64)) for x in rational)
    if b.ndim != 1 or a.ndim != 1 or not np.isfinite([*b, *a]).all() or a[0] == 0:
        raise DataError(
            f"filter with numerator {b} and denominator {a}. Give finite coefficients in "
            "ascending powers of q^-1, the denominator's first one not zero."
        )
    radius = largest_root(a)
    if radius >= 1:
        raise DataError(
            f"the prefilter is unstable: its denominator {a} has a root of modulus {radius:.6g}. "
            "Replace the root z by 1/z, which keeps the shape of the spectrum, or filter with a "
            "noise model of lower order."
        )
    size = max(a.size, b.size)
    return tuple(np.pad(x / a[0], (0, size - x.size)) for x in (b, a))  # type: ignore[return-value]


def _check_sample_time(name: str, prefilter: FirFilter | None, Ts: float) -> None:
    if prefilter is not None and abs(prefilter.Ts / Ts - 1) > 1e-3:
        raise DataError(
            f"{name}: the prefilter is designed for Ts = {prefilter.Ts:g} s, the samples have "
            f"Ts = {Ts:g} s. Design it for them: "
            f"casid.data.fir_filter.equiripple(cutoff_hz, Ts={Ts:g})."
        )


def _filled(result: Moments, name: str) -> Moments:
    if result.N == 0:
        raise DataError(
            f"{name}: no stretch between gaps is longer than the {result.lags} lags and what the "
            "filters take. Give a longer record, fewer lags or a shorter filter."
        )
    return result
