"""A bound on the noise of measured inputs, by the channels alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.arrays import BoolArray
from casid.estimation.noise.noise_floor import floor_error, is_held, white_floor
from casid.estimation.noise.variances import with_rounding
from casid.estimation.simulation.input_noise.foreseen_noise import foreseen_noise
from casid.estimation.simulation.input_noise.input_noise import noisy_inputs
from casid.estimation.simulation.records.signals import Signals


def input_noise_floor(signals: Sequence[Signals], inputs: Sequence[str]) -> dict[str, float]:
    """Estimated bound on each input's white noise: the quietest spectrum near Nyquist.

    The upper half band of every record is cut into twenty parts. The quietest quarter of all parts
    is averaged, and divided by what that would be, of 1, for white noise alone: the parts of a
    tapered periodogram are Gamma distributed, and the quietest lie below the mean. A command that
    is held has steps up to Nyquist, but no noise: that would not repeat its values. Nor does it
    where it is rounded: then it is that of the rounding. Samples that were filled do not count, nor
    records in which it rests.
    Where its past and the outputs predict a channel more closely than that, as in a closed loop,
    the error of that prediction is the bound (`foreseen_noise`).
    """
    columns = {
        name: [d.u[_recorded(d, name), i] for d in _with_noise(signals, i)]
        for i, name in enumerate(inputs)
    }
    rounded = with_rounding(signals, {})
    out = {}
    for i, (name, c) in enumerate(columns.items()):
        out[name] = rounded.get(name, 0.0)
        if not is_held(c):
            floor, foreseen = white_floor(c), _foreseen(signals, i, name)
            by_chance = 4.0 * floor_error([len(values) for values in c])  # standard errors
            out[name] = foreseen if foreseen**2 < (1.0 - by_chance) * floor**2 else floor
    return out


def samples_with_noise(signals: Sequence[Signals], column: int, name: str) -> list[int]:
    """How many samples of an input each record has in which it does not rest."""
    return [int(_recorded(d, name).sum()) for d in _with_noise(signals, column)]


def _with_noise(signals: Sequence[Signals], column: int) -> list[Signals]:
    return [d for e, d in enumerate(signals) if noisy_inputs(signals, e)[column]]


def _recorded(d: Signals, name: str) -> BoolArray:
    """(N,) samples of an input that were not filled."""
    return ~d.filled[name] if name in d.filled else np.ones(d.N, dtype=bool)


def _foreseen(signals: Sequence[Signals], column: int, name: str) -> float:
    """`foreseen_noise` of one input."""
    moving = _with_noise(signals, column)
    used = [d.used & _recorded(d, name)[:, None] for d in moving]
    return foreseen_noise([d.u[:, column] for d in moving], [d.y for d in moving], used)
