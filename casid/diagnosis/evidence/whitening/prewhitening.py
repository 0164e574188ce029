"""The noise found at a fit, and the simulation error whitened by it.

The model is fitted and its noise estimated in turn until both agree (`Weighing.weigh`). Whatever is
compared later is fitted to the same criterion.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.scores.score_tests import step_without_bias
from casid.diagnosis.evidence.scores.window_states import left_by_states, states_of_windows
from casid.diagnosis.evidence.whitening.fit_points import is_at_bound, moved, use_samples_of
from casid.diagnosis.evidence.whitening.weighted_model import (
    Weighted,
    at_point,
    minus_log_likelihood,
)
from casid.diagnosis.evidence.whitening.white_floors import not_below
from casid.diagnosis.solvers import NEAR
from casid.diagnosis.thresholds import PREWHITENING, RESTARTS
from casid.errors import CasidError
from casid.estimation.disturbances.disturbance_estimation import with_disturbance_spectra
from casid.estimation.disturbances.disturbance_likelihood import likeliest
from casid.estimation.errors_in_variables.input_noise import input_noise
from casid.estimation.errors_in_variables.left_by_noise import share_that_is_there
from casid.estimation.errors_in_variables.total_least_squares import total_least_squares
from casid.estimation.nlp.solver import Solver
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.thresholds import REMOVAL, VARYING_RESPONSE
from casid.estimation.noise.variances import error_over_noise, estimate_noise
from casid.estimation.noise.varying_response import followed_path, with_varying_response
from casid.estimation.simulation.fit import within_bounds
from casid.estimation.simulation.initial_state import with_states_anew
from casid.estimation.simulation.input_noise.input_noise import input_noise_sd
from casid.estimation.simulation.minimization import Fit, minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """Fits of models to these records, weighted by their noise.

    Attributes
    ----------
    known_noise : channel -> standard deviation of its white noise, where it is known.
    seed : of the draws that stand for the noise of the inputs.
    takes_disturbances : whether what neither sensors nor inputs explain is taken for disturbances
        with spectra of their own, and the fits are made under them. Otherwise misfit that passes
        for a disturbance is no noise.
    """

    experiments: Sequence[Experiment]
    known_noise: Mapping[str, float] = field(default_factory=dict)
    solver: Solver | None = None  # default: `NEAR`
    seed: int = 0
    takes_disturbances: bool = False

    def with_disturbances(self) -> Weighing:
        """The weighing that takes all unexplained misfit for disturbances."""
        return replace(self, takes_disturbances=True)

    def weigh(
        self,
        model: Model,
        fit: Fit,
        *,
        rounds: int = PREWHITENING.rounds,
        shown: Weighted | None = None,
    ) -> Weighted:
        """Estimate the noise at a fit and fit again under it.

        Where sensors and measured inputs leave much unexplained, misfit would pass for a
        disturbance and mask its own cause: the fit is then made under the sensors' noise alone.

        Parameters
        ----------
        shown : the fit with the noise there (`estimated`), where that is known.
        """
        found = shown or self.estimated(fit)
        exact = self._with_floors(found)
        return exact._weighed(model, found if exact is self else exact.estimated(fit), rounds)

    def _weighed(self, model: Model, found: Weighted, rounds: int) -> Weighted:
        """A model under the noise that was estimated at a fit."""
        fit = found.fit
        if self.takes_disturbances and found.full.spectra:
            return self._comparable(self.likeliest(model, found))
        if (far := self._far_root(found)) is not None:
            return self._beside(far, far)
        if found.noise_absorbs_misfit:
            at = self._without_bias(found)
            if at is None or at.noise_absorbs_misfit:
                noise = not_below(found.full.quiet(found.input_sd), found.criterion, fit.x)
                criterion = self.criterion(model, noise, fit.values, fit.criterion)
                return replace(found, fit=self.minimum(criterion), noise=noise)
            found = at
        for _ in range(rounds):
            criterion = self.criterion(model, found.full, found.fit.values, fit.criterion)
            found = self.estimated(self.minimum(criterion))
        if self.takes_disturbances and found.full.spectra:
            # Far from the truth a residual may show no disturbance, which it shows next to it.
            return self._comparable(self.likeliest(model, found))
        return self._beside(found, self._without_bias(found))

    def _beside(self, found: Weighted, root: Weighted | None) -> Weighted:
        """The minimum next to what was found, under the noise at the root if there is one."""
        at = root or found
        criterion = self.criterion(at.model, at.full, found.fit.values, found.criterion)
        return replace(
            at,
            fit=self.minimum(criterion),
            noise=at.full,
            noise_absorbs_misfit=False,
            unbiased=None if root is None else root.fit,
        )

    def _far_root(self, found: Weighted) -> Weighted | None:
        """The root without bias, where noise on the inputs led least squares far away from it."""
        c = found.criterion
        declared = np.array([v.start for v in c.variables])
        x = total_least_squares(c, [found.fit.x, declared], found.full.quiet(found.input_sd))
        if x is None:
            return None
        near = self.estimated(moved(found.fit, c, x))
        root = None if near.noise_absorbs_misfit else self._without_bias(near)
        return None if root is None or root.noise_absorbs_misfit else root

    def _comparable(self, best: Weighted) -> Weighted:
        """The likeliest point, and the minimum there that whatever is compared is fitted to."""
        fit = self.minimum(self.criterion(best.model, best.noise, best.fit.values, best.criterion))
        use_samples_of(fit.criterion, best.criterion)
        return replace(best, fit=fit, unbiased=best.fit)

    def from_disturbance_of(self, bare: Weighted, extended: Weighted) -> Weighted:
        """The likelier of a model and the same as found from where an extension of it ended.

        Its likelihood has several maxima. An extension that led to a higher one, which is there
        without it as well, would have its evidence from that. Where the model as it is diverges at
        the extension's values, such as a time constant that only the extension follows in its
        steps, there is none.
        """
        if not extended.full.spectra:
            return bare
        there = (extended.unbiased or extended.fit).values
        values = {name: there.get(name, v) for name, v in bare.fit.values.items()}
        # The noise whitens residuals in the units of the errors that the extended model leaves.
        like = extended.criterion
        criterion = self.criterion(bare.model, extended.full, values, like)
        use_samples_of(criterion, bare.criterion)
        x = within_bounds(criterion, np.array([values[name] for name in criterion.names]))
        if not np.isfinite(criterion.evaluate(x).value):
            return bare
        at = replace(bare, fit=moved(bare.fit, criterion, x), full=extended.full, unbiased=None)
        found = self._comparable(self.likeliest_near(bare.model, at))
        return min(bare, found, key=minus_log_likelihood)

    def _with_floors(self, found: Weighted) -> Weighing:
        """The weighing with input noise from the inputs' own spectra where these are more exact.

        A slow system shows the noise of its inputs in few lines of the residual, and a fit absorbs
        most of those; an input that an output responds to at once is as white there as the output's
        own noise. The residual may then show none of it by chance, or that alone. Where the floor
        of the channel agrees with it, as far as the fit lets it show, both count (`input_noise`).
        """
        c = found.criterion
        measured = [n for n, entry in c.model.inputs.items() if entry.kind == "measured"]
        if all(name in found.full.known for name in measured):
            return self
        at = input_noise(c, found.fit.x, self.known_noise)
        exact = {name: at.sd[name] for name in at.at_floor}
        return replace(self, known_noise={**self.known_noise, **exact}) if exact else self

    def likeliest(self, model: Model, found: Weighted) -> Weighted:
        """The model under the disturbance that is likeliest together with its parameters.

        `weigh` adds the minimum under that noise, which whatever is compared with it is fitted to
        as well; tests of the residual are made at the likeliest point itself.

        Parameters
        ----------
        found : a fit with the noise there, of which a force has a spectrum.
        """
        return min((self.likeliest_near(model, at) for at in self._starts(found)), key=at_point)

    def _starts(self, found: Weighted) -> Iterator[Weighted]:
        """A fit, and the same with what is at its bound where the model declares it to start.

        Each also with spectra of first order: which of the shapes is the likeliest, a taper does
        not show where they differ in the slowest few periods of a record alone. A model that errs
        by many times the noise may have been led astray by least squares, with a loop that follows
        the disturbance above all: it is begun where all its parameters are declared to start, too.
        Where the response varies along the record, parameters by an average one are biased.
        """
        shapes = [*self._shapes(found)]
        yield from shapes
        yield from self._along_path(shapes[-1])
        c, x = found.criterion, found.fit.x
        declared, at_bounds = x.copy(), x.copy()
        for i, v in enumerate(c.variables):
            if v.source in c.model.parameters:
                declared[i] = np.clip(c.model.parameters[v.source].start, v.lower, v.upper)
                at_bounds[i] = declared[i] if is_at_bound(v, float(x[i])) else x[i]
        with contextlib.suppress(CasidError):  # it diverges from there
            if not np.array_equal(at_bounds, x):
                yield from self._shapes(self.estimated(moved(found.fit, c, at_bounds)))
        with contextlib.suppress(CasidError):
            if error_over_noise(found.fit, found.full) > RESTARTS.far:
                # The states that the record began in were those of where it went astray.
                yield self.estimated(moved(found.fit, c, with_states_anew(c, declared)))

    def _shapes(self, found: Weighted) -> Iterator[Weighted]:
        """The noise, also with first-order forces alone where one is of another order."""
        yield found
        if any(s.damping is not None for s in found.full.spectra.values()):
            yield self.estimated(found.fit, is_simple=True)

    def _along_path(self, found: Weighted) -> Iterator[Weighted]:
        """The same fitted under its forces along the path, where that is likelier by far.

        What is not white under it shows in spectra of the average response as forces that are none.
        """
        at, before = found, at_point(self._whitened(found.model, found))
        with contextlib.suppress(CasidError):
            for _ in range(PREWHITENING.rounds):
                if (noise := followed_path(at.full, at.criterion, at.fit.x)) is None:
                    break
                criterion = self.criterion(at.model, noise, at.fit.values, at.criterion)
                fit = self.minimum(criterion)
                value = at_point(replace(at, fit=fit, noise=noise))
                if not value < before - VARYING_RESPONSE.likelier:
                    break
                at, before = self.estimated(fit, is_simple=True), value
        if at is not found:
            yield at

    def likeliest_near(
        self, model: Model, at: Weighted, near: Mapping[str, DisturbanceSpectrum] | None = None
    ) -> Weighted:
        """The likeliest parameters, and the noise there, in turn until neither moves.

        The first turn seeks its own spectra by default, else from those that are `near`.
        """
        best = self._whitened(model, at)
        for _ in range(PREWHITENING.rounds):
            x = likeliest(at.criterion, at.fit.x, at.full, self.known_noise)
            at = self.estimated(moved(at.fit, at.criterion, x), near=near)
            near = at.full.spectra
            found = self._whitened(model, at)
            if not at_point(found) < at_point(best) - PREWHITENING.likelier:
                break
            best = found
        return best

    def _whitened(self, model: Model, at: Weighted) -> Weighted:
        """The model whitened by its own noise, with initial states estimated again."""
        criterion = self.criterion(model, at.full, at.fit.values, at.criterion)
        use_samples_of(criterion, at.criterion)
        x = with_states_anew(criterion, at.fit.x)
        return replace(at, fit=moved(at.fit, criterion, x), noise=at.full)

    def _without_bias(self, found: Weighted) -> Weighted | None:
        """The root of (2) in `score_tests`, with the noise found there; None if none is near.

        Where much is unexplained, the noise meanwhile is that of sensors and inputs alone. Given up
        where it is farther than all steps reach, where several come no nearer (a bound holds a
        parameter back, say), or so slowly that all that are left would not reach it.
        """
        if not any(found.input_sd.values()):
            return None
        at = found
        shortest, since, first = np.inf, 0, np.inf
        for k in range(PREWHITENING.steps):
            noise = at.full.quiet(at.input_sd) if at.noise_absorbs_misfit else at.full
            criterion = self.criterion(at.model, noise, at.fit.values, found.criterion)
            use_samples_of(criterion, found.criterion)
            step = step_without_bias(criterion, criterion.start, at.input_sd, seed=self.seed)
            x, length = step.x, step.length
            if length > (PREWHITENING.steps - k) * PREWHITENING.longest_step:
                return None
            there = replace(at.fit, criterion=criterion, solution=replace(at.fit.solution, x=x))
            if not criterion.evaluate(x).value * float(np.finfo(float).eps) < step.value:
                return None  # it diverges: next to its errors none of the records' are left
            at = self.estimated(there, is_far=length > PREWHITENING.longest_step)
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

    def estimated(
        self,
        fit: Fit,
        *,
        is_simple: bool = False,
        near: Mapping[str, DisturbanceSpectrum] | None = None,
        is_far: bool = False,
    ) -> Weighted:
        """A fit with the noise that its residual shows.

        Parameters
        ----------
        is_simple, near : as for `with_disturbance_spectra`.
        is_far : the search goes on far from here: the noise is that of an average response.
        """
        full = self.noise(fit, is_simple=is_simple, near=near, is_far=is_far)
        input_sd = self.input_sd(full, fit.criterion)
        share = share_that_is_there(fit, full, input_sd, self.seed)
        input_sd = {name: share * sd for name, sd in input_sd.items()}
        quiet = full.quiet(input_sd)
        ratio, spread = full.excess(quiet, [d.N for d in fit.criterion.data])
        limit = max(PREWHITENING.absorbs_misfit**2, 1 + PREWHITENING.absorbs_spreads * spread)
        noise_absorbs_misfit = ratio > limit and not self.takes_disturbances
        if noise_absorbs_misfit and (alone := self._sensors_alone(fit, full)) is not None:
            full, noise_absorbs_misfit = alone, False
            input_sd = {n: share * sd for n, sd in self.input_sd(full, fit.criterion).items()}
        return Weighted(fit.criterion.model, fit, full, full, input_sd, noise_absorbs_misfit)

    def without_forces(self, at: Weighted) -> Weighted | None:
        """A model under the noise of sensors and inputs alone, where forces are likelier by BIC.

        None where the noise holds no force, where none is likelier, and where misfit is known to
        pass for them.
        """
        fit = at.unbiased or at.fit
        if (
            self.takes_disturbances
            or at.noise_absorbs_misfit
            or not at.full.forces(at.model.inputs)
        ):
            return None
        noise = self._alone(fit, at.full)
        if self._is_as_likely(noise, at.full, fit):
            return None
        criterion = self.criterion(at.model, noise, fit.values, at.criterion)
        unbiased = None if at.unbiased is None else moved(fit, criterion, fit.x)
        least = self.minimum(criterion)
        return replace(at, fit=least, noise=noise, full=noise, unbiased=unbiased)

    def _sensors_alone(self, fit: Fit, full: NoiseModel) -> NoiseModel | None:
        """The noise of sensors and inputs alone, where the residual shows no more than that.

        A force that an accelerometer responds to at once is as white there as its sensor's own
        noise, and takes a part of it by chance: each that was found has to be likelier by BIC.
        """
        if not full.forces(fit.criterion.model.inputs):
            return None
        alone = self._alone(fit, full)
        return replace(alone, known=full.known) if self._is_as_likely(alone, full, fit) else None

    def _alone(self, fit: Fit, full: NoiseModel) -> NoiseModel:
        """The noise of sensors and inputs alone that the residual shows."""
        c, held = fit.criterion, dict(self.known_noise)
        alone = partial(estimate_noise, c, fit.x, responses=full.responses, has_disturbances=False)
        floors = input_noise_floor(c.data, list(c.model.inputs))
        found = alone(known=held)
        # An input that is held at its floor leaves its share to the next one that acts alike.
        while over := {
            name: floor
            for name, floor in floors.items()
            if name not in held and found.source_sd.get(name, 0.0) > floor
        }:
            held |= over
            found = alone(known=held)
        return found

    def _is_as_likely(self, alone: NoiseModel, full: NoiseModel, fit: Fit) -> bool:
        """True if noise without forces is as likely as that with them, by BIC."""
        c = fit.criterion
        price = 0.5 * len(full.forces(c.model.inputs)) * float(np.log(c.n_samples))
        return alone.misfit - full.misfit < price

    def noise(
        self,
        fit: Fit,
        *,
        is_simple: bool = False,
        near: Mapping[str, DisturbanceSpectrum] | None = None,
        is_far: bool = False,
    ) -> NoiseModel:
        """The noise that the residual of a fit shows; parameters as of `estimated`."""
        found = estimate_noise(fit.criterion, fit.x, known=self.known_noise)
        c, x, known = fit.criterion, fit.x, self.known_noise
        if self.takes_disturbances:
            found = with_disturbance_spectra(found, c, x, known, is_simple=is_simple, near=near)
        if is_far:
            return found
        return with_varying_response(found, c, x, known, seeks_spectra=self.takes_disturbances)

    def fitted(self, model: Model, like: Weighted, start: Mapping[str, float]) -> Fit:
        """Another model under the noise and the weights of one that was judged."""
        return self.minimum(self.criterion(model, like.noise, start, like.criterion))

    def minimum(self, criterion: SimulationError) -> Fit:
        """The fit next to where the criterion starts."""
        return minimize_simulation_error(
            criterion, solver=self.solver or NEAR, check_rank=False, retry="unsuccessful"
        )

    def criterion(
        self,
        model: Model,
        noise: NoiseModel,
        start: Mapping[str, float],
        like: SimulationError,
    ) -> SimulationError:
        """The criterion of a model under a noise; own parameters and weights as `like` has them."""
        found = SimulationError(
            model,
            self.experiments,
            own=[n for n in like.own if n in model.parameters],
            weights=like.weights,
            substeps=like.substeps,
            start=start,
        )
        return found.whitened(noise.whitener(found.data))

    def input_sd(self, noise: NoiseModel, criterion: SimulationError) -> dict[str, float]:
        """Input noise: what the residual shows, but no more than the channels' own floors."""
        measured = [n for n, u in criterion.model.inputs.items() if u.kind == "measured"]
        floors = input_noise_floor(criterion.data, list(criterion.model.inputs))
        largest = {n: self.known_noise.get(n, floors[n]) for n in measured}
        return {**dict.fromkeys(measured, 0.0), **noise.of_inputs(largest)}

    def compensated_criterion(self, at: Weighted, criterion: SimulationError, x: Array) -> float:
        """J of (1) in `joint_refit` at `x`: the criterion less what input noise alone gives."""
        value = criterion.evaluate(x).value
        names = list(criterion.model.inputs)
        sd = np.array([at.input_sd.get(n, 0.0) for n in names])
        if not np.any(sd > 0):
            return value
        rng, share = np.random.default_rng(self.seed), REMOVAL.drawn_share
        order = sorted(range(len(names)), key=lambda i: names[i])
        states = states_of_windows(criterion, range(len(x)))
        for e, d in enumerate(criterion.data):
            w, here = np.zeros(d.u.shape), input_noise_sd(criterion.data, e, sd)
            for i in order:  # the same draw for a channel in every model
                if sd[i] > 0:
                    w[:, i] = share * here[i] * rng.standard_normal(d.N)
            up = criterion.simulate(x, e, signals=replace(d, u=d.u + w))[0]
            down = criterion.simulate(x, e, signals=replace(d, u=d.u - w))[0]
            moved = d.in_sizes((up - down) / (2 * share) * d.used) * criterion.weights
            assert criterion.whiten is not None
            white = criterion.whiten(moved[:, :, None], e).ravel()
            if states:
                begun = criterion.columns(x, e)[1].reshape(len(white), -1)[:, states]
                white = left_by_states(begun, white)
            value -= 0.5 * float(np.sum(white**2))
        return value
