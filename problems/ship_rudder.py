"""What the rudder is told: zigzags and random steps, and a look at whether it did."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def stuck_rudder(delta: ArrayLike, limits: tuple[float, float], Ts: float) -> str | None:
    """Say so if a rudder lies at a limit for a tenth of its record in one stretch; else None.

    Parameters
    ----------
    delta : (N,) rudder angle [rad].
    limits : smallest and largest angle [rad].
    Ts : sample time [s].
    """
    angle = np.asarray(delta, dtype=np.float64)
    slack = 1e-3 * (limits[1] - limits[0])
    at_limit = (angle <= limits[0] + slack) | (angle >= limits[1] - slack)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_limit.astype(int), [0]])))
    stretches = edges[1::2] - edges[::2]
    if not stretches.size or stretches.max() < 0.1 * angle.size:
        return None
    longest = int(np.argmax(stretches))
    first = int(edges[2 * longest])
    return (
        f"rudder at its limit of {math.degrees(angle[first]):.1f} deg for "
        f"{stretches[longest] * Ts:.1f} s from t = {first * Ts:.1f} s, and for "
        f"{100 * at_limit.mean():.0f} % of the record: it excites nothing there. "
        "Command less, or leave that stretch out."
    )


def zigzag(duration: float, *, angle: float, every: float, Ts: float = 0.02) -> Array:
    """(N,) rudder command [rad]: angle and its opposite in turn, first to port.

    Parameters
    ----------
    duration, every : of the record and of one side [s].
    angle : [rad].
    Ts : sample time [s].
    """
    t = Ts * np.arange(round(duration / Ts))
    return np.asarray(np.where(np.floor((t + 1e-9) / every) % 2 == 0, angle, -angle))


def random_steps(
    duration: float, *, angle: float, hold: float, seed: int, Ts: float = 0.02
) -> Array:
    """(N,) rudder command [rad]: levels uniform in +-angle, each held for `hold` s on average."""
    rng, N = np.random.default_rng(seed), round(duration / Ts)
    change = rng.random(N) < Ts / hold
    change[0] = True
    levels = rng.uniform(-angle, angle, N)
    return np.asarray(levels[np.maximum.accumulate(np.where(change, np.arange(N), 0))])
