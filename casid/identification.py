"""`identify`: estimate the unknown parameters of a problem by minimising the simulation error."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casid.checking import standing
from casid.data import Experiment, Record
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError
from casid.estimate import Estimate, Estimated, Identifiability
from casid.identifiability.requirement import require_identifiable
from casid.local_rank import describe_null, local_rank
from casid.model import Model
from casid.problem import Problem
from casid.simulation_error import (
    Constraint,
    Fit,
    SimulationError,
    minimize_simulation_error,
)
from casid.solving.nlp import Solver
from casid.uncertainty import sandwich, whiteness

Array = np.ndarray[Any, Any]

SOURCES = (
    "H. G. Bock, in Numerical Treatment of Inverse Problems, Birkhauser 1983: multiple shooting",
    "L. Ljung, System Identification, 2nd ed., Prentice Hall 1999: simulation error",
    "W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708: robust covariance",
    "D. W. K. Andrews, Econometrica 59 (1991) 817-858: its bandwidth",
    "A. Waechter, L. T. Biegler, Math. Program. 106 (2006) 25-57: Ipopt",
    "J. A. E. Andersson et al., Math. Program. Comput. 11 (2019) 1-36: CasADi",
)
"""Papers behind the methods of an estimate."""

ASSUMES = (
    "autocorrelation-robust sandwich (Newey-West, {lags} lags): residuals of zero mean with a "
    "memory short against the record; noise on measured inputs biases the estimate and is not in it"
)


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How a fit is sought.

    Attributes
    ----------
    starts : number of starts; the best optimum is kept.
    segments : shooting segments a record; more than one for unstable models.
    substeps : Runge-Kutta steps a sample; None doubles them until they no longer matter.
    own : parameters that every record has for itself.
    constraints : each takes a mapping of names to symbols and returns what is to be zero.
    """

    starts: int = 3
    segments: int = 1
    substeps: int | None = None
    own: Sequence[str] = ()
    constraints: Sequence[Constraint] = ()
    solver: Solver | None = None
    seed: int = 0


def fit_model(
    model: Model,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    *,
    start: Mapping[str, float] | None = None,
    check_rank: bool = True,
    throw: bool = True,
) -> Fit:
    """Minimise the simulation error, with as many Runge-Kutta substeps as the data can feel."""
    substeps = settings.substeps or 1
    fit: Fit | None = None
    while True:
        criterion = SimulationError(
            model,
            experiments,
            own=settings.own,
            segments=settings.segments,
            substeps=substeps,
            start=start if fit is None else fit.values,
        )
        fit = minimize_simulation_error(
            criterion,
            solver=settings.solver,
            starts=settings.starts if fit is None else 1,
            seed=settings.seed,
            constraints=settings.constraints,
            check_rank=check_rank and fit is None,
            throw=throw,
        )
        if settings.substeps is not None or substeps >= 16 or not _steps_matter(fit):
            return fit
        substeps *= 2


def _steps_matter(fit: Fit) -> bool:
    """True if halving the step moves the simulation by over a hundredth of the residual."""
    old = fit.criterion
    fine = SimulationError(
        old.model,
        old.experiments,
        own=old.own,
        weights=old.weights,
        segments=old.segments,
        substeps=2 * old.substeps,
        start=fit.values,
    )
    moved, left = 0.0, 0.0
    with np.errstate(all="ignore"):
        for e, d in enumerate(old.data):
            a, b = old.simulate(fit.x, e)[0], fine.simulate(fit.x, e)[0]
            moved += float(np.sum(((a - b) * d.used * old.weights) ** 2))
            left += float(np.sum(((d.y - a) * d.used * old.weights) ** 2))
    return bool(np.isfinite(moved)) and moved > 1e-4 * left + 1e-16 * old.n_samples


def identify(
    problem: Problem | Model,
    experiments: Sequence[Experiment | Record] | Experiment | Record | None = None,
    *,
    hold_out: float | Sequence[Experiment] = 0.0,
    settings: FitSettings | None = None,
    start: Mapping[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Estimate:
    """Estimate the unknown parameters and initial states by least-squares simulation error.

    Parameters
    ----------
    problem : or its model alone, where nothing else is to be said of it.
    experiments : records in the problem's channels (SI), each with the values known for it alone;
        default the problem's own example. Unknown parameters are shared unless `settings.own`.
    hold_out : share of each record, at its end, or whole records, used for validation only.
    start : start values by variable name, over the model's own.

    Returns
    -------
    Estimate
        Values in SI units, with standard errors robust to coloured residuals. Where the fit is
        poor, `suspects` names a channel that was probably recorded with the wrong sign.

    Raises
    ------
    DataError
        Channels missing, inputs incomplete, record too short for the unknowns.
    IdentifiabilityError
        Parameters that these records cannot tell apart, naming what they can tell.
    SolveError
        The simulation diverges at the start, or the solver finds no optimum.
    """
    from casid.holdout import record_views, split_records, validation
    from casid.wrong_signs import is_poor, wrong_sign

    say = progress or (lambda _: None)
    if isinstance(problem, Model):
        problem = Problem(problem.name, problem)
    chosen = experiments_of(problem, experiments)
    split = split_records(chosen, hold_out)
    settings = settings or FitSettings(starts=problem.starts)
    told = "not asked, as there are constraints"
    if not settings.constraints:
        told = require_identifiable(
            problem.model, split.fitted, own=settings.own, problem=problem, progress=progress
        )
    say(f"fit {', '.join(e.name for e in split.fitted)}")
    asked = not settings.constraints and settings.segments == 1
    try:
        fit = fit_model(problem.model, split.fitted, settings, start=start)
    except (IdentifiabilityError, SolveError) as error:
        turned = wrong_sign(problem, split.fitted, settings) if asked else None
        if turned is None:
            raise
        raise type(error)(f"{turned}. As recorded: {error}") from error
    turned = None
    if asked and is_poor(fit):
        say("the fit is poor: negate each channel in turn")
        turned = wrong_sign(problem, split.fitted, settings)
    held = validation(fit, split)
    estimate = estimate_of(problem, fit, held, notes=standing_channels(problem.model, chosen))
    return replace(
        estimate,
        records=record_views(fit, None, split),
        suspects=() if turned is None else (str(turned),),
        identifiability=replace(estimate.identifiability, structural=told),
    )


def standing_channels(model: Model, experiments: Sequence[Experiment]) -> list[str]:
    """Warnings of channels that rest or stand at a limit, inputs for a tenth of the record."""
    return [
        f"{e.name}: {f.channel}: {f.text} {f.mend}"
        for e in experiments
        for channels, least in ((model.inputs, 0.1), (model.outputs, 0.0))
        for f in standing(e.record, channels, least=least)
    ]


def experiments_of(
    problem: Problem, experiments: Sequence[Experiment | Record] | Experiment | Record | None
) -> list[Experiment]:
    """What the caller gave as a list of experiments, names made unique; the example by default."""
    if not isinstance(problem, Problem):
        given = f"model {problem.name}" if isinstance(problem, Model) else repr(problem)
        raise ModelError(
            f"{given} is no problem; give casid.Problem(name, model), or "
            "casid.load_problem(path) of a file"
        )
    chosen: list[Experiment]
    if experiments is None:
        chosen = problem.examples()
    elif isinstance(experiments, Record):
        chosen = [problem.experiment(experiments)]
    elif isinstance(experiments, Experiment):
        chosen = [experiments]
    else:
        chosen = [problem.experiment(e) if isinstance(e, Record) else e for e in experiments]
    if not chosen:
        raise DataError("no record given; name at least one")
    seen: dict[str, int] = {}
    out = []
    for e in chosen:
        n = seen.get(e.name, 0)
        seen[e.name] = n + 1
        out.append(e if n == 0 else Experiment(e.record, e.known, f"{e.name}#{n + 1}"))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Simulated and measured signals of what was held out of one record."""

    name: str
    t: Array  # (M,)
    measured: Array  # (M, ny), NaN where not used
    simulated: Array  # (M, ny)
    in_record: bool  # the end of a fitted record, against a record of its own


def rms(error: Array) -> Array:
    """(ny,) root mean square of the columns, NaN left out."""
    with np.errstate(all="ignore"):
        return np.asarray(np.sqrt(np.nanmean(error**2, axis=0)))


def nrmse_fit(measured: Array, error: Array) -> Array:
    """(ny,) 100 (1 - |y - yhat| / |y - mean y|) per cent, NaN left out."""
    spread = np.nansum((measured - np.nanmean(measured, axis=0)) ** 2, axis=0)
    return np.asarray(100 * (1 - np.sqrt(np.nansum(error**2, axis=0) / np.maximum(spread, 1e-300))))


def estimate_of(
    problem: Problem,
    fit: Fit,
    held: Sequence[HeldOut] = (),
    *,
    method: str | None = None,
    notes: Sequence[str] = (),
) -> Estimate:
    """The `Estimate` of a fit: errors, fit, rank, whiteness, provenance."""
    criterion, solution = fit.criterion, fit.solution
    model = criterion.model
    bound = {*solution.at_lower, *solution.at_upper}
    free = np.array([n not in bound for n in criterion.names])
    covariance, lags = sandwich(
        solution.hessian,
        criterion.scores(fit.x),
        free,
        solution.constraint_jacobian if solution.constraint_jacobian.size else None,
    )
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.array([v.scale for v in criterion.variables])
    rank = local_rank(solution.hessian, fit.x, criterion.names, scale)
    unseen = {n for direction in rank.null for n in direction}
    parameters: list[Estimated] = []
    states: list[Estimated] = []
    warnings = list(notes)
    for i, v in enumerate(criterion.variables):
        if "[" in v.name:
            continue  # inner nodes of multiple shooting
        is_state = v.source in model.states
        unit = model.states[v.source].unit if is_state else model.parameters[v.source].unit
        note, error = "", float(sd[i])
        shown: float | None = error
        if v.name in solution.at_lower or v.name in solution.at_upper:
            side = "lower" if v.name in solution.at_lower else "upper"
            note, shown = f"at {side} bound: no standard error", None
            warnings.append(
                f"{v.name} is at its {side} bound: other errors are given it stays there"
            )
        elif v.name in unseen:
            note, shown = "not identifiable at the estimate", None
        row = Estimated(v.name, float(fit.x[i]), unit, False, shown, v.start, note)
        (states if is_state else parameters).append(row)
    for p in model.parameters.values():
        if p.value is not None and p.name not in criterion.names:
            parameters.append(Estimated(p.name, p.value, p.unit, True))
    if not rank.is_full:
        warnings.append(describe_null(rank))
    if not solution.is_converged:
        warnings.append(f"{solution.solver} stopped with {solution.status}: {solution.mend}")
    by_record: dict[str, dict[str, float]] = {}
    fits: dict[str, dict[str, float]] = {}
    white: dict[str, str] = {}
    for e, d in enumerate(criterion.data):
        at = criterion.simulated(fit.x, e)
        error_e = np.where(d.used, at.residual, np.nan)
        measured = np.where(d.used, d.y, np.nan)
        by_record[d.name] = dict(zip(criterion.outputs, rms(error_e).tolist(), strict=True))
        fits[d.name] = dict(
            zip(criterion.outputs, nrmse_fit(measured, error_e).tolist(), strict=True)
        )
        for i, name in enumerate(criterion.outputs):
            outside = whiteness(at.residual[d.used[:, i], i])
            where = f"{d.name}/{name}" if len(criterion.data) > 1 else name
            white[where] = f"whiteness: {outside} of 20 lags outside 95 %" + (
                "" if outside <= 3 else " (coloured: the model, or its noise, is not all)"
            )
    return Estimate(
        problem=problem.name,
        method=method
        or (
            "simulation error, "
            + (
                "single shooting"
                if criterion.segments == 1
                else f"multiple shooting ({criterion.segments})"
            )
        ),
        parameters=tuple(parameters),
        initial_states=tuple(states),
        covariance_names=criterion.names,
        covariance=covariance,
        assumes=ASSUMES.format(lags=lags),
        status=solution.status,
        is_converged=solution.is_converged,
        iterations=solution.iterations,
        scaled_gradient=solution.scaled_gradient,
        starts_tried=fit.starts_tried,
        starts_agreeing=fit.starts_agreeing,
        rmse=by_record,
        nrmse_fit=fits,
        held_out_rmse={
            h.name: dict(
                zip(criterion.outputs, rms(h.measured - h.simulated).tolist(), strict=True)
            )
            for h in held
        },
        held_out_fit={
            h.name: dict(
                zip(
                    criterion.outputs,
                    nrmse_fit(h.measured, h.measured - h.simulated).tolist(),
                    strict=True,
                )
            )
            for h in held
        },
        whiteness=white,
        identifiability=Identifiability(
            rank.rank, rank.unknowns, rank.smallest, "" if rank.is_full else describe_null(rank)
        ),
        units={name: unit for name, (_, unit) in model.outputs.items()},
        warnings=tuple(warnings),
        provenance=tuple(
            f"{e.name}: {line}" for e in criterion.experiments for line in e.record.provenance
        ),
        versions=versions(),
        sources=SOURCES,
    )


def versions() -> dict[str, str]:
    """Versions of what computed a result."""
    try:
        own = importlib.metadata.version("casid")
    except importlib.metadata.PackageNotFoundError:
        own = "not installed"
    return {
        "casid": own,
        "python": platform.python_version(),
        "casadi": importlib.metadata.version("casadi"),
        "numpy": str(np.__version__),
    }
