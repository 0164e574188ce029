"""Screening: score tests at a fit to the asset's first records decide which are searched.

A full search fits the model from several starts, estimates its noise in rounds and refits
candidates, which is wasted where nothing is missing. The asset's reference has all that does not
depend on a record's noise: parameters near those of the record, the catalogue scaled to its
signals, and the extended model as functions. What is left for a record is a few Gauss-Newton steps
to its own optimum, its noise, and the scores of the catalogue, which are those of the diagnosis.

Where much of a record is explained by neither sensors nor measured inputs, it may be a random
disturbance (a sea) or a cause. Its scores are computed under the noise that takes all of it for
disturbances, and where that is not white at the parameters that are likeliest under it
(`disturbance_likelihood`): right in a sea, but it may absorb a cause. So the effects that score
best are taken out of the residual as well: a cause leaves less for disturbances to explain, by a
likelihood ratio with one degree of freedom. A line in a sea is judged by its nearest neighbours
alone: no family of spectra follows the narrow peak of a sea everywhere. A record is searched
whatever its scores where they do not represent it: its channels are others, its own fit is not
found or held by a bound, samples are spoilt or too few, or its outputs are noise alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, chdtri
from scipy.stats import norm

from casid.arrays import TINY, Array, scaled_inverse
from casid.data.arguments import in_si
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.diagnosis.evidence.gain_under_disturbance import gains_under_disturbance, unwhitened
from casid.diagnosis.evidence.recording_faults.corrupted_samples import without_corrupted
from casid.diagnosis.evidence.records.recorded_channels import varying_channels, with_unused_columns
from casid.diagnosis.evidence.records.signal_sizes import sizes_of
from casid.diagnosis.evidence.records.sufficiency import fewest_samples, why_uninformative
from casid.diagnosis.evidence.residual.spectral_peaks import find_peaks
from casid.diagnosis.evidence.scores.score_tests import ScoreTable, scores_of, step_without_bias
from casid.diagnosis.evidence.scores.signature_columns import Columns, extended_columns
from casid.diagnosis.evidence.whitening.fit_points import use_samples_of
from casid.diagnosis.evidence.whitening.holding_bounds import held_beyond_chance
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.evidence.whitening.white_floors import not_below
from casid.diagnosis.thresholds import DISTURBED, PEAKS
from casid.errors import CasidError, DataError
from casid.estimation.disturbances.disturbance_likelihood import errors
from casid.estimation.holdout import split_records
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.simulation.fit import FitSettings, fit_model, weighted_by_errors
from casid.estimation.simulation.initial_state import with_states_anew
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.input_gaps import with_gaps_treated
from casid.estimation.simulation.simulation_error import SimulationError
from casid.fleets.thresholds import SCREENING
from casid.model.effects.catalogue import catalogue
from casid.model.effects.user_effects import user_effects
from casid.model.quantities import count_text
from casid.model.rate_laws import with_balances
from casid.model.written_accelerations import with_written_accelerations


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """An estimate from one record, every number in `unit`; no error where there is none."""

    name: str
    value: float
    std_error: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class Screened:
    """The outcome of the screening for one record.

    Attributes
    ----------
    p_value : family-wise, Bonferroni's bound over the catalogue; 0 where the record has to be
        searched whatever its scores.
    why : why the scores do not decide, or an empty text.
    parameters : the record's own fit, where the scores were computed.
    """

    p_value: float
    why: str = ""
    parameters: tuple[ParameterValue, ...] = ()

    def passes(self, level: float) -> bool:
        """True if the record gets the full search at this level of the fleet."""
        return bool(self.why) or self.p_value < SCREENING.share * level


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """The screening of the records of one asset, against one fitted record.

    Attributes
    ----------
    problem : in SI, its laws of rates as balances.
    declared : the same as it was declared, for the units of what is reported.
    at : the model at the reference record, under its noise.
    columns : of the model with the whole catalogue.
    channels : recorded beside the model's in the reference record, name -> unit.
    """

    problem: Problem
    declared: Problem
    at: Weighted
    columns: Columns
    channels: Mapping[str, str]
    level: float
    without: tuple[str, ...]

    @classmethod
    def of(
        cls,
        problem: Problem,
        reference: Experiment,
        values: Mapping[str, float],
        *,
        level: float,
        without: tuple[str, ...] = (),
    ) -> Screen:
        """The screen of an asset from a record of it and its parameters in SI.

        Raises
        ------
        CasidError
            If the model cannot be fitted to the record.
        """
        declared = problem
        problem, record = _prepared(problem, reference)
        settings = FitSettings(starts=1)
        fit = fit_model(
            problem.model, [record], settings, start=values, check_rank=False, throw=False
        )
        fit = weighted_by_errors(fit, settings)
        weighing = Weighing([record], known_noise=problem.noise)
        at = weighing.weigh(problem.model, fit, rounds=1)
        channels = varying_channels(problem, [record])
        effects = catalogue(
            at.model,
            sizes_of(at, channels),
            channels,
            extra=user_effects(at.model, problem.effects),
            without=without,
        )
        columns = extended_columns(at.fit, list(effects))
        columns = replace(columns, wide=columns.wide.for_columns())
        return cls(problem, declared, at, columns, channels, level, without)

    def __call__(self, experiment: Experiment) -> Screened:
        """Screen one record."""
        try:
            problem, record = _prepared(self.declared, experiment)
            if dict(varying_channels(problem, [record])) != dict(self.channels):
                return Screened(0.0, "it has other channels than the asset's reference")
            with np.errstate(all="ignore"):
                return self._screened(record)
        except CasidError as error:
            return Screened(0.0, f"it could not be screened: {error}")

    def _screened(self, record: Experiment) -> Screened:
        reason = why_uninformative(self.problem.model, split_records([record], 0.0))
        if reason:
            return Screened(0.0, f"it may determine nothing: {reason}")
        base = self.at.criterion
        own = {n: v for n, v in self.at.fit.values.items() if n in base.free}
        criterion = base.of_records([record], weights=base.weights, start=own)
        used = sum(int(d.used.sum()) for d in criterion.data)
        if used < fewest_samples(len(criterion.variables)):
            return Screened(0.0, f"it has {count_text(used, 'sample')}, too few to judge the model")
        x = _minimum(criterion, {})
        if x is None:
            # A sea may move the roll so that the simulation errs least far from the truth.
            disturbed = self._screened_under_disturbance(record, criterion, None)
            return disturbed or Screened(0.0, _FAR)
        fit = self._moved(criterion, x)
        kept = self._without_first(fit, record)
        if kept is None:
            return Screened(0.0, "some of its samples are faulty")
        if kept is not record:
            return self._screened(kept)
        at = Weighing([record], known_noise=self.problem.noise).estimated(fit)
        if at.noise_absorbs_misfit:
            disturbed = self._screened_under_disturbance(record, criterion, x)
            if disturbed is not None:
                return disturbed
        plain = criterion
        criterion = base.of_records(
            [record], weights=base.weights, whiten=at.full.whiten, start=fit.values
        )
        own_fit = _minimum(criterion, at.input_sd)
        if own_fit is None:
            return Screened(0.0, _FAR)
        if at.noise_absorbs_misfit:
            # Far from the truth a residual may show no disturbance, which it shows next to it.
            disturbed = self._screened_under_disturbance(record, plain, own_fit)
            if disturbed is not None:
                return disturbed
        return self._scored(criterion, own_fit, at)

    def _screened_under_disturbance(
        self, record: Experiment, criterion: SimulationError, x: Array | None
    ) -> Screened | None:
        """Scores under a disturbance with a spectrum; None where the record shows none.

        The likelihood of parameters and disturbance has several maxima, and least squares may lead
        a fit in a sea far from the highest: it is begun at the asset's own parameters, and at the
        record's own fit `x` only where the residual of the former shows no disturbance.

        None also where the record has no fit (`x` is None) and does not determine a parameter.
        """
        weighing = Weighing([record], known_noise=self.problem.noise).with_disturbances()
        start = with_states_anew(criterion, criterion.start)
        found = weighing.estimated(self._moved(criterion, start))
        if not found.full.spectra and x is not None:
            found = weighing.estimated(self._moved(criterion, x))
        if not found.full.spectra:
            return None
        bare = weighing.likeliest_near(self.at.model, found, near=found.full.spectra)
        if not bare.noise.spectra or (x is None and self._is_undetermined(bare)):
            return None
        return self._scored_under_disturbance(bare)

    def _moved(self, criterion: SimulationError, x: Array) -> Fit:
        """The fit of the asset's reference at a point of another record's criterion."""
        solution = replace(self.at.fit.solution, x=x)
        return replace(self.at.fit, criterion=criterion, solution=solution)

    def _is_undetermined(self, bare: Weighted) -> bool:
        """True if a standard error exceeds a parameter, here and in the asset's reference.

        A large force explains any. One estimated at nothing may be as exact as any other.
        """
        at, x = bare.criterion, bare.fit.x
        usual = np.array([self.at.fit.values.get(name, 0.0) for name in at.names])
        sizes = np.maximum(np.abs(x), np.abs(usual))
        wide = errors(at, x, bare.noise, self.problem.noise) > sizes
        is_own = [v.source in self.problem.model.parameters for v in at.variables]
        return bool(np.any(wide & np.array(is_own)))

    def _scored_under_disturbance(self, bare: Weighted) -> Screened:
        """Scores of the catalogue, and gains of the best, under a disturbance.

        The score of an effect is what it gains while the disturbance stays as it is; where that is
        little, it is not followed up, nor where scores or lines decide already.
        """
        at, x = bare.criterion, bare.fit.x
        table = scores_of(self.columns_at(at, x), at, input_sd=bare.input_sd, draws=0)
        p = min(_of_scores(table), self._lines(at, x, neighbours=_NEAR))
        decides = SCREENING.share * self.level / SCREENING.tests
        if p >= decides:
            count = max(len(table.tested), 1)
            passing = 0.5 * float(chdtri(1, decides / count))
            follow = 2 * DISTURBED.followed * passing
            best = [i for i in best_scored(table) if table.scores[i].unrobust > follow]
            gain = max(self._gains(bare, best, passing), default=0.0) if best else 0.0
            p = min(p, count * float(chdtrc(1, 2.0 * max(gain, 0.0))))
        return self._judged(p, bare.fit)

    def _gains(self, bare: Weighted, effects: list[int], passing: float) -> Iterator[float]:
        columns, known = self.columns_at(unwhitened(bare), bare.fit.x), self.problem.noise
        return gains_under_disturbance(bare, columns, effects, known=known, passing=passing)

    def _lines(
        self,
        criterion: SimulationError,
        x: Array,
        *,
        neighbours: tuple[int, int] = PEAKS.neighbours,
    ) -> float:
        """p of the most significant line in the spectrum of the residual."""
        if "periodic_disturbance" in self.without:
            return 1.0
        residual, _ = criterion.columns(x, 0)
        Ts = [d.Ts for d in criterion.data]
        peaks = find_peaks([residual], Ts, alpha=self.level, neighbours=neighbours)
        return min((peak.p_value for peak in peaks), default=1.0)

    def columns_at(self, criterion: SimulationError, x: Array) -> Columns:
        """Signature columns of the whole catalogue at a fit of another record.

        Lags that are none yet leave out no samples, as in `widened`.
        """
        start = dict(zip(criterion.names, x.tolist(), strict=True))
        wide = self.columns.wide.of_records(
            criterion.experiments, weights=criterion.weights, whiten=criterion.whiten, start=start
        )
        use_samples_of(wide, criterion)
        return replace(self.columns, wide=wide)

    def _taken_out(self, at: Weighted) -> float:
        """Smallest p, Bonferroni's, that an effect explains no more than disturbances would.

        At the fit under the sensors' noise alone, the parameters free to move with the effect.
        """
        criterion = at.fit.criterion
        quiet = not_below(at.full.quiet(at.input_sd), criterion, at.fit.x)
        plain = self.columns_at(criterion, at.fit.x)
        wide = plain.wide.of_records(
            criterion.experiments,
            weights=criterion.weights,
            whiten=quiet.whiten,
            start=at.fit.values,
        )
        white = replace(plain, wide=wide)
        table = scores_of(white, criterion, input_sd=at.input_sd, draws=0)
        best = best_scored(table)
        residual, tangent, psi = plain.of_record(plain.wide.start, 0)
        psi = psi[:, white.judged]
        nothing = self._misfit_without(at, residual, tangent)
        gain = max(
            (
                nothing - self._misfit_without(at, residual, np.hstack([tangent, psi[:, [i]]]))
                for i in best
            ),
            default=0.0,
        )
        return len(table.tested) * float(chdtrc(1, 2.0 * max(gain, 0.0)))

    def _misfit_without(self, at: Weighted, residual: Array, columns: Array) -> float:
        """Minus the log-likelihood of what columns (M, n) leave of a residual (M,).

        Both are weighted, samples by outputs; the noise is estimated from what is left.
        """
        criterion = at.fit.criterion
        ny = len(criterion.weights)
        both = np.column_stack([residual, columns]).reshape(-1, ny, 1 + columns.shape[1])
        white = at.full.whiten(both, 0).reshape(len(residual), -1)
        size = np.sqrt(np.maximum(np.einsum("ij,ij->j", white[:, 1:], white[:, 1:]), TINY))
        step = np.linalg.lstsq(white[:, 1:] / size, white[:, 0], rcond=None)[0] / size
        left = residual - columns @ step
        return estimate_noise(
            criterion,
            at.fit.x,
            known=self.problem.noise,
            residuals=[left.reshape(-1, len(criterion.weights)) / criterion.weights],
            responses=at.full.responses,
        ).misfit

    def _scored(self, criterion: SimulationError, x: Array, at: Weighted) -> Screened:
        """Scores and lines under the noise that was estimated, and the record's own parameters.

        The estimate of a score's variance counts an effect that acts in bursts as noise in bursts.
        So where the noise is known to be no misfit, the score under that noise counts as well.
        """
        table = scores_of(self.columns_at(criterion, x), criterion, input_sd=at.input_sd, draws=0)
        if at.noise_absorbs_misfit:
            other, neighbours = self._taken_out(at), _NEAR
        else:
            most = max((s.unrobust for s in table.tested), default=0.0)
            other, neighbours = len(table.tested) * float(chdtrc(1, most)), PEAKS.neighbours
        p = min(_of_scores(table), other, self._lines(criterion, x, neighbours=neighbours))
        return self._judged(p, self._moved(criterion, x))

    def _judged(self, p: float, fit: Fit) -> Screened:
        """The outcome from the smallest p of the tests at a fit under the noise.

        The tests leave the parameters free to move, also beyond a bound that holds one.
        """
        errors = _std_errors(fit)
        if held := held_beyond_chance(fit) or self._far_at_bounds(fit, errors):
            return Screened(0.0, f"its own fit is held by the bound of {held[0]}")
        return Screened(min(1.0, SCREENING.tests * p), "", self._parameters(fit, errors))

    def _far_at_bounds(self, fit: Fit, errors: Array) -> tuple[str, ...]:
        """Parameters at a bound that is farther from the asset's own value than chance has it.

        A disturbance may then absorb what drives them there, so that nothing holds them.
        """
        own, model = self.at.fit.values, self.problem.model
        names = [n for n in fit.criterion.names if n in model.parameters]
        p = SCREENING.share * self.level / (SCREENING.tests * len(names))
        limits = float(norm.isf(0.5 * p)) * errors
        found = zip(fit.criterion.variables, fit.x, limits, strict=True)
        return tuple(
            v.name
            for v, x, limit in found
            if v.name in names and not v.lower < x < v.upper and abs(x - own[v.name]) > limit
        )

    def _parameters(self, fit: Fit, errors: Array) -> tuple[ParameterValue, ...]:
        """The record's own parameters with their errors (n,), in declared units.

        A parameter at a bound has no error.
        """
        criterion, x = fit.criterion, fit.x
        is_free = [
            v.lower < value < v.upper for v, value in zip(criterion.variables, x, strict=True)
        ]
        model = self.declared.model
        return tuple(
            ParameterValue(
                name,
                float(model.shown(name, float(x[i]))),
                float(model.shown_size(name, float(errors[i]))) if is_free[i] else None,
                model.unit_of(name),
            )
            for i, name in enumerate(criterion.names)
            if name in model.parameters
        )

    def _without_first(self, fit: Fit, record: Experiment) -> Experiment | None:
        """The record without a first sample from before its inputs had acted.

        None if samples are clipped or outliers, which the search leaves out as well and reports.
        """
        split, alpha = split_records([record], 0.0), SCREENING.share * self.level
        corrupted, split = without_corrupted(fit, split, alpha, without=self.without)
        if corrupted.count > corrupted.first:
            return None
        return split.whole[0] if corrupted.first else record


def _std_errors(fit: Fit) -> Array:
    """(n,) standard errors of a whitened fit, as if no bound held it.

    By the inverse of the Gauss-Newton matrix: the noise model is taken for right.
    """
    information = fit.criterion.evaluate(fit.x).hessian
    return np.asarray(np.sqrt(np.maximum(np.diag(scaled_inverse(information)), 0.0)))


def best_scored(table: ScoreTable) -> list[int]:
    """The effects that score best, by their places, of those that act alike the first.

    Effects of one signature, as a delay and a lag of an input, explain the same.
    """
    visible = [i for i, s in enumerate(table.scores) if s.is_visible]
    visible.sort(key=lambda i: -table.scores[i].unrobust)
    out: list[int] = []
    for i in visible[: SCREENING.taken_out]:
        if all(abs(table.cosines[i, j]) < SCREENING.alike for j in out):
            out.append(i)
    return out


def _of_scores(table: ScoreTable) -> float:
    """Family-wise p of the most significant score."""
    return table.smallest.adjusted if table.smallest is not None else 1.0


_NEAR = (SCREENING.beside, SCREENING.beside)
_FAR = "its own fit was not found from the asset's reference"


def _minimum(criterion: SimulationError, input_sd: Mapping[str, float]) -> Array | None:
    """The record's own fit from the asset's: Gauss-Newton steps, or where these are many a solver.

    None where neither settles.
    """
    x = criterion.start
    for _ in range(SCREENING.steps):
        x, length, _ = step_without_bias(criterion, x, input_sd)
        if length < SCREENING.settled:
            return x
    x = Weighing(criterion.experiments).minimum(criterion).x
    for _ in range(SCREENING.steps):
        x, length, _ = step_without_bias(criterion, x, input_sd)
        if length < SCREENING.settled:
            return x
    return None


def _prepared(problem: Problem, experiment: Experiment) -> tuple[Problem, Experiment]:
    """Problem and record as a diagnosis prepares them; the record in one piece."""
    problem, (record,) = in_si(problem, [experiment])
    problem = with_unused_columns(problem, [record])
    model, _ = with_written_accelerations(with_balances(problem.model))
    if model is not problem.model:
        problem = replace(problem, model=model)
    pieces = with_gaps_treated(problem.model, [record], problem.recorded)
    if len(pieces) != 1:
        raise DataError(f"{record.name}: gaps of its inputs cut it into {len(pieces)} pieces")
    return problem, pieces[0]
