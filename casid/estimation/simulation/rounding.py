"""Rounding of a measured input that repeats most of its readings.

Such a channel shows no noise near Nyquist, and is not exact for that: its error is uniform within a
step (Widrow and Kollar, Quantization Noise, Cambridge 2008, chapter 5). Near rest it is a part of
the signal, and passes for dry friction or a dead zone where it is taken for none.
"""

from __future__ import annotations

import numpy as np

from casid.arrays import Array
from casid.data.channel_quality import quantisation_step
from casid.estimation.simulation.thresholds import READINGS


def rounding_of(values: Array) -> float:
    """Standard deviation of the rounding of a channel (N,), 0 where it is not rounded so.

    A command has levels of its own and no error: it goes from one to another by many steps at once,
    or at a rate of its own (a rudder that its gear turns), one equal step after the other.
    """
    step = quantisation_step(values)
    if step is None or np.mean(np.diff(values) != 0.0) >= 1 - READINGS.repeated:
        return 0.0
    counts = np.round((values - values.min()) / step)
    if len(np.unique(counts)) < READINGS.levels:
        return 0.0
    moves = np.diff(counts)
    is_alone = np.abs(moves) == 1
    is_alone[1:] &= moves[1:] != moves[:-1]
    is_alone[:-1] &= moves[:-1] != moves[1:]
    share = is_alone.sum() / max(np.count_nonzero(moves), 1)
    return step / float(np.sqrt(12.0)) if share >= READINGS.single else 0.0
