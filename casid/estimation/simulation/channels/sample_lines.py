"""Inputs as a straight line in each sample: held, joined, delayed by a part of a sample, lagging.

A held input that is delayed by a part of a sample steps within samples, and a joined one bends
there. The line that stands for it has its mean and first moment over the sample, so that nothing
moves in time; both are differentiable in the delay. Without a delay the line is the input itself.
"""

from __future__ import annotations

import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.channels.first_order_lags import delay_held
from casid.model.declarations import Hold


def lines_of(u: Array, hold: Hold) -> Array:
    """A column (N,) as (N, 3): its value at the sample, where the line begins, where it ends."""
    after = u if hold == "zoh" else np.concatenate([u[1:], u[-1:]])
    return np.stack([u, u, after], axis=1)


def delayed_lines(
    u: Array, samples: float, hold: Hold, before: float | None = None
) -> tuple[Array, Array]:
    """Lines (N, 3) of an input column delayed by any number of samples, and their derivative.

    With s the part of a sample, v the value one delay before a sample, c and d what it rose by
    within the sample before and rises by within the next one, and q = 1 - s, mean and tilt are

        held:    v - s c,                     6 s q c                                         (1)
        joined:  v - s^2 c / 2 + q^2 d / 2,   (3 s^2 - 2 s^3) c + (3 q^2 - 2 q^3) d           (2)

    Before the record the input was what `before` says, by default what it is at its first sample;
    after the last one it is held.
    """
    whole = int(np.floor(samples))
    s = samples - whole
    q = 1.0 - s
    long = np.concatenate([u[:1] if before is None else [before], u])
    places = np.arange(1, len(long)) - whole
    last = len(u)
    v = long[np.clip(places, 0, last)]
    c = v - long[np.clip(places - 1, 0, last)]
    if hold == "zoh":
        now, d_now = delay_held(u, samples, before)
        mean, d_mean = v - s * c, -c
        tilt, d_tilt = 6 * s * q * c, 6 * (q - s) * c
    else:
        d = long[np.clip(places + 1, 0, last)] - v
        now, d_now = v - s * c, -c
        mean, d_mean = v - 0.5 * s**2 * c + 0.5 * q**2 * d, -s * c - q * d
        tilt = (3 - 2 * s) * s**2 * c + (3 - 2 * q) * q**2 * d
        d_tilt = 6 * s * q * (c - d)
    return _line(now, mean, tilt), _line(d_now, d_mean, d_tilt)


def _line(now: Array, mean: Array, tilt: Array) -> Array:
    return np.stack([now, mean - 0.5 * tilt, mean + 0.5 * tilt], axis=1)
