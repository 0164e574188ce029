"""Steps of Runge and Kutta that a sample needs for its slopes in the states."""

from __future__ import annotations

import numpy as np

from casid.arrays import Array
from casid.estimation.noise.thresholds import STEPS


def fewest_steps(slopes: Array, least: int, most: int) -> int:
    """The fewest steps, from `least` on, that pass states on as `most` of them do.

    Parameters
    ----------
    slopes : (n, nx, nx) of the rates in the states, times the sample time.
    """
    exact = passed(slopes, most)
    size = np.max(np.abs(exact), initial=1.0)
    for n in range(least, most):
        if np.all(np.abs(passed(slopes, n) - exact) <= STEPS.resolved * size):
            return n
    return most


def passed(slopes: Array, steps: int) -> Array:
    """(n, nx, nx) what so many steps make of the states over a sample with these slopes."""
    h, once = slopes / steps, np.eye(slopes.shape[1])
    for k in (4, 3, 2, 1):
        once = np.eye(slopes.shape[1]) + h @ once / k
    return np.linalg.matrix_power(once, steps)
