"""The noise of a simulation error: from sensors, measured inputs and disturbances.

A measured input is noisy, and the model's resonance amplifies that noise (errors in variables); a
force that nobody models does the same. With G_j the model's transfer functions at the estimate,

    S_i(w) = sigma_i^2 + sum_j |G_ij(w)|^2 sigma_j^2                                          (1)

for output i. What sensors and actuators do beyond an expression (delays, lags) is part of G: of the
recorded input's noise on its way in, and of everything that an output's sensor passes on; the
sensor's own white noise comes after it. The variances minimise Whittle's likelihood of the
residual; their whole spectra and cross-spectra whiten residuals and sensitivities alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.optimize import lsq_linear, nnls

from casid.arrays import TINY, Array, BoolArray, require_finite
from casid.estimation.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.innovations import Innovations, innovations_of
from casid.estimation.missing_samples import (
    PartialInnovations,
    UnbrokenInnovations,
    unbroken,
)
from casid.estimation.noise_response import Response, name_of_force, noise_response
from casid.estimation.residual_spectra import Spectra, restricted, spectra_of, with_floors
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.varying_innovations import PartialVarying, VaryingInnovations
from casid.model.model import Model

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
        """The same without disturbances: sensors and measured inputs only."""
        quiet = {name: input_sd.get(name, 0.0) for name in self.source_sd}
        return replace(self, source_sd=quiet, varying=())

    def averaged(self) -> NoiseModel:
        """The same by the average response: for other parts of records than it was found from."""
        return replace(self, varying=()) if self.varying else self

    def variance_error(self, name: str) -> float:
        """Standard error of the variance of a source; 0 where it was not sought."""
        key: Variance = ("source", name)
        return float(np.sqrt(max(self.covariance.get((key, key), 0.0), 0.0)))

    def of_inputs(self, largest: Mapping[str, float]) -> dict[str, float]:
        """What part of `source_sd` the measured inputs can account for.

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
class Seen:
    """How residuals show the errors of which they are.

    Attributes
    ----------
    windows : (N, ny) an experiment, the samples that there are.
    absorbed : what the fit took out of the spectra (`absorbed_noise`); None: nothing.
    floors : input -> its variance as its own channel shows it, and the standard error of that. Each
        counts as one more line of the spectra, once for every output, as the lines of these do.
    """

    windows: Sequence[BoolArray]
    absorbed: Sequence[Array] | None = None
    floors: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def estimate_noise(
    criterion: SimulationError,
    x: Array,
    *,
    known: Mapping[str, float] | None = None,
    residuals: Sequence[Array] | None = None,
    merge: bool = True,
    responses: Sequence[Response] | None = None,
    has_disturbances: bool = True,
    seen_through: Seen | None = None,
) -> NoiseModel:
    """Estimate (1) from the residuals at `x` by Fisher scoring of Whittle's likelihood.

    Sources whose responses have the same shape (an input and a balance it enters) are
    indistinguishable: the variance is given to the first, measured inputs before balances, and
    `alike` lists them. A source whose noise is known is counted on its own. There is no white noise
    in stated rates: integrated, it would be any slow error.

    Parameters
    ----------
    known : channel -> standard deviation that is known and not estimated; of the force in a balance
        by the name that `with_forces` gives it.
    residuals : (N, ny) an experiment, default those at `x`.
    responses : of the experiments, where they are known already.
    has_disturbances : False: of sensors and measured inputs alone.
    seen_through : which samples `residuals` have, and what the fit absorbed; default those that
        count, and nothing.
    """
    known = with_rounding(criterion.data, known or {})
    stated = known_sources(known, criterion.model)
    ny = len(criterion.outputs)
    if responses is None:
        responses = [noise_response(criterion, x, e) for e in range(len(criterion.data))]
    if residuals is None:
        residuals = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
    every = list(responses[0].sources)
    alike: list[tuple[str, ...]] = [(name,) for name in every if name in stated]
    found_in = [*criterion.model.inputs, *(criterion.model.balances if has_disturbances else ())]
    rest = [name for name in every if name not in stated and name in found_in]
    alike += _alike(responses, criterion.weights, every, rest) if merge else [(n,) for n in rest]
    sources = [group[0] for group in alike]
    given = given_variances(criterion.outputs, sources, known, stated)
    used = [d.used.copy() for d in criterion.data]
    shown = seen_through or Seen(used)
    spectra = spectra_of(residuals, responses, sources, ny, shown.windows, absorbed=shown.absorbed)
    require_finite("the residual's spectra", spectra.power, spectra.design)
    floors = {g[0]: shown.floors[n] for g in alike for n in g if n in shown.floors}
    with_lines = with_floors(spectra, floors, sources)
    value = variances(with_lines, given)
    output_sd = np.sqrt(np.maximum(value[:ny], spectra.least))
    found = {name: float(np.sqrt(v)) for name, v in zip(sources, value[ny:], strict=True)}
    is_felt = np.any(spectra.design * value > spectra.floor[:, None], axis=0)
    is_input = np.array([False] * ny + [name in criterion.model.inputs for name in sources])
    sought = np.isnan(given) & (is_felt | is_input)
    keys: list[Variance] = [("output", n) for n in criterion.outputs]
    keys += [("source", n) for n in sources]
    return NoiseModel(
        output_sd=output_sd,
        source_sd={name: found.get(name, 0.0) for name in every},
        responses=responses,
        weights=criterion.weights,
        alike=tuple(alike),
        covariance=_covariance(with_lines, value, keys, sought),
        misfit=whittle(spectra, value),
        used=() if all(mask.all() for mask in used) else used,
        known=known,
    )


def whittle(spectra: Spectra, value: Array) -> float:
    """Minus Whittle's log-likelihood of periodograms under the variances `value`.

    The restricted one, where the spectra have a tangent.
    """
    s = np.maximum(spectra.design @ value, spectra.floor)
    return float(spectra.count @ (np.log(s) + spectra.power / s) + restricted(spectra, s))


def _covariance(
    spectra: Spectra, value: Array, keys: Sequence[Variance], sought: Array
) -> dict[tuple[Variance, Variance], float]:
    """Covariance of the variances that were `sought`: the inverse of Whittle's information."""
    index = np.flatnonzero(sought)
    design = spectra.design[:, index] / np.maximum(spectra.design @ value, spectra.floor)[:, None]
    size = np.sqrt(np.maximum(np.sum(spectra.count[:, None] * design**2, axis=0), TINY))
    scaled = design / size
    inverse = np.linalg.pinv((scaled * spectra.count[:, None]).T @ scaled) / np.outer(size, size)
    return {
        (keys[i], keys[j]): float(inverse[a, b])
        for a, i in enumerate(index.tolist())
        for b, j in enumerate(index.tolist())
    }


def variances(spectra: Spectra, given: Array, *, tolerance: float = 0.0) -> Array:
    """Variances that minimise Whittle's likelihood by scoring; `given` ones (else NaN) are kept.

    `tolerance` is the relative change of the spectrum at which it ends early.
    """
    design, power, count, floor = spectra.design, spectra.power, spectra.count, spectra.floor
    fixed = np.isfinite(given)
    value = np.where(fixed, given, 0.0)
    offset = design @ value
    free = design[:, ~fixed]
    if not free.shape[1]:
        return value
    s = np.maximum(power, 1e-4 * floor) + offset
    solution = new = np.zeros(free.shape[1])
    for k in range(60):
        weight = np.sqrt(count) / s
        scale = np.sqrt(np.sum((free * weight[:, None]) ** 2, axis=0)) + TINY
        target = np.maximum(power - offset, 0.0) * weight
        new = _least(free * (weight[:, None] / scale), target, new) / scale
        solution = new if k == 0 else 0.5 * (solution + new)
        before, s = s, np.maximum(free @ solution + offset, floor)
        if np.all(np.abs(s - before) < tolerance * s):
            break
    value[~fixed] = solution
    return value


def _least(a: Array, b: Array, near: Array) -> Array:
    """Non-negative x that minimises |a x - b|; the one with the zeros of `near`, if it is."""
    held = near <= 0.0
    if not held.all():
        x = np.zeros(a.shape[1])
        x[~held], _, rank, _ = np.linalg.lstsq(a[:, ~held], b, rcond=None)
        if rank == np.sum(~held) and np.all(x[~held] > 0.0):
            # Lawson and Hanson's condition, columns of unit size: none held at zero would grow.
            if np.all(a[:, held].T @ (b - a @ x) <= 1e-12 * np.linalg.norm(b)):
                return x
    return non_negative(a, b)


def non_negative(a: Array, b: Array) -> Array:
    """(k,) non-negative x that minimises |a x - b|, for a (B, k) and b (B,)."""
    try:
        return np.asarray(nnls(a, b)[0])
    except RuntimeError:  # its active set cycles where columns are nearly dependent
        return np.asarray(lsq_linear(a, b, bounds=(0.0, np.inf)).x)


def _alike(
    responses: Sequence[Response], weights: Array, sources: list[str], candidates: Sequence[str]
) -> list[tuple[str, ...]]:
    """Those of `candidates` in groups whose |G|^2 are multiples of one another; none that is 0.

    Outputs, which may differ by orders of magnitude in SI, count in the criterion's weights. What
    acts on one output alone is not like what acts on that and on another.
    """
    groups: list[list[str]] = []
    if not sources:
        return []
    weighted = [r.gain2 * weights[:, None] ** 2 for r in responses]
    stacked = np.concatenate([g.reshape(-1, len(sources)) for g in weighted])
    logs = 0.5 * np.log(np.maximum(stacked, TINY))
    strong = stacked > 1e-6 * stacked.max(axis=0, initial=0.0)
    for name in candidates:
        j = sources.index(name)
        if not strong[:, j].any():
            continue
        for group in groups:
            head = sources.index(group[0])
            either = strong[:, j] | strong[:, head]
            if float(np.std(logs[either, j] - logs[either, head])) < 0.25:
                group.append(name)
                break
        else:
            groups.append([name])
    return [tuple(group) for group in groups]


def with_rounding(signals: Sequence[Signals], known: Mapping[str, float]) -> dict[str, float]:
    """The noise of channels that is known: of rounded inputs that of rounding, else as stated."""
    out: dict[str, float] = {}
    for d in signals:
        for name, sd in d.rounding.items():
            out[name] = max(sd, out.get(name, 0.0))
    return out | dict(known)


def known_sources(known: Mapping[str, float], model: Model) -> dict[str, float]:
    """Of the noise that is known, that of inputs, and of forces by their balances.

    The law of a state is a balance by the state's name, and so may be an output.
    """
    inputs = {name: known[name] for name in model.inputs if name in known}
    forces = {place: name_of_force(place) for place in model.balances}
    return inputs | {place: known[n] for place, n in forces.items() if n in known}


def given_variances(
    outputs: Sequence[str],
    sources: Sequence[str],
    known: Mapping[str, float],
    known_forces: Mapping[str, float],
) -> Array:
    """(ny + ns,) variances of outputs and sources that are known, NaN of the others."""
    sds = [known.get(n, np.nan) for n in outputs] + [known_forces.get(n, np.nan) for n in sources]
    return np.array(sds) ** 2


def error_over_noise(fit: Fit, noise: NoiseModel) -> float:
    """The largest error of an output over its white noise, both rms."""
    white = np.maximum(np.asarray(noise.output_sd, dtype=float), TINY)
    c = fit.criterion
    squares = [np.sum(c.simulated(fit.x, e).residual ** 2, axis=0) for e in range(len(c.data))]
    samples = np.sum([d.used.sum(axis=0) for d in c.data], axis=0)
    return float(np.max(np.sqrt(np.sum(squares, axis=0) / np.maximum(samples, 1)) / white))
