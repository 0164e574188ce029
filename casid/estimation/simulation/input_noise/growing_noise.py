"""Noise that grows in proportion to what a sensor reads: an assay, a flow meter, a counter.

    sd_k = share * sqrt(level^2 + yhat_k^2)                                                   (1)

at the reading yhat_k that the model simulates: `share` of large readings, and `share * level` where
there is nothing to read. Whether it grows is tested on what is left of a residual when each sample
is taken less the line through its two neighbours, and these differences once more less the lines
through theirs: a misfit, which is smooth, hardly shows there.

Source: R. J. Carroll and D. Ruppert, Transformation and Weighting in Regression, Chapman and Hall
1988, chapters 2 and 3: variance as a function of the mean, and weights that follow it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from casid.arrays import TINY, Array, BoolArray, robust_sd
from casid.estimation.simulation.thresholds import GROWING_NOISE


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """The samples that there are of one output in one record, or in one window of it."""

    t: Array  # (M,)
    simulated: Array  # (M,)
    error: Array  # (M,), measured less simulated


def growing_level(readings: Sequence[Readings]) -> float | None:
    """`level` of (1) of noise that grows with the reading, None where none is seen to grow.

    A likelihood ratio of the differences from neighbours under Student's t with four degrees of
    freedom, against noise of one size, both without outliers; a lower one has to remain without the
    few samples that lie furthest off, which may be all that is larger, and of differences that are
    taken twice: they keep noise, and lose a misfit that grows with a motion of few samples a
    period. It is none where the sizes that follow differ little over the record, or where
    differences that follow each other are alike: noise that is independent from sample to sample
    makes them unlike, and a misfit, which grows with the motion as well, alike.
    """
    sizes = np.concatenate([r.simulated for r in readings]) if readings else np.zeros(0)
    rms = float(np.sqrt(np.mean(sizes**2))) if len(sizes) else 0.0
    if sum(max(len(r.t) - 2, 0) for r in readings) < GROWING_NOISE.samples or rms == 0.0:
        return None
    levels = rms * np.geomspace(GROWING_NOISE.lowest, 1.0, 13)
    clean = _without_outliers(readings, levels)
    parts = [_differences(r) for r in clean]
    level, log_likelihood = _likeliest(parts, levels)
    few = [_differences(r) for r in _without_outliers(readings, None)]
    gains = [
        (log_likelihood - _log_likelihood(parts, None), GROWING_NOISE.alpha),
        (_likeliest(few, levels)[1] - _log_likelihood(few, None), GROWING_NOISE.inner),
    ]
    twice = _differences_taken_twice(clean, parts)
    if sum(len(p.value) for p in twice) >= GROWING_NOISE.samples:
        gain = _likeliest(twice, levels)[1] - _log_likelihood(twice, None)
        gains.append((gain, GROWING_NOISE.inner))
    if any(2 * gain < GROWING_NOISE.along * chi2.isf(alpha, 1) for gain, alpha in gains):
        return None
    low, high = np.quantile(np.hypot(level, sizes), [0.1, 0.9])
    if high < GROWING_NOISE.ratio * low or not _is_independent(parts, level):
        return None
    return level


@dataclass(frozen=True, slots=True, eq=False)
class _Differences:
    """Samples less the lines through their neighbours."""

    value: Array  # (M - 2,)
    weights: Array  # (M - 2, 3), of the sample before, the sample, and the one behind
    simulated: Array  # (M - 2, 3)

    def variance(self, level: float | None) -> Array:
        """(M - 2,) up to a factor."""
        return np.asarray(np.sum(self.weights**2 * self._squares(level), axis=1))

    def next_covariance(self, level: float | None) -> Array:
        """(M - 3,) of a difference and the next one, up to the same factor, of independent noise.

        They share two samples.
        """
        s, w = self._squares(level), self.weights
        return np.asarray(w[:-1, 1] * w[1:, 0] * s[:-1, 1] + w[:-1, 2] * w[1:, 1] * s[:-1, 2])

    def _squares(self, level: float | None) -> Array:
        return np.ones_like(self.weights) if level is None else level**2 + self.simulated**2


def _differences(r: Readings) -> _Differences:
    later = (r.t[1:-1] - r.t[:-2]) / np.maximum(r.t[2:] - r.t[:-2], TINY)
    weights = np.column_stack([later - 1, np.ones(len(later)), -later])

    def threes(values: Array) -> Array:
        return np.column_stack([values[:-2], values[1:-1], values[2:]])

    return _Differences(np.sum(weights * threes(r.error), axis=1), weights, threes(r.simulated))


def _differences_taken_twice(
    readings: Sequence[Readings], once: Sequence[_Differences]
) -> list[_Differences]:
    """Differences of differences, as if these were samples, where there are enough of them."""
    pairs = zip(readings, once, strict=True)
    return [
        _differences(Readings(r.t[1:-1], r.simulated[1:-1], d.value))
        for r, d in pairs
        if len(d.value) > 2
    ]


def _likeliest(parts: Sequence[_Differences], levels: Array) -> tuple[float, float]:
    """The highest of the levels that are about as likely as the best, and its log-likelihood.

    Its weights differ least.
    """
    found = np.array([_log_likelihood(parts, level) for level in levels.tolist()])
    return float(levels[found > found.max() - GROWING_NOISE.as_likely][-1]), float(found.max())


def _without_outliers(readings: Sequence[Readings], levels: Array | None) -> list[Readings]:
    """The samples without outliers that growing noise does not explain either.

    In two passes: beside an outlier its neighbours lie far off as well, until it is gone.

    Parameters
    ----------
    levels : that noise may have; None: the few samples go that lie furthest from their neighbours.
    """
    out = [r for r in readings if len(r.t) > 2]
    for _ in range(2):
        parts = [_differences(r) for r in out]
        level = None if levels is None else _likeliest(parts, levels)[0]
        unit = [np.abs(p.value) / np.sqrt(np.maximum(p.variance(level), TINY)) for p in parts]
        every = np.concatenate(unit)
        limit = GROWING_NOISE.outlier * robust_sd(every)
        if levels is None:
            limit = float(np.quantile(every, 1 - GROWING_NOISE.few / 2))
        for k, (r, size) in enumerate(zip(out, unit, strict=True)):
            kept = np.ones(len(r.t), dtype=bool)
            highest = maximum_filter1d(size, 3)
            kept[1:-1] = (size <= limit) | (size < highest)
            out[k] = Readings(r.t[kept], r.simulated[kept], r.error[kept])
        out = [r for r in out if len(r.t) > 2]
    return out


def _log_likelihood(parts: Sequence[_Differences], level: float | None) -> float:
    """The largest over the factor; of long records by a part of their differences."""
    step = max(sum(len(p.value) for p in parts) // GROWING_NOISE.most, 1)
    value = np.concatenate([p.value[::step] for p in parts])
    sd = np.concatenate([p.variance(level)[::step] for p in parts])
    sd = np.sqrt(np.maximum(sd, TINY))
    unit = value / sd
    size = float(np.sqrt(np.mean(unit**2)))
    if size == 0.0:
        return float("inf")

    def minus(log_factor: float) -> float:
        t2 = (unit / (size * np.exp(log_factor))) ** 2
        return float(np.sum(np.log(sd) + np.log(size) + log_factor + 2.5 * np.log1p(t2 / 4)))

    return -float(minimize_scalar(minus, bounds=(-4.0, 1.0), method="bounded").fun)


def _is_independent(parts: Sequence[_Differences], level: float) -> bool:
    """True if differences that follow each other vary as those of independent noise.

    Their products are halfway at least from what no correlation gives to what is expected.
    """
    found = expected = 0.0
    unit = np.concatenate([p.value / np.sqrt(p.variance(level)) for p in parts])
    size = robust_sd(unit)
    for p in parts:
        sd = np.sqrt(p.variance(level))
        clipped = np.clip(p.value / (max(size, TINY) * sd), -3.0, 3.0)
        found += float(np.sum(clipped[1:] * clipped[:-1]))
        expected += float(np.sum(p.next_covariance(level) / (sd[1:] * sd[:-1])))
    return found < 0.5 * expected


def size_of_readings(measured: Array, simulated: Array, used: BoolArray) -> Array:
    """(N,) size of what is read, by the simulation, which the noise of a sample has no part in.

    Where the simulation is far from the median of three readings, or breaks down, within a factor
    of that.

    Parameters
    ----------
    measured, simulated, used : (N,) of one output in one record.
    """
    size = np.abs(simulated)
    there = np.flatnonzero(used)
    if len(there) <= 2:
        return np.where(np.isfinite(size), size, 0.0)
    read = np.abs(median_filter(measured[there], size=3, mode="nearest"))
    read = np.interp(np.arange(len(size)), there, read)
    size = np.where(np.isfinite(size), size, read)
    return np.asarray(np.clip(size, read / GROWING_NOISE.far, read * GROWING_NOISE.far))
