"""`identify`: estimate the unknown parameters of a problem by minimising the simulation error."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.argument_types import names_wrong_types
from casid.data.arguments import Recorded, in_si, problem_of
from casid.data.problem import Problem
from casid.errors import DataError
from casid.estimation.estimate import Estimate, Estimated, Uncertainty
from casid.estimation.holdout import split_records
from casid.estimation.intervals.choice import require_intervals
from casid.estimation.prediction_error.disturbances import Disturbance, with_known_noise
from casid.estimation.simulation.budget import fit_budget
from casid.estimation.simulation.fit import FitSettings
from casid.estimation.simulation.records.input_gaps import with_gaps_treated
from casid.estimation.unknowns import Unknowns, refuse_strangers
from casid.identifiability.requirement import require_identifiable
from casid.identification.disturbed import identify_disturbed, identify_unstable
from casid.identification.simulated import identify_simulated
from casid.identification.task import Task
from casid.identification.unstable import unstable_in_windows
from casid.model.model import Model
from casid.time_limit import out_of_time_text, until, wall_clock

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
    starts: int | None = None,
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
    settings : of the fit: number of starts, solver, seed, constraints; `FitSettings`.
    start : start values by variable name, over the model's own, in the units that it declares.
    budget : seconds that the estimate may take; by default from the number of samples and unknowns
        (`FIT_BUDGET`); profiles that are not requested get a part of it. What is not done in time
        is in `not_done`; an unfinished fit gives its best point, without errors, not converged.
    intervals : "auto": normal, and by the profile of the criterion for parameters at a bound or
        where the criterion is not the parabola that a normal interval assumes (the limits are in
        `QUADRATIC_TEST`); "quick": normal; "profile"; "bootstrap": from simulated records.
        Those of instruments are normal.
    disturbances : as "torque:peak": in a balance, a state or an unmeasured input, of spectrum
        "white", "first" (order) or "peak"; by the prediction error of a Kalman filter. What is held
        out is then predicted one sample ahead; no interval is bootstrapped.
    starts : of the fit, as in `diagnose`; default that of `settings`, or of the problem.
    progress : called with a line of text at every step.

    Returns
    -------
    Estimate
        Values in the units that the model declares, with standard errors robust to autocorrelated
        residuals. A coloured residual that is noise is weighted by its spectrum where that makes a
        parameter much more certain; `method` and `evidence` say so. Several outputs count in units
        of the error that each leaves, the maximum of the likelihood for noise of unknown sizes.
        Where noise on measured inputs (those not declared `known`) biases least squares, the
        estimate is without that bias, and `method` and `evidence` say so; where that, or feedback,
        cannot be removed and the problem has an `external` signal, it is by instruments. An
        unstable model under random disturbances is estimated together with them, by prediction
        error; `evidence` has them under "disturbances". Where the fit is poor, `suspects` names a
        channel that was probably recorded with the wrong sign, or a term that makes the model
        unstable by its sign.

    Raises
    ------
    ModelError
        `start` names what is no variable.
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
    began = wall_clock()
    require_intervals(intervals)
    declared = problem_of(problem)
    problem, chosen = in_si(declared, experiments)
    begin = declared.model.in_si(start or {})
    if not isinstance(hold_out, float | int):
        _, hold_out = in_si(declared, hold_out)
        hold_out = with_gaps_treated(problem.model, hold_out)
    split = split_records(with_gaps_treated(problem.model, chosen), hold_out)
    settings = settings or FitSettings(starts=problem.starts)
    settings = settings if starts is None else replace(settings, starts=starts)
    acting = _disturbances(disturbances, settings, intervals)
    say = progress or (lambda _: None)
    if not acting:  # the prediction error has variables of its own, and refuses others itself
        known = [(e.name, e.known) for e in split.fitted]
        unknowns = Unknowns(problem.model, known, settings.own)
        refuse_strangers(problem.model, unknowns.startable, begin)
    task = Task(problem, split, settings, begin, intervals, budget, say, began)
    with until(began + fit_budget(problem.model, split.fitted, budget)):
        structural = _structure(task, acting)
        estimate = _estimate(task, acting)
    seen = replace(estimate.identifiability, structural=structural)
    estimate = replace(estimate, identifiability=seen).in_units(problem.model.declared_units)
    return _cut_off(estimate) if estimate.not_done else estimate


def _estimate(task: Task, disturbances: Sequence[Disturbance]) -> Estimate:
    """The estimate by the criterion that suits the model and its disturbances.

    By prediction error with the disturbances that are requested, or with those that the residual of
    an unstable model shows; by simulation error in all other cases.
    """
    if disturbances:
        return identify_disturbed(task, disturbances)
    task.say(f"fit {', '.join(e.name for e in task.split.fitted)}")
    unstable = unstable_in_windows(task) if task.is_free else None
    if unstable is not None and unstable.is_disturbed and task.intervals != "bootstrap":
        found = identify_unstable(task, unstable.values)
        if found is not None:
            return found
    return identify_simulated(task, unstable)


def _structure(task: Task, disturbances: Sequence[Disturbance]) -> str:
    """What the equations determine, in words.

    Raises
    ------
    IdentifiabilityError
        If they do not determine all parameters that are to be estimated.
    """
    problem, settings = task.problem, task.settings
    if settings.constraints:
        return "not checked, as there are constraints"
    model, condition = problem.model, ""
    if any(d.place in model.inputs for d in disturbances):
        model = with_known_noise(model, disturbances)
        condition = "if the noise that drives unmeasured inputs were known: "
    return condition + require_identifiable(
        model, task.split.fitted, own=settings.own, problem=problem, progress=task.say
    )


def _disturbances(
    disturbances: Sequence[Disturbance | str] | str,
    settings: FitSettings,
    intervals: str,
) -> list[Disturbance]:
    """The disturbances that are requested.

    Raises
    ------
    DataError
        For options that cannot be combined with them.
    """
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


def _cut_off(estimate: Estimate) -> Estimate:
    """The estimate with a warning of what was not done; without errors if it is no minimum."""
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
