"""Samples that a sensor or logger corrupted, left out before anything is judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.diagnosis.evidence.plateaus import Plateaus, find_plateaus
from casid.diagnosis.evidence.spikes import Spikes, find_spikes
from casid.diagnosis.thresholds import OUTLIERS
from casid.estimation.holdout import Split, simulate_apart, whole_simulation
from casid.estimation.simulation.minimization import Fit


@dataclass(frozen=True, slots=True, eq=False)
class CorruptedSamples:
    """What was left out."""

    spikes: tuple[Spikes, ...] = ()
    plateaus: tuple[Plateaus, ...] = ()

    @property
    def count(self) -> int:
        """Samples left out."""
        return sum(s.count for s in self.spikes) + sum(p.count for p in self.plateaus)


@dataclass(frozen=True, slots=True, eq=False)
class _Simulated:
    """One channel of every record, fitted ones to their end and then those apart."""

    measured: list[Array]
    simulated: list[Array]
    used: list[Array]

    @property
    def residuals(self) -> list[Array]:
        return [
            np.where(u, y - s, 0.0)
            for y, s, u in zip(self.measured, self.simulated, self.used, strict=True)
        ]


def without_corrupted(
    fit: Fit, split: Split, alpha: float, *, without: Sequence[str] = ()
) -> tuple[CorruptedSamples, Split]:
    """Mark clipped samples and isolated spikes of every output as missing, held-out ones too.

    `without` are kinds that are not looked for.
    """
    spikes: list[Spikes] = []
    plateaus: list[Plateaus] = []
    for i, channel in enumerate(fit.criterion.outputs):
        at = _channel(fit, split, i)
        if "saturation" not in without:
            cut = find_plateaus(
                channel, at.measured, at.simulated, at.used, OUTLIERS.test_share * alpha
            )
            if cut is not None:
                plateaus.append(cut)
                split = _masked(split, channel, cut.masks)
                for used, mask in zip(at.used, cut.masks, strict=True):
                    used &= ~mask
        if "outliers" not in without:
            found = find_spikes(channel, at.residuals, OUTLIERS.test_share * alpha)
            if found is not None:
                spikes.append(found)
                split = _masked(split, channel, found.masks)
    return CorruptedSamples(tuple(spikes), tuple(plateaus)), split


def _channel(fit: Fit, split: Split, i: int) -> _Simulated:
    runs = [whole_simulation(fit, split, e) for e in range(len(split.whole))]
    runs += [simulate_apart(fit, experiment) for experiment in split.apart]
    return _Simulated(
        [d.y[:, i] for d, _, _ in runs],
        [y[:, i] for _, y, _ in runs],
        [d.used[:, i].copy() for d, _, _ in runs],
    )


def _masked(split: Split, channel: str, masks: Sequence[Array]) -> Split:
    n = len(split.whole)
    return split.mask(channel, masks[:n], masks[n:])
