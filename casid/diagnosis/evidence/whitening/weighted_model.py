"""A model fitted under a noise model, and how likely it makes the records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Weighted:
    """A model fitted under one noise model."""

    model: Model
    fit: Fit
    noise: NoiseModel  # what it is fitted under
    full: NoiseModel  # with what may be a disturbance
    input_sd: Mapping[str, float]
    noise_absorbs_misfit: bool  # much of it is explained by neither sensors nor measured inputs
    unbiased: Fit | None = None  # where the noise of the inputs has no part in the estimate, or a
    # disturbance counts by the response of the model itself
    beside: Weighted | None = None  # the same under disturbances, where these were sought

    @property
    def criterion(self) -> SimulationError:
        """The whitened criterion at its minimum."""
        return self.fit.criterion

    @property
    def likelihoods(self) -> Weighted:
        """The model under noise with disturbances, which gives likelihoods, where that was sought.

        Where it absorbs misfit, the noise of sensors and inputs alone gives none.
        """
        return self.beside if self.noise_absorbs_misfit and self.beside is not None else self


def minus_log_likelihood(at: Weighted, counted: SimulationError | None = None) -> float:
    """Whittle's, of the residual under the noise that the model is fitted under.

    Parameters
    ----------
    counted : whose samples count. Of those that the model leaves out, the first ones of a late
        input, each counts as much as is expected of it: no model is more or less likely for that.
    """
    if at.noise.spectra and at.unbiased is not None:
        at = replace(at, fit=at.unbiased)
    return at_point(at, counted)


def at_point(at: Weighted, counted: SimulationError | None = None) -> float:
    """`minus_log_likelihood` at the parameters of the fit."""
    noise, value, data = at.noise, at.fit.solution.value, at.criterion.data
    if counted is not None:
        left_out = [its.used & ~d.used for its, d in zip(counted.data, data, strict=True)]
        if any(mask.any() for mask in left_out):
            whole = [d.used | mask for d, mask in zip(data, left_out, strict=True)]
            noise = replace(noise, used=whole)
            value += 0.5 * sum(int(mask.sum()) for mask in left_out)
    logs = sum(noise.log_determinant(e, d.N) for e, d in enumerate(data))
    return value + 0.5 * logs
