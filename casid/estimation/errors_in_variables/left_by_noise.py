"""What noise on sensors and inputs leaves to least squares, and how much noise a residual allows.

The spectrum of an input bounds its white noise only from above: a recorded command that is drawn
anew at every sample is as white as noise. But what least squares leaves has the noise in it. Where
it leaves far less than noise of that size would, the input has less.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from casid.arrays import TINY, Array, BoolArray
from casid.estimation.errors_in_variables.equations import columns_of, gaussian_noise
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.thresholds import REMOVAL
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError


def squares(criterion: SimulationError, x: Array) -> float:
    """Weighted sum of squared residuals at `x` (n,), of all records."""
    total = 0.0
    for e, d in enumerate(criterion.data):
        residual = criterion.simulated(x, e).residual * criterion.weights
        total += float(np.sum(np.where(d.used, residual, 0.0) ** 2))
    return total


def left_by_noise(
    criterion: SimulationError,
    x: Array,
    free: BoolArray,
    input_sd: Mapping[str, float],
    output_sd: Array,
    seed: int = 0,
) -> Array:
    """(m, 3) what least squares leaves of so many records of noise.

    Weighted sums of squares of what the inputs' noise leaves, of what the outputs' does, and twice
    their product: the sum of the three is that of both.

    Parameters
    ----------
    x : (n,) where the simulation is linearised.
    free : (n,) bool, False at active bounds.
    input_sd : measured input -> standard deviation of its noise.
    output_sd : (ny,) of the noise of the outputs, in their units.
    seed : of the draws.
    """
    used = np.concatenate([d.used.ravel() for d in criterion.data])
    out = []
    for draw in range(REMOVAL.left_records):
        rng = np.random.default_rng((seed, draw))
        columns = columns_of(criterion, x, input_sd, draw, drawn=gaussian_noise)
        parts = [
            (
                sum((source.moved for source in part.noise), np.zeros(part.residual.shape)),
                output_sd * criterion.weights * rng.standard_normal(part.residual.shape),
            )
            for part in columns
        ]
        tangents = [part.tangent.reshape(-1, len(x)) for part in columns]
        t = np.concatenate(tangents)[used][:, free]
        t = t / np.maximum(np.linalg.norm(t, axis=0), TINY)
        r = np.stack([np.concatenate([p[i].ravel() for p in parts])[used] for i in (0, 1)], axis=1)
        left = r - t @ np.linalg.lstsq(t, r, rcond=None)[0]
        moved, own = left.T
        out.append((moved @ moved, own @ own, 2 * moved @ own))
    return np.array(out)


def share_that_is_there(
    fit: Fit, noise: NoiseModel, input_sd: Mapping[str, float], seed: int = 0
) -> float:
    """Which share of `input_sd` the residual of a fit allows, at most 1.

    Less than 1 only where noise of that size would leave more to least squares than the fit has, by
    more than chance.

    Parameters
    ----------
    noise : the noise found at the fit; of it that of the outputs counts.
    input_sd : measured input -> standard deviation of its noise, by other evidence.
    """
    criterion = fit.criterion
    if not any(input_sd.values()):
        return 1.0
    quiet = noise.quiet(input_sd)
    expected = sum(
        float(d.used.sum(axis=0) @ (quiet.floor(e) * criterion.weights) ** 2)
        for e, d in enumerate(criterion.data)
    )
    least = max(squares(criterion, fit.x), TINY)
    if expected <= least:
        return 1.0  # what least squares leaves is less than that
    moved, own, both = left_by_noise(
        criterion, fit.x, fit.solution.is_free, input_sd, noise.output_sd, seed
    ).T
    left = np.log(np.maximum(moved + own + both, TINY))
    if left.mean() - np.log(least) <= REMOVAL.left_spreads * left.std(ddof=1):
        return 1.0
    return float(np.sqrt(min(max(least - own.mean(), 0.0) / max(moved.mean(), TINY), 1.0)))
