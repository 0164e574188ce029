"""Recorded references of a control loop: channels that drive an input, and are no cause.

In a closed loop the measured input is a function of the reference and of the output. The output
follows the reference, so that a reference, taken as one more input, imitates whatever acts on the
output itself, and with the noise that the loop feeds back it explains the residual. What acts on
the system it acts through the input, which is in the model.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.diagnosis.thresholds import REFERENCES
from casid.model.model import Model
from casid.model.units import same_dimension


def loop_references(
    experiments: Sequence[Experiment], model: Model, channels: Collection[str]
) -> tuple[str, ...]:
    """The `channels` that are the reference of a control loop around some output.

    A reference has the output's dimension, and an input is a filtered function of both, of which
    the output alone explains much less. The output follows the reference, unless the input is that
    function to the last digits: behind a slow loop an output lags far.
    """
    recorded = [name for name, u in model.inputs.items() if u.kind in ("measured", "known")]
    return tuple(
        channel
        for channel in channels
        if any(
            all(_is_reference(e, channel, output, name) for e in experiments)
            for output in model.outputs
            for name in recorded
        )
    )


def _is_reference(experiment: Experiment, channel: str, output: str, name: str) -> bool:
    record = experiment.record
    if not same_dimension(record.units[channel], record.units[output]):
        return False
    names = (channel, output, name)
    if any(record.is_missing(n).all() for n in names):
        return False
    r, y, u = (record.filled(n) for n in names)
    apart = y - r
    if np.var(r) <= TINY:
        return False
    follows = np.var(apart) <= REFERENCES.apart * np.var(r)
    with_it, without = _left(u, [r, y]), _left(u, [y])
    most = REFERENCES.left if follows else REFERENCES.exact
    return bool(with_it < most * min(float(np.var(u)), without))


def _left(u: Array, signals: Sequence[Array]) -> float:
    """Mean square of an input that a filter of the signals and their integrals leaves."""
    n = REFERENCES.lags
    columns = [np.ones(len(u))]
    for s in signals:
        scaled = (s - s.mean()) / max(float(s.std()), TINY)
        columns += [np.roll(scaled, k) for k in range(-1, n)]
        integral = np.cumsum(scaled)
        columns.append(integral / max(float(np.abs(integral).max()), TINY))
    design = np.stack(columns, axis=1)[n:-1]
    solved = np.linalg.lstsq(design, u[n:-1], rcond=None)[0]
    return float(np.mean((u[n:-1] - design @ solved) ** 2))
