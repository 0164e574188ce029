"""Which forces that nobody recorded are not white, and their spectra.

Estimated from a residual by Whittle's likelihood, beside the white noise of sensors and inputs. A
force counts as white unless the likelihood gains more by a spectrum of its own than Schwarz's
criterion charges for its parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from casid.arrays import Array, BoolArray
from casid.estimation.disturbances.common_disturbance import CommonSearch
from casid.estimation.disturbances.variance_scoring import likelihoods
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.forces import places_of_forces
from casid.estimation.noise.joined_sources import joined
from casid.estimation.noise.missing_samples import FILLED_FROM, unbroken
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import Response
from casid.estimation.noise.residual_periodograms import (
    Spectra,
    band_edges,
    spectra_of,
    with_tangent,
)
from casid.estimation.noise.variances import (
    given_variances,
    known_sources,
    variances,
    whittle,
    with_rounding,
)
from casid.estimation.simulation.simulation_error import SimulationError

CORNERS = 12
"""Frequencies, even in the logarithm, that a search starts from."""
WIDTHS = (0.05, 0.3)
"""Values of zeta that a search starts from."""
LOWEST = 4
"""Periods that a record holds of the lowest peak, at least."""
LOWEST_CORNER = 1
"""The same of the corner of a first-order spectrum: what is slower is a walk in this record, which
one at its lowest corner is as well."""
LINE = 1.44
"""Width of a line at half its power under Hann's window, times the length of the record (Harris,
Proc. IEEE 66 (1978) 51-83, table 1). A band that is no wider may be one: it is no random force."""
ROUGHLY = 1e-2
"""Relative change of the spectrum at which its variances are found while spectra are compared: the
likelihood, at its maximum over the variances, errs by the square of that."""
TOLERANCE = 1e-4
"""The same for the spectrum that is chosen."""
FINER = (0.15, 0.05, 0.017)
"""Changes of the logarithm of the frequency, one after another, by which the search goes on beside
the best of the grid; the last is far less than one record can distinguish."""
NARROW = (0.006, 0.002)
"""Further such changes, each only for a peak whose zeta is no more than that."""
WIDER = 3.0
"""Times as large are those of the logarithm of the width."""
LEAST_WIDTH = 0.01
"""Value of zeta of the narrowest peak; half of a line's where that is less."""
MOVES = 4
"""Of one such search on to where it gains at its edge, at most."""
LEAST = 0.05
"""Share of the power of an output that a force in a stated rate must account for. A weaker one only
corrects the course between samples that is assumed for a force in a balance."""
FILLINGS = 2
"""Draws of missing samples, each under the noise that the one before it gives."""


def with_disturbance_spectra(
    noise: NoiseModel,
    criterion: SimulationError,
    x: Array,
    known: Mapping[str, float] | None = None,
    *,
    residuals: Sequence[Array] | None = None,
    is_simple: bool = False,
    near: Mapping[str, DisturbanceSpectrum] | None = None,
    has_common: bool = True,
) -> NoiseModel:
    """The noise of the residual at `x` with forces that are not white where it shows such.

    Forces in several places are taken up one after another, the one that gains most first; one
    force that acts in several balances takes their places where it is likelier.

    Parameters
    ----------
    noise : as estimated with white sources alone.
    known, residuals : as for `estimate_noise`.
    is_simple : no force has a spectrum with a peak.
    near : spectra found at a point close by; they are adjusted, and no other is sought.
    has_common : whether one force may act in several balances.
    """
    if residuals is None:
        residuals = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
    known = with_rounding(criterion.data, known or {})
    used = [d.used for d in criterion.data]
    searched = partial(
        _searched,
        noise,
        criterion,
        known=known,
        moved=_sensitivities(criterion, x),
        allowed=_Allowed(peaks=not is_simple, common=has_common),
    )
    found = searched(residuals, used, near=near or {})
    has_holes = [unbroken(u) is None for u in used]
    if any(has_holes) and min(float(u.mean()) for u in used) >= FILLED_FROM:
        # What a narrow band has at its peak leaks through gaps over all other frequencies, and its
        # spectrum is known no better than a few of its periods are many.
        rng = np.random.default_rng(0)
        found = replace(found, output_sd=np.minimum(found.output_sd, _rough(residuals, used)))
        there = [np.ones_like(u) if hole else u for u, hole in zip(used, has_holes, strict=True)]
        for k in range(FILLINGS):
            whole = [found.filled(r, e, rng) for e, r in enumerate(residuals)]
            found = searched(whole, there, near=near or (found.spectra if k else {}))
    return found


def _rough(residuals: Sequence[Array], used: Sequence[BoolArray]) -> Array:
    """(ny,) largest white noise that residuals (N, ny) can have, by samples next to each other.

    What four in a row leave of a parabola, whose variance is 20 times that of white noise.
    """
    parts = []
    for r, u in zip(residuals, used, strict=True):
        in_a_row = u[3:] & u[2:-1] & u[1:-2] & u[:-3]
        parts.append(np.where(in_a_row, np.diff(r, 3, axis=0), np.nan))
    bent = np.concatenate(parts)
    count = np.sum(np.isfinite(bent), axis=0)
    return np.where(
        count > 0, np.sqrt(np.nansum(bent**2, axis=0) / np.maximum(count, 1) / 20), np.inf
    )


@dataclass(frozen=True, slots=True)
class _Allowed:
    """Whether spectra may have peaks, and whether one force may act in several balances."""

    peaks: bool
    common: bool


def _searched(
    noise: NoiseModel,
    criterion: SimulationError,
    residuals: Sequence[Array],
    used: Sequence[BoolArray],
    *,
    known: Mapping[str, float],
    moved: Sequence[Array],
    allowed: _Allowed,
    near: Mapping[str, DisturbanceSpectrum],
) -> NoiseModel:
    """The noise with the spectra of forces that residuals (N, ny) have in the samples `used`.

    Parameters
    ----------
    moved : (N, ny, n) an experiment, what parameters that were fitted change of them.
    near : spectra to be adjusted, where no other is sought.
    """
    # Without a taper the ends of a slow and large motion leak over the noise of the sensors.
    tapered = [_tapered(r) for r in residuals]
    windows = [u if u.all() else _tapered(1.0 * u) for u in used]
    envelopes = [_tapered(np.ones(u.shape)) for u in used]
    base, noise, outputs = noise, _joined(noise, near), tuple(criterion.outputs)
    sources = noise.responses[0].sources
    spectra = spectra_of(tapered, noise.responses, sources, len(outputs), windows, envelopes)
    columns = [_tapered(m * u[:, :, None]) for m, u in zip(moved, used, strict=True)]
    search = _Search(
        noise,
        with_tangent(spectra, columns),
        [(d.N, d.Ts) for d in criterion.data],
        known,
        known_sources(known, criterion.model),
        outputs,
        WIDTHS if allowed.peaks else (),
    )
    together = partial(_together, search, base, criterion, residuals, used)
    if any(s.parts for s in near.values()):
        found = search.noise_of(near, search.fitted(near)[1])
        return together(found, is_near=True) or found
    return _greedily(search, criterion, near, together if allowed.common else None)


def _greedily(
    search: _Search,
    criterion: SimulationError,
    near: Mapping[str, DisturbanceSpectrum],
    together: Callable[[NoiseModel], NoiseModel | None] | None,
) -> NoiseModel:
    """The noise with forces of one place each, or one in several in their place.

    Parameters
    ----------
    near : as for `_searched`.
    together : seeks one in several; None: it is not sought.
    """
    noise = search.noise
    chosen: dict[str, DisturbanceSpectrum] = {}
    best = search.fitted(chosen)
    if near:
        adjusted = search.adjusted(near)
        adjusted = {n: s for n, s in adjusted.items() if search.is_resolved(s)}
        least, value = search.fitted(adjusted)
        return search.noise_of(adjusted, value) if least < best[0] else noise
    while True:
        tried = [search.best_additional(chosen, name) for name in places_of_forces(criterion.model)]
        more = [t for t in tried if t is not None and search.is_seen(*t[1:])]
        top = min(more, key=lambda t: t[0], default=None)
        if top is None or top[0] >= best[0]:
            break
        best, chosen = (top[0], top[1]), top[2]
    if not chosen:
        return noise
    found = search.noise_of(chosen, best[1])
    return (together(found) if together else None) or found


def _joined(noise: NoiseModel, found: Mapping[str, DisturbanceSpectrum]) -> NoiseModel:
    """The noise with one more source for each force that acts in several balances."""
    responses = [joined(r, found) for r in noise.responses]
    source_sd = {n: noise.source_sd.get(n, 0.0) for n in responses[0].sources}
    return replace(noise, responses=responses, source_sd=source_sd)


def _together(
    search: _Search,
    base: NoiseModel,
    criterion: SimulationError,
    residuals: Sequence[Array],
    used: Sequence[BoolArray],
    chosen: NoiseModel,
    *,
    is_near: bool = False,
) -> NoiseModel | None:
    """The noise with a force in several balances; None where independent ones are as likely.

    Parameters
    ----------
    base : the noise of white forces, each in one balance.
    chosen : that with spectra; `is_near`: one of a force in several balances, which is adjusted.
    """
    rows = [unbroken(u) for u in used]
    if len(criterion.outputs) < 2 or any(r.cross is not None for r in base.responses):
        return None
    if any(row is None and not u.all() for row, u in zip(rows, used, strict=True)):
        return None
    of = CommonSearch(
        base,
        [r[row or slice(None)] for r, row in zip(residuals, rows, strict=True)],
        [d.Ts for d in criterion.data],
        search.outputs,
        list(criterion.model.balances),
        (search.known, search.known_inputs),
    )
    found = of.adjusted(chosen) if is_near else of.best(chosen)
    if found is None or not any(s.parts for s in found.spectra.values()):
        return None
    every = replace(search, noise=_joined(base, found.spectra))
    value = [*found.output_sd**2]
    value += [found.source_sd.get(n, 0.0) ** 2 for n in every._sources(found.spectra)]
    return every.noise_of(found.spectra, np.array(value))


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """Whittle's likelihood of the residuals, with forces of given spectra."""

    noise: NoiseModel
    white: Spectra  # with every source white
    records: Sequence[tuple[int, float]]  # samples and sample time [s] of each
    known: Mapping[str, float]
    known_inputs: Mapping[str, float]
    outputs: tuple[str, ...]
    widths: tuple[float, ...] = WIDTHS  # those of peaks that a search starts from

    def fitted(self, found: Mapping[str, DisturbanceSpectrum]) -> tuple[float, Array]:
        """Minus the log-likelihood and the price of its parameters, and the variances."""
        sources = self._sources(found)
        spectra = replace(self.white, design=self._design(sources, found))
        given = given_variances(self.outputs, sources, self.known, self.known_inputs)
        value = variances(spectra, given, tolerance=TOLERANCE)
        return whittle(spectra, value) + self._price(found), value

    def _price(self, found: Mapping[str, DisturbanceSpectrum]) -> float:
        """The BIC penalty, in nats: parameters of the spectra, variances that white noise lacks."""
        count = sum(1 if s.damping is None else 2 for s in found.values())
        count += len(self._in_rates(found))
        return 0.5 * count * float(np.log(max(self.white.count.sum(), 2.0)))

    def best_additional(
        self, found: Mapping[str, DisturbanceSpectrum], name: str
    ) -> tuple[float, Array, dict[str, DisturbanceSpectrum]] | None:
        """The best spectrum of one more force: of a grid, and then beside it.

        Where that is as narrow as a line, which hides what else the force does, one without a peak.
        """
        low, high = self._range(is_peak=True)
        if name in found or not self._is_felt(name) or low >= high:
            return None
        first = [DisturbanceSpectrum(w) for w in self._corners(is_peak=False)]
        peaks = [
            DisturbanceSpectrum(w, zeta, band)
            for zeta in self.widths
            for band in (False, True)
            for w in self._corners(is_peak=True)
        ]
        best = self._refined(*self._best_of([*first, *peaks], found, name), found, name)
        if not self.is_resolved(best):
            best = self._refined(*self._best_of(first, found, name), found, name)
        chosen = {**found, name: best}
        return (*self.fitted(chosen), chosen)

    def _corners(self, *, is_peak: bool) -> list[float]:
        """Frequencies [rad/s] that a search starts from."""
        return [float(w) for w in np.geomspace(*self._range(is_peak=is_peak), CORNERS)]

    def adjusted(self, near: Mapping[str, DisturbanceSpectrum]) -> dict[str, DisturbanceSpectrum]:
        """The spectra refined from those in `near`, one force after another, the others held."""
        found = dict(near)
        for name, spectrum in near.items():
            others = {n: s for n, s in found.items() if n != name}
            start = self._best_of([spectrum], others, name)
            found[name] = self._refined(*start, others, name)
        return found

    def _range(self, *, is_peak: bool) -> tuple[float, float]:
        """Lowest and highest frequency [rad/s] of a spectrum that the records can show."""
        once = min(2 * np.pi / (n * Ts) for n, Ts in self.records)
        high = 0.5 * np.pi / min(Ts for _, Ts in self.records)
        return once * (LOWEST if is_peak else LOWEST_CORNER), high

    def _refined(
        self,
        best: DisturbanceSpectrum,
        least: float,
        found: Mapping[str, DisturbanceSpectrum],
        name: str,
    ) -> DisturbanceSpectrum:
        """The best spectrum near `best`, of criterion `least`, of a force added to `found`."""
        limits = self._range(is_peak=best.damping is not None)
        for step in (*FINER, *NARROW):
            if step in NARROW and (best.damping is None or best.damping > step):
                break
            for _ in range(MOVES):
                around = self._neighbours(best, step, limits)
                near, value = self._best_of(around, found, name)
                if not value < least:
                    break
                best, least = near, value
                if best.is_between(around[0], around[-1]):
                    break
        return best

    def _best_of(
        self,
        candidates: Sequence[DisturbanceSpectrum],
        found: Mapping[str, DisturbanceSpectrum],
        name: str,
    ) -> tuple[DisturbanceSpectrum, float]:
        """The candidate of least criterion for a force added to `found`, and the criterion."""
        sources = self._sources({**found, name: candidates[0]})
        every = np.repeat(self._design(sources, found)[None], len(candidates), axis=0)
        every[:, :, len(self.outputs) + sources.index(name)] *= self._in_bands(candidates)
        given = given_variances(self.outputs, sources, self.known, self.known_inputs)
        values = likelihoods(self.white, every, given, ROUGHLY)
        values += [self._price({**found, name: c}) for c in candidates]
        k = int(np.argmin(values))
        return candidates[k], float(values[k])

    def _design(self, sources: Sequence[str], found: Mapping[str, DisturbanceSpectrum]) -> Array:
        """(B, ny + ns) what a unit variance of each output and each of these sources adds.

        By their places: an output may have the name of the balance that moves it.
        """
        ny, every = len(self.outputs), self.noise.responses[0].sources
        columns = [*range(ny), *(ny + every.index(name) for name in sources)]
        design = self.white.design[:, columns].copy()
        for name, spectrum in found.items():
            design[:, ny + sources.index(name)] *= self._in_bands([spectrum])[0]
        return design

    def _neighbours(
        self, at: DisturbanceSpectrum, step: float, range_of: tuple[float, float]
    ) -> list[DisturbanceSpectrum]:
        """Spectra of the same kind whose frequency and width are up to two steps away."""
        places = np.arange(-2, 3)
        w = np.clip(at.frequency * np.exp(step * places), *range_of).tolist()
        if at.damping is None:
            return [DisturbanceSpectrum(f, None, at.is_band) for f in w]
        least = min(LEAST_WIDTH, 0.5 * self._damping_of_a_line(at.frequency))
        widths = np.clip(at.damping * np.exp(WIDER * step * places), least, 1.0).tolist()
        return [DisturbanceSpectrum(f, zeta, at.is_band) for f in w for zeta in widths]

    def _damping_of_a_line(self, frequency: float) -> float:
        """The zeta of a band that is as wide as a line in the longest record."""
        longest = max(n * Ts for n, Ts in self.records)
        return LINE * np.pi / (frequency * longest)

    def is_resolved(self, spectrum: DisturbanceSpectrum) -> bool:
        """False of a band that is no wider than a line in the longest record, and may be one."""
        if spectrum.damping is None:
            return True
        return spectrum.damping > self._damping_of_a_line(spectrum.frequency)

    def is_seen(self, value: Array, found: Mapping[str, DisturbanceSpectrum]) -> bool:
        """False if a force in a stated rate makes less than `LEAST` of every output."""
        rates = self._in_rates(found)
        if not rates:
            return True
        noise = self.noise_of(found, value)
        power = np.mean(noise.spectrum(0), axis=0)
        gain2 = np.mean(noise.responses[0].gain2, axis=0)
        of = noise.responses[0].sources.index
        return all(
            np.any(noise.source_sd[name] ** 2 * gain2[:, of(name)] > LEAST * power)
            for name in rates
        )

    def _in_rates(self, found: Mapping[str, DisturbanceSpectrum]) -> list[str]:
        """The forces in stated rates, of which no part is white."""
        is_white = {name for group in self.noise.alike for name in group}
        return [name for name in found if name not in is_white]

    def noise_of(self, found: Mapping[str, DisturbanceSpectrum], value: Array) -> NoiseModel:
        """The noise model with these spectra and variances."""
        sources, ny = self._sources(found), len(self.outputs)
        sd = dict(zip(sources, np.sqrt(value[ny:]).tolist(), strict=True))
        groups = [g for g in self.noise.alike if g[0] in sources]
        return replace(
            self.noise,
            output_sd=np.sqrt(np.maximum(value[:ny], self.white.least)),
            source_sd={name: sd.get(name, 0.0) for name in self.noise.source_sd},
            responses=self._responses(found),
            alike=(*groups, *((name,) for name in found if name not in {g[0] for g in groups})),
            spectra=dict(found),
        )

    def _sources(self, found: Mapping[str, DisturbanceSpectrum]) -> list[str]:
        """The first of every group that acts alike, and every force with a spectrum of its own."""
        own = [g[0] for g in self.noise.alike]
        return [*own, *(name for name in found if name not in own)]

    def _responses(self, found: Mapping[str, DisturbanceSpectrum]) -> list[Response]:
        out = []
        for r, (_, Ts) in zip(self.noise.responses, self.records, strict=True):
            shapes = np.ones((len(r.omega), len(r.sources)))
            for name, spectrum in found.items():
                shapes[:, r.sources.index(name)] = spectrum.at(r.omega, Ts)
            out.append(r.reshaped(shapes))
        return out

    def _in_bands(self, spectra: Sequence[DisturbanceSpectrum]) -> Array:
        """(G, B) spectra in the bands of `white`, record by record and output by output."""
        parts, first = [], 0
        for n, Ts in self.records:
            grid = np.linspace(0.0, np.pi, n + 1)
            bands = len(band_edges(n)) - 1
            omega = self.white.omega[first : first + bands]
            left = np.minimum((omega / grid[1]).astype(int), n - 1)
            share = omega / grid[1] - left
            shape = np.array([s.at(grid, Ts) for s in spectra])
            own = shape[:, left] * (1.0 - share) + shape[:, left + 1] * share
            parts += [own] * len(self.outputs)
            first += bands * len(self.outputs)
        return np.concatenate(parts, axis=1)

    def _is_felt(self, name: str) -> bool:
        return any(r.gain2[:, :, r.sources.index(name)].any() for r in self.noise.responses)


def _sensitivities(criterion: SimulationError, x: Array) -> list[Array]:
    """(N, ny, n) an experiment, of residuals to the parameters; a taper hides initial states."""
    model = criterion.model
    of = [i for i, v in enumerate(criterion.variables) if v.source in model.parameters]
    every = [criterion.simulated(x, e).jacobian[:, :, of] for e in range(len(criterion.data))]
    return [np.nan_to_num(each, nan=0.0, posinf=0.0, neginf=0.0) for each in every]


def _tapered(residual: Array) -> Array:
    """A residual (N, ny, ...) under Hann's window, of the same power."""
    window = np.hanning(len(residual) + 2)[1:-1]
    window = window / np.sqrt(np.mean(window**2))
    return np.asarray(residual * window.reshape(-1, *[1] * (residual.ndim - 1)))
