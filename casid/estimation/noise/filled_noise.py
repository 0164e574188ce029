"""Noise of an input that was not recorded in every sample of the clock, and filled between.

White noise of the recorded samples is joined as they are: each stands in its neighbours by a kernel
of the two intervals beside it, a hat where samples are joined by straight lines, a box where they
are held. With K_i the transform of that of sample i, the periodogram's mean is, for noise of unit
variance,

    S(w) = sum_i |K_i(w)|^2 / N.                                                              (1)

Where intervals differ such noise is not stationary; what linear filters make of it has the same
mean square as what they make of stationary noise with this spectrum, but for a record's ends.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array, BoolArray
from casid.estimation.simulation.input_noise.input_noise import noisy_inputs
from casid.estimation.simulation.records.signals import Signals
from casid.model.declarations import Hold


def filled_spectrum(filled: BoolArray, hold: Hold, omega: Array) -> Array:
    """(F,) S of (1) at the frequencies `omega` (F,), rad/sample."""
    there = np.flatnonzero(~filled)
    between = np.diff(there)
    sides = np.column_stack([[1, *between], [*between, 1]])
    kinds, counts = np.unique(sides, axis=0, return_counts=True)
    out = np.zeros(len(omega))
    for (before, after), count in zip(kinds.tolist(), counts.tolist(), strict=True):
        if hold == "zoh":
            places, weights = np.arange(after), np.ones(after)
        else:
            places = np.arange(1 - before, after)
            weights = 1 - np.abs(places) / np.where(places < 0, before, after)
        kernel = np.exp(-1j * np.outer(omega, places)) @ weights
        out += count * np.abs(kernel) ** 2
    return np.asarray(out / len(filled))


def noise_spectrum(
    data: Sequence[Signals], experiment: int, column: int, named: tuple[str, Hold], omega: Array
) -> Array:
    """(F,) of unit noise of an input in one record, by where its samples are; 0 where it rests.

    Parameters
    ----------
    column, named : its place, and its name and hold.
    """
    name, hold = named
    filled = data[experiment].filled
    if not noisy_inputs(data, experiment)[column]:
        return np.zeros(len(omega))
    return filled_spectrum(filled[name], hold, omega) if name in filled else np.ones(len(omega))
