"""The noise of sensors and inputs alone, with a floor of white noise in every output."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.diagnosis.thresholds import PREWHITENING
from casid.estimation.noise.noise_floor import white_floor
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.simulation.simulation_error import SimulationError


def not_below(noise: NoiseModel, criterion: SimulationError, x: Array) -> NoiseModel:
    """The noise with a white floor: the quietest part of the residual, small against the misfit.

    A force to which an output responds at once (an accelerometer) explains its sensor's noise as
    well as a sensor does. And where sensors have next to no noise, whitening would give most weight
    to frequencies at which hardly anything is left, and misfit of another kind, beside what is to
    be named.
    """
    parts = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
    left = np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0))
    used = [d.used for d in criterion.data]
    quiet = [
        white_floor([p[u[:, i], i] for p, u in zip(parts, used, strict=True)])
        for i in range(len(left))
    ]
    floor = np.maximum(quiet, PREWHITENING.white_share * left)
    return replace(noise, output_sd=np.maximum(noise.output_sd, floor))
