"""Isolated spikes of outputs that the estimate did not leave out."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from casid.data.channel_quality import isolated_spikes, spiked
from casid.estimation.simulation.minimization import Fit


def spike_notes(fit: Fit) -> list[str]:
    """A warning for each output of a record with isolated spikes that the simulation has not."""
    return [note for e in range(len(fit.criterion.data)) for note in _of_record(fit, e)]


def _of_record(fit: Fit, e: int) -> Iterator[str]:
    criterion = fit.criterion
    data, residual = criterion.data[e], criterion.simulated(fit.x, e).residual
    name, t = criterion.experiments[e].name, criterion.experiments[e].record.t
    for i, output in enumerate(criterion.outputs):
        rows = np.flatnonzero(data.used[:, i])
        whole = np.zeros(rows.size, dtype=bool)
        measured, left = (isolated_spikes(each[rows, i], whole) for each in (data.y, residual))
        at = rows[np.intersect1d(measured, left)]
        if at.size:
            found = spiked(output, t[at])
            yield f"{name}: {found.channel}: {found.text} {found.remedy}"
