"""Screening: score tests at the asset's last fit say which records are worth the full search.

A full search fits the model from several starts, estimates its noise in rounds and refits
candidates. Where nothing is missing that is wasted. The asset's reference has all that does not
depend on a record's noise: parameters near those of the record, the catalogue scaled to its
signals, and the extended model as functions. What is left for a record is a few Gauss-Newton steps
to its own optimum, its noise, and the scores of the catalogue, which are those of the diagnosis.

A record is also searched where the scores cannot speak for it: its signals are of another kind, the
steps do not settle, the noise model absorbs misfit, or samples are spoilt.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.data.arguments import in_si
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.diagnosis.evidence.corrupted_samples import without_corrupted
from casid.diagnosis.evidence.prewhitening import Weighing, Weighted
from casid.diagnosis.evidence.recorded_channels import recorded_beside, with_unused_columns
from casid.diagnosis.evidence.score_tests import scores_of, step_without_bias
from casid.diagnosis.evidence.signal_sizes import sizes_of
from casid.diagnosis.evidence.signature_columns import Columns, extended_columns
from casid.diagnosis.evidence.spectral_peaks import find_peaks
from casid.errors import CasidError, DataError
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model, weighted_by_errors
from casid.estimation.simulation.input_gaps import with_gaps_treated
from casid.estimation.simulation.minimization import Fit
from casid.fleets.thresholds import SCREENING
from casid.model.effects.catalogue import catalogue
from casid.model.effects.user_effects import user_effects
from casid.model.rate_laws import with_balances


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """An estimate from one record, every number in `unit`; no error where there is none."""

    name: str
    value: float
    std_error: float | None
    unit: str


@dataclass(frozen=True, slots=True)
class Screened:
    """What the screening says of a record.

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
    """What screens the records of one asset.

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
        channels = recorded_beside(problem, [record])
        effects = catalogue(
            at.model,
            sizes_of(at, channels),
            channels,
            extra=user_effects(at.model, problem.effects),
            without=without,
        )
        columns = extended_columns(at.fit, list(effects))
        return cls(problem, declared, at, columns, channels, level, without)

    def __call__(self, experiment: Experiment) -> Screened:
        """Screen one record."""
        try:
            problem, record = _prepared(self.declared, experiment)
            if dict(recorded_beside(problem, [record])) != dict(self.channels):
                return Screened(0.0, "it has other channels than the asset's reference")
            with np.errstate(all="ignore"):
                return self._screened(record)
        except CasidError as error:
            return Screened(0.0, f"it could not be screened: {error}")

    def _screened(self, record: Experiment) -> Screened:
        base = self.at.criterion
        own = {n: v for n, v in self.at.fit.values.items() if n in base.free}
        criterion = base.of_records([record], weights=base.weights, start=own)
        x = criterion.start
        for _ in range(SCREENING.steps):
            x, length = step_without_bias(criterion, x, {})
        fit = replace(self.at.fit, criterion=criterion, solution=replace(self.at.fit.solution, x=x))
        if self._is_spoilt(fit, record):
            return Screened(0.0, "samples of it are spoilt")
        weighing = Weighing([record], known_noise=self.problem.noise)
        at = weighing.estimated(fit)
        if at.noise_absorbs_misfit:
            return Screened(0.0, "much of it is explained by neither sensors nor measured inputs")
        criterion = base.of_records(
            [record], weights=base.weights, whiten=at.full.whiten, start=fit.values
        )
        x = criterion.start
        for _ in range(SCREENING.steps):
            x, length = step_without_bias(criterion, x, at.input_sd)
            if length < SCREENING.settled:
                break
        if not length < SCREENING.settled:
            return Screened(0.0, "its fit is far from the asset's reference")
        return self._scored(replace(fit, criterion=criterion), x, at)

    def _scored(self, fit: Fit, x: Array, at: Weighted) -> Screened:
        """The scores at the record's own fit."""
        criterion = fit.criterion
        start = dict(zip(criterion.names, x.tolist(), strict=True))
        wide = self.columns.wide.of_records(
            criterion.experiments, weights=criterion.weights, whiten=criterion.whiten, start=start
        )
        columns = replace(self.columns, wide=wide)
        table = scores_of(columns, criterion, input_sd=at.input_sd, draws=0)
        p = table.smallest.adjusted if table.smallest is not None else 1.0
        residual, tangent = criterion.columns(x, 0)
        if "periodic_disturbance" not in self.without:
            peaks = find_peaks([residual], [d.Ts for d in criterion.data], alpha=self.level)
            p = min(p, *(peak.p_value for peak in peaks), 1.0)
        return Screened(float(p), "", self._parameters(criterion.names, x, tangent))

    def _parameters(
        self, names: tuple[str, ...], x: Array, tangent: Array
    ) -> tuple[ParameterValue, ...]:
        """The record's own parameters with their errors, in declared units.

        (T'T)^-1 of whitened sensitivities: the noise model is taken for right.
        """
        T = tangent.reshape(-1, tangent.shape[-1])
        size = np.sqrt(np.maximum(np.einsum("ij,ij->j", T, T), np.finfo(float).tiny))
        covariance = np.linalg.pinv((T / size).T @ (T / size), hermitian=True)
        errors = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / size
        model = self.declared.model
        return tuple(
            ParameterValue(
                name,
                float(model.shown(name, float(x[i]))),
                float(model.shown_size(name, float(errors[i]))),
                model.unit_of(name),
            )
            for i, name in enumerate(names)
            if name in model.parameters
        )

    def _is_spoilt(self, fit: Fit, record: Experiment) -> bool:
        """True if samples are clipped or outliers, which the search leaves out first."""
        split = split_records([record], 0.0)
        corrupted, _ = without_corrupted(fit, split, self.level, without=self.without)
        return bool(corrupted.count)


def _prepared(problem: Problem, experiment: Experiment) -> tuple[Problem, Experiment]:
    """Problem and record as a diagnosis prepares them; the record in one piece."""
    problem, (record,) = in_si(problem, [experiment])
    problem = with_unused_columns(problem, [record])
    problem = replace(problem, model=with_balances(problem.model))
    pieces = with_gaps_treated(problem.model, [record], problem.recorded)
    if len(pieces) != 1:
        raise DataError(f"{record.name}: gaps of its inputs cut it into {len(pieces)} pieces")
    return problem, pieces[0]
