"""The noise of a simulation error: from sensors, measured inputs and disturbances.

A measured input is noisy, and the model's resonance amplifies that noise (errors in variables); a
force that nobody models does the same. With G_j the model's transfer functions at the estimate,

    S_i(w) = sigma_i^2 + sum_j |G_ij(w)|^2 sigma_j^2                                          (1)

for output i. What sensors and actuators do beyond an expression (delays, lags) is part of G: of the
recorded input's noise on its way in, and of everything that an output's sensor passes on; the
sensor's own white noise comes after it. Whole spectra and cross-spectra whiten residuals and
sensitivities alike. `variances` estimates their variances.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from casid.arrays import TINY, Array, BoolArray, basis_of
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.innovations import Innovations, innovations_of
from casid.estimation.noise.missing_samples import PartialInnovations, UnbrokenInnovations, unbroken
from casid.estimation.noise.noise_response import Response
from casid.estimation.noise.thresholds import AVERAGE_RESPONSE
from casid.estimation.noise.varying_innovations import PartialVarying, VaryingInnovations
from casid.estimation.simulation.records.signals import Signals

Partial = PartialInnovations | UnbrokenInnovations | PartialVarying

Variance = tuple[Literal["output", "source"], str]
"""Whose: of an output, or of a source, which is a measured input or a force. The law of a state
is a force by the state's name, which an output may have as well."""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Variances of (1) and the whitening they give, in the criterion's weighted output units."""

    output_sd: Array  # (ny,) white noise of each output, output units
    source_sd: Mapping[str, float]  # measured input or balance -> white noise per sample
    responses: Sequence[Response]  # one an experiment
    weights: Array
    alike: Sequence[tuple[str, ...]] = ()  # sources of one shape; the first carries the variance
    covariance: Mapping[tuple[Variance, Variance], float] = field(default_factory=dict)
    spectra: Mapping[str, DisturbanceSpectrum] = field(default_factory=dict)  # of forces not white
    misfit: float = float("nan")  # minus Whittle's log-likelihood of the residual it is found from
    used: Sequence[BoolArray] = ()  # (N, ny) an experiment, where samples are missing
    known: Mapping[str, float] = field(default_factory=dict)  # channel -> noise that was stated
    varying: Sequence[
        VaryingInnovations
    ] = ()  # one an experiment, in place of the average response
    _innovations: dict[tuple[int, int], Innovations] = field(
        default_factory=dict, init=False, repr=False
    )
    _cut: dict[tuple[int, int, int], VaryingInnovations] = field(
        default_factory=dict, init=False, repr=False
    )
    _partial: dict[tuple[int, bytes], Partial] = field(default_factory=dict, init=False, repr=False)

    def quiet(self, input_sd: Mapping[str, float]) -> NoiseModel:
        """The noise of sensors and measured inputs alone, without disturbances."""
        quiet = {name: input_sd.get(name, 0.0) for name in self.source_sd}
        return replace(self, source_sd=quiet, varying=())

    def forces(self, inputs: Container[str]) -> list[str]:
        """The sources with a variance that are no measured inputs."""
        return [name for name, sd in self.source_sd.items() if sd > 0.0 and name not in inputs]

    def price_of_shapes(self, samples: int) -> float:
        """Schwarz's penalty [units of log-likelihood] of the parameters of its spectra."""
        shapes = self.spectra.values()
        count = sum(1 + (s.damping is not None) + len(s.parts[1:]) for s in shapes)
        return 0.5 * count * float(np.log(samples))

    def averaged(self) -> NoiseModel:
        """The noise with average responses, for parts of records that it was not found from."""
        return replace(self, varying=()) if self.varying else self

    def under_spectra(
        self, spectra: Mapping[str, DisturbanceSpectrum], data: Sequence[Signals]
    ) -> NoiseModel:
        """The noise with other frequencies and widths of its spectra, and the same variances.

        Innovations along a path, `varying`, stay as they were.
        """
        moved = {n: s for n, s in spectra.items() if s != self.spectra[n]}
        if not moved:
            return self
        responses = []
        for r, d in zip(self.responses, data, strict=True):
            ratios = np.ones((len(r.omega), len(r.sources)))
            for name, spectrum in moved.items():
                before = np.maximum(self.spectra[name].at(r.omega, d.Ts), TINY)
                ratios[:, r.sources.index(name)] = spectrum.at(r.omega, d.Ts) / before
            responses.append(r.reshaped(ratios))
        return replace(self, responses=responses, spectra=dict(spectra))

    def variance_error(self, name: str) -> float:
        """Standard error of the variance of a source; 0 where it was not sought."""
        key: Variance = ("source", name)
        return float(np.sqrt(max(self.covariance.get((key, key), 0.0), 0.0)))

    def of_inputs(self, largest: Mapping[str, float]) -> dict[str, float]:
        """The part of `source_sd` that the measured inputs can account for.

        Parameters
        ----------
        largest : measured input -> upper bound on its white noise. Inputs that act alike share the
            variance found, each by the part it could have at its bound; the rest is a disturbance.
        """
        out = {}
        for group in self.alike:
            inputs = [name for name in group if name in largest]
            gains = {name: sum(self.gain(name, r) for r in self.responses) for name in group}
            white = [name for name in group if name not in self.spectra]  # others are their own
            found = sum(self.source_sd[name] ** 2 * gains[name] for name in white)
            could = sum(largest[name] ** 2 * gains[name] for name in inputs)
            share = np.sqrt(min(found / could, 1.0)) if could > 0 else 0.0
            out.update({name: float(share * largest[name]) for name in inputs})
        return out

    def gain(self, name: str, r: Response) -> float:
        """Weighted power of the outputs, of a unit variance of a source."""
        return float((r.gain2[:, :, r.sources.index(name)] * self.weights**2).mean())

    def power(self, data: Sequence[Signals]) -> float:
        """Power of the residuals, added over samples and weighted outputs."""
        weights = self.weights**2
        return sum(d.N * float(np.mean(self.spectrum(e) @ weights)) for e, d in enumerate(data))

    def unit_power(self, source: str, data: Sequence[Signals], *, is_white: bool = False) -> float:
        """The part of `power` that a unit variance of a source makes; of its white part."""
        total = 0.0
        for r, d in zip(self.responses, data, strict=True):
            gain2 = r.gain2[:, :, r.sources.index(source)] @ self.weights**2
            if is_white and source in self.spectra:
                gain2 = gain2 / np.maximum(self.spectra[source].at(r.omega, d.Ts), TINY)
            total += d.N * float(np.mean(gain2))
        return total

    def makes(self, source: str, share: float, data: Sequence[Signals]) -> bool:
        """True if a source makes this share of the power or more."""
        made = self.source_sd[source] ** 2 * self.unit_power(source, data)
        return made > 0 and made >= share * self.power(data)

    def spectrum(self, experiment: int) -> Array:
        """S (F, ny) per sample, output units squared, on the response's frequencies."""
        r = self.responses[experiment]
        variances = np.array([self.source_sd[s] ** 2 for s in r.sources])
        return np.asarray(self.output_sd[None, :] ** 2 + r.gain2 @ variances)

    def floor(self, experiment: int) -> Array:
        """(ny,) rms that the best possible model would leave."""
        s = self.spectrum(experiment)
        return np.asarray(
            np.sqrt(np.trapezoid(s, self.responses[experiment].omega, axis=0) / np.pi)
        )

    def spread(self, experiment: int, samples: int) -> Array:
        """(ny,) relative standard deviation of the mean square of so many samples.

        A mean of exponential periodograms: sqrt(sum S^2) / sum S.
        """
        omega, s = self.responses[experiment].omega, self.spectrum(experiment)
        per = samples / (2 * np.pi)
        total = per * np.trapezoid(s, omega, axis=0)
        root = np.sqrt(per * np.trapezoid(s**2, omega, axis=0))
        return np.asarray(root / np.maximum(total, TINY))

    def excess(self, quiet: NoiseModel, samples: Sequence[int]) -> tuple[float, float]:
        """Mean square of this noise over that of `quiet`, and the latter's relative spread.

        The largest over the outputs, all records together; a mean of exponential periodograms has
        the variance sum S^2 / (sum S)^2.

        Parameters
        ----------
        samples : of each record.
        """
        total, other, square = (np.zeros(len(self.output_sd)) for _ in range(3))
        for e, n in enumerate(samples):
            omega, s, per = self.responses[e].omega, quiet.spectrum(e), n / (2 * np.pi)
            total += per * np.trapezoid(self.spectrum(e), omega, axis=0)
            other += per * np.trapezoid(s, omega, axis=0)
            square += per * np.trapezoid(s**2, omega, axis=0)
        i = int(np.argmax(total / np.maximum(other, TINY)))
        floor = max(float(other[i]), TINY)
        return float(total[i]) / floor, float(np.sqrt(square[i])) / floor

    def whiten(self, columns: Array, experiment: int, used: BoolArray | None = None) -> Array:
        """Columns (N, ny, m), times `weights`, as white noise of unit size.

        Each sample less what those before it, and the outputs before it, predict of it: as outputs
        that the same source moves belong together, and no end of a record is an edge. Missing
        samples, those of the record that the noise comes from unless `used` (N, ny) says which
        there are, count for nothing.
        """
        if not any(self.source_sd.values()):
            return np.asarray(columns / (self.output_sd * self.weights)[None, :, None])
        partial = self._partial_of(experiment, len(columns), used)
        if partial is not None:
            return partial.whiten(columns)
        return self._along(experiment, slice(0, len(columns))).whiten(columns)

    def whitener(self, data: Sequence[Signals]) -> Whitening:
        """`whiten` for a criterion, which may count fewer samples than the noise comes from."""
        return Whitening(self, data)

    def weighted(self, columns: Array, experiment: int) -> Array:
        """The inverse of a complete record's covariance times columns (N, ny, m), weighted."""
        if not any(self.source_sd.values()):
            return np.asarray(columns / ((self.output_sd * self.weights) ** 2)[None, :, None])
        of = self._along(experiment, slice(0, len(columns)))
        return of.transposed(of.whiten(columns))

    def seen(self, white: Array, experiment: int) -> Array:
        """Columns (N, ny, m), whitened as of a complete record, less what missing samples took."""
        used = self._used_of(experiment, len(white))
        if used is None:
            return white
        if not any(self.source_sd.values()):
            return np.where(used[:, :, None], white, 0.0)
        partial = self._partial_of(experiment, len(white), None)
        assert partial is not None
        return partial.seen(white)

    def completed(self, white: Array, experiment: int) -> Array:
        """Whitened residuals (N, ny) with white noise in the place of what missing samples took.

        Inner products with whitened sensitivities stay as they are.
        """
        rng = np.random.default_rng(experiment)
        if any(self.source_sd.values()):
            partial = self._partial_of(experiment, len(white), None)
            return white if partial is None else partial.completed(white[:, :, None], rng)[:, :, 0]
        used = self._used_of(experiment, len(white))
        return white if used is None else np.where(used, white, rng.standard_normal(white.shape))

    def filled(self, residual: Array, experiment: int, rng: np.random.Generator) -> Array:
        """A residual (N, ny) with a draw of the samples missing between others, given those."""
        used = self._used_of(experiment, len(residual))
        if used is None or unbroken(used) is not None:
            return residual
        if not any(self.source_sd.values()):
            return np.where(used, residual, self.output_sd * rng.standard_normal(used.shape))
        partial = self.averaged()._partial_of(experiment, len(residual), None)
        assert isinstance(partial, PartialInnovations)
        return partial.filled(residual * self.weights, rng) / self.weights

    def is_broken(self, experiment: int) -> bool:
        """True of a record in the midst of which samples lacked where the noise was found."""
        used = self.used[experiment] if self.used else None
        return used is not None and unbroken(used) is None

    def _used_of(self, experiment: int, samples: int) -> BoolArray | None:
        """Which samples there are, None where all are."""
        used = self.used[experiment] if self.used else None
        return None if used is None or len(used) != samples or used.all() else used

    def _partial_of(self, experiment: int, samples: int, used: BoolArray | None) -> Partial | None:
        used = self._used_of(experiment, samples) if used is None else used
        if used is None or used.all():
            return None
        key = (experiment, used.tobytes())
        if key not in self._partial:
            rows = unbroken(used)
            of = self._along(experiment, rows or slice(0, samples))
            if rows is not None:
                self._partial[key] = UnbrokenInnovations(of, rows)
            elif isinstance(of, VaryingInnovations):
                self._partial[key] = PartialVarying(of, used.copy())
            else:
                self._partial[key] = PartialInnovations(of, used.copy())
        return self._partial[key]

    def matrix(self, experiment: int) -> Array:
        """Spectra and cross-spectra (F, ny, ny) per sample, output units squared."""
        r = self.responses[experiment]
        if len(self.output_sd) == 1:
            return self.spectrum(experiment)[:, :, None]
        if r.cross is not None:
            variances = np.array([self.source_sd[s] ** 2 for s in r.sources])
            return np.asarray(r.cross @ variances + np.diag(self.output_sd**2))
        assert r.gain is not None
        g = r.gain * np.array([self.source_sd[s] for s in r.sources])
        return np.asarray(g @ g.conj().swapaxes(1, 2) + np.diag(self.output_sd**2))

    def log_determinant(self, experiment: int, samples: int) -> float:
        """log det of the covariance of what there is of a record, whatever the weights."""
        used = self._used_of(experiment, samples)
        count = np.full(len(self.weights), samples) if used is None else used.sum(axis=0)
        if not any(self.source_sd.values()):
            return 2 * float(count @ np.log(self.output_sd))
        there = self._partial_of(experiment, samples, None)
        whitener = there or self._along(experiment, slice(0, samples))
        return whitener.log_determinant(samples) - 2 * float(count @ np.log(self.weights))

    def minus_log_likelihood(
        self, residuals: Sequence[Array], beside: Sequence[Array] | None = None
    ) -> float:
        """Minus log-likelihood of residuals (N, ny) an experiment; not finite where they diverge.

        Parameters
        ----------
        beside : columns (N, ny, m) of each experiment, of which a residual has whatever makes it
            likeliest, as of initial states.
        """
        value = 0.0
        with np.errstate(all="ignore"):
            for e, residual in enumerate(residuals):
                used = self._used_of(e, len(residual))
                stack = residual[:, :, None]
                if beside is not None:
                    stack = np.concatenate([stack, beside[e]], axis=2)
                there = stack if used is None else np.where(used[:, :, None], stack, 0.0)
                white = self.whiten(there * self.weights[None, :, None], e)
                r, columns = (
                    white[:, :, 0].ravel(),
                    white[:, :, 1:].reshape(white[:, :, 0].size, -1),
                )
                if columns.size and np.isfinite(white).all():
                    basis = basis_of(columns)
                    r = r - basis @ (basis.T @ r)
                value += 0.5 * float(r @ r) + 0.5 * self.log_determinant(e, len(there))
        return value

    def _along(self, experiment: int, rows: slice) -> Innovations | VaryingInnovations:
        """The innovations of these rows of a record, none of which is missing."""
        if not self.varying:
            return self._innovations_of(experiment, rows.stop - rows.start)
        key = experiment, rows.start, rows.stop
        if key not in self._cut:
            self._cut[key] = self.varying[experiment].cut(rows)
        return self._cut[key]

    def _innovations_of(self, experiment: int, samples: int) -> Innovations:
        if (experiment, samples) not in self._innovations:
            self._innovations[experiment, samples] = innovations_of(
                self.responses[experiment].omega,
                self.matrix(experiment) * np.outer(self.weights, self.weights),
                samples,
            )
        return self._innovations[experiment, samples]


@dataclass(frozen=True, slots=True, eq=False)
class Whitening:
    """`NoiseModel.whiten` of the samples that a criterion counts.

    A zero in the place of a sample that it leaves out, the first ones of a late input, is no
    measurement: under a slow disturbance it would contradict all that follow.
    """

    noise: NoiseModel
    data: Sequence[Signals]

    def __call__(self, columns: Array, experiment: int) -> Array:
        """Columns (N, ny, m) as `NoiseModel.whiten` takes and gives them."""
        used, noise = self.data[experiment].used, self.noise
        # An average response asks for a system as large as what lacks in the midst of a record.
        is_cheap = (
            bool(noise.varying)
            or noise.is_broken(experiment)
            or unbroken(used) is not None
            or np.count_nonzero(~used) <= AVERAGE_RESPONSE.missing
        )
        counts = is_cheap and len(used) == len(columns)
        return noise.whiten(columns, experiment, used if counts else None)
