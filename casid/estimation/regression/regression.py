"""Nonlinear regression of one response on measured columns, with bounds and constraints.

The criterion is V(theta) = 1/2 sum_k r_k(theta)^2. It is stated as an `Nlp` and solved twice:
with the exact Hessian J'J + sum r_k r_k'', which survives poor starts and large residuals, and with
the Gauss-Newton matrix J'J, which does not follow directions of negative curvature out to infinity.
Neither wins everywhere, so both optima are polished and the lower one is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from casid.argument_types import names_wrong_types
from casid.errors import IdentifiabilityError, ModelError, SolveError
from casid.estimation.nlp.solver import Solver
from casid.estimation.regression.regression_estimate import (
    Attempt,
    Optimum,
    RegressionEstimate,
    Residuals,
)
from casid.estimation.regression.regression_point import RegressionPoint, polished
from casid.estimation.regression.regression_problem import RegressionProblem

HESSIANS = ("exact", "gauss-newton")


@names_wrong_types()
def regress(
    model: str | tuple[Any, Any],
    data: Mapping[str, Any],
    start: Mapping[str, float],
    *,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    known: Mapping[str, float] | None = None,
    constraints: Sequence[str] = (),
    solver: Solver | None = None,
    hessians: Sequence[str] = HESSIANS,
) -> RegressionEstimate:
    """Estimate the parameters of ``response ~ prediction`` by least squares.

    Parameters
    ----------
    model : text such as ``"y ~ b1*(1 - exp(-b2*x))"`` or ``"log(y) ~ b1 - b2*x"`` (see
        `parse`), or the two sides as a pair of CasADi expressions whose symbols
        carry the names of parameters and columns.
    data : column name -> (N,) array; columns the model does not name are left alone.
    start : parameter name -> start value; these are the parameters estimated.
    bounds : parameter name -> (lower, upper), None for an open side.
    known : name -> value of a parameter that is not estimated.
    constraints : texts such as ``"b1 + b2 = 1"`` or ``"b1*b2 <= 3"`` in parameters and known names.
    solver : default ``Solver("ipopt")``.
    hessians : which Hessians to try, out of `HESSIANS`; the lowest optimum is kept, the first of
        equals.

    Raises
    ------
    ModelError
        If the model cannot be read, or a name is unknown, declared twice or unused.
    DataError
        If columns differ in length, hold non-finite numbers, or are fewer than the parameters.
    SolveError
        If the start is outside the bounds, or no attempt reaches an optimum.
    IdentifiabilityError
        If J has not full rank at the optimum; names the combination that the data do not determine.

    Notes
    -----
    An optimum is judged by the relative offset (Bates & Watts 1981), not by the solver's status. A
    local method finds a local optimum: compare several starts where that matters.

    Example
    -------
    >>> import casid
    >>> import numpy as np
    >>> t = np.arange(6.0)
    >>> data = {"y": 3 * np.exp(-0.5 * t), "t": t}
    >>> fit = casid.regress("y ~ a*exp(-b*t)", data, {"a": 1, "b": 1})
    >>> round(fit["b"], 9)
    0.5
    """
    problem = RegressionProblem(model, data, start, bounds or {}, known or {}, constraints)
    solver = solver or Solver()
    unknown = [h for h in hessians if h not in HESSIANS]
    if unknown or not hessians:
        raise ModelError(
            f"regression: hessians={tuple(hessians)!r}; choose one or both of {HESSIANS}"
        )
    attempts, points, failures = [], [], []
    for hessian in hessians:
        try:
            solution = problem.nlp(exact=hessian == "exact").solve(solver, throw=False)
        except SolveError as error:
            failures.append(error)
            attempts.append(Attempt(hessian, str(error), 0, float("inf"), False))
            continue
        point = polished(problem, solution.x)
        points.append((point, len(attempts)))
        attempts.append(
            Attempt(hessian, solution.status, solution.iterations, point.rss, point.is_optimum)
        )
    if not points:
        raise failures[0]
    return _estimate(problem, points, tuple(attempts), solver)


def _estimate(
    problem: RegressionProblem,
    points: list[tuple[RegressionPoint, int]],
    attempts: tuple[Attempt, ...],
    solver: Solver,
) -> RegressionEstimate:
    """The lowest optimum with its uncertainty; `points` with the number of the attempt of each."""
    best, chosen = _lowest_optimum(problem.name, points, attempts)
    notes = []
    lower = [a for a in attempts if not a.is_optimum and a.rss < best.rss * (1 - 1e-6)]
    if lower:
        notes.append(
            f"a lower rss ({lower[0].rss:.6g}) was seen at a point that is no optimum: "
            "try other starts or bounds"
        )
    if best.dof <= 0:
        notes.append("as many parameters as data: no standard errors")
    best.average_rounding()
    covariance = best.covariance()
    std_errors = np.sqrt(np.diag(covariance))
    for array in (best.theta, std_errors, covariance, problem.start, best.singular_values, best.r):
        array.flags.writeable = False
    bound = [name for name, held in zip(problem.parameters, best.held, strict=True) if held]
    return RegressionEstimate(
        model=problem.name,
        parameters=problem.parameters,
        values=best.theta,
        std_errors=std_errors,
        covariance=covariance,
        start=problem.start,
        fit=Residuals(best.r, best.rss, best.dof),
        optimum=Optimum(
            attempts[chosen],
            solver.name,
            best.offset,
            best.violation,
            tuple(bound),
            best.rank,
            best.singular_values,
        ),
        attempts=attempts,
        notes=tuple(notes),
        _predict=partial(problem.predict, best.theta),
    )


def _lowest_optimum(
    model: str, points: list[tuple[RegressionPoint, int]], attempts: tuple[Attempt, ...]
) -> tuple[RegressionPoint, int]:
    """The optimum of the smallest sum of squares, or a refusal."""
    stationary = [(p, i) for p, i in points if p.is_stationary]
    if not stationary:
        best = min((p for p, _ in points), key=lambda p: p.rss)
        tried = "; ".join(f"{a.hessian}: {a.status}" for a in attempts)
        deficient = f" {best.deficiency()}" if best.is_usable and best.is_deficient else ""
        raise SolveError(
            f"{model}: no optimum reached ({tried}; relative offset {best.offset:.1e}, "
            f"constraint violation {best.violation:.1e}).{deficient} Start nearer to the "
            "solution, bound the parameters, or raise max_iterations."
        )
    # Equal up to rounding is the same optimum, and then the sharper one is taken.
    lowest = min((p for p, _ in stationary), key=lambda p: p.rss)
    slack = 10 * lowest.rounding * (np.sqrt(lowest.rss) + lowest.rounding)
    equal = [(p, i) for p, i in stationary if p.rss <= lowest.rss * (1 + 1e-10) + slack]
    best, chosen = min(equal, key=lambda p: (p[0].is_deficient, p[0].offset))
    if best.is_deficient:
        full = [p for p, _ in stationary if not p.is_deficient]
        other = f" Another optimum has rss {full[0].rss:g} against {best.rss:g}." if full else ""
        raise IdentifiabilityError(f"{model}: {best.deficiency()}{other}")
    return best, chosen
