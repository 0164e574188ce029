"""Irregular samples onto a uniform grid, on request."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import BoolArray, FloatArray
from casid.data.reading.clocks.even_clock import GAP, UNIFORM
from casid.data.record import Record
from casid.errors import DataError
from casid.model.quantities import count_text

_USUAL = 0.9  # of the intervals of random instants, which are none longer than usual; heuristic

DENSEST = 100
"""Most samples that one recorded sample becomes: more only make every fit longer."""


def resample(times: ArrayLike, values: ArrayLike, Ts: float) -> tuple[FloatArray, FloatArray]:
    """Interpolate samples at irregular times onto a uniform grid.

    Monotone piecewise cubic interpolation (PCHIP; Fritsch & Carlson 1980, SIAM J. Numer. Anal.
    17, 238-246): third order on smooth signals and no overshoot at steps. It does not
    limit the bandwidth: choose Ts near the median interval, then decimate.

    Parameters
    ----------
    times : (N,) array [s], strictly increasing
    values : (N,) or (N, n) array
    Ts : float
        Sample time of the grid [s].

    Returns
    -------
    (M,) times t0 + k Ts within the given ones [s]; (M,) or (M, n) values

    Raises
    ------
    DataError
        If the times do not increase, or the grid has fewer than two samples.
    """
    from scipy.interpolate import PchipInterpolator

    t = np.asarray(times, dtype=np.float64)
    y = np.asarray(values, dtype=np.float64)
    if t.ndim != 1 or t.size < 2 or y.shape[:1] != t.shape or not (np.diff(t) > 0).all():
        raise DataError(
            f"resampling needs strictly increasing times and as many values, got shapes {t.shape} "
            f"and {y.shape}. Sort the samples and drop doubled time stamps."
        )
    if not (np.isfinite(Ts) and 0 < Ts <= t[-1] - t[0]):
        raise DataError(
            f"Ts = {Ts!r} s does not fit a record of {t[-1] - t[0]:g} s. "
            f"Give for example the median interval, {np.median(np.diff(t)):.6g} s."
        )
    count = int((t[-1] - t[0]) / Ts * (1 + 1e-12)) + 1
    if count > DENSEST * t.size:
        raise DataError(
            f"Ts = {Ts!r} s would make {count:.3g} samples of {t.size}, which hold nothing new. "
            f"Give for example the median interval, {np.median(np.diff(t)):.6g} s, or cut long "
            "gaps away with a window."
        )
    grid = t[0] + Ts * np.arange(count)
    grid = np.minimum(grid, t[-1])
    return grid, np.asarray(PchipInterpolator(t, y, axis=0)(grid), dtype=np.float64)


def resampled(
    times: FloatArray,
    values: dict[str, FloatArray],
    units: dict[str, str],
    missing: dict[str, BoolArray],
    Ts: float,
    name: str,
    steps: list[str],
    held: Collection[str] = (),
) -> Record:
    """Resample every channel; a sample between neighbours far apart or missing is marked.

    Parameters
    ----------
    held : channels that stand from row to row, as a command does: each sample has what flows in
        until the next one, as on the clock of their own instants.

    Raises
    ------
    DataError
        As `resample`, or if the filter before a decimation reaches from gap to gap of a channel.
    """
    intervals = np.diff(times)
    usual = _usual(intervals)
    # A grid coarser than the samples would alias: interpolate finer, then decimate behind a filter.
    factor = int(np.ceil(Ts / usual * (1 - UNIFORM))) if Ts > usual * (1 + UNIFORM) else 1
    fine = Ts / factor
    gridded: dict[str, FloatArray] = {}
    masks: dict[str, BoolArray] = {}
    marked = 0
    grid, _ = resample(times, times, fine)
    for channel, y in values.items():
        kept = ~missing[channel] if channel in missing else np.ones(times.size, dtype=bool)
        t_kept = times[kept]
        if t_kept.size < 2:
            gridded[channel], masks[channel] = np.zeros(grid.size), np.ones(grid.size, dtype=bool)
            continue
        inner = np.clip(grid, t_kept[0], t_kept[-1])
        gridded[channel] = (
            _held_means(t_kept, y[kept], inner, fine)
            if channel in held
            else _pchip(t_kept, y[kept], inner)
        )
        after = np.clip(np.searchsorted(t_kept, grid, side="left"), 1, t_kept.size - 1)
        far = t_kept[after] - t_kept[after - 1] > GAP * usual
        nearest = np.minimum(np.abs(grid - t_kept[after]), np.abs(grid - t_kept[after - 1]))
        masks[channel] = (far & (nearest > 0.5 * usual)) | (inner != grid)
        marked += int(masks[channel].sum())
    steps.append(
        f"resampled by PCHIP onto Ts = {fine:g} s (intervals were {intervals.min():.6g} to "
        f"{intervals.max():.6g} s, median {np.median(intervals):.6g} s); "
        f"{count_text(marked, 'sample')} in gaps marked missing"
    )
    record = Record(gridded, units, fine, float(times[0]), name, masks, tuple(steps))
    if factor == 1:
        return record
    return _decimated(record, factor, Ts)


def _decimated(record: Record, factor: int, Ts: float) -> Record:
    """Every sample that is `Ts` apart behind the filter; refused where a channel keeps none."""
    fewer = record.decimate(factor)
    for channel in fewer.names:
        if fewer.is_missing(channel).all() and not record.is_missing(channel).all():
            raise DataError(
                f"no sample of {channel} is left: onto Ts = {Ts:g} s the anti-alias filter takes "
                f"{record.N - factor * (fewer.N - 1)} samples of {record.Ts:g} s, and nowhere so "
                "many are without a gap."
            )
    return fewer


def _usual(intervals: FloatArray) -> float:
    """The interval of a clock [s]: one that is even but for lost rows has it more often than not.

    That of random instants is what nine in ten do not exceed: none of these is a gap.
    """
    median = float(np.median(intervals))
    is_even = np.mean(np.abs(intervals - median) <= UNIFORM * median) >= 0.5
    return median if is_even else float(np.quantile(intervals, _USUAL))


def _held_means(t: FloatArray, y: FloatArray, at: FloatArray, Ts: float) -> FloatArray:
    """Means over the sample time after each instant of a signal that is held from `t` to `t`."""
    flowed = np.concatenate([[0.0], np.cumsum(y[:-1] * np.diff(t))])
    end = np.minimum(at + Ts, t[-1])
    means = (np.interp(end, t, flowed) - np.interp(at, t, flowed) + (at + Ts - end) * y[-1]) / Ts
    last = np.searchsorted(t, at, side="right") - 1
    following = np.append(t, np.inf)[last + 1]
    return np.asarray(np.where(following >= at + Ts, y[last], means), dtype=np.float64)


def _pchip(t: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    from scipy.interpolate import PchipInterpolator

    return np.asarray(PchipInterpolator(t, y)(at), dtype=np.float64)
