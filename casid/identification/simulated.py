"""`identify` by least squares of the simulation error, without the bias of noise on inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from casid.arrays import Array
from casid.errors import IdentifiabilityError, OutOfTimeError, SolveError
from casid.estimation.covariance import sandwich
from casid.estimation.errors_in_variables.error_bars import covariance_under_colour, error_bars
from casid.estimation.errors_in_variables.removal import (
    Corrected,
    with_spectral_weights,
    without_input_noise,
)
from casid.estimation.estimate import Estimate, Trust
from casid.estimation.holdout import Split, record_views, validation, window_length
from casid.estimation.intervals.choice import Estimation, by_mask, undetermined_in
from casid.estimation.noise.input_feedback import feedback_notes
from casid.estimation.simulation.fit import fit_model, weighted_by_errors
from casid.estimation.simulation.minimization import Fit, require_minimum, whitened
from casid.estimation.simulation_estimate import channel_notes, estimate_of, method_of
from casid.identification.approach import approach
from casid.identification.problem_notes import problem_notes
from casid.identification.reference_instruments import instrumented
from casid.identification.signs_from_simulation import WrongSign, is_poor, wrong_sign
from casid.identification.signs_of_terms import WrongTerm
from casid.identification.sized_noise import fitted_in_sizes, sized_noise_text
from casid.identification.spike_notes import spike_notes
from casid.identification.task import Task
from casid.identification.unstable import InWindows, fit_in_segments
from casid.time_limit import no_time_limit


def identify_simulated(task: Task, unstable: InWindows | None) -> Estimate:
    """Estimate a model by its simulation error.

    Least squares; outputs and samples weighted by their errors; the bias of noise on inputs
    removed, by instruments where nothing else can; then error bars and intervals. Each of these
    steps is left out, and noted, where no time is left for it.

    Parameters
    ----------
    unstable : the model in short windows, where no simulation stays with a whole record.

    Raises
    ------
    IdentifiabilityError, SolveError
        As `identify`.
    """
    undone = task.undone
    fit, suspect = _fit(task, unstable)
    if fit.solution.is_converged:
        alike = replace(task.settings, segments=fit.criterion.segments)
        by_errors = partial(weighted_by_errors, fit, alike)
        fit = undone.attempt("the weighing of outputs by their errors", by_errors) or fit
    in_sizes = undone.attempt("the sizes of noise that grows", partial(_in_sizes, task, fit))
    split, fit, grows = in_sizes or (task.split, fit, ())
    task = replace(task, split=split)
    found, feedback = _unbiased(task, fit)
    with no_time_limit():  # a few passes over the record, without which there is no result
        notes = problem_notes(task.problem, split.fitted)
        notes += channel_notes(task.problem.model, task.split.whole)
        notes += spike_notes(found.fit)
        notes += [sized_noise_text(grows)] if grows else []
        estimate = _estimate(task, found, [*notes, *feedback])
    if estimate.is_converged:
        kind = "quick" if found.reference else None  # instruments have no criterion to profile
        estimate = task.with_intervals(estimate, _estimation(task, found, estimate), kind)
    trust = Trust(
        approach(task.problem, found, task.settings.segments, feedback),
        suspects=() if suspect is None else (str(suspect),),
        not_done=tuple(undone.not_done),
    )
    return replace(estimate, trust=trust)


def _fit(task: Task, unstable: InWindows | None) -> tuple[Fit, WrongSign | WrongTerm | None]:
    """The fit, and where it is poor a channel, or a term, that probably has the wrong sign."""
    problem, experiments, settings = task.problem, task.split.fitted, task.settings
    wrong = None if unstable is None else unstable.wrong
    if unstable is not None and wrong is None:
        in_segments = fit_in_segments(task, unstable)
        if in_segments is not None:
            return in_segments, None
    try:
        fit = fit_model(problem.model, experiments, settings, start=task.start, throw=False)
        if not _is_found_without_noise(task, fit):
            require_minimum(fit)
    except OutOfTimeError as error:
        if not isinstance(error.found, Fit):
            raise
        fit = error.found
    except (IdentifiabilityError, SolveError) as error:
        if wrong is not None:
            raise type(error)(f"{wrong}. As written: {error}") from error
        suspect = wrong_sign(problem, experiments, settings) if task.is_free else None
        if suspect is None:
            raise
        raise type(error)(f"{suspect}. As recorded: {error}") from error
    task.undone.add(*fit.not_done)
    if wrong is not None:
        return fit, wrong

    def suspected() -> WrongSign | None:
        """A channel of the wrong sign, sought only where the fit is poor."""
        if not is_poor(fit):
            return None
        task.say("the fit is poor: negate each channel in turn")
        return wrong_sign(problem, experiments, settings, reported=fit)

    if not task.is_free:
        return fit, None
    return fit, task.undone.attempt("the test of the signs of the channels", suspected)


def _is_found_without_noise(task: Task, fit: Fit) -> bool:
    """Whether the estimate without the bias of input noise is found where no minimum was."""
    if fit.solution.is_converged or fit.not_done:
        return False
    return without_input_noise(fit, task.problem.noise, seed=task.settings.seed).is_removed


def _in_sizes(task: Task, fit: Fit) -> tuple[Split, Fit, tuple[str, ...]]:
    """The records, the fit by sizes of noise that grows with the reading, and where it does."""
    settings, split = task.settings, task.split
    if not fit.solution.is_converged or settings.segments > 1 or fit.criterion.segments > 1:
        return split, fit, ()
    once = replace(settings, starts=1, substeps=fit.criterion.substeps)

    def again(records: Split, near: Fit) -> Fit:
        """The fit by `weighted_by_errors`, with the errors that the sizes leave."""
        found = fit_model(
            task.problem.model,
            records.fitted,
            once,
            start=near.values,
            weights=near.criterion.weights,
            check_rank=False,
        )
        found = weighted_by_errors(found, once)
        tried, agreeing = fit.starts_tried, fit.starts_agreeing
        return replace(found, starts_tried=tried, starts_agreeing=agreeing, begun=fit.begun)

    return fitted_in_sizes(fit, split, task.problem.noise, again)


def _unbiased(task: Task, fit: Fit) -> tuple[Corrected, list[str]]:
    """The fit without the bias of noise on its inputs, and notes on feedback that biases it.

    By instruments, where the problem has an external signal and the bias remains otherwise.
    """
    problem, undone = task.problem, task.undone
    found = _corrected(task, fit)
    with no_time_limit():
        feedback = feedback_notes(found.fit, found.noisy)
    is_biased = bool(feedback) or (bool(found.why_not) and bool(found.noisy))
    if problem.external and is_biased and found.fit.solution.is_converged:
        task.say("instruments")
        replaced = partial(instrumented, problem, found, task.split.fitted)
        found = undone.attempt("instruments", replaced) or found
        feedback = [] if found.reference else feedback
    return found, feedback


def _corrected(task: Task, fit: Fit) -> Corrected:
    """The fit without the bias of noise on its inputs, where it is finished and there is time."""
    if not fit.solution.is_converged and fit.not_done:
        return Corrected(fit)
    what = "the removal of the bias of noise on inputs"
    removed = partial(without_input_noise, fit, task.problem.noise, seed=task.settings.seed)
    found = task.undone.attempt(what, removed)
    if found is None:
        return Corrected(fit, why_not="the budget of time ended")
    what = "the weighing by the spectrum of the residual"
    return task.undone.attempt(what, partial(with_spectral_weights, found)) or found


def _estimate(task: Task, found: Corrected, notes: Sequence[str]) -> Estimate:
    """The estimate, with what became of the bias that noise on measured inputs gives."""
    fit, split, method = found.fit, task.split, method_of(found.fit)
    if fit.criterion.segments > 1 and not split.is_empty:
        length = window_length(fit) * max(d.Ts for d in fit.criterion.data)
        method = f"{method}; held out in windows of {length:.2g} s"
    if found.reference:
        method = f"instrumental variables from {found.reference}"
    elif found.weights is not None:
        method = f"{method}, weighted by the spectrum of the residual"
    elif found.is_removed:
        method = f"{method}, without the bias of input noise"
    elif found.why_not and (found.noisy or found.bias is None):
        notes = [*notes, f"noise on measured inputs: {found.text}"]
    held_out, bars = validation(fit, split), error_bars(found)
    estimate = estimate_of(task.problem, fit, held_out, method=method, notes=notes, bars=bars)
    return replace(estimate, records=record_views(fit, None, split))


def _estimation(task: Task, found: Corrected, estimate: Estimate) -> Estimation:
    """The estimate as the search for its intervals takes it."""

    def covariance(mask: Array) -> Array:
        """Covariance with these variables free: under the noise found, or by the sandwich."""
        if found.weights is not None:
            return found.weights.covariance(mask)
        if found.covariance is not None:
            return found.covariance
        coloured = covariance_under_colour(found.fit, mask)
        if coloured is not None:
            return coloured[0]
        scores, tied = found.fit.criterion.scores(found.fit.x), found.fit.solution
        return sandwich(tied.hessian, scores, mask, tied.constraint_jacobian)[0]

    fit = found.fit if found.weights is None else found.weights.fit
    if found.is_removed and found.noise is not None:
        fit = whitened(fit, found.noise.whiten)
    return Estimation(
        fit,
        by_mask(covariance),
        replace(task.settings, segments=found.fit.criterion.segments),
        task.problem.noise,
        undetermined_in(estimate, found.fit.solution),
        found,
    )
