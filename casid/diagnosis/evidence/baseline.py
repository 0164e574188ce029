"""The baseline: the model as it is, fitted to records from which corrupted samples are left out."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from casid.data.problem import Problem
from casid.diagnosis.attempts import FAILURES, reason_of
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
from casid.diagnosis.evidence.records.recorded_channels import (
    channels_held_out_too,
    varying_channels,
)
from casid.diagnosis.evidence.records.sufficiency import (
    few_step_fit,
    weighted_as_white,
    why_doubtful,
    why_undecided,
    why_uninformative,
)
from casid.diagnosis.evidence.records.unstable_records import records_in_windows
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.robust_errors import std_error
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.thresholds import STEPS_IN_GAPS
from casid.errors import (
    CasidError,
    IdentifiabilityError,
    ModelError,
    OutOfTimeError,
    SolveError,
)
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
    windows = records_in_windows(problem.model, split, settings.fit, say)
    if windows.wrong is not None:
        raise ModelError(f"{problem.name}: {windows.wrong}")
    split = windows.split
    fit, negated, sizes = _with_signs_as_recorded(problem, split, settings, windows.start)
    as_recorded: Fit | None = None
    if sizes is not None:
        problem, as_recorded, fit = replace(problem, model=sizes.model), fit, sizes.fit
    if negated is not None:
        as_recorded, split = _negated(problem, split, settings, negated, fit)
    if fit is None or negated is not None:
        fit = fit_model(problem.model, split.fitted, settings.fit, throw=False)
    records = _Cleaning(problem, settings, split, fit)
    records.place_steps()
    gaps = records.fill_levels()
    sized = records.weigh_growing_noise()
    corrupted, less = records.leave_out_corrupted()
    if corrupted.count:  # what a faulty sensor had bent the fit by, steps were placed against
        records.place_steps()
    records.fit = weighted_by_errors(records.fit, settings.fit)
    split = records.split
    between = steps_between_rows(records.fit, settings.alpha)
    channels, notes = channels_held_out_too(varying_channels(problem, split.fitted), split.apart)
    weighing = Weighing(
        split.fitted, known_noise=problem.noise, solver=settings.fit.solver, seed=settings.fit.seed
    )
    say("estimate the noise")
    start = records.weigh(weighing)
    fit = records.fit
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
            *filter(None, (windows.note, sized, less or little, between.note if between else "")),
            *notes,
        ),
        levels=gaps,
    )


@dataclass(slots=True)
class _Cleaning:
    """Records and their fit while faults of the recording are found, one kind after the other.

    Each step leaves records without a kind of fault in `split`, and their fit in `fit`.
    """

    problem: Problem
    settings: DiagnosisSettings
    split: Split
    fit: Fit

    def place_steps(self) -> None:
        """Place steps of held inputs in gaps."""
        self.split, moved = with_steps_in_gaps(self.fit, self.split)
        if moved:
            steps = count_text(moved, "step")
            self._refit(f"place {steps} of held inputs in gaps and fit again")

    def fill_levels(self) -> int:
        """Estimate levels in the gaps of controlled inputs; in how many gaps."""
        count, by_outputs = 0, self.settings.levels_by_outputs
        for _ in range(STEPS_IN_GAPS.passes if by_outputs else 1):
            self.split, count = with_levels_in_gaps(self.fit, self.split, by_outputs=by_outputs)
            if not count:
                break
            gaps = count_text(count, "gap")
            self._refit(f"estimate the levels of held inputs in {gaps} and fit again")
        return count

    def weigh_growing_noise(self) -> str:
        """Give sizes to noise that grows with the reading; a note where it still does by these."""

        def again(records: Split, near: Fit) -> Fit:
            self.settings.progress("weigh samples by noise that grows with the reading")
            return _refitted(self.problem, records, self.settings.fit, near)

        known = self.problem.noise
        self.split, self.fit, names = fitted_in_sizes(self.fit, self.split, known, again)
        average = ", and RMS errors are those of samples with noise of average size"
        return sized_noise_text(names) + average if names else ""

    def leave_out_corrupted(self) -> tuple[CorruptedSamples, str]:
        """Leave out corrupted samples; which, and a note if less is held out for it."""
        without = tuple(self.settings.without)
        corrupted, self.split = without_corrupted(
            self.fit, self.split, self.settings.alpha, without=without
        )
        if not corrupted.count:
            return corrupted, ""
        samples = count_text(corrupted.count, "clipped or outlying sample")
        self.split, note = holding_out_measured(self.split, list(self.problem.model.outputs))
        self._refit(f"leave out {samples} and fit again")
        return corrupted, note

    def weigh(self, weighing: Weighing) -> Weighted:
        """The model under its noise; it and the fit get steps that are fine enough for both."""
        start = weighing.weigh(self.problem.model, self.fit)
        fine = resolved_under(self.fit.criterion, start.fit.x, start.noise.whiten)
        if fine is self.fit.criterion:
            return start
        finer = replace(self.settings.fit, substeps=fine.substeps)
        near = replace(self.fit, criterion=fine)
        self.fit = _refitted(self.problem, self.split, finer, near)
        return weighing.weigh(self.problem.model, self.fit)

    def _refit(self, why: str) -> None:
        """Fit the changed records, from what the fit was."""
        self.settings.progress(why)
        self.fit = _refitted(self.problem, self.split, self.settings.fit, self.fit)


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


def _refitted(problem: Problem, split: Split, settings: FitSettings, fit: Fit) -> Fit:
    """The fit to changed records, from what it was."""
    again = replace(settings, starts=1, substeps=fit.criterion.substeps)
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
