"""Band-limited signals between their samples, by a windowed sinc.

A signal without power above half the sampling rate is the sum of its samples, each times
sinc(t / Ts - k) (Shannon 1949). Here the sinc ends after `REACH` samples on both sides, under a
Kaiser window: a sine of up to 0.9 of half the sampling rate is met to 2e-4 of its amplitude, a
constant exactly.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.signal import firwin
from scipy.special import i0, i1

from casid.arrays import Array

REACH = 32
"""Samples on both sides that a value between two of them is made of."""

_BETA = 8.0
"""Shape of the Kaiser window: ripple of 80 dB."""

_NEAR = np.arange(REACH, -REACH, -1)
"""The sample that each weight of a value between samples 0 and 1 belongs to."""


def between_samples(u: Array, parts: int) -> Array:
    """Columns (N, m) at 1/parts, 2/parts, ... of the way to the next sample, (N, m, parts - 1).

    Beyond its ends a column is its own mirror image, turned about the last sample.
    """
    out = np.empty((*u.shape, parts - 1))
    for i, column in enumerate(u.T):
        out[:, i] = _course(column.tobytes(), parts)
    return out


@functools.lru_cache(maxsize=8)
def _course(column: bytes, parts: int) -> Array:
    """Band-limited values of one column, kept, as every fit of a record needs them."""
    u = np.frombuffer(column)
    out = np.empty((len(u), parts - 1))
    if len(u) < 2:
        out[:] = u[:, None]
        return out
    long = np.pad(u, REACH, mode="reflect", reflect_type="odd")
    for j, weights in enumerate(_phases(parts)):
        out[:, j] = np.convolve(long, weights, "valid")[1:]
    return out


@functools.cache
def _phases(parts: int) -> tuple[Array, ...]:
    """Weights (2 REACH,) of the samples around each value, for `numpy.convolve`; their sum is one.

    The value at j / parts lies between samples 0 and 1 and is made of those from 1 - REACH to
    REACH.
    """
    taps = firwin(2 * REACH * parts + 1, 1 / parts, window=("kaiser", _BETA))
    middle = REACH * parts
    out = []
    for j in range(1, parts):
        weights = taps[middle + j - _NEAR * parts]
        out.append(weights / weights.sum())
    return tuple(out)


def responses_between(omega: Array, parts: int) -> Array:
    """Responses (F, parts - 1), at `omega` (F,) rad/sample, of what `between_samples` returns."""
    return _responses(omega.tobytes(), parts)


@functools.lru_cache(maxsize=4)
def _responses(omega: bytes, parts: int) -> Array:
    """The responses at frequencies that a search comes back to, kept: read them only."""
    waves = np.exp(1j * np.frombuffer(omega)[:, None] * _NEAR)
    out = np.asarray(waves @ np.array(_phases(parts)).reshape(parts - 1, -1).T)
    out.flags.writeable = False
    return out


def moved(u: Array, samples: float) -> tuple[Array, Array]:
    """A column (N,) later by a number of samples, and the derivative with that number.

    Before and after the record the column has the value of its first and of its last sample.
    """
    whole = int(np.floor(samples))
    back = np.arange(-REACH, REACH + 2)  # samples before k - whole that a value is made of
    weights, slopes = _kernel(back - (samples - whole))
    total = weights.sum()
    slopes = -(slopes - weights * (slopes.sum() / total)) / total
    pad = REACH + 1 + abs(whole)
    long = np.pad(u, pad, mode="edge")
    first = pad - whole + int(back[0]) - 1  # the last of `back` at sample 0
    n = len(u) + len(back) - 1
    part = long[first : first + n]
    return np.convolve(part, weights / total, "valid"), np.convolve(part, slopes, "valid")


def _kernel(t: Array) -> tuple[Array, Array]:
    """sinc(t) under the Kaiser window of `REACH`, and its slope."""
    share = np.sqrt(np.maximum(1 - (t / (REACH + 1)) ** 2, 0.0))
    window = i0(_BETA * share) / i0(_BETA)
    bent = np.where(share > 0, i1(_BETA * share) / np.maximum(share, 1e-12), 0.5 * _BETA)
    d_window = -_BETA * bent * t / (REACH + 1) ** 2 / i0(_BETA)
    value = np.sinc(t)
    near = np.abs(t) < 1e-4  # by its series, where the quotient would lose digits
    far = np.where(near, 1.0, t)
    d_value = np.where(near, -(np.pi**2) * t / 3, (np.cos(np.pi * far) - np.sinc(far)) / far)
    return value * window, d_value * window + value * d_window
