"""Disturbances: stationary forces that nobody recorded, with their place and spectrum.

A force that no function of states, inputs, recorded channels or time explains is no deficiency of a
model: it belongs to what the model is simulated in. It is reported with its size, and the model may
still be adequate.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any

import numpy as np
from scipy.stats import chi2

from casid.data.files import plain_fields
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import DESCRIPTION, JUDGING, RESIDUAL
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.forces import name_of_force, shown_force
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.noise.noise_floor import floor_error
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.variances import estimate_noise
from casid.model.model import Model
from casid.model.quantities import quantity_text, quantity_texts
from casid.model.units import (
    declared_quotient,
    difference_from_si,
    difference_to_si,
    same_dimension,
)

DAY = timedelta(days=1).total_seconds()
"""Its length [s]."""


@dataclass(frozen=True, slots=True)
class Ratio:
    """Ratio of a disturbance in a further balance to itself in its first one."""

    where: str
    value: float
    std_error: float
    unit: str

    @property
    def text(self) -> str:
        """The ratio in words."""
        (value, error), unit = quantity_texts([self.value, self.std_error], self.unit)
        return f"{self.where} at a ratio of {f'{value} +- {error} {unit}'.rstrip()}"


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A stationary random force in one balance or stated rate, or beside one input.

    Attributes
    ----------
    where : the balance, the input beside whose recorded values it acts, or the state whose stated
        rate it enters (`z' = v + it`).
    std : standard deviation of the force at the samples, in `unit`.
    share : of the residual's power that it makes, added over the outputs in units of their
        weights, 0..1.
    peak : frequency [Hz] at which its spectrum is largest; None where the spectrum is flat.
    bandwidth : width [Hz] of the band that holds its power; None where that is all frequencies.
    also : further balances in which the same force acts, in a fixed ratio.
    """

    where: str
    std: float
    unit: str
    share: float
    peak: float | None = None
    bandwidth: float | None = None
    also: tuple[Ratio, ...] = ()

    @property
    def is_dominant(self) -> bool:
        """True if it makes more of the residual than all else."""
        return self.share > 0.5

    @property
    def spectral_form(self) -> str:
        """The spectrum that `identify(disturbances=...)` has for one like it."""
        if self.peak is None:
            return "white"
        return "first" if self._band is None else "peak"

    @property
    def _band(self) -> tuple[float, float] | None:
        """Peak and width [Hz] of a spectrum that is narrow; None for a low-pass or a flat one."""
        if self.peak is None or self.bandwidth is None or self.bandwidth > 2 * self.peak:
            return None
        return self.peak, self.bandwidth

    @property
    def sentence(self) -> str:
        """The disturbance in words."""
        if self.peak is None:
            spectrum = "flat spectrum"
        elif self._band is None:
            spectrum = f"most of its power below {quantity_text(self.highest, 'Hz')}"
        else:
            peak, width = (quantity_text(each, "Hz") for each in self._band)
            spectrum = f"a band {width} wide around {peak}{_period_text(*self._band)}"
        if self.also:
            ratios = ", ".join(each.text for each in self.also)
            return (
                f"one unrecorded random disturbance acts on {self.place} together: standard "
                f"deviation {quantity_text(self.std, self.unit)} in {self.where}, {ratios}, "
                f"{spectrum}, {100 * self.share:.0f} % of the residual"
            )
        return (
            f"an unrecorded random disturbance acts on {self.where}: standard deviation "
            f"{quantity_text(self.std, self.unit)}, {spectrum}, {100 * self.share:.0f} % of the "
            "residual"
        )

    @property
    def place(self) -> str:
        """Where it acts: one place, or several balances."""
        return " and ".join([self.where, *(each.where for each in self.also)])

    @property
    def highest(self) -> float:
        """Upper end [Hz] of the band that holds its power; infinite where the spectrum is flat."""
        if self.peak is None or self.bandwidth is None:
            return float("inf")
        return self.peak + 0.5 * self.bandwidth

    def in_units(self, units: Mapping[str, str]) -> Disturbance:
        """The disturbance in the unit that `units` has for its balance.

        A law of a state is a balance by the state's name: its unit is not that of the state.
        """
        unit = units.get(self.where, self.unit)
        if self.also or not same_dimension(unit, self.unit):
            return self
        std = float(difference_from_si(difference_to_si(self.std, self.unit), unit))
        return replace(self, std=std, unit=unit)

    def to_json(self) -> dict[str, Any]:
        """The fields as `diagnosis.json` holds them."""
        out = plain_fields(self, "sentence", leave_out=("also",))
        return out | {"also": [plain_fields(each) for each in self.also]}


def _period_text(peak: float, width: float) -> str:
    """The period of a slow peak [Hz], and whether a day is among those of its band."""
    if peak > DESCRIPTION.slow:
        return ""
    is_daily = 2 * abs(peak - 1 / DAY) <= width
    day = "; once a day, as sun and use come, is in that band" if is_daily else ""
    return f" (a period of {quantity_text(1 / peak, 's')}{day})"


def disturbances_of(at: Weighted, level: float) -> tuple[Disturbance, ...]:
    """The disturbances in the noise found at a fit, the one with the largest share first.

    Those that make less than `JUDGING.practical` of the residual are left out, and those that
    noise alone may seem to be.

    Parameters
    ----------
    level : at which they are tested, all together.
    """
    noise, data = at.full, at.criterion.data
    if p_value_of(at, list(noise.source_sd)) >= level:
        return ()
    total = noise.power(data)

    found: dict[str, list[tuple[float, float, DisturbanceSpectrum | None]]] = {}
    # Of sources that act alike, the first carries the variance: that of inputs which their sensors
    # account for is noise, and the rest a force in their balance.
    for group in noise.alike:
        carried = noise.source_sd[group[0]] ** 2 * noise.unit_power(group[0], data)
        own = {n: at.input_sd[n] for n in group if n in at.input_sd}
        measured = sum(sd**2 * noise.unit_power(name, data) for name, sd in own.items())
        where = next((name for name in group if name in at.model.balances), group[0])
        # A balance that has its own spectrum is a separate source; here only its white part counts.
        is_white_part = where != group[0] and where in noise.spectra
        unit_power = noise.unit_power(where, data, is_white=is_white_part)
        share = (carried - measured) / total if total > 0 else 0.0
        if share > 0 and unit_power > 0:
            spectrum = None if is_white_part else noise.spectra.get(where)
            part = share, (carried - measured) / unit_power, spectrum
            found.setdefault(where, []).append(part)
    shares = {where: sum(p[0] for p in parts) for where, parts in found.items()}
    large = [where for where, share in shares.items() if share >= JUDGING.practical]
    seen = [w for w in large if p_value_of(at, _acting_as(at, w)) < level / len(large)]
    # Of several that act nearly alike none may be needed: the one with most of it stands for all.
    strongest = sorted(large, key=lambda where: -shares[where])[:1]
    out = []
    for where in seen or strongest:
        parts = found[where]
        sd = float(np.sqrt(sum(p[1] for p in parts)))
        spectrum = max(parts, key=lambda p: p[0])[2]
        first, also = _places(at.model, where, spectrum)
        size, unit = shown_force(at.model, first, sd)
        share = min(shares[where], 1.0)
        out.append(Disturbance(first, size, unit, share, *_peak(spectrum), also))
    return tuple(sorted(out, key=lambda d: -d.share))


def _places(
    model: Model, source: str, spectrum: DisturbanceSpectrum | None
) -> tuple[str, tuple[Ratio, ...]]:
    """The first place in which a source acts, and what it does in others."""
    if spectrum is None or not spectrum.parts:
        return source, ()
    first, *others = spectrum.parts
    one, below = shown_force(model, first.place, 1.0)
    also = []
    for part in others:
        size, above = shown_force(model, part.place, 1.0)
        value, error = (size / one * v for v in (part.ratio, part.error))
        also.append(Ratio(part.place, value, error, declared_quotient(above, below)))
    return first.place, tuple(also)


def shown_source(model: Model, noise: NoiseModel, source: str, size: float) -> tuple[float, str]:
    """`shown_force` of a source; of one that acts in several balances what it does in the first."""
    return shown_force(model, _places(model, source, noise.spectra.get(source))[0], size)


def _acting_as(at: Weighted, where: str) -> Sequence[str]:
    """The sources that act as one does."""
    return next((group for group in at.full.alike if where in group), (where,))


def p_value_of(at: Weighted, group: Collection[str]) -> float:
    """p that sources are no more than the noise of the inputs among them, as these have it at most.

    By the ratio of Whittle's likelihoods without and with more of them at the fit. As a variance is
    not negative, twice its logarithm is zero half of the time, and else chi-square of one degree of
    freedom (Self, Liang 1987); of several groups that act alike it is at most chi-square of as many
    as there are. 0 where disturbances have spectra of their own, which were chosen by their
    likelihood.
    """
    if at.full.spectra:
        return 0.0
    # The floor of a channel's spectrum is an estimate, with an error of its own.
    beyond = np.sqrt(1 + RESIDUAL.floor_errors * floor_error([d.N for d in at.criterion.data]))
    own = input_noise_floor(at.criterion.data, list(at.model.inputs))
    floors = {name: beyond * floor for name, floor in own.items()}
    kept = {name: at.input_sd.get(name, 0.0) for name in group}
    for name, sd in kept.items():
        if (shown := at.full.source_sd.get(name, 0.0)) > sd:
            kept[name] = min(shown, beyond * sd)
    without = _noise_with(at, kept)
    # What acts alike would else be taken for noise of an input that its own channel does not have.
    most = {n: floors[n] for n in floors if without.source_sd.get(n, 0.0) > floors[n]}
    if most:
        without = _noise_with(at, most | kept)
    groups = sum(any(name in group for name in each) for each in at.full.alike)
    ratio = 2 * (without.misfit - _noise_with(at, {}).misfit)
    return float(chi2.sf(ratio, groups)) * (0.5 if groups <= 1 else 1.0) if ratio > 0 else 1.0


def _noise_with(at: Weighted, stated: Mapping[str, float]) -> NoiseModel:
    """The noise of the residual at a fit, that of some sources given."""
    inputs = at.model.inputs
    held = {n if n in inputs else name_of_force(n): sd for n, sd in stated.items()}
    known = {**at.full.known, **held}
    return estimate_noise(at.criterion, at.fit.x, known=known, responses=at.full.responses)


def is_seen(at: Weighted, source: str) -> bool:
    """True if the noise found at a source makes `JUDGING.practical` of the residual or more."""
    return at.full.makes(source, JUDGING.practical, at.criterion.data)


def _peak(spectrum: DisturbanceSpectrum | None) -> tuple[float | None, float | None]:
    """Frequency and width [Hz] of a spectrum; of a low-pass one half its band, and its band."""
    if spectrum is None:
        return None, None
    hertz = spectrum.frequency / (2 * np.pi)
    if spectrum.damping is None or (spectrum.damping > np.sqrt(0.5) and not spectrum.is_band):
        return 0.0, 2 * hertz
    if spectrum.is_band:
        return hertz, 2 * spectrum.damping * hertz
    return hertz * np.sqrt(1 - 2 * spectrum.damping**2), 2 * spectrum.damping * hertz
