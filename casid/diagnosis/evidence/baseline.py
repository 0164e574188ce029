"""The baseline: the model as it is, fitted to records from which corrupted samples are left out."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from casid.data.problem import Problem
from casid.diagnosis.attempts import FAILURES, reason_of
from casid.diagnosis.evidence.prewhitening import Weighing, Weighted
from casid.diagnosis.evidence.recorded_channels import (
    channels_held_out_too,
    varying_channels,
)
from casid.diagnosis.evidence.recording_faults.corrupted_samples import (
    CorruptedSamples,
    without_corrupted,
)
from casid.diagnosis.evidence.recording_faults.levels_in_gaps import with_levels_in_gaps
from casid.diagnosis.evidence.recording_faults.rectified_channels import (
    Rectified,
    rectified_channel,
)
from casid.diagnosis.evidence.recording_faults.steps_between_rows import steps_between_rows
from casid.diagnosis.evidence.recording_faults.steps_in_gaps import with_steps_in_gaps
from casid.diagnosis.evidence.robust_errors import std_error
from casid.diagnosis.evidence.sufficiency import (
    few_step_fit,
    weighted_as_white,
    why_doubtful,
    why_undecided,
    why_uninformative,
)
from casid.diagnosis.evidence.unstable_records import records_in_windows
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.thresholds import STEPS_IN_GAPS
from casid.errors import CasidError, IdentifiabilityError, OutOfTimeError, SolveError
from casid.estimation.holdout import Split, holding_out_less, holding_out_measured
from casid.estimation.simulation.fit import (
    FitSettings,
    fit_model,
    resolved_under,
    weighted_by_errors,
)
from casid.estimation.simulation.minimization import Fit
from casid.identification.signs_from_simulation import (
    WrongSign,
    is_poor,
    negated_split,
    quick_settings,
    wrong_sign,
)
from casid.identification.sized_noise import fitted_in_sizes, sized_noise_text
from casid.model.quantities import count_text
from casid.time_limit import require_time, until


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """The model without any cause, fitted.

    Attributes
    ----------
    split : the records as they are judged, with corrupted samples missing and a wrong sign negated.
    recorded : the same with the sign as it was recorded.
    fit : simulation-error fit to `split`.
    reported_fit : the same to `recorded`.
    start : the model under the noise found there.
    channels : recorded channels outside the model, on which causes may depend, name -> unit.
    corrupted : samples left out.
    negated : a channel that probably has the wrong sign.
    rectified : a channel that shows absolute values: it does in `fit` and `start`.
    why_undecided : why the records support no answer, or an empty text.
    levels : gaps in which levels of inputs are estimated.
    why_doubtful : why `fit` is unreliable, or an empty text. An added cause may remedy that; where
        none does, the records support no answer.
    """

    split: Split
    recorded: Split
    fit: Fit
    reported_fit: Fit
    start: Weighted
    weighing: Weighing
    channels: dict[str, str]
    corrupted: CorruptedSamples = CorruptedSamples()
    negated: WrongSign | None = None
    rectified: Rectified | None = None
    why_undecided: str = ""
    why_doubtful: str = ""
    is_fitted: bool = True
    notes: tuple[str, ...] = ()
    levels: int = 0

    @property
    def is_extended(self) -> bool:
        """True if `fit` is one of more than the model as it is, to the records as they are."""
        return self.negated is not None or self.rectified is not None


def fit_baseline(problem: Problem, split: Split, settings: DiagnosisSettings) -> Baseline:
    """Fit the model as it is, and find its noise.

    Raises
    ------
    SolveError
        If the simulation diverges from the start values.
    """
    reason = why_uninformative(problem.model, split)
    if not reason:
        try:
            with until(settings.search_ends):
                return _determined(problem, split, settings)
        except OutOfTimeError:
            reason = (
                "the budget of time ended before the model as it is was fitted: fit a shorter "
                "window (--window), or raise the budget (--budget)"
            )
        except CasidError:
            raise
        except FAILURES as error:
            reason = f"the model as it is cannot be judged, since {reason_of(error)}"
    return _uninformative(problem, split, settings.fit, reason)


def _determined(problem: Problem, split: Split, settings: DiagnosisSettings) -> Baseline:
    """The model fitted to so much of the records that they determine its parameters.

    What is not seen of them in the first part of a record may be seen in its end.
    """
    less = split
    while True:
        try:
            found = _fitted(problem, less, settings)
        except IdentifiabilityError:
            if not any(bool(held.any()) for held in less.held):
                raise
            less = holding_out_less(less)
            settings.progress("the fitted part does not determine the parameters: hold out less")
            continue
        if less is split:
            return found
        part, left = (max(float(np.mean(h)) for h in s.held) for s in (split, less))
        held = f"{100 * left:.0f} % are" if left else "nothing is"
        note = (
            f"the first {100 * (1 - part):.0f} % of the record do not determine all parameters, "
            f"which more of it does: {held} held out"
        )
        return replace(found, notes=(*found.notes, note))


def _fitted(problem: Problem, split: Split, settings: DiagnosisSettings) -> Baseline:
    say = settings.progress
    split, little = holding_out_measured(split, list(problem.model.outputs))
    say("fit the model as it is")
    split, of_windows, begun = records_in_windows(problem.model, split, settings.fit, say)
    fit, negated, sizes = _with_signs_as_recorded(problem, split, settings, begun)
    as_recorded: Fit | None = None
    if sizes is not None:
        problem, as_recorded, fit = replace(problem, model=sizes.model), fit, sizes.fit
    if negated is not None:
        as_recorded, split = _negated(problem, split, settings, negated, fit)
    if fit is None or negated is not None:
        fit = fit_model(problem.model, split.fitted, settings.fit, throw=False)
    split, fit = _with_steps_placed(problem, split, settings, fit)
    split, fit, gaps = _with_levels_filled(problem, split, settings, fit)
    split, fit, sized = _with_growing_noise(problem, split, settings, fit)
    corrupted, split, fit, less = _cleaned(problem, split, settings, fit)
    if corrupted.count:  # what a faulty sensor had bent the fit by, steps were placed against
        split, fit = _with_steps_placed(problem, split, settings, fit)
    fit = weighted_by_errors(fit, settings.fit)
    between = steps_between_rows(fit, settings.alpha)
    channels, notes = channels_held_out_too(varying_channels(problem, split.fitted), split.apart)
    weighing = Weighing(
        split.fitted, known_noise=problem.noise, solver=settings.fit.solver, seed=settings.fit.seed
    )
    say("estimate the noise")
    fit, start = _weighed(problem, split, settings, weighing, fit)
    errors = partial(std_error, start.fit)
    undecided = why_undecided(fit, start, errors, split.whole)
    if not undecided and not fit.solution.is_converged:
        require_time("the fit of the model as it is")
    return Baseline(
        split=split,
        recorded=split if negated is None else negated_split(split, negated.channel),
        fit=fit,
        reported_fit=as_recorded or fit,
        start=start,
        weighing=weighing,
        channels=channels,
        corrupted=corrupted,
        negated=negated,
        rectified=sizes,
        why_undecided=undecided,
        why_doubtful="" if undecided else why_doubtful(fit, start, errors),
        notes=(
            *filter(None, (of_windows, sized, less or little, between.note if between else "")),
            *notes,
        ),
        levels=gaps,
    )


def _weighed(
    problem: Problem, split: Split, settings: DiagnosisSettings, weighing: Weighing, fit: Fit
) -> tuple[Fit, Weighted]:
    """The fit under its noise, and the fit itself, with steps fine enough for both."""
    start = weighing.weigh(problem.model, fit)
    fine = resolved_under(fit.criterion, start.fit.x, start.noise.whiten)
    if fine is fit.criterion:
        return fit, start
    finer = replace(settings, fit=replace(settings.fit, substeps=fine.substeps))
    fit = _refitted(problem, split, finer, replace(fit, criterion=fine))
    return fit, weighing.weigh(problem.model, fit)


def _cleaned(
    problem: Problem, split: Split, settings: DiagnosisSettings, fit: Fit
) -> tuple[CorruptedSamples, Split, Fit, str]:
    """Corrupted samples, the records without them, their fit, and a note if less is held out."""
    corrupted, split = without_corrupted(
        fit, split, settings.alpha, without=tuple(settings.without)
    )
    if not corrupted.count:
        return corrupted, split, fit, ""
    settings.progress(
        f"leave out {count_text(corrupted.count, 'clipped or outlying sample')} and fit again"
    )
    split, note = holding_out_measured(split, list(problem.model.outputs))
    return corrupted, split, _refitted(problem, split, settings, fit), note


def _with_growing_noise(
    problem: Problem, split: Split, settings: DiagnosisSettings, fit: Fit
) -> tuple[Split, Fit, str]:
    """The records with sizes of noise that grows with the reading, their fit, and a note on it.

    As given where it is not seen to grow, or no longer once the fit counts by it.
    """

    def again(records: Split, near: Fit) -> Fit:
        settings.progress("weigh samples by noise that grows with the reading")
        return _refitted(problem, records, settings, near)

    split, fit, names = fitted_in_sizes(fit, split, problem.noise, again)
    average = ", and RMS errors are those of samples with noise of average size"
    return split, fit, sized_noise_text(names) + average if names else ""


def _with_steps_placed(
    problem: Problem, split: Split, settings: DiagnosisSettings, fit: Fit
) -> tuple[Split, Fit]:
    """The records with steps of held inputs placed in gaps, and their fit."""
    split, moved = with_steps_in_gaps(fit, split)
    if not moved:
        return split, fit
    settings.progress(f"place {count_text(moved, 'step')} of held inputs in gaps and fit again")
    return split, _refitted(problem, split, settings, fit)


def _with_levels_filled(
    problem: Problem, split: Split, settings: DiagnosisSettings, fit: Fit
) -> tuple[Split, Fit, int]:
    """The records with levels in the gaps of controlled inputs, their fit, and how many gaps."""
    count, by_outputs = 0, settings.levels_by_outputs
    for _ in range(STEPS_IN_GAPS.passes if by_outputs else 1):
        split, count = with_levels_in_gaps(fit, split, by_outputs=by_outputs)
        if not count:
            break
        gaps = count_text(count, "gap")
        settings.progress(f"estimate the levels of held inputs in {gaps} and fit again")
        fit = _refitted(problem, split, settings, fit)
    return split, fit, count


def _with_signs_as_recorded(
    problem: Problem, split: Split, settings: DiagnosisSettings, start: Mapping[str, float]
) -> tuple[Fit | None, WrongSign | None, Rectified | None]:
    """The fit of the records as they are, and the channel that has a wrong sign in it, or none."""
    fit: Fit | None = None
    with suppress(SolveError, IdentifiabilityError):  # the next fit says so, or a sign is to blame
        fit = fit_model(problem.model, split.fitted, settings.fit, start=start, throw=False)
    if fit is not None and not is_poor(fit):
        return fit, None, None
    if fit is not None and (sizes := rectified_channel(split, settings, fit)) is not None:
        return fit, None, sizes
    alpha = settings.alpha
    return fit, wrong_sign(problem, split.fitted, settings.fit, reported=fit, alpha=alpha), None


def _refitted(problem: Problem, split: Split, settings: DiagnosisSettings, fit: Fit) -> Fit:
    """The fit to changed records, from what it was."""
    again = replace(settings.fit, starts=1, substeps=fit.criterion.substeps)
    # Where they ended the rank may be poor, which the first fit was judged by at its start.
    return fit_model(
        problem.model, split.fitted, again, start=fit.values, check_rank=False, throw=False
    )


def _uninformative(problem: Problem, split: Split, settings: FitSettings, why: str) -> Baseline:
    """A baseline for the report where nothing can be estimated."""
    fit = few_step_fit(problem.model, split.fitted)
    weighing = Weighing(split.fitted, solver=settings.solver)
    start = weighted_as_white(fit)
    return Baseline(split, split, fit, fit, start, weighing, {}, why_undecided=why, is_fitted=False)


def _negated(
    problem: Problem, split: Split, settings: DiagnosisSettings, wrong: WrongSign, fit: Fit | None
) -> tuple[Fit, Split]:
    """The fit with the sign as it was recorded, and the records with it negated."""
    settings.progress(f"negate {wrong.channel}, which probably has the wrong sign")
    as_recorded = fit or _fit_as_recorded(problem, split, settings.fit, wrong)
    return as_recorded, negated_split(split, wrong.channel)


def _fit_as_recorded(
    problem: Problem, split: Split, settings: FitSettings, negated: WrongSign
) -> Fit:
    """The best quick fit with the sign as it was recorded."""
    quick = quick_settings(settings)
    try:
        return fit_model(problem.model, split.fitted, quick, check_rank=False, throw=False)
    except SolveError as error:
        raise SolveError(f"{negated} As recorded: {error}") from error
