"""The noise found at a fit, and the simulation error whitened by it.

The model is fitted and its noise estimated in turn until both agree (`Weighing.weigh`). Whatever is
compared later is fitted to the same criterion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.score_tests import step_without_bias
from casid.diagnosis.thresholds import PREWHITENING
from casid.estimation.nlp.solver import Solver
from casid.estimation.noise import NoiseModel, estimate_noise, input_noise_floor
from casid.estimation.simulation.minimization import Fit, minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model

NEAR = Solver(
    max_iterations=25,
    options={"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-7, "ipopt.tol": 1e-6},
)
"""For fits that start next to their minimum: a large barrier would only lead away from it."""

EXACT = Solver(options={**NEAR.options, "ipopt.mu_init": 1e-6, "ipopt.tol": 1e-8})
"""The same for fits that are reported."""


@dataclass(frozen=True, slots=True, eq=False)
class Weighted:
    """A model fitted under one noise model."""

    model: Model
    fit: Fit
    noise: NoiseModel  # what it is fitted under, whatever passes for a disturbance in it
    input_sd: Mapping[str, float]
    unbiased: Fit | None = None  # where the noise of the inputs has no part in the estimate

    @property
    def criterion(self) -> SimulationError:
        """The whitened criterion at its minimum."""
        return self.fit.criterion

    @property
    def is_disturbed(self) -> bool:
        """True if much of the residual is explained by neither sensors nor measured inputs."""
        return self.noise.share_of_disturbances(self.input_sd) > PREWHITENING.disturbed


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """How models of these records are fitted under their noise.

    Attributes
    ----------
    known_noise : channel -> standard deviation of its white noise, where it is known.
    seed : of the draws that stand for the noise of the inputs.
    """

    experiments: Sequence[Experiment]
    known_noise: Mapping[str, float] = field(default_factory=dict)
    solver: Solver | None = None  # default: `NEAR`
    seed: int = 0

    def weigh(self, model: Model, fit: Fit, *, rounds: int = PREWHITENING.rounds) -> Weighted:
        """Estimate the noise at a fit and fit again under it.

        What the model lacks passes for a disturbance at first: it is judged with the noise
        estimated again under each candidate (`alternatives`).
        """
        found = self._estimated(fit)
        for _ in range(rounds):
            criterion = self.criterion(model, found.noise, found.fit.values, fit.criterion)
            found = self._estimated(self.minimum(criterion))
        at = self._without_bias(found) or found
        criterion = self.criterion(model, at.noise, found.fit.values, fit.criterion)
        return replace(at, fit=self.minimum(criterion), unbiased=None if at is found else at.fit)

    def _without_bias(self, found: Weighted) -> Weighted | None:
        """The root of (2) in `score_tests`, with the noise found there; None if none is near.

        The bias that the noise of the inputs gives to a fit passes for a disturbance, too. So where
        there is one, the root is sought under the noise of sensors and inputs alone at first, and
        kept if it leaves none.
        """
        if not any(found.input_sd.values()):
            return None
        if found.is_disturbed:
            at = self._root(found, quiet=True)
            if at is not None and not at.is_disturbed:
                return at
        return self._root(found)

    def _root(self, found: Weighted, *, quiet: bool = False) -> Weighted | None:
        """The same under the noise found, or that of sensors and inputs alone.

        Given up where several steps come no nearer (a bound holds a parameter back, say), or so
        slowly that all that are left would not reach it.
        """
        at = found
        shortest, since, first = np.inf, 0, np.inf
        for k in range(PREWHITENING.steps):
            noise = at.noise.quiet(at.input_sd) if quiet else at.noise
            criterion = self.criterion(at.model, noise, at.fit.values, found.criterion)
            use_samples_of(criterion, found.criterion)
            x, length = step_without_bias(criterion, criterion.start, at.input_sd, seed=self.seed)
            moved = replace(at.fit, criterion=criterion, solution=replace(at.fit.solution, x=x))
            if not np.isfinite(criterion.evaluate(x).value):
                return None
            at = self._estimated(moved)
            if length < PREWHITENING.converged:
                return at
            first = length if k == 0 else first
            if k >= PREWHITENING.patience and length > PREWHITENING.longest_step:
                to_come = (first - length) / k * (PREWHITENING.steps - k)
                if length - to_come > PREWHITENING.longest_step:
                    return None  # at this rate it is still far away after the last step
            is_nearer = length < PREWHITENING.nearer * shortest
            shortest, since = (length, 0) if is_nearer else (shortest, since + 1)
            if since >= PREWHITENING.patience and length < PREWHITENING.longest_step:
                return None
        return None

    def _estimated(self, fit: Fit) -> Weighted:
        """A fit with the noise that its residual shows."""
        noise = self.noise(fit)
        return Weighted(fit.criterion.model, fit, noise, self.input_sd(noise, fit.criterion))

    def without_disturbances(self, at: Weighted) -> Weighted:
        """The same model under the noise of sensors and measured inputs alone, fitted again.

        Where refits start: a cause may explain whatever passes for a disturbance.
        """
        quiet = at.noise.quiet(at.input_sd)
        criterion = self.criterion(at.model, quiet, at.fit.values, at.criterion)
        return replace(at, fit=self.minimum(criterion), noise=quiet, unbiased=None)

    def noise(self, fit: Fit) -> NoiseModel:
        """The noise that the residual of a fit shows."""
        return estimate_noise(fit.criterion, fit.x, known=self.known_noise)

    def fitted(self, model: Model, like: Weighted, start: Mapping[str, float]) -> Fit:
        """Another model under the noise and the weights of one that was judged."""
        return self.minimum(self.criterion(model, like.noise, start, like.criterion))

    def minimum(self, criterion: SimulationError) -> Fit:
        """The fit next to where the criterion starts."""
        return minimize_simulation_error(
            criterion,
            solver=self.solver or NEAR,
            check_rank=False,
            throw=False,
            retry="unsuccessful",
        )

    def criterion(
        self,
        model: Model,
        noise: NoiseModel,
        start: Mapping[str, float],
        like: SimulationError,
    ) -> SimulationError:
        """The criterion of a model under a noise; own parameters and weights as `like` has them."""
        return SimulationError(
            model,
            self.experiments,
            own=[n for n in like.own if n in model.parameters],
            weights=like.weights,
            whiten=noise.whiten,
            substeps=like.substeps,
            start=start,
        )

    def input_sd(self, noise: NoiseModel, criterion: SimulationError) -> dict[str, float]:
        """Input noise: what the residual shows, but no more than the channels' own floors."""
        measured = [n for n, u in criterion.model.inputs.items() if u.kind == "measured"]
        floors = input_noise_floor(criterion.data, list(criterion.model.inputs))
        largest = {n: self.known_noise.get(n, floors[n]) for n in measured}
        return {**dict.fromkeys(measured, 0.0), **noise.of_inputs(largest)}

    def compensated(self, at: Weighted, criterion: SimulationError, x: Array) -> float:
        """J of (1) in `refitting` at `x`: the criterion less what input noise alone gives to it."""
        value = criterion.evaluate(x).value
        names = list(criterion.model.inputs)
        sd = np.array([at.input_sd.get(n, 0.0) for n in names])
        if not np.any(sd > 0):
            return value
        rng = np.random.default_rng(self.seed)
        order = sorted(range(len(names)), key=lambda i: names[i])
        for e, d in enumerate(criterion.data):
            w = np.zeros(d.u.shape)
            for i in order:  # the same draw for a channel in every model
                if sd[i] > 0:
                    w[:, i] = sd[i] * rng.standard_normal(d.N)
            up = criterion.simulate(x, e, signals=replace(d, u=d.u + w))[0]
            down = criterion.simulate(x, e, signals=replace(d, u=d.u - w))[0]
            moved = 0.5 * (up - down) * d.used * criterion.weights
            assert criterion.whiten is not None
            white = criterion.whiten(moved[:, :, None], e)
            value -= 0.5 * float(np.sum(white**2))
        return value


def use_samples_of(criterion: SimulationError, other: SimulationError) -> None:
    """Count the samples that another criterion of the same records counts; a delay leaves out some.

    To be called before `criterion` is simulated: it keeps the residuals of its last simulation.
    """
    for mine, its in zip(criterion.data, other.data, strict=True):
        mine.used[:] = its.used
