"""Instruments of a declared reference in the place of least squares that feedback or noise biases.

Least squares of the simulation error is the better of the two where it is consistent: it uses all
that drives the system, instruments what the reference drives. Where it is not, instruments made of
a signal that nothing in the experiment affects are consistent all the same (Linder 2017, (2.44)).
Only the user knows of such a signal. The record can contradict it, where moments contradict one
another; whether past outputs predict a reference says little of one that follows a schedule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.errors import CasidError, OutOfTimeError
from casid.estimation.covariance import sandwich
from casid.estimation.errors_in_variables.removal import Corrected
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.prediction_error.disturbances import rest_of
from casid.estimation.simulation.simulation_error import SimulationError
from casid.identification.moment_estimators import instrumental_variables
from casid.model.model import Model
from casid.model.quantities import p_statement

LEVEL = 0.01
"""Of the test of overidentification: a p-value below it contradicts the reference."""
STEPS = 5
"""Gauss-Newton steps of the initial states, at most; of a linear model the first is exact."""


def instrumented(
    problem: Problem, found: Corrected, experiments: Sequence[Experiment]
) -> Corrected:
    """The estimate by instruments of the problem's reference; why there is none, in `refused`.

    Parameters
    ----------
    problem : with an `external` signal.
    found : what least squares gave, in SI, as the problem is.
    """
    usable = [n for n in problem.external if all(n in e.record for e in experiments)]
    if not usable:
        return replace(found, refused=f"{problem.external[0]} is not in every record")
    name = usable[0]
    reason = _unsuited(problem, found, experiments, name)
    if reason:
        return replace(found, refused=reason)
    settings = MomentSettings(method=_method(problem.model))
    try:
        moments = instrumental_variables(problem, experiments, Instruments(name), settings=settings)
    except OutOfTimeError:
        raise
    except CasidError as error:
        return replace(found, refused=f"they give no estimate: {error}")
    p = moments.propagated.p_value
    if p < LEVEL:
        why = f"moments of {name} contradict one another ({p_statement(p, '.1g')})"
        return replace(found, refused=why)
    at_bound = [q.name for q in moments.parameters if not q.known and q.std_error is None]
    if at_bound:
        return replace(found, refused=f"{at_bound[0]} is at a bound")
    return _with_initial_states(found, moments, name)


def _unsuited(
    problem: Problem, found: Corrected, experiments: Sequence[Experiment], name: str
) -> str:
    """Why no instruments can be made of a reference; empty where they can."""
    criterion = found.fit.criterion
    if criterion.segments > 1 or criterion.own or found.fit.solution.constraint_jacobian.size:
        return "it is fitted in segments, under constraints, or with parameters of each record"
    if rest_of(problem.model) is None:
        return "the model is not linear"
    for e in experiments:
        gaps = [n for n, mask in e.record.missing.items() if mask.any()]
        used = {name, *problem.model.inputs, *problem.model.outputs}
        if e.filled or used & set(gaps):
            return "samples are missing"
    return ""


def _method(model: Model) -> str:
    """The discretisation that is exact for the model's inputs, where they are all alike."""
    holds = {u.hold for u in model.inputs.values() if u.kind != "generated"}
    return next(iter(holds)) if holds in ({"zoh"}, {"foh"}) else "bilinear"


def _with_initial_states(found: Corrected, moments: MomentEstimate, name: str) -> Corrected:
    """The fit at the values of the moments, with the initial states that then fit best."""
    fit, criterion = found.fit, found.fit.criterion
    place = {n: i for i, n in enumerate(criterion.names)}
    index = np.array([place[n] for n in moments.names])
    states = np.setdiff1d(np.arange(len(fit.x)), index)
    x = fit.x.copy()
    x[index] = [moments[n] for n in moments.names]
    for _ in range(STEPS if len(states) else 0):
        r, t = _stacked(criterion, x)
        move = np.linalg.lstsq(t[:, states], r, rcond=None)[0]
        x[states] += move
        if np.all(np.abs(move) <= 1e-6 * np.maximum(np.abs(x[states]), TINY)):
            break
    out, C = np.zeros((len(x), len(x))), moments.covariance
    out[np.ix_(index, index)] = C
    if len(states):
        _, t = _stacked(criterion, x)
        moved = -np.linalg.lstsq(t[:, states], t[:, index], rcond=None)[0]
        free = np.isin(np.arange(len(x)), states)
        at = criterion.evaluate(x)
        own = sandwich(at.hessian, criterion.scores(x), free)[0][np.ix_(states, states)]
        out[np.ix_(states, states)] = own + moved @ C @ moved.T
        out[np.ix_(states, index)] = moved @ C
        out[np.ix_(index, states)] = (moved @ C).T
    apart = np.abs(x - fit.x)[index] / np.sqrt(np.maximum(np.diag(C), TINY))
    worst = int(np.argmax(apart))
    lower, upper = (
        tuple(n for n in held if n not in moments.names)
        for held in (fit.solution.at_lower, fit.solution.at_upper)
    )
    return replace(
        found,
        fit=replace(fit, solution=replace(fit.solution, x=x, at_lower=lower, at_upper=upper)),
        covariance=out,
        reference=name,
        apart=(moments.names[worst], float(apart[worst])),
        why_not="",
        whiten=None,
    )


def _stacked(criterion: SimulationError, x: Array) -> tuple[Array, Array]:
    """Weighted residuals (M,) and sensitivities (M, n) of all records."""
    parts = [criterion.columns(x, e) for e in range(len(criterion.data))]
    n = len(x)
    return (
        np.concatenate([r.ravel() for r, _ in parts]),
        np.concatenate([t.reshape(-1, n) for _, t in parts]),
    )
