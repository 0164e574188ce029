"""The estimate of a fit: values, standard errors, measures of fit and provenance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.data.problem import Problem
from casid.data.quality import standing
from casid.data.record import Experiment
from casid.estimation.covariance import sandwich, whiteness
from casid.estimation.estimate import Estimate, Estimated, Identifiability
from casid.estimation.fit_statistics import nrmse_fit, rms
from casid.estimation.holdout import HeldOut
from casid.estimation.local_rank import describe_null, local_rank
from casid.estimation.simulation.simulation_error import Fit
from casid.model.model import Model
from casid.versions import versions

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


def standing_channels(model: Model, experiments: Sequence[Experiment]) -> list[str]:
    """Warnings of channels that rest or stand at a limit, inputs for a tenth of the record."""
    return [
        f"{e.name}: {f.channel}: {f.text} {f.mend}"
        for e in experiments
        for channels, least in ((model.inputs, 0.1), (model.outputs, 0.0))
        for f in standing(e.record, channels, least=least)
    ]


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
