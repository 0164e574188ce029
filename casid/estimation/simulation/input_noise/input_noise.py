"""The noise of inputs: in which records a channel has it, and draws of it for a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from casid.arrays import Array, BoolArray
from casid.data.record import Record, with_samples
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError


def noisy_inputs(data: Sequence[Signals], experiment: int) -> BoolArray:
    """(nu,) inputs whose channel may have noise in this record: noise would show where one rests.

    So rests the force in a coast-down beside runs under power. An input that rests in every record
    says nothing of its noise, and what is stated of it acts.
    """
    moves = np.array([np.any(d.u != d.u[:1], axis=0) for d in data])
    return np.asarray(moves[experiment] | ~moves.any(axis=0))


def input_noise_sd(data: Sequence[Signals], experiment: int, sd: Array) -> Array:
    """(nu,) standard deviations of the inputs' noise in one record, 0 of what rests there.

    Parameters
    ----------
    sd : (nu,) of the channels, SI units.
    """
    return np.asarray(sd * noisy_inputs(data, experiment))


def with_input_noise(
    record: Record,
    criterion: SimulationError,
    experiment: int,
    sd: Mapping[str, float],
    rng: np.random.Generator,
) -> Record:
    """The record of an experiment with a draw of white noise on its inputs, one after another.

    Parameters
    ----------
    sd : input -> standard deviation of its channel, SI units.
    """
    names = list(criterion.model.inputs)
    own = np.array([sd.get(name, 0.0) for name in names])
    here = dict(zip(names, input_noise_sd(criterion.data, experiment, own).tolist(), strict=True))
    for name in sd:
        noise = here[name] * rng.standard_normal(record.N)
        record = with_samples(record, name, record[name] + noise)
    return record
