"""How noisy the measured inputs are, and whether their noise matters to an estimate.

The variance of an input's white noise is what the residual shows of it (`estimation.noise`) and the
floor of the channel's own spectrum, each by its error, where the two agree, and else what the
residual shows, at most the floor; one that is stated is taken as it is. Where a noise as
large as both allow moves no unknown by a tenth of its standard error, and adds next to nothing to
its variance, it is left out of account.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import rfft
from scipy.stats import chi2

from casid.arrays import TINY, Array, BoolArray, scaled_inverse
from casid.estimation.errors_in_variables.equations import both_halves, columns_of, equations
from casid.estimation.noise.absorbed_noise import absorbed
from casid.estimation.noise.input_noise_floor import input_noise_floor, samples_with_noise
from casid.estimation.noise.missing_samples import unbroken
from casid.estimation.noise.noise_floor import floor_error
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import noise_response
from casid.estimation.noise.thresholds import FILLINGS, REMOVAL
from casid.estimation.noise.variances import ResidualWindows, estimate_noise, with_rounding
from casid.estimation.noise.varying_response import with_varying_response
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError


@dataclass(frozen=True, slots=True, eq=False)
class InputNoise:
    """The noise that a residual shows, and how much of it each measured input has.

    Both what the residual shows and the floor count where they agree. Where the residual shows far
    more than the floor, the rest is a disturbance, or misfit; where it shows far less, the floor is
    that of a signal.

    Attributes
    ----------
    floors : input -> variance of its white noise, at most: by its own spectrum, or as stated.
    errors : standard errors of `floors`; 0 where stated.
    agree : inputs whose floor agrees with what the residual shows; `noise` is from both.
    """

    noise: NoiseModel
    floors: Mapping[str, float]
    errors: Mapping[str, float]
    agree: tuple[str, ...] = ()

    @property
    def at_floor(self) -> tuple[str, ...]:
        """Inputs of `agree` whose floor is more exact than what the residual shows."""
        both = self.noise.variance_error
        return tuple(n for n in self.agree if 2 * both(n) ** 2 > self.errors[n] ** 2)

    @property
    def sd(self) -> dict[str, float]:
        """Input -> standard deviation of its noise."""
        found, bounded = self.noise.of_inputs(self._largest), self.bounded
        return {
            name: float(np.sqrt(self.floors[name])) if name in bounded else sd
            for name, sd in found.items()
        }

    @property
    def bounded(self) -> tuple[str, ...]:
        """Inputs whose noise is that of their floor, or as stated."""
        largest, error = self._largest, self.noise.variance_error
        found = self.noise.of_inputs(largest)
        return tuple(n for n, sd in found.items() if sd >= largest[n] or error(n) == 0.0)

    @property
    def most(self) -> dict[str, float]:
        """Standard deviations as `sd`, as large as the errors of the variances allow."""
        noise, above = self.noise, REMOVAL.above
        raised = {
            name: float(np.sqrt(sd**2 + above * noise.variance_error(name)))
            for name, sd in noise.source_sd.items()
        }
        return replace(noise, source_sd=raised).of_inputs(self._largest)

    @property
    def _largest(self) -> dict[str, float]:
        """Input -> standard deviation beyond which the residual shows more than its noise.

        The channel's own spectrum bounds its noise, up to the error of that bound. What a residual
        shows in few lines, as behind an integrator, has an error in proportion to its size: of a
        misfit it is so large that it would allow any noise, so it counts up to that of the bound.
        """
        out = {}
        for name, floor in self.floors.items():
            own, shown = self.errors[name], self.noise.variance_error(name)
            above = REMOVAL.above * np.hypot(own, min(shown, own))
            out[name] = float(np.sqrt(floor + above))
        return out


def input_noise(
    criterion: SimulationError,
    x: Array,
    known: Mapping[str, float],
    before: NoiseModel | None = None,
) -> InputNoise:
    """The noise at `x` (n,), with that of the channels `known` (standard deviations) as stated.

    Parameters
    ----------
    before : the noise found nearby, if it was: missing samples are drawn from it first, and whether
        a response varies (`with_varying_response`) is as it was there.
    """
    known = with_rounding(criterion.data, known)
    seen = _Residuals(criterion, x, known, before)
    noise = seen.noise()
    inputs = criterion.model.inputs
    floors = input_noise_floor(criterion.data, list(inputs))
    measured = [n for n, u in inputs.items() if u.kind == "measured"]
    errors = {
        n: 0.0
        if n in known
        else floor_error(samples_with_noise(criterion.data, i, n)) * floors[n] ** 2
        for i, n in enumerate(inputs)
        if n in measured
    }
    noise, agree = seen.with_floors(noise, {n: (floors[n] ** 2, errors[n]) for n in measured})
    if before is None or before.varying:
        noise = with_varying_response(noise, criterion, x, known, residuals=seen.recorded)
    return InputNoise(noise, {n: known.get(n, floors[n]) ** 2 for n in measured}, errors, agree)


def _apart(variance: float, floor: float, error: float) -> float:
    """Twice the log-likelihood by which a variance is less likely than the floor, itself."""
    ratio = floor / max(variance, TINY)
    return float(2 * (floor / error) ** 2 * (ratio - 1 - np.log(ratio)))


class _Residuals:
    """Residuals at `x`, and the noise that they show.

    Through a window with holes the spectrum of a slow residual leaks all over the band, and hides
    the noise of the sensors. Missing samples are drawn from the noise last found instead, and that
    is found anew, some times over: stochastic EM (Celeux and Diebolt 1985), which converges at the
    rate of the share that is missing.
    """

    def __init__(
        self,
        criterion: SimulationError,
        x: Array,
        known: Mapping[str, float],
        before: NoiseModel | None,
    ) -> None:
        self.criterion, self.x, self.known, self.before = criterion, x, known, before
        self.recorded = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
        self.residuals = self.recorded
        self.windows = [d.used for d in criterion.data]
        self.responses = [noise_response(criterion, x, e) for e in range(len(criterion.data))]
        self.absorbed = absorbed(self.responses, *self._tangents())
        self.share = 1.0  # of the samples that the residuals have, those that were recorded

    def _tangents(self) -> tuple[list[Array], list[Array]]:
        """T of every record, and what the estimate multiplies them by.

        An estimate of least squares where there is no noise from before, else one under that.
        """
        c, tangents, weighted = self.criterion, [], []
        for e, d in enumerate(c.data):
            complete = replace(d, used=np.ones_like(d.used))
            t = c.simulated(self.x, e, signals=None if d.used.all() else complete).jacobian
            w = c.weights[None, :, None]
            tangents.append(t)
            weighted.append(t * w**2 if self.before is None else self.before.weighted(t * w, e) * w)
        return tangents, weighted

    def noise(self) -> NoiseModel:
        """The noise of few sources."""
        has_holes = any(unbroken(d.used) is None for d in self.criterion.data)
        if not has_holes:
            return self._of_few_sources()
        found, fillings = self.before, FILLINGS.again
        if found is None:
            found, fillings = self._of_few_sources(), FILLINGS.first
        rng = np.random.default_rng(0)
        for _ in range(fillings):
            self._fill(found, rng)
            found = self._of_few_sources()
        return found

    def _fill(self, noise: NoiseModel, rng: np.random.Generator) -> None:
        data = self.criterion.data
        self.residuals = [noise.filled(r, e, rng) for e, r in enumerate(self.recorded)]
        holes = [unbroken(d.used) is None for d in data]
        self.windows = [
            np.ones_like(d.used) if hole else d.used for d, hole in zip(data, holes, strict=True)
        ]
        has = sum(int(w.sum()) for w in self.windows)
        self.share = sum(int(d.used.sum()) for d in data) / has

    def with_floors(
        self, noise: NoiseModel, floors: Mapping[str, tuple[float, float]]
    ) -> tuple[NoiseModel, tuple[str, ...]]:
        """The noise by the floors as well that agree with it, and the inputs that these are of.

        Parameters
        ----------
        noise : what the residual shows.
        floors : input -> variance and its standard error; 0 where it is stated.
        """
        inputs = self.criterion.model.inputs
        # Inputs that act alike are seen together alone.
        single = [group[0] for group in noise.alike if sum(n in inputs for n in group) == 1]
        sought = {n: floor for n, floor in floors.items() if n in single and floor[1] > 0.0}
        has_disturbances = any(noise.source_sd[b] > 0 for b in self.criterion.model.balances)
        while sought:
            both = self.of(self.known, has_disturbances=has_disturbances, floors=sought)
            apart = {n: _apart(both.source_sd[n] ** 2, *floor) for n, floor in sought.items()}
            moved = 2 * (both.misfit - noise.misfit) / len(self.criterion.outputs)
            if moved + sum(apart.values()) < chi2.ppf(REMOVAL.agrees, len(sought)):
                return both, tuple(sought)
            del sought[max(apart, key=apart.__getitem__)]
        return noise, ()

    def of(
        self,
        known: Mapping[str, float],
        *,
        has_disturbances: bool = True,
        floors: Mapping[str, tuple[float, float]] | None = None,
    ) -> NoiseModel:
        """The noise, with that of some channels known, and errors of what is recorded alone."""
        found = estimate_noise(
            self.criterion,
            self.x,
            known=known,
            residuals=self.residuals,
            responses=self.responses,
            has_disturbances=has_disturbances,
            seen_through=ResidualWindows(self.windows, self.absorbed, floors or {}),
        )
        wider = (2 - self.share) / self.share  # for what is missing, and for what was drawn
        return replace(found, covariance={k: wider * v for k, v in found.covariance.items()})

    def _of_few_sources(self) -> NoiseModel:
        """The noise of sensors and measured inputs; with disturbances where residuals show them.

        What an input and a force somewhere else give to a residual is often much alike. A force
        gets a part of it only where the likelihood gains more by it than Schwarz's criterion
        charges. As outputs may all show the same noise, what it counts for each of them is counted
        once.
        """
        whole = self.of(self.known)
        inputs, ny = self.criterion.model.inputs, len(self.criterion.outputs)
        forces = [g for g in whole.alike if g[0] not in inputs and whole.source_sd[g[0]] > 0]
        if not forces:
            return whole
        few = self.of(self.known, has_disturbances=False)
        lines = sum(d.N // 2 + 1 for d in self.criterion.data) * ny
        price = 0.5 * len(forces) * np.log(max(lines, 2))
        return few if (few.misfit - whole.misfit) / ny < price else whole


def added_variance(fit: Fit, noise: NoiseModel, free: Array) -> float:
    """The largest share that noise on inputs adds to the variance of an unknown of least squares.

    Parameters
    ----------
    noise : of sensors, and of inputs as large as it may be.
    free : (n,) bool, False at active bounds.
    """
    criterion, index = fit.criterion, np.flatnonzero(free)
    matrix, alone, whole = (np.zeros((len(index), len(index))) for _ in range(3))
    for e, d in enumerate(criterion.data):
        t = criterion.columns(fit.x, e)[1][:, :, index]
        spectra = rfft(t, axis=0) / np.sqrt(d.N)
        omega = np.linspace(0.0, np.pi, len(spectra))
        for i, weight in enumerate(criterion.weights):
            power = np.interp(omega, noise.responses[e].omega, noise.spectrum(e)[:, i])
            part = spectra[:, i]
            matrix += t[:, i].T @ t[:, i]
            alone += (weight * noise.output_sd[i]) ** 2 * (t[:, i].T @ t[:, i])
            rows = (weight**2 * both_halves(d.N) * power)[:, None] * part
            whole += (part.conj().T @ rows).real
    inverse = scaled_inverse(matrix)
    least, most = (np.diag(inverse @ part @ inverse) for part in (alone, whole))
    return float(np.max(most / np.maximum(least, TINY) - 1, initial=0.0))


def possible_bias(
    fit: Fit, input_sd: Mapping[str, float], covariance: Array, free: Array, seed: int = 0
) -> Array:
    """(n,) bias of a fit that takes its inputs for exact, in standard errors.

    Parameters
    ----------
    input_sd : of the noise that the inputs may have.
    covariance : (n, n) of the fit.
    free : (n,) bool, False at active bounds.
    """
    used = [d.used for d in fit.criterion.data]
    at = equations(columns_of(fit.criterion, fit.x, input_sd, seed), Unwhitened(used), input_sd)
    index = np.flatnonzero(free)
    slope, bias = at.matrix[np.ix_(index, index)], at.bias[index]
    moved = scaled_inverse(slope) @ bias
    out = np.zeros(len(free))
    sd = np.sqrt(np.maximum(np.diag(covariance)[index], 0.0))
    out[index] = np.divide(moved, sd, out=np.zeros(len(index)), where=sd > 0)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Unwhitened:
    """The columns as they are, of the samples `used` (N, ny) of each experiment."""

    used: Sequence[BoolArray]

    def whiten(self, columns: Array, experiment: int, used: BoolArray | None = None) -> Array:
        """The columns."""
        return columns

    def seen(self, white: Array, experiment: int) -> Array:
        """Zero where samples are missing."""
        return np.asarray(white * self.used[experiment][:, :, None])
