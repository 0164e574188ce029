"""Whether what a disturbance moves is whitened by a response that changes along the record.

`noise` whitens by one response, the average of a record. Where a flow, a speed or a load changes
what a force does, the residual that it leaves is neither stationary nor white under that, and
passes for a function of what changed the response. A filter along the path (`varying_innovations`)
is used in its place where the residual is likelier under it, at the same variances and spectra.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.estimation.noise import NoiseModel
from casid.estimation.noise_response import joined_steps, steps_along
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.varying_innovations import varying_innovations

LIKELIER = 5.0
"""Units of log-likelihood by which the residual has to be likelier: ends of a record, which the
two do not begin alike, and sampled spectra make a few."""


def with_varying_response(
    noise: NoiseModel,
    criterion: SimulationError,
    x: Array,
    *,
    residuals: Sequence[Array] | None = None,
) -> NoiseModel:
    """The noise at `x` with the innovations of a response that varies, where it is seen to.

    The same as given of white sources, of a model that is linear and constant, with delays and lags
    beside its equations, and of inputs that are filled between their samples.

    Parameters
    ----------
    residuals : (N, ny) an experiment, default those at `x`.
    """
    records = range(len(criterion.data))
    if not noise.spectra or criterion.model.stages or criterion.segments > 1:
        return noise
    for e, d in enumerate(criterion.data):
        if d.filled or len(criterion.starts_anew(e)):
            return noise
    found = []
    with np.errstate(all="ignore"):
        for e in records:
            steps = steps_along(criterion, x, e)
            if steps is None:
                return noise
            of = noise.output_sd, noise.source_sd, noise.spectra, noise.weights
            try:
                found.append(varying_innovations(joined_steps(steps, noise.spectra), *of))
            except np.linalg.LinAlgError:  # it diverges along the path
                return noise
        varying = replace(noise, varying=found)
        if residuals is None:
            residuals = [criterion.simulated(x, e).residual for e in records]
        gain = _misfit(noise, criterion, residuals) - _misfit(varying, criterion, residuals)
    return varying if gain > LIKELIER else noise


def _misfit(noise: NoiseModel, criterion: SimulationError, residuals: Sequence[Array]) -> float:
    """Minus the log-likelihood of residuals (N, ny)."""
    value = 0.0
    for e, d in enumerate(criterion.data):
        weighted = np.where(d.used, residuals[e], 0.0) * noise.weights
        white = noise.whiten(weighted[:, :, None], e)
        value += 0.5 * float(np.sum(white**2)) + 0.5 * noise.log_determinant(e, d.N)
    return value
