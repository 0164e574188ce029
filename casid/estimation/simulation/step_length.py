"""Whether the steps of a filter are short enough, by what half of them changes."""

from __future__ import annotations

import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.thresholds import STEPS


def moves_likelihood(coarse: float, fine: float, samples: int) -> bool:
    """True if half the step changes the logarithm of a likelihood of so many samples too much.

    The coarse one overflowing counts as a change, both of them as none: finer is no better.
    """
    if np.isfinite(fine) and not np.isfinite(coarse):
        return True
    return bool(abs(fine - coarse) > STEPS.filter_at_start * samples)


def moves_minimum(gradient: Array, hessian: Array) -> bool:
    """True if half the step moves a minimum by too much of its standard errors.

    Parameters
    ----------
    gradient : (n,) what half the step adds to that of minus the log likelihood at the minimum.
    hessian : (n, n) Fisher information there.
    """
    length = gradient @ np.linalg.pinv(hessian, rcond=1e-12) @ gradient
    return bool(np.sqrt(abs(length)) > STEPS.filter_at_end)
