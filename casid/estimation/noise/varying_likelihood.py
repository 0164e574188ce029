"""The likeliest variances and spectra of noise whose response changes along a record.

With e the innovation of each output at each sample, given all before, over its standard deviation
s, minus the log-likelihood and Fisher's information of any parameters of the noise are

    sum e^2 / 2 + log s,    I_kl = E sum (de/dk) (de/dl) + (dlog s/dk) (dlog s/dl)            (1)

(A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, section 3.4,
where the information is in terms of innovations that are not divided by s). They are logarithms of
variances, and of frequencies and widths of spectra; one more filter for each gives the derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY, Array, BoolArray
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.joined_sources import joined_steps
from casid.estimation.noise.noise_model import NoiseModel, Variance
from casid.estimation.noise.source_spectra import SourceSpectra
from casid.estimation.noise.thresholds import VARYING_RESPONSE
from casid.estimation.noise.variances import known_sources
from casid.estimation.noise.varying_innovations import (
    Process,
    VaryingInnovations,
    process_of,
    varying_innovations,
)
from casid.estimation.noise.varying_steps import Steps
from casid.estimation.noise.whittle_scoring import At, impossible, minimum
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError


def filters_along(
    noise: NoiseModel, steps: Sequence[Steps], data: Sequence[Signals] = ()
) -> list[VaryingInnovations] | None:
    """The filters along the steps of each experiment; None where they diverge.

    Parameters
    ----------
    data : whose samples count; default all.
    """
    of = noise.output_sd, noise.source_sd, noise.spectra, noise.weights
    used = [_where_missing(d) for d in data] or [None] * len(steps)
    with np.errstate(all="ignore"):
        try:
            return [varying_innovations(s, *of, used=u) for s, u in zip(steps, used, strict=True)]
        except np.linalg.LinAlgError:
            return None


def weighted(noise: NoiseModel, data: Sequence[Signals], residuals: Sequence[Array]) -> list[Array]:
    """Residuals (N, ny) of each experiment as columns (N, ny, 1) that filters take."""
    return [
        (np.where(d.used, r, 0.0) * noise.weights)[:, :, None]
        for d, r in zip(data, residuals, strict=True)
    ]


def is_white(noise: NoiseModel, data: Sequence[Signals], residuals: Sequence[Array]) -> bool:
    """Whether residuals (N, ny) are noise of unit size under a noise, up to chance.

    By the mean square of what every output adds to those before it.
    """
    columns = weighted(noise, data, residuals)
    with np.errstate(all="ignore"):
        squares = sum(np.sum(noise.whiten(c, e) ** 2, axis=(0, 2)) for e, c in enumerate(columns))
    count = sum(d.used.sum(axis=0) for d in data)
    return bool(
        np.all(np.abs(squares - count) <= VARYING_RESPONSE.by_chance * np.sqrt(2.0 * count))
    )


def with_likeliest_noise(
    noise: NoiseModel,
    steps: Sequence[Steps],
    criterion: SimulationError,
    residuals: Sequence[Array],
) -> NoiseModel:
    """The noise with the likeliest variances and spectra along a path, by Fisher scoring.

    Variances that are known stay, and those of sources that are too small to count. What a source
    moves where the plant answers most is most of what the average response knows of its spectrum.

    Parameters
    ----------
    noise : with innovations along the path (`NoiseModel.varying`), to begin with.
    steps : of each experiment.
    residuals : (N, ny) an experiment.
    """
    search = _Likelihood(noise, steps, criterion, residuals)
    none = np.zeros(0)
    z, at = minimum(search.at, search.start(), none, none)
    found = search.noise_at(z)
    filters = filters_along(found, steps)
    if filters is None:
        return noise
    size = np.sqrt(np.maximum(np.diag(at.information), TINY))
    inverse = np.linalg.pinv(at.information / np.outer(size, size), hermitian=True)
    factor = np.exp(z) / size  # from logarithms of unit size
    covariance = {
        (a, b): float(factor[i] * inverse[i, j] * factor[j])
        for a, i in search.variances.items()
        for b, j in search.variances.items()
    }
    return replace(found, varying=filters, covariance={**found.covariance, **covariance})


def with_spectra_along(
    noise: NoiseModel,
    steps: Sequence[Steps],
    criterion: SimulationError,
    residuals: Sequence[Array],
) -> NoiseModel:
    """The noise with spectra of first order for white forces, where it is likelier by Schwarz.

    One force after another, the one that gains most first; parameters as of `with_likeliest_noise`.
    """
    data, places = criterion.data, criterion.model.balances
    least, found = _priced(noise, criterion, residuals), noise
    while True:
        white = [
            name
            for name in places
            if name not in found.spectra and found.makes(name, VARYING_RESPONSE.noticeable, data)
        ]
        begun = [_coloured(found, n, w, data) for n in white for w in _corners(criterion)]
        tried = []
        for one in begun:
            if (filters := filters_along(one, steps)) is None:
                continue
            along = replace(one, varying=filters)
            tried.append(with_likeliest_noise(along, steps, criterion, residuals))
        values = [_priced(one, criterion, residuals) for one in tried]
        if not values or not min(values) < least:
            return found
        least, found = min(values), tried[int(np.argmin(values))]


def _corners(criterion: SimulationError) -> list[float]:
    """Frequencies [rad/s] that the search for a spectrum begins at: a window is to hold several."""
    e = int(np.argmin([d.Ts for d in criterion.data]))
    d = criterion.data[e]
    longest = int(np.max(np.diff([0, *criterion.starts_anew(e), d.N]))) * d.Ts
    ends = 2 * np.pi / longest, 0.5 * np.pi / d.Ts
    return [float(w) for w in np.geomspace(*ends, VARYING_RESPONSE.corners + 2)[1:-1]]


def _coloured(noise: NoiseModel, name: str, w: float, data: Sequence[Signals]) -> NoiseModel:
    """The noise with one force of first order, as strong at low frequencies as it was white."""
    share = float(np.exp(-w * min(d.Ts for d in data)))
    sd = noise.source_sd[name] * np.sqrt((1 - share) / (1 + share))
    white = replace(noise, spectra={**noise.spectra, name: DisturbanceSpectrum(np.inf)})
    coloured = white.under_spectra({**noise.spectra, name: DisturbanceSpectrum(w)}, data)
    alike = noise.alike if (name,) in noise.alike else (*noise.alike, (name,))
    return replace(coloured, source_sd={**noise.source_sd, name: float(sd)}, alike=alike)


def _priced(noise: NoiseModel, criterion: SimulationError, residuals: Sequence[Array]) -> float:
    price = noise.price_of_shapes(criterion.n_samples)
    return noise.minus_log_likelihood(residuals) + price


class _Likelihood:
    """(1) over the logarithms of variances and of the frequencies and widths of spectra."""

    def __init__(
        self,
        noise: NoiseModel,
        steps: Sequence[Steps],
        criterion: SimulationError,
        residuals: Sequence[Array],
    ) -> None:
        self.noise, self.steps, self.data = noise, steps, criterion.data
        self.columns = weighted(noise, self.data, residuals)
        stated = known_sources(noise.known, criterion.model)
        held = {
            n: sd
            for n, sd in noise.source_sd.items()
            if n in stated or not noise.makes(n, VARYING_RESPONSE.noticeable, self.data)
        }
        self.of = SourceSpectra(
            criterion.outputs, noise.output_sd, noise.source_sd, noise.spectra, (noise.known, held)
        )
        # In which ratio a force acts in several balances is known from the average response.
        self.free = [i for i, e in enumerate(self.of.entries) if e.kind != "ratio"]
        self.variances: dict[Variance, int] = {}  # the place of each among the free ones
        for k, entry in enumerate(self.of.entries[i] for i in self.free):
            if entry.kind == "output" or entry.kind == "source":
                self.variances[entry.kind, entry.of] = k
        self._processes: tuple[Mapping[str, DisturbanceSpectrum], list[Process]] | None = None

    def noise_at(self, z: Array) -> NoiseModel:
        """The noise of these logarithms, with its innovations as they were."""
        output_sd, source_sd, spectra = self._read(z)
        found = replace(self.noise, output_sd=output_sd, source_sd=source_sd)
        return found.under_spectra(spectra, self.data)

    def _read(self, z: Array) -> tuple[Array, dict[str, float], dict[str, DisturbanceSpectrum]]:
        """Standard deviations of the outputs' noise (ny,) and of the sources, and their spectra."""
        phi = self.of.start.copy()
        phi[self.free] = z
        white, scales, spectra = self.of.read(phi)
        source_sd = {**self.noise.source_sd, **{n: float(np.sqrt(v)) for n, v in scales.items()}}
        return np.sqrt(white), source_sd, {**self.noise.spectra, **spectra}

    def start(self) -> Array:
        """The noise to begin with, all variances times one factor where that is likelier.

        Under variances all times a factor, innovations are the same times the inverse of its root:
        the likeliest factor is their mean square (Harvey, section 3.4). It is the factor of all
        but those that are known.
        """
        z = self.of.start[self.free]
        here = self._innovations(z)
        count = sum(int(d.used.sum()) for d in self.data)
        squares = sum(float(np.sum(e**2)) for e, _ in here)
        if not here or not squares > 0.0:
            return z
        there = z.copy()
        there[list(self.variances.values())] += np.log(squares / count)
        return there if _value(self._innovations(there)) < _value(here) else z

    def at(self, z: Array) -> At:
        """Value, gradient and information at a point."""
        n = len(z)
        here = self._innovations(z)
        beside = [self._innovations(z + VARYING_RESPONSE.difference * step) for step in np.eye(n)]
        value, gradient, information = _value(here), np.zeros(n), np.zeros((n, n))
        for k in range(len(self.data)):
            if not all(beside) or not here:
                return impossible(n)
            e, logs = here[k]
            de = np.array([(b[k][0] - e).ravel() for b in beside]) / VARYING_RESPONSE.difference
            dlogs = (
                np.array([(b[k][1] - logs).ravel() for b in beside]) / VARYING_RESPONSE.difference
            )
            gradient += de @ e.ravel() - dlogs.sum(axis=1)
            information += de @ de.T + dlogs @ dlogs.T
        is_finite = np.isfinite(value) and np.all(np.isfinite(information))
        return At(value, gradient, information) if is_finite else impossible(n)

    def _innovations(self, z: Array) -> list[tuple[Array, Array]]:
        """e (N, ny) and -log s of each experiment; none where the filters diverge."""
        output_sd, source_sd, spectra = self._read(z)
        sizes, out = (output_sd * self.noise.weights, source_sd), []
        with np.errstate(all="ignore"):
            try:
                for process, d, columns in zip(
                    self._driven(spectra), self.data, self.columns, strict=True
                ):
                    of = VaryingInnovations(process.under(*sizes), _where_missing(d))
                    out.append((of.whiten(columns)[:, :, 0], of.log_roots))
            except np.linalg.LinAlgError:
                return []
        return out

    def _driven(self, spectra: Mapping[str, DisturbanceSpectrum]) -> list[Process]:
        """What sources of these spectra drive in each record; anew only where a spectrum moved."""
        if self._processes is None or self._processes[0] != spectra:
            moving = [n for n, sd in self.noise.source_sd.items() if sd > 0.0]
            joined = [joined_steps(s, spectra) for s in self.steps]
            found = [process_of(s, moving, spectra, self.noise.weights) for s in joined]
            self._processes = spectra, found
        return self._processes[1]


def _where_missing(data: Signals) -> BoolArray | None:
    """(N, ny) the samples that there are; None where none lacks."""
    return None if data.used.all() else data.used


def _value(innovations: Sequence[tuple[Array, Array]]) -> float:
    """Minus the log-likelihood of e and -log s of each experiment; infinite of none."""
    squares = [0.5 * float(np.sum(e**2)) - float(np.sum(logs)) for e, logs in innovations]
    return sum(squares) if squares else np.inf
