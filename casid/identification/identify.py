"""`identify`: estimate the unknown parameters of a problem by minimising the simulation error."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.data.arguments import Recorded, in_si, problem_of
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.errors import DataError, IdentifiabilityError, OutOfTimeError, SolveError
from casid.estimation.covariance import sandwich
from casid.estimation.errors_in_variables.error_bars import covariance_under_colour, error_bars
from casid.estimation.errors_in_variables.removal import (
    Corrected,
    with_spectral_weights,
    without_input_noise,
)
from casid.estimation.estimate import Estimate, Estimated, Trust, Uncertainty
from casid.estimation.holdout import (
    Split,
    record_views,
    split_records,
    validation,
    window_length,
)
from casid.estimation.intervals.choice import (
    Estimation,
    chosen_intervals,
    patience_since,
    require_intervals,
    with_intervals,
)
from casid.estimation.prediction_error.disturbances import Disturbance
from casid.estimation.simulation.budget import fit_budget
from casid.estimation.simulation.fit import FitSettings, fit_model, weighted_by_errors
from casid.estimation.simulation.input_feedback import feedback_notes
from casid.estimation.simulation.input_gaps import with_gaps_treated
from casid.estimation.simulation.minimization import Fit, require_minimum, whitened
from casid.estimation.simulation.simulation_estimate import (
    channel_notes,
    estimate_of,
    method_of,
)
from casid.identifiability.requirement import require_identifiable
from casid.identification.approach import approach
from casid.identification.disturbed import identify_disturbed, identify_unstable
from casid.identification.problem_notes import problem_notes
from casid.identification.reference_instruments import instrumented
from casid.identification.signs_from_simulation import WrongSign, is_poor, wrong_sign
from casid.identification.sized_noise import fitted_in_sizes, sized_noise_text
from casid.identification.unstable import InWindows, fit_in_segments, unstable_in_windows
from casid.model.model import Model
from casid.time_limit import (
    Undone,
    no_time_limit,
    out_of_time_text,
    until,
    wall_clock,
)

UNFINISHED = "the fit was not finished: no standard errors"
"""What the errors of the best point of a fit without end assume."""


@names_wrong_types()
def identify(
    problem: Problem | Model,
    experiments: Sequence[Recorded] | Recorded | None = None,
    *,
    hold_out: float | Sequence[Recorded] | Recorded = 0.0,
    settings: FitSettings | None = None,
    start: Mapping[str, float] | None = None,
    budget: float | None = None,
    intervals: str = "auto",
    disturbances: Sequence[Disturbance | str] | str = (),
    progress: Callable[[str], None] | None = None,
) -> Estimate:
    """Estimate the unknown parameters and initial states by least-squares simulation error.

    Parameters
    ----------
    problem : or its model alone, where there is nothing to add to it.
    experiments : records in the problem's channels (SI), or DataFrames with its columns, each with
        the values known for it alone; default the problem's own example. Unknown parameters are
        shared unless `settings.own`.
    hold_out : share of each record, at its end, or whole records, used for validation only.
    start : start values by variable name, over the model's own, in the units that it declares.
    budget : seconds that the estimate may take; by default from the number of samples and unknowns
        (`FIT_BUDGET`), profiles not requested a part of it. What no time is left for is in
        `not_done`; an unfinished fit gives its best point, without errors and not converged.
    intervals : "auto": normal, and by the profile of the criterion for parameters at a bound or
        where the criterion is not the parabola that a normal interval takes it for (the numbers
        are in `QUADRATIC_TEST`); "quick": normal; "profile"; "bootstrap": from simulated records.
        Those of instruments are normal.
    disturbances : as "torque:peak": in a balance, a state or an input that nobody measures;
        "white", "first" (order) or "peak"; by the prediction error of a Kalman filter. What is held
        out is then predicted one sample ahead; no interval is bootstrapped.

    Returns
    -------
    Estimate
        Values in the units that the model declares, with standard errors robust to autocorrelated
        residuals. A coloured residual that is noise is weighted by its spectrum where that makes a
        parameter much more certain; `method` and `evidence` say so. Several outputs count in units
        of the error that each leaves, the maximum of the likelihood for noise of unknown sizes.
        Where noise on measured inputs (those not declared `known`) biases least squares, the
        estimate is without that bias, and `method` and `evidence` say so; where that, or feedback,
        cannot be removed and the problem has an `external` signal, it is by instruments. Of an
        unstable model that is pushed at random it is with the disturbances, by prediction error,
        and `evidence` says so under "disturbances". Where the
        fit is poor, `suspects` names a channel that was probably recorded with the wrong sign.

    Raises
    ------
    DataError
        Channels missing, inputs without a complete stretch, record too short for the unknowns.
    IdentifiabilityError
        Parameters that are not identifiable from these records; those that are, are named.
    SolveError
        The simulation diverges at the start, or the solver finds no optimum; `OutOfTimeError` where
        the budget is over before there is any fit.

    Example
    -------
    >>> import casid
    >>> import numpy as np
    >>> m = casid.Model("cooling cup")
    >>> T, tau = m.state("T", "K"), m.parameter("tau", "s", start=100, lower=1)
    >>> m.derivative(T, -T / tau)
    >>> _ = m.output("excess", T, "K")
    >>> noise = 0.1 * np.random.default_rng(1).standard_normal(200)
    >>> excess = 50 * np.exp(-5 * np.arange(200) / 400) + noise
    >>> cup = casid.Record({"excess": excess}, {"excess": "K"}, Ts=5, name="cup")
    >>> estimate = casid.identify(m, cup)
    >>> estimate
    <Estimate cooling cup: converged, 1 free, 0 at bound, fit 99.3 %>
    >>> print(f"{estimate['tau']:.0f} s")
    400 s
    """
    began, say = wall_clock(), progress or (lambda _: None)
    require_intervals(intervals)
    if not isinstance(hold_out, float | int):
        _, hold_out = in_si(problem, hold_out)
        hold_out = with_gaps_treated(problem_of(problem).model, hold_out)
    if start is not None:
        start = (problem if isinstance(problem, Model) else problem.model).in_si(start)
    problem, chosen = in_si(problem, experiments)
    chosen = with_gaps_treated(problem.model, chosen)
    split = split_records(chosen, hold_out)
    settings = settings or FitSettings(starts=problem.starts)
    undone, chosen_disturbances = Undone(), _disturbances(disturbances, settings, intervals)
    with until(began + fit_budget(problem.model, split.fitted, budget)):
        structural = _structure(problem, split.fitted, settings, chosen_disturbances, progress)
        unstable, disturbed = _by_prediction_error(
            problem, split, chosen_disturbances, settings, start, intervals, budget, say
        )
        if disturbed is not None:
            return _completed(disturbed, problem.model, structural)
        estimate, found = _estimate_of_fit(
            problem, split, settings, start, chosen, unstable, (say, undone)
        )
        if estimate.is_converged:
            estimation = _estimation(problem, found, estimate, settings)
            patience = patience_since(began, budget)
            kind = "quick" if found.reference else intervals
            found_intervals = chosen_intervals(estimation, kind, undone, say, patience)
            estimate = with_intervals(estimate, found_intervals)
    trust = replace(estimate.trust, not_done=tuple(undone.not_done))
    return _completed(replace(estimate, trust=trust), problem.model, structural)


def _estimate_of_fit(
    problem: Problem,
    split: Split,
    settings: FitSettings,
    start: Mapping[str, float] | None,
    chosen: Sequence[Experiment],
    unstable: InWindows | None,
    to: tuple[Callable[[str], None], Undone],
) -> tuple[Estimate, Corrected]:
    """The estimate with its records and with what it rests on, and the fit that it is of.

    Of the records `chosen`, fitted and held out, it has the notes. Progress and what was not done
    go to `to`.
    """
    say, undone = to
    fit, suspect = _fit(problem, split.fitted, settings, start, unstable, to)
    if fit.solution.is_converged:
        alike = replace(settings, segments=fit.criterion.segments)
        by_errors = partial(weighted_by_errors, fit, alike)
        fit = undone.attempt("the weighing of outputs by their errors", by_errors) or fit
    weigh = partial(_sized, problem, fit, split, settings)
    split, fit, grows = undone.attempt("the sizes of noise that grows", weigh) or (split, fit, ())
    found = _corrected(problem, fit, settings, undone)
    with no_time_limit():  # a few passes over the record, without which there is no result
        feedback = feedback_notes(found.fit, found.noisy)
    is_biased = bool(feedback) or (bool(found.why_not) and bool(found.noisy))
    if problem.external and is_biased and found.fit.solution.is_converged:
        say("instruments")
        replaced = partial(instrumented, problem, found, split.fitted)
        found = undone.attempt("instruments", replaced) or found
        feedback = [] if found.reference else feedback
    with no_time_limit():
        notes = [*problem_notes(problem, split.fitted), *channel_notes(problem.model, chosen)]
        notes += [sized_noise_text(grows)] if grows else []
        estimate = _estimate(problem, found, split, [*notes, *feedback])
        trust = Trust(
            approach(problem, found, settings.segments, feedback),
            suspects=() if suspect is None else (str(suspect),),
        )
        return replace(estimate, records=record_views(found.fit, None, split), trust=trust), found


def _sized(
    problem: Problem, fit: Fit, split: Split, settings: FitSettings
) -> tuple[Split, Fit, tuple[str, ...]]:
    """The records, the fit by sizes of noise that grows with the reading, and where it does."""
    if not fit.solution.is_converged or settings.segments > 1 or fit.criterion.segments > 1:
        return split, fit, ()
    once = replace(settings, starts=1, substeps=fit.criterion.substeps)

    def again(records: Split, near: Fit) -> Fit:
        """The fit by `weighted_by_errors`, with the errors that the sizes leave."""
        found = fit_model(
            problem.model,
            records.fitted,
            once,
            start=near.values,
            weights=near.criterion.weights,
            check_rank=False,
        )
        found = weighted_by_errors(found, once)
        tried, agreeing = fit.starts_tried, fit.starts_agreeing
        return replace(found, starts_tried=tried, starts_agreeing=agreeing, begun=fit.begun)

    return fitted_in_sizes(fit, split, problem.noise, again)


def _structure(
    problem: Problem,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    disturbances: Sequence[Disturbance],
    progress: Callable[[str], None] | None,
) -> str:
    """What the equations determine, in words; a refusal where not all that is sought."""
    if settings.constraints:
        return "not checked, as there are constraints"
    if any(d.place in problem.model.inputs for d in disturbances):
        return "not checked, as there are inputs that nobody measures"
    own = settings.own
    return require_identifiable(
        problem.model, experiments, own=own, problem=problem, progress=progress
    )


def _completed(estimate: Estimate, model: Model, structural: str) -> Estimate:
    """The estimate in the units that the model declares, with what was found before the fit."""
    seen = replace(estimate.identifiability, structural=structural)
    estimate = replace(estimate, identifiability=seen).in_units(model.declared_units)
    return _cut_off(estimate) if estimate.not_done else estimate


def _disturbances(
    disturbances: Sequence[Disturbance | str] | str,
    settings: FitSettings,
    intervals: str,
) -> list[Disturbance]:
    """The disturbances, and a refusal of what is not done with them."""
    given = [disturbances] if isinstance(disturbances, str) else list(disturbances)
    for name, is_given in (
        ("segments (--segments)", settings.segments > 1),
        ("constraints", bool(settings.constraints)),
        (f"intervals={intervals!r} (--intervals)", intervals == "bootstrap"),
    ):
        if given and is_given:
            raise DataError(
                f"{name} is not done with disturbances, which are estimated by prediction error; "
                "leave it out, or leave the disturbances out"
            )
    return [Disturbance.of(d) if isinstance(d, str) else d for d in given]


def _estimation(
    problem: Problem, found: Corrected, estimate: Estimate, settings: FitSettings
) -> Estimation:
    """The estimate as the search for its intervals takes it."""
    rows = (*estimate.parameters, *estimate.initial_states)
    held = found.fit.solution.active
    undetermined = [p.name for p in rows if p.std_error is None and p.name not in held]

    @cache
    def covariance(free: tuple[bool, ...]) -> Array:
        """Covariance with these variables free: under the noise found, or by the sandwich."""
        mask = np.array(free)
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
        lambda free: covariance(tuple(free.tolist())),
        replace(settings, segments=found.fit.criterion.segments),
        problem.noise,
        undetermined,
        found,
    )


def _corrected(problem: Problem, fit: Fit, settings: FitSettings, undone: Undone) -> Corrected:
    """The fit without the bias of noise on its inputs, where it is finished and there is time."""
    if not fit.solution.is_converged and fit.not_done:
        return Corrected(fit)
    what = "the removal of the bias of noise on inputs"
    found = undone.attempt(
        what, lambda: without_input_noise(fit, problem.noise, seed=settings.seed)
    )
    if found is None:
        return Corrected(fit, why_not="the budget of time ended")
    what = "the weighing by the spectrum of the residual"
    return undone.attempt(what, lambda: with_spectral_weights(found)) or found


def _cut_off(estimate: Estimate) -> Estimate:
    """The estimate with what no time was left for; without errors where the fit is no minimum."""
    warnings = (out_of_time_text(estimate.not_done), *estimate.warnings)
    estimate = replace(estimate, warnings=warnings)
    if estimate.is_converged:
        return estimate

    def without_error(row: Estimated) -> Estimated:
        if row.std_error is None:
            return row
        return replace(row, std_error=None, note="not finished: no standard error")

    return replace(
        estimate,
        parameters=tuple(without_error(p) for p in estimate.parameters),
        initial_states=tuple(without_error(p) for p in estimate.initial_states),
        uncertainty=Uncertainty((), np.zeros((0, 0)), UNFINISHED),
    )


def _estimate(problem: Problem, found: Corrected, split: Split, notes: Sequence[str]) -> Estimate:
    """The estimate, with what became of the bias that noise on measured inputs gives."""
    fit, method = found.fit, method_of(found.fit)
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
    return estimate_of(problem, fit, held_out, method=method, notes=notes, bars=bars)


def _is_found_without_noise(problem: Problem, fit: Fit, settings: FitSettings) -> bool:
    """Whether noise on the inputs hides the minimum, but not the estimate without it."""
    if fit.solution.is_converged or fit.not_done:
        return False
    return without_input_noise(fit, problem.noise, seed=settings.seed).is_removed


def _by_prediction_error(
    problem: Problem,
    split: Split,
    disturbances: Sequence[Disturbance],
    settings: FitSettings,
    start: Mapping[str, float] | None,
    intervals: str,
    budget: float | None,
    say: Callable[[str], None],
) -> tuple[InWindows | None, Estimate | None]:
    """A model that no simulation stays with, and an estimate that is not by simulation error.

    That is by prediction error, with the disturbances that are requested, or with those that show
    where an unstable model is pushed.
    """
    if disturbances:
        return None, identify_disturbed(
            problem,
            split,
            disturbances,
            settings,
            start=start,
            intervals=intervals,
            budget=budget,
            progress=say,
        )
    say(f"fit {', '.join(e.name for e in split.fitted)}")
    if not _is_free(settings):
        return None, None
    unstable = unstable_in_windows(problem, split.fitted, settings, start, say)
    if unstable is None or not unstable.is_disturbed or intervals == "bootstrap":
        return unstable, None
    begin = dict(start or {}) | unstable.values
    return unstable, identify_unstable(
        problem, split, settings, begin, intervals=intervals, budget=budget, progress=say
    )


def _is_free(settings: FitSettings) -> bool:
    """Whether the fit has neither constraints nor a requested number of segments."""
    return not settings.constraints and settings.segments == 1


def _fit(
    problem: Problem,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    start: Mapping[str, float] | None,
    unstable: InWindows | None,
    to: tuple[Callable[[str], None], Undone],
) -> tuple[Fit, WrongSign | None]:
    """The fit, and where it is poor a channel that was probably recorded with the wrong sign.

    Progress and what was not done go to `to`.
    """
    say, undone = to
    checks_signs = _is_free(settings)
    if unstable is not None:
        in_segments = fit_in_segments(problem, experiments, settings, start, unstable, say)
        if in_segments is not None:
            return in_segments, None
    try:
        fit = fit_model(problem.model, experiments, settings, start=start, throw=False)
        if not _is_found_without_noise(problem, fit, settings):
            require_minimum(fit)
    except OutOfTimeError as error:
        if not isinstance(error.found, Fit):
            raise
        fit = error.found
    except (IdentifiabilityError, SolveError) as error:
        suspect = wrong_sign(problem, experiments, settings) if checks_signs else None
        if suspect is None:
            raise
        raise type(error)(f"{suspect}. As recorded: {error}") from error
    undone.add(*fit.not_done)

    def suspected() -> WrongSign | None:
        """A channel of the wrong sign, sought only where the fit is poor."""
        if not is_poor(fit):
            return None
        say("the fit is poor: negate each channel in turn")
        return wrong_sign(problem, experiments, settings, reported=fit)

    if not checks_signs:
        return fit, None
    return fit, undone.attempt("the test of the signs of the channels", suspected)
