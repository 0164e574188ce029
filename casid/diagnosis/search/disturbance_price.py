"""When a random disturbance explains a residual, and what an effect in its place is charged."""

from __future__ import annotations

import math

import numpy as np

from casid.arrays import TINY
from casid.estimation.simulation.minimization import Fit


def as_white(fit: Fit) -> float:
    """Minus the log-likelihood of a residual as white noise of its own size in each output.

    A disturbance that is less likely than that is no explanation: its estimate went astray.
    """
    c = fit.criterion
    parts = [np.where(d.used, c.simulated(fit.x, e).residual, 0.0) for e, d in enumerate(c.data)]
    samples = np.sum([d.used.sum(axis=0) for d in c.data], axis=0)
    squares = np.sum([np.sum(p**2, axis=0) for p in parts], axis=0)
    seen = samples > 0
    means = np.maximum(squares[seen] / samples[seen], TINY)
    return float(0.5 * np.sum(samples[seen] * (1 + np.log(means))))


def is_held(fit: Fit) -> bool:
    """True if a bound holds one of the parameters: that leaves misfit of its own."""
    return bool(fit.solution.at_lower or fit.solution.at_upper)


def price_of(cost: int, samples: int, tested: int) -> float:
    """What the extended BIC charges an effect, in units of twice the log-likelihood.

    Parameters
    ----------
    cost : parameters of the effect.
    tested : effects among which it was chosen.
    """
    return cost * math.log(samples) + 2 * math.log(max(tested, 1))
