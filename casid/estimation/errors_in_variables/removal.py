"""The estimate without the bias that noise on measured inputs gives to a simulation-error fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY, Array, BoolArray
from casid.estimation.covariance import sandwich
from casid.estimation.errors_in_variables.equations import Equations, columns_of, equations, step
from casid.estimation.errors_in_variables.input_noise import (
    InputNoise,
    added_variance,
    input_noise,
    possible_bias,
)
from casid.estimation.errors_in_variables.left_by_noise import left_by_noise, squares
from casid.estimation.errors_in_variables.total_least_squares import total_least_squares
from casid.estimation.generalised_least_squares import SpectralWeights, weighted_by_spectrum
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.thresholds import FAR_ROOT, REMOVAL, VARIANCE_SLOPE
from casid.estimation.simulation.fit import resolved_under
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError, Whitener


@dataclass(frozen=True, slots=True, eq=False)
class Corrected:
    """A fit, and what became of the bias that noise on its inputs gives.

    Attributes
    ----------
    fit : at the root of the equations without bias, or as it was.
    covariance : (n, n) of it; None where the fit is as it was.
    input_sd : measured input -> standard deviation of its noise.
    bias : unknown -> what noise on the inputs gives to the fit as it was, in standard errors.
    why_not : why the bias is still in the fit; an empty text where it is not, or is negligible.
    whiten : what the covariance rests on, by the noise that was found.
    noise : that was found at the root; None where the fit is as it was.
    reference : recorded signal of which instruments were made in the place of least squares.
    apart : with instruments, the parameter that least squares misses most, and by how many standard
        errors.
    refused : why no instruments were made of a declared reference.
    weights : the estimate by the spectrum of a coloured residual, which `fit` then has; None of
        plain least squares.
    why_plain : why a coloured residual has no part in the weights.
    """

    fit: Fit
    covariance: Array | None = None
    input_sd: Mapping[str, float] | None = None
    bias: Mapping[str, float] | None = None
    why_not: str = ""
    whiten: Whitener | None = None
    noise: NoiseModel | None = None
    reference: str = ""
    apart: tuple[str, float] = ("", 0.0)
    refused: str = ""
    weights: SpectralWeights | None = None
    why_plain: str = ""

    @property
    def is_removed(self) -> bool:
        """True if the fit is one without the bias, or of instruments."""
        return self.covariance is not None and self.weights is None

    @property
    def weigh(self) -> Whitener | None:
        """What columns are to be fitted under: the noise that was found, or the weights."""
        return self.whiten if self.noise is None else self.noise.whiten

    @property
    def noisy(self) -> tuple[str, ...]:
        """Measured inputs whose noise counts, removed or not."""
        if self.bias is None or self.input_sd is None:
            return ()
        worst = max(map(abs, self.bias.values()), default=0.0)
        counts = self.is_removed or not worst < REMOVAL.negligible
        return tuple(n for n, sd in self.input_sd.items() if sd > 0) if counts else ()

    @property
    def text(self) -> str:
        """How noise on measured inputs was treated, in words; empty where there is none."""
        if self.bias is None or self.input_sd is None:
            return f"noise on inputs is not removed, since {self.why_not}" if self.why_not else ""
        name, worst = max(self.bias.items(), key=lambda item: abs(item[1]))
        model = self.fit.criterion.model
        sizes = ", ".join(
            f"{n} of {model.shown_size(n, sd):.3g} {model.unit_of(n)}".rstrip()
            for n, sd in self.input_sd.items()
            if sd > 0
        )
        if self.is_removed and not sizes:
            return _HARMLESS
        if self.reference:
            return f"white noise on {sizes} at most is no bias to instruments"
        if self.is_removed and abs(worst) < REMOVAL.negligible:
            return (
                f"white noise on {sizes} biases least squares by no more than "
                f"{REMOVAL.negligible:g} standard errors, but makes it less certain: the estimate "
                "is weighted by its spectrum"
            )
        if self.is_removed:
            return (
                f"white noise on {sizes} biases least squares, {name} most, by {abs(worst):.2g} "
                "standard errors; the estimate is the root of equations without that bias"
            )
        if self.why_not and abs(worst) < REMOVAL.negligible:
            return (
                f"white noise on {sizes} at most moves no unknown by more than "
                f"{REMOVAL.negligible:g} standard errors; what it adds to their variance is not "
                f"counted, since {self.why_not}"
            )
        if self.why_not:
            return (
                f"white noise on {sizes} at most may bias {name} by up to {abs(worst):.2g} times "
                f"its standard error; it is not removed, since {self.why_not}"
            )
        return _HARMLESS


def without_input_noise(fit: Fit, known: Mapping[str, float], *, seed: int = 0) -> Corrected:
    """The estimate at the root of the equations without bias, where noise on inputs matters.

    Parameters
    ----------
    fit : minimum of the simulation error, not whitened.
    known : channel -> standard deviation of its white noise, where stated; 0 for none.
    """
    criterion, solution = fit.criterion, fit.solution
    inputs = criterion.model.inputs
    noisy = [n for n, u in inputs.items() if u.kind == "measured" and known.get(n, 1.0) > 0]
    if not noisy:
        return Corrected(fit)
    if criterion.segments > 1 or solution.constraint_jacobian.size:
        return Corrected(fit, why_not="it is fitted in segments, or under constraints")
    free = solution.is_free
    found = input_noise(criterion, fit.x, known)
    covariance, _ = sandwich(solution.hessian, criterion.scores(fit.x), free)
    bias = possible_bias(fit, found.most, covariance, free, seed)
    named = dict(zip(criterion.names, bias.tolist(), strict=True))
    at = Corrected(fit, input_sd=found.most, bias=named)
    if not np.all(np.isfinite(bias)):
        return replace(at, why_not="the simulation overflows with noise on its inputs")
    if float(np.abs(bias).max(initial=0.0)) < REMOVAL.negligible:
        if added_variance(fit, found.noise.quiet(found.most), free) < REMOVAL.adds:
            return at
    root = _resolved(_root(fit, known, free, found, seed), fit)
    why_not = root.why_not or _worse(fit, root)
    if why_not:
        return replace(at, why_not=why_not)
    size, most = solution.scaled_gradient, root.scaled_score
    solution = replace(
        solution,
        x=root.x,
        scaled_gradient=size if solution.is_converged else most,
        at_lower=root.held(solution.at_lower, root.lower),
        at_upper=root.held(solution.at_upper, root.upper),
    )
    return Corrected(
        replace(fit, criterion=root.criterion, solution=solution),
        root.covariance(),
        root.found.sd,
        named,
        whiten=root.whitened,
        noise=root.found.noise,
    )


def with_spectral_weights(found: Corrected) -> Corrected:
    """With the estimate weighted by the residual's spectrum, where that is much more certain.

    A fit with a bias from its inputs, or without it, stays as it is.
    """
    if found.is_removed or found.why_not:
        return found
    weights = weighted_by_spectrum(found.fit)
    if isinstance(weights, str):
        return replace(found, why_plain=weights)
    old, new = found.fit.solution, weights.fit.solution
    solution = replace(old, x=new.x, at_lower=new.at_lower, at_upper=new.at_upper)
    return replace(
        found,
        fit=replace(found.fit, solution=solution),
        covariance=weights.covariance(new.is_free),
        whiten=weights.fit.criterion.whiten,
        weights=weights,
    )


def _root(fit: Fit, known: Mapping[str, float], free: Array, found: InputNoise, seed: int) -> _Root:
    """The root near the fit, or near total least squares where that is far better elsewhere."""
    criterion = fit.criterion
    declared = [fit.begun.get(v.name, v.start) for v in criterion.variables]
    starts = [fit.x, np.array(declared)]
    x = total_least_squares(criterion, starts, found.noise.quiet(found.sd))
    if x is not None:
        there = replace(fit, solution=replace(fit.solution, x=x))
        lower, upper = ([getattr(v, s) for v in criterion.variables] for s in ("lower", "upper"))
        is_free = (x > lower) & (x < upper)
        root = _Root(there, known, is_free, input_noise(criterion, x, known), seed, True)
        if not root.why_not:
            return root
    return _Root(fit, known, free, found, seed)


def _resolved(root: _Root, fit: Fit) -> _Root:
    """The root with integration steps as fine as its weights need."""
    if root.why_not:
        return root
    fine = resolved_under(root.criterion, root.x, root.found.noise.whiten)
    if fine is root.criterion:
        return root
    there = replace(fit, criterion=fine, solution=replace(fit.solution, x=root.x))
    return _Root(there, root.known, root.free, root.found, root.seed, is_cautious=True)


_HARMLESS = f"noise on inputs moves no unknown by more than {REMOVAL.negligible:g} standard errors"
_NO_ROOT = "the equations without it have no root near the fit"
_ALL_HELD = "the equations without it lead every unknown to a bound"


def _misfit(criterion: SimulationError, found: InputNoise) -> str:
    """Why a residual is more than noise of sensors and inputs; empty where it is not."""
    noise = found.noise
    ratio, spread = noise.excess(noise.quiet(found.sd), [d.N for d in criterion.data])
    if ratio <= max(REMOVAL.absorbs_misfit**2, 1 + REMOVAL.absorbs_spreads * spread):
        return ""
    return (
        f"the residual is {np.sqrt(ratio):.2g} times what sensors and inputs account for: the "
        "model is incomplete, or there are disturbances (casid diagnose)"
    )


def _worse(fit: Fit, root: _Root) -> str:
    """Why a root simulates worse than its noise allows; empty where it does not.

    The root of a drifting system may well simulate worse than least squares, whose initial states
    take most of the drift that noise on an input gives. By how much is known: noise of the sizes
    found at the root leaves to least squares what is orthogonal to its sensitivities. Where least
    squares leaves far less, that noise is not there, and where it leaves far more, misfit is.
    """
    criterion = fit.criterion
    least, now = (max(squares(criterion, x), TINY) for x in (fit.x, root.x))
    if now <= REMOVAL.absorbs_misfit**2 * least:
        return ""
    if root.found.noise.varying and root.is_noise():
        return ""  # most of the squares are where the noise is large
    left = np.log(_left_by_noise(root))
    ratio = np.log(least) - left.mean()
    if abs(ratio) <= REMOVAL.left_spreads * left.std(ddof=1):
        return ""
    means = (
        "the model is incomplete, or there are disturbances (casid diagnose)"
        if ratio > 0
        else "the inputs have less noise than that"
    )
    return (
        f"that raises the error {np.sqrt(now / least):.2g}-fold, and least squares leaves "
        f"{np.exp(ratio / 2):.2g} times what the noise would leave: {means}"
    )


def _left_by_noise(root: _Root) -> Array:
    """(m,) weighted sums of squares that least squares leaves of so many records of noise."""
    found = root.found
    left = left_by_noise(
        root.criterion, root.x, root.free, found.sd, found.noise.output_sd, root.seed
    )
    return np.asarray(np.maximum(left.sum(axis=1), TINY))


_OVERFLOWS = "the simulation overflows beside the fit"


class _Steps:
    """How far the search for a root goes along each step.

    Next to the root the whole way. Farther off, where noise is most of the residual, steps may lead
    to and fro: a cautious search goes as far as the step before it says, and goes back half the way
    where the next step would be far longer.
    """

    def __init__(self, is_cautious: bool) -> None:
        self.is_cautious = is_cautious
        self.most = FAR_ROOT.evaluations if is_cautious else REMOVAL.steps
        self.converged = FAR_ROOT.closely if is_cautious else REMOVAL.converged
        self.part = 1.0
        self.last: tuple[Array, BoolArray, Array] | None = None

    def end(self, x: Array, free: BoolArray, move: Array, matrix: Array) -> tuple[Array, BoolArray]:
        """Where a step (n,) from `x` is to end, and what was free where it began.

        Parameters
        ----------
        matrix : (n, n) in which a step has its length in standard errors.
        """
        if self.is_cautious and self.last is not None:
            begun, its_free, way = self.last
            before, now, along = (
                float(a @ matrix @ b) for a, b in ((way, way), (move, move), (way, move))
            )
            if now > FAR_ROOT.longer**2 * before and self.part > FAR_ROOT.least_part:
                self.part *= 0.5
                return begun + self.part * way, its_free
            left = along / max(before, TINY)  # of the step before, 1 - part times its slope
            self.part = float(np.clip(self.part / max(1 - left, TINY), FAR_ROOT.least_part, 1.0))
        self.last = x, free, move
        return x + self.part * move, free


class _Root:
    """The root of the equations, sought from a fit, with the noise found anew at every step."""

    def __init__(
        self,
        fit: Fit,
        known: Mapping[str, float],
        free: Array,
        found: InputNoise,
        seed: int,
        is_cautious: bool = False,
    ) -> None:
        self.criterion, self.known, self.seed = fit.criterion, known, seed
        self.x, self.free = fit.x.copy(), free.copy()
        self.lower, self.upper = (
            np.array([getattr(v, side) for v in self.criterion.variables])
            for side in ("lower", "upper")
        )
        self.beside = (1 - VARIANCE_SLOPE.difference, 1 + VARIANCE_SLOPE.difference)
        self.found = found
        self.at: Equations
        self.why_not = self._sought(is_cautious)

    def _sought(self, is_cautious: bool) -> str:
        """Go to the root; a reason where there is none."""
        share, at_fit, steps = 0.0, self.found, _Steps(is_cautious)
        for k in range(steps.most):
            if not self.free.any():
                return _misfit(self.criterion, at_fit) or _ALL_HELD
            if k > 0 and not self._is_finite():
                return _OVERFLOWS
            if k > 0:
                # Least squares leaves other parts of the noise than weighted steps do, and at its
                # own point the noise was found from what it leaves.
                self.found = input_noise(self.criterion, self.x, self.known, self.found.noise)
            self._evaluate()
            parts = (self.at.matrix, self.at.noise, self.at.score)
            if not all(np.all(np.isfinite(part)) for part in parts):
                return _OVERFLOWS
            move, length, share = step(self.at, self.free, REMOVAL.least_information)
            if length < steps.converged:
                break
            move *= min(1.0, REMOVAL.longest_step / length)
            there, free = steps.end(self.x, self.free, move, self.at.matrix)
            self.x = np.clip(there, self.lower, self.upper)
            # What a bound holds back stays there, and the others go on without it.
            self.free = free & (self.x == there)
        else:
            return _misfit(self.criterion, at_fit) or _NO_ROOT
        if share < REMOVAL.least_information:
            return "it is most of what the inputs say of a combination of the unknowns"
        if _misfit(self.criterion, self.found):
            return _misfit(self.criterion, at_fit) or _NO_ROOT
        return ""

    def _is_finite(self) -> bool:
        """Whether the model simulates every record here, with its sensitivities.

        By their fourth powers: noise is found by its variances, which have variances themselves.
        """
        runs = [self.criterion.simulated(self.x, e) for e in range(len(self.criterion.data))]
        with np.errstate(over="ignore"):
            powers = [part**4 for run in runs for part in (run.residual, run.jacobian)]
        return all(bool(np.all(np.isfinite(power))) for power in powers)

    def _evaluate(self) -> None:
        sd = self.found.sd
        self.columns = columns_of(self.criterion, self.x, sd, self.seed)
        self.at = equations(self.columns, self.found.noise, sd)

    def whitened(self, columns: Array, experiment: int) -> Array:
        """Columns (N, ny, 1) by the noise found, with white noise where samples are missing."""
        noise = self.found.noise
        white = noise.whiten(columns, experiment)[:, :, 0]
        return noise.completed(white, experiment)[:, :, None]

    def is_noise(self) -> bool:
        """Whether the residual at the root is as large as the noise found there."""
        c = self.criterion
        white = [
            self.whitened((c.simulated(self.x, e).residual * c.weights)[:, :, None], e)
            for e in range(len(c.data))
        ]
        size = sum(w.size for w in white)
        over = sum(float(np.sum(w**2)) for w in white) / size - 1.0
        return bool(abs(over) <= REMOVAL.left_spreads * np.sqrt(2.0 / size))

    @property
    def scaled_score(self) -> float:
        """The largest scaled score, as `Solution.scaled_gradient` is for a minimum."""
        score, size = self.at.score[self.free], np.diag(self.at.matrix)[self.free]
        value = 0.5 * self.criterion.n_samples * len(self.criterion.outputs)
        return float(np.max(np.abs(score) / np.sqrt(np.maximum(size * value, TINY)), initial=0.0))

    def held(self, before: Sequence[str], bound: Array) -> tuple[str, ...]:
        """Names of the variables at one of their bounds (n,), or held there `before` and here."""
        is_held = (self.x == bound) | (np.isin(self.criterion.names, before) & ~self.free)
        return tuple(self.criterion.names[i] for i in np.flatnonzero(is_held))

    def covariance(self) -> Array:
        """(n, n) of the root, by the slope and the variance of the equations."""
        n, index = len(self.x), np.flatnonzero(self.free)
        both = np.ix_(index, index)
        slope = self.at.slope[both]
        d = 1 / np.sqrt(np.diag(self.at.matrix)[index])
        inverse = np.outer(d, d) * np.linalg.pinv(slope * np.outer(d, d), rcond=1e-13)
        variance = self.at.variance + self._of_noise()
        out = np.zeros((n, n))
        samples, unknowns = self.criterion.n_samples, len(index)
        factor = samples / max(samples - unknowns, 1)
        out[both] = factor * inverse @ variance[both] @ inverse
        return out

    def _of_noise(self) -> Array:
        """D V D' (n, n): what the errors of the variances of the noise give to the equations."""
        found, noise = self.found, self.found.noise
        keys = sorted({key for key, _ in noise.covariance})
        slopes = [self._slope_by_variance(*key) for key in keys]
        out = np.zeros((len(self.x), len(self.x)))
        for a, one in zip(keys, slopes, strict=True):
            for b, other in zip(keys, slopes, strict=True):
                out += noise.covariance[a, b] * np.outer(one, other)
        for name in found.bounded:
            if found.errors[name] > 0:
                slope = self._slope([(noise, self._scaled_inputs((name,), f)) for f in self.beside])
                out += found.errors[name] ** 2 * np.outer(slope, slope) / found.floors[name] ** 2
        return out

    def _slope_by_variance(self, of: str, name: str) -> Array:
        """(n,) derivative of the equations by the variance of an output or a source of noise.

        The noise of the inputs that it stands for changes with it, where no bound holds them.
        """
        noise, outputs = self.found.noise, self.criterion.outputs
        if of == "output":
            its = np.array([n == name for n in outputs])
            variance = float(noise.output_sd[its][0] ** 2)
            changed = [
                replace(noise, output_sd=noise.output_sd * np.where(its, np.sqrt(f), 1.0))
                for f in self.beside
            ]
            slope = self._slope([(each, self.found.sd) for each in changed])
        else:
            variance, error = noise.source_sd[name] ** 2, np.sqrt(noise.variance_error(name))
            # At its bound it is zero up to what a solver leaves.
            if variance <= VARIANCE_SLOPE.nothing * error:
                return np.zeros(len(self.x))
            alike = next((group for group in noise.alike if name in group), (name,))
            free = tuple(n for n in alike if n not in self.found.bounded)
            own = noise.source_sd[name]
            changed = [
                replace(noise, source_sd={**noise.source_sd, name: float(own * np.sqrt(f))})
                for f in self.beside
            ]
            inputs = [self._scaled_inputs(free, f) for f in self.beside]
            slope = self._slope(list(zip(changed, inputs, strict=True)))
        return slope / variance

    def _scaled_inputs(self, names: Sequence[str], factor: float) -> dict[str, float]:
        """The noise of the inputs with the variances of some times a factor."""
        root = float(np.sqrt(factor))
        return {n: sd * (root if n in names else 1.0) for n, sd in self.found.sd.items()}

    def _slope(self, beside: Sequence[tuple[NoiseModel, Mapping[str, float]]]) -> Array:
        """(n,) change of the equations between two noises, by the relative change of a variance."""
        below, above = (equations(self.columns, m, sd).score for m, sd in beside)
        return np.asarray((above - below) / (self.beside[1] - self.beside[0]))
