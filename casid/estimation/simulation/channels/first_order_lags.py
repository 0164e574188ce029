"""First-order lags of sampled signals, exact for what a signal does between its samples.

A lag of time constant tau answers to a signal w with

    tau dx/dt + x = w,    x[k] = E x[k-1] + (1/tau) int exp(-(t_k - s)/tau) w(s) ds            (1)

over the last sample, E = exp(-Ts/tau). Where w is a polynomial in each sample the integral is in
closed form, and so is its derivative with tau, down to tau = 0. A recursion on the samples alone
would bring an error of half a sample, which passes for a delay.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.special import hyp1f1

from casid.arrays import Array

COINCIDENT = 0.1
"""Sample times below which a held input's step and the sample that it falls on are simultaneous."""


def lag_columns(y: Array, samples: float, *, at_rest: bool = False) -> tuple[Array, Array]:
    """Columns (N, ...) of a smooth signal behind a lag, and their derivative with the lag.

    Between samples the signal is a cubic through two neighbours with centred slopes (Keys 1981),
    the interpolation of a delay: without a lag the derivative is minus the slope that a delay has
    without a delay. The ends are extended by straight lines, and so is the past.

    Parameters
    ----------
    samples : time constant over the sample time, not negative.
    at_rest : in the past the signal was what it is at the first sample.
    """
    r = samples
    decay, slope = _decay(r)
    first = 0.0 * y[0] if at_rest else y[1] - y[0]
    long = np.concatenate([y[:1] - first, y, 2 * y[-1:] - y[-2:-1]])
    before, left, right, after = long[:-3], long[1:-2], long[2:-1], long[3:]
    cubic = (
        left,
        0.5 * (right - before),
        before - 2.5 * left + 2.0 * right - 0.5 * after,
        0.5 * (after - before) + 1.5 * (left - right),
    )
    moments, changes = _moments(r)
    driven = sum(m * c for m, c in zip(moments, cubic, strict=True))
    change = sum(m * c for m, c in zip(changes, cubic, strict=True))
    x = _recursion(decay, y[0] - r * first, driven)
    return x, _recursion(decay, -first, change + slope * x[:-1])


def filtered(y: Array, samples: float) -> tuple[Array, Array]:
    """Samples (N, ...) behind x[k] = x[k-1] + (y[k] - x[k-1])/(1 + r), and its derivative with r.

    An exponential moving average, r its time constant over the sample time; it begins at y[0].
    """
    keep = samples / (1 + samples)
    x = _recursion(keep, y[0], (1 - keep) * y[1:])
    return x, _recursion(keep, 0.0 * y[0], (x[:-1] - y[1:]) / (1 + samples) ** 2)


def lag_held(u: Array, samples: float) -> tuple[Array, Array]:
    """Held columns (N, ...) behind a lag at the samples, and their derivative with the lag.

    A step moves nothing behind a lag at the sample that it falls on; without a lag the new value
    counts there, and for lags shorter than `COINCIDENT` samples a value between the two.
    """
    decay, slope = _decay(samples)
    x = _recursion(decay, u[0], (u * (1 - decay))[:-1])
    dx = _recursion(decay, 0.0 * u[0], (slope * (x - u))[:-1])
    new, d_new = at_the_step(samples)
    return x + new * (u - x), (1 - new) * dx + d_new * (u - x)


def delay_held(u: Array, samples: float, before: float | None = None) -> tuple[Array, Array]:
    """A lag behind a delay of any number of samples, and its derivative with the delay.

    Before the record stands `before`, by default the first value.
    """
    whole = int(np.floor(samples))
    first = u[:1] if before is None else np.full_like(u[:1], before)
    late = np.concatenate([np.repeat(first, whole + 1, axis=0), u])[: len(u) + 1]
    new, d_new = at_the_step(samples - whole)
    rise = late[1:] - late[:-1]
    return late[:-1] + new * rise, d_new * rise


def at_the_step(samples: float) -> tuple[float, float]:
    """Share of the new value at the sample on which a step falls, and its derivative."""
    if samples >= COINCIDENT:
        return 0.0, 0.0
    left = 1 - samples / COINCIDENT
    return left**2, -2 * left / COINCIDENT


def lag_lines(
    lines: Array, samples: float, *, steps: bool, before: float | None = None
) -> tuple[Array, Array]:
    """An input (N, 3) of a line in each sample behind a lag, the same, and the derivative with it.

    The columns are the value at the sample, where the line begins, and where it ends. A
    held input that steps moves nothing behind a lag at the sample itself, but the line that stands
    for what follows begins beside it. Without a lag it is the new value that acts there: for lags
    shorter than `COINCIDENT` samples the value of an input that `steps` lies between the two. Mean
    and first moment over the sample are those of the exact response to the lines, so that nothing
    moves in time; without a lag they are the lines. Before the record the input was what `before`
    says, by default what it is at its first sample.
    """
    decay, slope = _decay(samples)
    (p, h, f, g), (dp, dh, df, dg) = _line_weights(samples)
    given, u, rise = lines[:, 0], lines[:, 1], lines[:, 2] - lines[:, 1]
    # From (1) with w = u + rise a, 0 <= a <= 1: x(a) = w(a) - r rise + (x - u + r rise) exp(-a/r).
    driven = u * (1 - decay) + rise * (1 - p)
    x = _recursion(decay, given[0] if before is None else before, driven[:-1])
    dx = _recursion(decay, 0.0, (slope * (x - u) - dp * rise)[:-1])
    mean = u + 0.5 * rise + p * (x - u) - h * rise
    d_mean = dp * (x - u) + p * dx - dh * rise
    tilt = (1 - f) * rise - g * (x - u)
    d_tilt = -df * rise - dg * (x - u) - g * dx
    now, d_now = x, dx
    if steps:
        new, d_new = at_the_step(samples)
        now, d_now = x + new * (given - x), (1 - new) * dx + d_new * (given - x)
    return (
        np.stack([now, mean - 0.5 * tilt, mean + 0.5 * tilt], axis=1),
        np.stack([d_now, d_mean - 0.5 * d_tilt, d_mean + 0.5 * d_tilt], axis=1),
    )


def _line_weights(r: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Weights of a line under exp(-a/r) over 0 <= a <= 1, and their derivatives with r:

    int exp, int (1 - a) exp, F = 6 int a (1 - a) exp and F / r.
    """
    if r > 1.0:  # the closed forms below would lose digits
        z = 1 / r
        p, h, f = _kummer(1, 2, -z), 0.5 * _kummer(1, 3, -z), _kummer(2, 4, -z)
        dp = 0.5 * z * z * _kummer(2, 3, -z)
        dh = z * z / 6 * _kummer(2, 4, -z)
        df = 0.5 * z * z * _kummer(3, 5, -z)
        return (p, h, f, z * f), (dp, dh, df, z * df - z * z * f)
    decay, slope = _decay(r)
    p, dp = r * (1 - decay), 1 - decay - r * slope
    h, dh = r * (1 - p), 1 - p - r * dp
    g, dg = 12 * r * (0.5 + 0.5 * decay - p), 12 * (0.5 + 0.5 * decay - p + r * (0.5 * slope - dp))
    return (p, h, r * g, g), (dp, dh, g + r * dg, dg)


def _kummer(a: float, b: float, x: float) -> float:
    """Kummer's function 1F1, of derivative a / b 1F1(a + 1, b + 1, x)."""
    return float(hyp1f1(a, b, x))


def _decay(r: float) -> tuple[float, float]:
    """E = exp(-1/r) and its derivative with r; both vanish with r, faster than any power."""
    if r < 1e-3:
        return 0.0, 0.0
    decay = float(np.exp(-1 / r))
    return decay, decay / r**2


def _moments(r: float) -> tuple[list[float], list[float]]:
    """int v^n exp(-(1-v)/r) dv / r over [0, 1] for n = 0..3, and the derivatives with r."""
    if r > 1.0:  # the recursion below would lose digits
        z = 1 / r
        value = [_kummer(1, n + 2, -z) / (n + 1) for n in range(4)]
        bent = [_kummer(2, n + 3, -z) / ((n + 1) * (n + 2)) for n in range(4)]
        return [z * v for v in value], [
            -z * z * (v - z * b) for v, b in zip(value, bent, strict=True)
        ]
    decay, slope = _decay(r)
    out, change = [1 - decay], [-slope]
    for n in range(1, 4):
        change.append(-n * (out[-1] + r * change[-1]))
        out.append(1 - n * r * out[-1])
    return out, change


def _recursion(decay: float, start: Any, driven: Array) -> Array:
    """x[0] = start, x[k] = decay x[k-1] + driven[k-1]; (M, ...) -> (M + 1, ...)."""
    out = np.concatenate([np.broadcast_to(start, (1, *driven.shape[1:])), driven])
    return np.asarray(lfilter([1.0], [1.0, -decay], out, axis=0))
