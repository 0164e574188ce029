"""Disturbances: stationary forces that nobody recorded, with their place and spectrum.

A force that no function of states, inputs, recorded channels or time explains is no deficiency of a
model: it belongs to what the model is simulated in. It is reported with its size, and the model may
still be adequate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casid.data.files import plain_fields
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.thresholds import JUDGING
from casid.model.units import difference_from_si, difference_to_si


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A stationary random force in one balance, or beside one input.

    Attributes
    ----------
    where : the balance, or the input beside whose recorded values it acts.
    std : standard deviation of the force at the samples, in `unit`.
    share : of the residual's power that it makes, added over the outputs in units of their
        weights, 0..1.
    peak : frequency [Hz] at which its spectrum is largest; None where the spectrum is flat.
    bandwidth : width [Hz] of the band that holds its power; None where that is all frequencies.
    """

    where: str
    std: float
    unit: str
    share: float
    peak: float | None = None
    bandwidth: float | None = None

    @property
    def sentence(self) -> str:
        """The disturbance in words."""
        if self.peak is None:
            spectrum = "with a flat spectrum"
        elif self.bandwidth is None or self.bandwidth > 2 * self.peak:
            spectrum = f"with most power at low frequencies, below {self.highest:.3g} Hz"
        else:
            spectrum = f"around {self.peak:.3g} Hz, {self.bandwidth:.2g} Hz wide"
        return (
            f"a random part of {self.where} that no channel records acts on the system, standard "
            f"deviation {self.std:.3g} {self.unit}, {spectrum}: "
            f"{100 * self.share:.0f} % of the residual"
        )

    @property
    def highest(self) -> float:
        """Upper end [Hz] of the band that holds its power; infinite where the spectrum is flat."""
        if self.peak is None or self.bandwidth is None:
            return float("inf")
        return self.peak + 0.5 * self.bandwidth

    def in_units(self, units: Mapping[str, str]) -> Disturbance:
        """The same in the unit that `units` has for its balance."""
        unit = units.get(self.where, self.unit)
        std = float(difference_from_si(difference_to_si(self.std, self.unit), unit))
        return replace(self, std=std, unit=unit)

    def to_json(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return plain_fields(self, "sentence")


def disturbances_of(at: Weighted) -> tuple[Disturbance, ...]:
    """The disturbances in the noise found at a fit, the one with the largest share first.

    Those that make less than `JUDGING.practical` of the residual are left out.
    """
    noise = at.full
    weights = noise.weights**2
    samples = [d.N for d in at.criterion.data]
    total = sum(n * float(np.mean(noise.spectrum(e) @ weights)) for e, n in enumerate(samples))

    def power(source: str) -> float:
        """Of the residual, for a unit standard deviation of a source."""
        return sum(
            n * float(np.mean(r.gain2[:, :, r.sources.index(source)] @ weights))
            for r, n in zip(noise.responses, samples, strict=True)
        )

    found = []
    # Of sources that act alike, the first carries the variance: that of inputs which their sensors
    # account for is noise, and the rest a force in their balance.
    for group in noise.alike:
        carried = noise.source_sd[group[0]] ** 2 * power(group[0])
        measured = sum(at.input_sd.get(name, 0.0) ** 2 * power(name) for name in group)
        where = next((name for name in group if name in at.model.balances), group[0])
        unit_power = power(where)
        share = (carried - measured) / total if total > 0 else 0.0
        if share >= JUDGING.practical and unit_power > 0:
            sd = float(np.sqrt((carried - measured) / unit_power))
            place = at.model.balances.get(where) or at.model.inputs[where]
            found.append(Disturbance(where, sd, place.unit, min(share, 1.0)))
    return tuple(sorted(found, key=lambda d: -d.share))
