"""Irregular samples onto a uniform grid, on request."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import BoolArray, FloatArray
from casid.data.reading.clocks.even_clock import GAP, UNIFORM
from casid.data.record import Record
from casid.errors import DataError
from casid.model.quantities import count_text

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
) -> Record:
    """Resample every channel; a sample between neighbours far apart or missing is marked."""
    intervals = np.diff(times)
    median = float(np.median(intervals))
    # A grid coarser than the samples would alias: interpolate finer, then decimate behind a filter.
    factor = int(np.ceil(Ts / median * (1 - UNIFORM))) if Ts > median * (1 + UNIFORM) else 1
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
        gridded[channel] = _pchip(t_kept, y[kept], inner)
        after = np.clip(np.searchsorted(t_kept, grid, side="left"), 1, t_kept.size - 1)
        far = t_kept[after] - t_kept[after - 1] > GAP * median
        nearest = np.minimum(np.abs(grid - t_kept[after]), np.abs(grid - t_kept[after - 1]))
        masks[channel] = (far & (nearest > 0.5 * median)) | (inner != grid)
        marked += int(masks[channel].sum())
    steps.append(
        f"resampled by PCHIP onto Ts = {fine:g} s (intervals were {intervals.min():.6g} to "
        f"{intervals.max():.6g} s, median {median:.6g} s); "
        f"{count_text(marked, 'sample')} in gaps marked missing"
    )
    record = Record(gridded, units, fine, float(times[0]), name, masks, tuple(steps))
    return record if factor == 1 else record.decimate(factor)


def _pchip(t: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    from scipy.interpolate import PchipInterpolator

    return np.asarray(PchipInterpolator(t, y)(at), dtype=np.float64)
