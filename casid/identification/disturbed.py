"""`identify` with disturbances: parameters, noise and spectra together, by prediction error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np

from casid.data.problem import Problem
from casid.errors import CasidError, OutOfTimeError, shell_option
from casid.estimation.covariance import LAGS_OUTSIDE, sandwich, whiteness
from casid.estimation.estimate import Agreement, Estimate, RecordView
from casid.estimation.fit_statistics import nrmse_fit, rms
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.fitted.from_fit import channels_of
from casid.estimation.free_simulation import simulated_views
from casid.estimation.holdout import Split
from casid.estimation.intervals.choice import Estimation, by_mask, undetermined_in
from casid.estimation.nlp.solution import not_converged
from casid.estimation.nlp.solver import as_solver
from casid.estimation.noise.forces import places_of_forces
from casid.estimation.prediction_error.disturbances import Disturbance
from casid.estimation.simulation.fit import FitSettings
from casid.identification.disturbance_search import Disturbed, minimum_with, without
from casid.identification.grey_box import Prediction
from casid.identification.problem_notes import problem_notes
from casid.identification.task import Task
from casid.model.model import Model
from casid.time_limit import Undone, no_time_limit, seconds_left, wall_clock

PROFILED = {"ipopt.tol": 1e-4, "ipopt.acceptable_tol": 1e-3, "ipopt.acceptable_iter": 1}
"""Of a refit with one unknown held: its likelihood is known to a hundredth where it ends."""
_WHY_DISTURBED = (
    "the model is unstable, and simulations over short windows err by more than white noise: what "
    "pushes it at random is estimated with the parameters, as by {named}"
)


def identify_disturbed(task: Task, disturbances: Sequence[Disturbance]) -> Estimate:
    """Estimate a model whose disturbances have a named place and a parametric spectrum.

    By the prediction errors of a Kalman filter, extended where the model is nonlinear or outputs
    miss samples, from least squares and the best sizes and frequencies of a grid.

    Raises
    ------
    ModelError
        For a place where nothing can act, or a white disturbance to which an output responds at
        once.
    IdentifiabilityError
        For parameters or disturbances that these records do not determine.
    SolveError
        If no optimum was found; for want of time, the estimate says so in `not_done`.
    """
    estimate = _completed(task, minimum_with(task, disturbances))
    with no_time_limit():
        return replace(estimate, records=_views(estimate, task.split))


def identify_unstable(task: Task, values: Mapping[str, float]) -> Estimate | None:
    """Estimate an unstable model that random disturbances push; None where that finds no optimum.

    The disturbances are white, one in every place; where innovations are coloured, they are of
    first order in those places where they have a size, if that is likelier (Akaike, IEEE Trans.
    Automatic Control 19 (1974) 716-723).

    Parameters
    ----------
    values : of parameters near the estimate, by variable name.
    """
    task = replace(task, start={**task.start, **values}, began=wall_clock(), undone=Undone())
    places = places_of_forces(task.problem.model)
    try:
        found = minimum_with(task, [Disturbance(p) for p in places], is_near=True)
        if coloured_innovations(found.prediction):
            likelier = partial(_coloured, task, found)
            what = "the search of coloured disturbances"
            found = task.undone.attempt(what, likelier) or found
        estimate = _completed(task, found)
    except OutOfTimeError:
        raise
    except CasidError:
        return None
    named = " ".join(map(_option, found.disturbances))
    evidence = {**estimate.evidence, "disturbances": _WHY_DISTURBED.format(named=named)}
    return replace(estimate, trust=replace(estimate.trust, evidence=evidence))


def _option(d: Disturbance) -> str:
    """The option of a command that states a disturbance."""
    return shell_option("--disturbance", f"{d.place}:{d.spectrum}")


def _coloured(task: Task, white: Disturbed) -> Disturbed:
    """The minimum with first-order disturbances where white ones act, if it is likelier."""
    active = white.prediction.solution.active
    acting = [replace(d, spectrum="first") for d in white.disturbances if d.size not in active]
    try:
        found = minimum_with(task, acting, is_near=True) if acting else white
    except OutOfTimeError:
        raise
    except CasidError:
        return white
    is_likelier = found.prediction.aic < white.prediction.aic
    return found if is_likelier and found.prediction.solution.is_converged else white


def _completed(task: Task, found: Disturbed) -> Estimate:
    """The estimate with its intervals, what was held out and warnings."""
    problem, prediction = without(task, found.disturbances).problem, found.prediction
    estimate, undone = prediction.estimate, task.undone
    if prediction.solution.is_converged:
        estimation = _estimation(problem, prediction, task.settings)
        estimate = task.with_intervals(estimate, estimation)
        with no_time_limit():  # one pass over what is held out
            estimate = replace(estimate, held_out=_held_out(estimate, task.split))
    elif seconds_left() > 0.0:
        raise not_converged(problem.name, prediction.solution)
    else:
        undone.add("the end of the search")
    with no_time_limit():
        notes = problem_notes(problem, task.split.fitted)
        doubts = fed_back(found.program.model, found.disturbances)
        doubts += coloured_innovations(prediction)
    estimate = replace(
        estimate,
        problem=problem.name,
        method=f"{estimate.method}; disturbances in "
        + ", ".join(f"{d.place} ({d.spectrum})" for d in found.disturbances),
        trust=replace(estimate.trust, not_done=tuple(undone.not_done)),
        warnings=(*notes, *estimate.warnings, *doubts),
        model=_finished(estimate.model, problem, tuple(found.program.spread)),
    )
    return estimate.in_units(found.program.model.declared_units)


def _views(estimate: Estimate, split: Split) -> tuple[RecordView, ...]:
    """The records beside their free simulations, without what disturbs them.

    None where one of these diverges, as that of an unstable plant does.
    """
    try:
        views = simulated_views(estimate, [*split.whole, *split.apart])
    except CasidError:
        return ()
    parts = [*(~held for held in split.held), *(np.zeros(e.record.N, bool) for e in split.apart)]
    return tuple(replace(v, fitted=part) for v, part in zip(views, parts, strict=True))


def _finished(
    model: FittedModel | None, problem: Problem, states: tuple[str, ...]
) -> FittedModel | None:
    """The model with the states of disturbances, and where the problem finds its signals."""
    if model is None or model.noise is None:
        return model
    noise = replace(model.noise, shaped=states)
    return replace(model, name=problem.name, noise=noise, channels=channels_of(problem))


def fed_back(model: Model, disturbances: Sequence[Disturbance]) -> list[str]:
    """A warning for every sensor that responds to a disturbance at once and is an input.

    What it shows of the disturbance of a sample comes back through the input at that sample, which
    a prediction of the output, given the input, does not know.
    """
    out = []
    e = model.explicit()
    for d in disturbances:
        names, symbols = (*e.states, *e.inputs), ca.vertcat(e.x, e.u)
        acts = symbols[names.index(d.source if d.spectrum == "white" else d.force)]
        for unknown, using in model.eliminations.items():
            if any(ca.which_depends(e.eliminated[unknown], acts, 1, False)):
                both = f"{_option(d)} {_option(Disturbance(unknown, 'first'))}"
                out.append(
                    f"input {using} responds directly to what acts in {d.place}, and feeds it "
                    "back: values may be biased by many standard errors. Estimate the model from "
                    f"which {unknown} is not eliminated, where {using} is an output and {unknown} "
                    f"a disturbance, too ({both})"
                )
    return out


def coloured_innovations(found: Prediction) -> list[str]:
    """A warning for every output whose innovations are not white."""
    criterion, out = found.criterion, []
    for e, d in enumerate(criterion.data):
        errors = criterion.innovations(found.x, e)
        for i, name in enumerate(criterion.outputs):
            outside = whiteness(errors[d.used[:, i], i])
            if outside > LAGS_OUTSIDE:
                out.append(
                    f"{d.name}: innovations of {name} are autocorrelated ({outside} of 20 lags "
                    "outside 95 %): a disturbance has another spectrum or place, the model lacks "
                    "something, or a measured input responds to the disturbance; values may be "
                    "biased, and error bars too small"
                )
    return out


def _estimation(problem: Problem, found: Prediction, settings: FitSettings) -> Estimation:
    """The estimate as the search for its intervals takes it."""
    criterion, solution, estimate = found.criterion, found.solution, found.estimate
    scores = criterion.scores(solution.x)
    solver = as_solver(settings.solver)
    if solver.name == "ipopt":
        settings = replace(settings, solver=replace(solver, options={**PROFILED, **solver.options}))

    return Estimation(
        found,
        by_mask(lambda free: sandwich(solution.hessian, scores, free)[0]),
        settings,
        problem.noise,
        undetermined_in(estimate, solution),
    )


def _held_out(estimate: Estimate, split: Split) -> Agreement:
    """RMS error and fit of predictions one sample ahead of what was held out."""
    assert estimate.model is not None
    names = list(estimate.units)
    parts = [(e, mask) for e, mask in zip(split.whole, split.held, strict=True) if mask.any()]
    parts += [(e, np.ones(e.record.N, dtype=bool)) for e in split.apart]
    errors: dict[str, dict[str, float]] = {}
    fits: dict[str, dict[str, float]] = {}
    for e, mask in parts:
        left, columns = estimate.model.residuals(e, 1), []
        for name in names:
            is_there = mask & ~e.record.is_missing(name)
            columns.append(np.where(is_there, [e.record[name], left[name]], np.nan))
        measured, error = np.stack(columns, axis=2)
        for found, values in ((errors, rms(error)), (fits, nrmse_fit(measured, error))):
            found[e.name] = dict(zip(names, values.tolist(), strict=True))
    return Agreement(errors, fits)
