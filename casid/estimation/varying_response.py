"""Whether what a source of noise moves is whitened by a response that changes along the record.

`noise` whitens by one response, the average of a record. Where a flow, a speed or a load changes
what a force or the noise of an input does, the residual that it leaves is neither stationary nor
white under that, and passes for a function of what changed the response. A filter along the path
(`varying_innovations`) is used in its place where the residual is likelier under it, at the same
variances and spectra, or with the noise of the inputs in place of a force.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.estimation.input_noise_floor import input_noise_floor
from casid.estimation.noise import estimate_noise
from casid.estimation.noise_model import NoiseModel
from casid.estimation.noise_response import Steps, joined_steps, may_vary, steps_along
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.varying_innovations import varying_innovations

LIKELIER = 5.0
"""Units of log-likelihood by which the residual has to be likelier: ends of a record, which the
two do not begin alike, and sampled spectra make a few."""
NOTICEABLE = 0.01
"""Of the residual's power, beyond which the noise of an input counts as one."""


def with_varying_response(
    noise: NoiseModel,
    criterion: SimulationError,
    x: Array,
    known: Mapping[str, float],
    *,
    residuals: Sequence[Array] | None = None,
) -> NoiseModel:
    """The noise at `x` with the innovations of a response that varies, where it is seen to.

    The same as given of a model that is linear and constant, with delays and lags beside its
    equations, and of inputs that are filled between their samples. Where the input of a product is
    noisy, its average response may fit the residual less well than that of a force: noise of the
    inputs alone, at the floors of their channels, is what such forces are compared with.

    Parameters
    ----------
    known : channel -> standard deviation of its white noise, where it is known.
    residuals : (N, ny) an experiment, default those at `x`.
    """
    records = range(len(criterion.data))
    moving = [n for n, sd in noise.source_sd.items() if sd > 0.0]
    if not moving or criterion.model.stages or criterion.segments > 1 or not may_vary(criterion):
        return noise
    for e, d in enumerate(criterion.data):
        if d.filled or len(criterion.starts_anew(e)):
            return noise
    along: dict[tuple[str, ...], list[Steps]] = {}
    if residuals is None:
        residuals = [criterion.simulated(x, e).residual for e in records]
    found, least = noise, _misfit(noise, criterion, residuals) - LIKELIER
    for alike in _alternatives(noise, criterion, x, known, residuals):
        noisy = _noisy_inputs(alike, criterion)
        if noisy not in along:
            along[noisy] = [steps_along(criterion, x, e, noisy) for e in records]
        varying = _along(alike, along[noisy])
        if varying is None:
            continue
        misfit = _misfit(varying, criterion, residuals)
        if misfit < least:
            found, least = varying, misfit
    return found


def _misfit(noise: NoiseModel, criterion: SimulationError, residuals: Sequence[Array]) -> float:
    """Minus the log-likelihood; forces and their spectra are priced by Schwarz's criterion."""
    inputs = criterion.model.inputs
    forces = sum(sd > 0.0 and name not in inputs for name, sd in noise.source_sd.items())
    price = 0.5 * (forces + len(noise.spectra)) * float(np.log(criterion.n_samples))
    return noise.minus_log_likelihood(residuals) + price


def _alternatives(
    noise: NoiseModel,
    criterion: SimulationError,
    x: Array,
    known: Mapping[str, float],
    residuals: Sequence[Array],
) -> Iterator[NoiseModel]:
    """What may act through a response that varies: the noise as found, or that of inputs alone.

    What is found by the average response is no better than that. Floors do not need one.
    """
    inputs = criterion.model.inputs
    measured = [n for n, u in inputs.items() if u.kind == "measured"]
    if noise.spectra or any(noise.source_sd.get(n, 0.0) > 0.0 for n in measured):
        yield noise
    floors = input_noise_floor(criterion.data, list(inputs))
    held = {n: known.get(n, floors[n]) for n in measured}
    noisy = {n: sd for n, sd in held.items() if sd > 0.0}
    if noisy and noisy != {n: sd for n, sd in noise.source_sd.items() if sd > 0.0}:
        of_inputs = estimate_noise(
            criterion,
            x,
            known={**known, **held},
            residuals=residuals,
            responses=noise.responses,
            has_disturbances=False,
        )
        yield replace(of_inputs, known=noise.known)


def _noisy_inputs(noise: NoiseModel, criterion: SimulationError) -> tuple[str, ...]:
    """Those whose noise is a noticeable part of the residual's."""
    return tuple(
        name
        for name, u in criterion.model.inputs.items()
        if u.kind == "measured" and noise.makes(name, NOTICEABLE, criterion.data)
    )


def _along(noise: NoiseModel, steps: Sequence[Steps]) -> NoiseModel | None:
    """The noise with innovations along these steps; None where they diverge."""
    found = []
    with np.errstate(all="ignore"):
        for each in steps:
            of = noise.output_sd, noise.source_sd, noise.spectra, noise.weights
            try:
                found.append(varying_innovations(joined_steps(each, noise.spectra), *of))
            except np.linalg.LinAlgError:
                return None
    return replace(noise, varying=found)
