"""When a random disturbance explains a residual, and what an effect in its place is charged."""

from __future__ import annotations

import math

import numpy as np

from casid.arrays import TINY
from casid.diagnosis.evidence.whitening.holding_bounds import held_beyond_chance
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.diagnosis.search.rounds import Search
from casid.estimation.simulation.minimization import Fit


def under_likelier_disturbance(search: Search, start: Weighted, fit: Fit) -> Weighted | None:
    """A model under the disturbances that its residual shows, where these may explain its misfit.

    None where the sensors' noise holds no misfit, where a bound holds a parameter beyond chance
    under them, too, which leaves misfit of its own, or where white noise is likelier.

    Parameters
    ----------
    start, fit : the model, under the sensors' noise and by its simulation error.
    """
    if not start.noise_absorbs_misfit:
        return None
    bare = search.under_disturbance(fit)
    if held_beyond_chance(bare.unbiased or bare.fit):
        return None
    return bare if minus_log_likelihood(bare) <= as_white(fit) else None


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


def price_of(cost: int, samples: int, tested: int) -> float:
    """Penalty of an effect by the extended BIC, in units of twice the log-likelihood.

    Parameters
    ----------
    cost : parameters of the effect.
    tested : effects among which it was chosen.
    """
    return cost * math.log(samples) + 2 * math.log(max(tested, 1))
