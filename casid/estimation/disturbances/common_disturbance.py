"""Forces that act in several balances in a fixed ratio: a crosswind pushes a car and turns it.

Forces that are independent move two outputs with a coherence below one, and with no phase between
them but that of the model's own responses; one force moves both together. The spectra of single
outputs hardly distinguish the two, the cross-spectra do: both parts of Whittle's likelihood of all
outputs together count here (`source_spectra`), at parameters that are given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum, Part
from casid.estimation.noise.joined_sources import joined
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import Response
from casid.estimation.noise.source_spectra import SourceSpectra, lines_of
from casid.estimation.noise.whittle_scoring import At, impossible, minimum, of_spectra

RATIOS = (0.3, 1.0, 3.0)
"""Ratios of what one force leaves in the outputs through two balances that a search starts from,
each with both signs."""
INDEPENDENT = 0.1
"""Share of the power of a force that acts in one balance alone, when the search for one that acts
in several begins."""
FLOOR = 1e-3
"""Share of the residual's power that any source has when a search begins, at least: a logarithm of
a variance does not leave zero."""
NEGLIGIBLE = 1e-3
"""Share of every spectrum, at any frequency, below which a source is none."""
DAMPINGS = (1e-3, 0.1, 3.0)
"""Of the scoring, one after another, each from where the one before ended: far from the likeliest
variances an undamped step may lead nowhere."""
TAPERED = 35 / 18
"""Variance of means of a periodogram under Hann's window, over that without: lines next to each
other are not independent."""


@dataclass(frozen=True, slots=True, eq=False)
class Common:
    """Variances and spectra of sources under which the residuals are likeliest.

    Attributes
    ----------
    criterion : minus the log-likelihood and the price of the parameters of spectra.
    """

    criterion: float
    output_sd: Array
    source_sd: Mapping[str, float]
    spectra: Mapping[str, DisturbanceSpectrum]


_Begun = tuple[Array, Mapping[str, float], Mapping[str, DisturbanceSpectrum]]
"""Standard deviations of outputs and of sources, and spectra, that a search begins with."""


def _common_of(found: Common) -> DisturbanceSpectrum | None:
    """The spectrum of the force that acts in several balances."""
    return next((s for s in found.spectra.values() if s.parts), None)


def name_of_common(parts: Sequence[Part]) -> str:
    """The source that acts in several places."""
    return " and ".join(p.place for p in parts)


@dataclass(frozen=True, slots=True, eq=False)
class CommonSearch:
    """The likelihood of all outputs together, with forces that act in several balances.

    Attributes
    ----------
    noise : of white sources alone.
    residuals : (N, ny) an experiment, complete.
    sample_times : [s] of each.
    balances : in which one force may act.
    given : outputs and sources whose noise is known.
    """

    noise: NoiseModel
    residuals: Sequence[Array]
    sample_times: Sequence[float]
    outputs: Sequence[str]
    balances: Sequence[str]
    given: tuple[Mapping[str, float], Mapping[str, float]]
    _seen: list[tuple[Array, Array, Response]] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        for residual, r in zip(self.residuals, self.noise.responses, strict=True):
            lines = lines_of(residual[:, :, None])
            of = lines.values[:, :, 0]
            power = np.add.reduceat(of[:, :, None] * of[:, None, :].conj(), lines.edges)
            places = np.clip(np.searchsorted(r.omega, lines.omega), 0, len(r.omega) - 1)
            assert r.gain is not None
            near = replace(r, omega=lines.omega, gain=r.gain[places], gain2=r.gain2[places])
            self._seen.append((power / lines.count[:, None, None], lines.count, near))

    def best(self, chosen: NoiseModel) -> Common | None:
        """The best with a force in several balances; None where independent ones are as good.

        Parameters
        ----------
        chosen : the noise with forces of one balance each, of which some have spectra.
        """
        felt = [n for n in self.balances if self._power(n) > 0.0]
        least = self.fitted(chosen.output_sd, self._begun(chosen), chosen.spectra)
        pairs = [p for p in combinations(felt, 2) if any(n in chosen.spectra for n in p)]
        tried = [self._best_of_pair(chosen, pair) for pair in pairs]
        found = min(tried, key=lambda c: c.criterion, default=least)
        while found.criterion < least.criterion:
            least = found
            if _common_of(found) is None:
                break  # in its search it came to nothing
            found = min(self._wider(chosen, found, felt), key=lambda c: c.criterion, default=found)
        return least if any(s.parts for s in least.spectra.values()) else None

    def adjusted(self, near: NoiseModel) -> Common:
        """The likeliest from a noise with such a force, of which the ratio may differ a little."""
        return self.fitted(near.output_sd, self._begun(near), near.spectra)

    def _best_of_pair(self, chosen: NoiseModel, pair: tuple[str, str]) -> Common:
        """The best with one force in two balances, beside which one of them may have its own."""
        others = {n: s for n, s in chosen.spectra.items() if n not in pair}
        own = {n: chosen.spectra[n] for n in pair if n in chosen.spectra}
        first, *more = sorted(own, key=lambda n: -self._made_by(chosen, n))
        size, ratios = self._size(*pair), [sign * r for r in RATIOS for sign in (1.0, -1.0)]
        parts = [(Part(pair[0], 1.0), Part(pair[1], ratio * size)) for ratio in ratios]
        # From the likeliest ratio of each sign.
        begun = [self._begun_with(chosen, replace(own[first], parts=p), others) for p in parts]
        likeliest = [min(begun[k::2], key=self._value) for k in range(2)]
        best = min((self.fitted(*b) for b in likeliest), key=lambda c: c.criterion)
        common = _common_of(best)
        if common is None:
            return best
        tried = [
            self._from(chosen, replace(own[shape], parts=common.parts), {**others, **kept})
            for shape in own
            for kept in ({}, *({n: own[n]} for n in own if more))
            if kept or shape != first
        ]
        return min((best, *tried), key=lambda c: c.criterion)

    def _wider(self, chosen: NoiseModel, found: Common, felt: Sequence[str]) -> list[Common]:
        """The force with one more balance in which it acts."""
        common = _common_of(found)
        assert common is not None
        taken, out = [p.place for p in common.parts], []
        for name in (n for n in felt if n not in taken):
            size = min(RATIOS) * self._size(taken[0], name)
            others = {n: s for n, s in found.spectra.items() if not s.parts and n != name}
            for ratio in (size, -size):
                wider = replace(common, parts=(*common.parts, Part(name, ratio)))
                out.append(self._from(chosen, wider, others))
        return out

    def _from(
        self,
        chosen: NoiseModel,
        spectrum: DisturbanceSpectrum,
        others: Mapping[str, DisturbanceSpectrum],
    ) -> Common:
        """The best from a force in several balances."""
        return self.fitted(*self._begun_with(chosen, spectrum, others))

    def _begun_with(
        self,
        chosen: NoiseModel,
        spectrum: DisturbanceSpectrum,
        others: Mapping[str, DisturbanceSpectrum],
    ) -> _Begun:
        """The noise with a force in several balances, which takes the power of those in each."""
        source_sd, name = self._begun(chosen), name_of_common(spectrum.parts)
        power = sum(self._made_by(chosen, p.place) for p in spectrum.parts)
        for place in (p.place for p in spectrum.parts):
            if place not in others and place in chosen.spectra:
                source_sd[place] = float(np.sqrt(INDEPENDENT)) * chosen.source_sd[place]
        of = joined(self.noise.responses[0], {name: spectrum})
        own = float(np.mean(of.gain2[:, :, -1] @ self.noise.weights**2))
        source_sd[name] = float(np.sqrt(max(power, TINY) / max(own, TINY)))
        return chosen.output_sd, source_sd, {**others, name: spectrum}

    def _begun(self, chosen: NoiseModel) -> dict[str, float]:
        """Standard deviations of the sources that a search begins with, none of them zero."""
        total = np.mean(
            [np.mean(np.sum((r * self.noise.weights) ** 2, axis=1)) for r in self.residuals]
        )
        heads = {group[0] for group in self.noise.alike} | set(chosen.spectra)
        out = {}
        every = {s for s in chosen.spectra if s not in self.noise.source_sd}
        for name in self.noise.source_sd:
            power = self._power(name)
            sd = chosen.source_sd.get(name, 0.0)
            if name in self.given[1]:
                out[name] = sd
            elif name in heads and power > 0.0:
                out[name] = max(sd, float(np.sqrt(FLOOR * total / power)))
        return out | {name: max(chosen.source_sd[name], TINY) for name in every}

    def fitted(
        self,
        output_sd: Array,
        source_sd: Mapping[str, float],
        spectra: Mapping[str, DisturbanceSpectrum],
    ) -> Common:
        """The likeliest variances, shapes and ratios from those given."""
        of, none = self._parametrised(output_sd, source_sd, spectra), np.zeros(0)
        phi, at = of.start, partial(self._at, of)
        for damping in DAMPINGS:
            phi, there = minimum(at, phi, none, none, damping)
        white, scales, found = of.read(phi, there.information / TAPERED)
        seen = self._seen_at(of, phi)
        sd = {n: float(np.sqrt(v)) for n, v in scales.items() if n in seen}
        found = {n: s for n, s in found.items() if n in sd}
        value = there.value + self._price(found)
        return Common(value, np.sqrt(white), sd, found)

    def _value(self, begun: _Begun) -> float:
        """Minus the log-likelihood of variances, shapes and ratios as they are given."""
        of = self._parametrised(*begun)
        return self._at(of, of.start).value

    def _parametrised(
        self,
        output_sd: Array,
        source_sd: Mapping[str, float],
        spectra: Mapping[str, DisturbanceSpectrum],
    ) -> SourceSpectra:
        sizes = {
            (name, p.place): self._size(s.parts[0].place, p.place)
            for name, s in spectra.items()
            for p in s.parts[1:]
        }
        return SourceSpectra(self.outputs, output_sd, source_sd, spectra, self.given, sizes)

    def _at(self, of: SourceSpectra, phi: Array) -> At:
        """Whittle's likelihood of all records, with gradient and information, at phi."""
        total = impossible(len(phi))
        total.information[:], value = 0.0, 0.0
        with np.errstate(all="ignore"):
            for (power, count, r), Ts in zip(self._seen, self.sample_times, strict=True):
                part = of_spectra(phi, *of.at(phi, r, Ts), count, power)
                if part is None or not np.isfinite(part.value):
                    return impossible(len(phi))
                value += part.value
                total.gradient[:] += part.gradient
                total.information[:] += part.information
        return replace(total, value=value)

    def _seen_at(self, of: SourceSpectra, phi: Array) -> set[str]:
        """The sources that are a share of some spectrum at some frequency."""
        seen = set()
        for (_, _, r), Ts in zip(self._seen, self.sample_times, strict=True):
            whole, own = of.spectra_at(phi, r, Ts)
            seen |= {name for name, part in own.items() if np.any(part > NEGLIGIBLE * whole)}
        return seen

    def _price(self, found: Mapping[str, DisturbanceSpectrum]) -> float:
        """The BIC penalty, in nats: shapes, ratios, and variances of forces in several balances."""
        count = sum(1 + (s.damping is not None) + len(s.parts) for s in found.values())
        return 0.5 * count * float(np.log(max(sum(c.sum() for _, c, _ in self._seen), 2.0)))

    def _power(self, name: str) -> float:
        """Power that a unit variance of a source adds to the outputs, in units of their weights."""
        r = self.noise.responses[0]
        gain2 = r.gain2[:, :, r.sources.index(name)]
        return float(np.mean(gain2 @ self.noise.weights**2))

    def _made_by(self, noise: NoiseModel, name: str) -> float:
        """Power that a source adds to the outputs."""
        return noise.source_sd.get(name, 0.0) ** 2 * self._power(name)

    def _size(self, first: str, other: str) -> float:
        """Ratio at which one force leaves as much through two balances."""
        return float(np.sqrt(self._power(first) / max(self._power(other), TINY)))
