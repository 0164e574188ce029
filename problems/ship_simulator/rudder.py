"""Commands to the rudder: zigzags, random steps, an autopilot, and a look at whether it did."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from casid.errors import DataError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class HeadingAutopilot:
    """Holds a course: delta = K_p (psi - course) + K_d r, as positive rudder turns to port.

    The error is the shorter way round. Against a steady torque there stays an error of the rudder
    that it takes, divided by K_p.

    Attributes
    ----------
    K_p : rudder per heading error [rad/rad].
    K_d : rudder per yaw rate [s].
    limit : largest angle of a command [rad]; the rudder's own limits, and its rate, hold too.
    """

    K_p: float = 1.0
    K_d: float = 0.5
    limit: float = math.radians(35.0)

    def __post_init__(self) -> None:
        if not (0.0 < self.K_p < math.inf and 0.0 <= self.K_d < math.inf and self.limit > 0.0):
            raise DataError(
                f"autopilot: K_p = {self.K_p!r}, K_d = {self.K_d!r} s, limit = {self.limit!r} rad. "
                "Give K_p > 0, K_d >= 0 and a limit > 0; other signs steer away from the course."
            )

    def __call__(self, error: Any, r: Any) -> Any:
        """Rudder command [rad], from psi - course [rad] and yaw rate [rad/s], as expressions."""
        error = ca.atan2(ca.sin(error), ca.cos(error))
        return ca.fmin(ca.fmax(self.K_p * error + self.K_d * r, -self.limit), self.limit)


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
