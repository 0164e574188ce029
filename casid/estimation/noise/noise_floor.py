"""The white noise of a channel by its own spectrum alone, which bounds it from above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import rfft
from scipy.special import gammainc, gammaincinv
from scipy.stats import norm

from casid.arrays import Array
from casid.estimation.noise.thresholds import CHANNEL_FLOOR


def is_held(records: Sequence[Array]) -> bool:
    """True of a channel that repeats its last value exactly in more than half of its samples."""
    return bool(np.mean(np.concatenate([np.diff(c) == 0.0 for c in records])) > 0.5)


def white_floor(records: Sequence[Array]) -> float:
    """The white noise floor of one channel, (N,) a record.

    Where the signal steps now and then, its spectrum reaches up to Nyquist, but most of its third
    differences are those of the noise: their median counts where it is lower by more than chance.
    """
    floor = _quietest(records)
    between = _between_steps(records)
    by_chance = 2.0 * floor_error([len(values) for values in records])  # standard errors
    return between if 0.0 < between**2 < (1.0 - by_chance) * floor**2 else floor


def _between_steps(records: Sequence[Array]) -> float:
    """Standard deviation of white noise from the median of the third differences' size.

    Each step is in three of them. Of a signal that steps every fifty samples their share alone
    would raise the median by 7 %, so those beyond what noise of that median would give are left out
    in turn.
    """
    size = np.abs(np.concatenate([np.diff(values, 3) for values in records]))
    found = 0.0
    while len(size):
        found = float(np.median(size)) / norm.ppf(0.75)
        within = size[size <= CHANNEL_FLOOR.beyond * found]
        if len(within) == len(size):
            break
        size = within
    return float(found / np.sqrt(20.0))


def _quietest(records: Sequence[Array]) -> float:
    """Standard deviation of white noise from the quietest parts of the upper half band."""
    parts: list[float] = []
    shapes: list[float] = []  # of every part
    for values in records:
        # A taper, else the ends' jump leaks to Nyquist.
        window = np.hanning(len(values))
        spectrum = np.abs(rfft((values - values.mean()) * window)) ** 2 / np.sum(window**2)
        pieces = [p for p in np.array_split(spectrum[len(spectrum) // 2 :], 20) if len(p)]
        parts += [float(p.mean()) for p in pieces]
        # Hann's bins are correlated by 2/3 and 1/6 in amplitude with the next and the second.
        shape = float(np.mean([len(p) for p in pieces])) / (1 + 2 * (4 / 9 + 1 / 36))
        shapes += [max(shape, 0.5)] * len(pieces)
    kept = max(len(parts) // 4, 1)
    ranks = (np.arange(1, kept + 1) - 0.375) / (len(parts) + 0.25)  # Blom's
    expected = float(np.mean(_quantiles(ranks, np.array(shapes))))
    return float(np.sqrt(np.mean(sorted(parts)[:kept]) / expected))


def _quantiles(ranks: Array, shapes: Array) -> Array:
    """Quantiles of means of 1 that are Gamma distributed, each with a shape of its own.

    The parts of a short record scatter more than those of a long one: among the quietest of both
    most are of the short one.
    """
    low = gammaincinv(shapes.min(), ranks) / shapes.min()
    high = gammaincinv(shapes.max(), ranks) / shapes.max()
    if shapes.min() == shapes.max():
        return np.asarray(low)
    each, count = np.unique(shapes, return_counts=True)
    for _ in range(50):  # halvings
        middle = 0.5 * (low + high)
        below = gammainc(each, each * middle[:, None]) @ (count / count.sum()) < ranks
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))


def floor_error(samples: Sequence[int]) -> float:
    """Standard error of the square of `white_floor` for white noise, relative to it.

    The mean of the quietest quarter of parts scatters 1.5 times as much as that of all.
    """
    independent = sum(samples) / 4 / (1 + 2 * (4 / 9 + 1 / 36))
    return float(1.5 / np.sqrt(max(independent, 1.0)))
