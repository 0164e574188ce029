"""One estimation problem solved by every available solver, compared with a reference.

A solver agrees if each variable is within 1e-7 of the reference, relative. One that does not has a
row that says why: its own stopping rule, an approximate Hessian, another optimum, a failing
quadratic program, or that it is not installed.
"""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import TINY, Array
from casid.errors import CasidError, SolveError
from casid.estimation.nlp.comparison_table import Row, SolverComparison
from casid.estimation.nlp.compiled import Compiled
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.program_values import at_start, inside
from casid.estimation.nlp.scipy_solvers import Program, StackedProgram, run_scipy
from casid.estimation.nlp.solution import Solution, judged
from casid.estimation.nlp.solver import Solver
from casid.estimation.nlp.solver_catalogue import (
    DEFAULT,
    NULL_SPACE,
    SLSQP,
    TRUST_CONSTR,
    SolverEntry,
    entry_of,
)
from casid.estimation.nlp.solver_processes import Outcome, muted, run_apart, run_here, timed
from casid.linear.constrained_least_squares import null_space_least_squares

_FLAT = 1e-7  # resolutions of the criterion above this are mentioned
# A solver that ends so has a vanishing gradient, by its own measure.
_BY_GRADIENT = ("Solve_Succeeded", "Solved", "Converged with feasible KKT point", "optimal")
_FEASIBLE = 1e-6  # largest violation of a constraint, in its own units


@names_wrong_types()
def compare_solvers(
    nlp: Nlp,
    parameters: Mapping[str, Any] | None = None,
    solvers: Sequence[str | Solver] | str | Solver | None = None,
    reference: Mapping[str, float] | Solution | Sequence[float] | Array | None = None,
    *,
    start: Sequence[float] | Array | Mapping[str, float] | None = None,
    tolerance: float = 1e-7,
    timeout: float = 30.0,
) -> SolverComparison:
    """Solve one program with many solvers and compare each with a reference.

    Parameters
    ----------
    nlp : objective as a CasADi expression, or a `Criterion` (then the solvers that take its
        Gauss-Newton matrix run, in this process, and the others have a row that says so).
    parameters : values of the parameters that `nlp` declares.
    solvers : names ("ipopt", "sqpmethod/daqp", "uno", "scipy/SLSQP", "null-space QR", any plug-in
        of `casadi.nlpsol`) or `Solver` values, or one of these; by default those of the catalogue.
    reference : the answer, as values by name or in order; by default the closed form where
        constraints are linear and the objective quadratic, else the best optimum that any solver
        reached, polished by Newton steps on its optimality conditions.
    start : (n,) in order, or name -> value; by default the declared starts.
    tolerance : largest relative distance of a variable that counts as agreement.
    timeout : seconds after which a CasADi plug-in is stopped.

    Raises
    ------
    SolveError
        If values of parameters are missing or do not fit, the start does not, or the reference
        has other variables.
    """
    solvers = DEFAULT if solvers is None else solvers
    entries = [entry_of(s) for s in ([solvers] if isinstance(solvers, str | Solver) else solvers)]
    begin: Array | None = None
    if start is not None:
        begin = at_start(nlp.name, nlp.names, start, nlp.start)
        begin = inside(nlp.name, nlp.names, begin, *nlp.limits)
    program: Any
    if nlp.has_criterion:
        constraints = copy.copy(nlp)
        constraints.minimize(ca.MX(0))
        compiled = constraints.compile()
        compiled.put(parameters or {})
        program = StackedProgram(nlp.objective, compiled)
        outcomes = [_criterion_outcome(nlp, c, program, parameters, begin) for c in entries]
    else:
        compiled = program = nlp.compile()
        compiled.put(parameters or {})
        plug_ins = [c for c in entries if c.solver is not None]
        apart = run_apart(compiled, parameters or {}, begin, plug_ins, timeout)
        by_entry = {id(c): found for c, found in zip(plug_ins, apart, strict=True)}
        outcomes = [by_entry.get(id(c)) or _here(c, compiled, begin, nlp.names) for c in entries]
    answer, words = _reference(nlp, program, outcomes, reference, polish=not nlp.has_criterion)
    objective = math.nan if answer is None else program.evaluate(answer).value
    rows = tuple(
        _row(c, found, answer, objective, program, tolerance)
        for c, found in zip(entries, outcomes, strict=True)
    )
    return SolverComparison(nlp.name, nlp.names, rows, answer, words, objective, tolerance)


# One solver


def _here(
    entry: SolverEntry, program: Program, start: Array | None, names: tuple[str, ...]
) -> Outcome:
    """SciPy's methods and the closed form, in this process."""
    try:
        if entry.name == NULL_SPACE:
            assert isinstance(program, Compiled)
            found = timed(lambda: _closed_form(program))
        else:
            with muted(), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the row reports it
                found = run_scipy(entry.name, names, program, start)
        return Outcome(entry.name, *found)
    except _DoesNotFitError as error:
        return _does_not_fit(entry, str(error))
    except CasidError as error:
        return Outcome(entry.name, reason=str(error).partition(": ")[2] or str(error))
    except Exception as error:
        return Outcome(entry.name, reason=f"{type(error).__name__}: {error}")


class _DoesNotFitError(SolveError):
    """A solver cannot run, because the problem is of another kind."""


def _does_not_fit(entry: SolverEntry, why: str) -> Outcome:
    return Outcome(entry.name, reason=why, kind="Does_Not_Fit")


def _closed_form(compiled: Compiled) -> Solution:
    """The constrained least-squares problem behind a quadratic program, solved by null space."""
    function = compiled.function
    symbol: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    x, p = (symbol.sym(name, function.numel_in(i)) for i, name in enumerate("xp"))
    f, g = function(x, p)
    if not ca.is_quadratic(f, x):
        raise _DoesNotFitError("the objective is not quadratic")
    if not ca.is_linear(g, x):
        raise _DoesNotFitError("a constraint is not linear")
    lower, upper, low, high = compiled.box
    equality = low == high
    scale = compiled.scale
    at = compiled.evaluate(np.zeros(len(scale)))
    H = at.hessian * np.outer(scale, scale)
    try:
        root = np.linalg.cholesky(H).T  # H = root' root: regressors with these moments
    except np.linalg.LinAlgError:
        raise _DoesNotFitError("the Hessian is not positive definite") from None
    z = null_space_least_squares(
        root,
        -np.linalg.solve(root.T, at.gradient * scale),
        (at.jacobian * scale)[equality],
        (low - at.constraints)[equality],
    )
    x = z * scale
    g_at = compiled.evaluate(x).constraints[~equality]
    inside = np.all((x >= lower) & (x <= upper)) and np.all(
        (g_at >= low[~equality]) & (g_at <= high[~equality])
    )
    if not inside:
        raise _DoesNotFitError("a bound or inequality is active, it takes equalities alone")
    ending = ("Closed_Form", 0, 0)
    return judged(compiled.names, x, compiled.evaluate(x), scale, compiled.box, ending, NULL_SPACE)


def _criterion_outcome(
    nlp: Nlp,
    entry: SolverEntry,
    program: StackedProgram,
    parameters: Mapping[str, Any] | None,
    start: Array | None,
) -> Outcome:
    """A solver on a criterion that is no expression, in this process."""
    if entry.name in (TRUST_CONSTR, SLSQP):
        return _here(entry, program, start, nlp.names)
    if entry.solver is None:
        return _does_not_fit(entry, "does not fit: the objective is no quadratic expression")
    if entry.polish:
        return _does_not_fit(entry, "does not fit: Newton steps need an expression")
    if not entry.takes_criterion:
        return _does_not_fit(entry, "does not fit: it takes no Hessian but its own")

    def solve(solver: Solver) -> tuple[Solution, float]:
        """The solution by one solver, and the seconds that it took."""
        return timed(
            lambda: nlp.solve(
                solver,
                None if start is None else start.tolist(),
                parameters=parameters,
                throw=False,
                natural_scales=True,
            ),
            repeats=1,
        )

    with muted():
        return run_here(entry.name, entry.solver, solve)


# The reference, and the distance to it


def _reference(
    nlp: Nlp,
    program: Program,
    outcomes: Sequence[Outcome],
    given: Any,
    *,
    polish: bool,
) -> tuple[Array | None, str]:
    """The answer to compare with, and where it is from."""
    if given is not None:
        if isinstance(given, Mapping):
            if given.keys() != set(nlp.names):
                raise SolveError(
                    f"{nlp.name}: the reference has {', '.join(given)}; give {', '.join(nlp.names)}"
                )
            given = [given[name] for name in nlp.names]
        answer = np.array(given.x if isinstance(given, Solution) else given, dtype=float).ravel()
        if len(answer) != len(nlp.names):
            raise SolveError(
                f"{nlp.name}: the reference has {len(answer)} values for {len(nlp.names)} "
                f"variables; give one for each of {', '.join(nlp.names)}"
            )
        return answer, "given"
    solved = [
        (o.solution, o.name)
        for o in outcomes
        if o.solution is not None
        and np.isfinite(o.solution.value)
        and o.solution.constraint_violation < _FEASIBLE
    ]
    for solution, name in solved:
        if name == NULL_SPACE:
            return solution.x, "closed form (null-space QR)"
    optima = [entry for entry in solved if entry[0].is_converged] or solved
    if not optima:
        return None, "none: no solver met the constraints"
    lowest = min(solution.value for solution, _ in optima)
    # Of those in the deepest valley the one with the smallest gradient.
    near = [e for e in optima if e[0].value <= lowest + 1e-6 * abs(lowest) + TINY]
    best, name = min(near, key=lambda entry: entry[0].scaled_gradient)
    words = f"best optimum ({name})"
    if polish and isinstance(program, Compiled):
        found = program.polished(best, _multipliers(program, best))
        if found is not best:
            best, words = found, f"{words}, polished by Newton steps"
    return best.x, f"{words}, scaled gradient {best.scaled_gradient:.0e}"


def _multipliers(program: Program, solution: Solution) -> Array:
    """Multipliers of the constraints at their limits, by least squares; of the right sign only."""
    _, _, low, high = program.box
    at = program.evaluate(solution.x)
    size = np.maximum(np.abs(solution.x), program.scale)
    near = 1e-6 * np.maximum(np.abs(at.jacobian) @ size, TINY)
    at_low, at_high = np.abs(at.constraints - low) < near, np.abs(at.constraints - high) < near
    free = solution.is_free
    lam = np.zeros(len(low))
    active = np.flatnonzero((low == high) | at_low | at_high)
    if len(active) and free.any():
        weight = size[free]
        rows = at.jacobian[active][:, free] * weight
        lam[active] = np.linalg.lstsq(rows.T, -at.gradient[free] * weight, rcond=None)[0]
    wrong = (low != high) & ((at_low & (lam > 0)) | (at_high & (lam < 0)))
    return np.where(wrong, 0.0, lam)


def _row(
    entry: SolverEntry,
    found: Outcome,
    reference: Array | None,
    objective: float,
    program: Program,
    tolerance: float,
) -> Row:
    """An outcome as a row: how far, and why."""
    solution = found.solution
    if solution is None:
        nan = math.nan
        return Row(entry.name, found.kind, nan, nan, nan, nan, 0, 0, nan, None, False, found.reason)
    distance = math.nan
    if reference is not None:
        tiny = 1e-9 * program.scale  # a variable at zero is measured by what it was declared to be
        unit = np.where(np.abs(reference) > tiny, np.abs(reference), program.scale)
        distance = float(np.max(np.abs(solution.x - reference) / unit, initial=0.0))
    is_feasible = solution.constraint_violation < _FEASIBLE
    agrees = bool(distance <= tolerance and is_feasible)
    return Row(
        solver=entry.name,
        status=solution.status,
        objective=solution.value,
        violation=solution.constraint_violation,
        distance=distance,
        scaled_gradient=solution.scaled_gradient,
        iterations=solution.iterations,
        evaluations=solution.evaluations,
        seconds=found.seconds,
        x=solution.x,
        agrees=agrees,
        reason=""
        if agrees
        else _reason(entry, solution, objective, is_feasible, _resolution(program, solution.x)),
    )


def _resolution(program: Program, x: Array) -> float:
    """The scaled gradient below which steps change the criterion by less than its rounding error.

    A criterion made of moments is a small difference of large terms. Its error is what it scatters
    by when the variables change in their last digits, where it should not change at all.
    """
    rng = np.random.default_rng(0)
    near = [x * (1 + 4e-16 * rng.integers(-4, 5, len(x))) for _ in range(24)]
    values = np.array([program.evaluate(point).value for point in near])
    level = max(abs(float(np.mean(values))), TINY)
    return float(np.sqrt(2 * np.std(values) / level))


def _reason(
    entry: SolverEntry,
    solution: Solution,
    objective: float,
    is_feasible: bool,
    resolution: float,
) -> str:
    """Why a solver's answer is not the reference."""
    if not is_feasible:
        size = f"{solution.constraint_violation:.1e}"
        if math.isfinite(objective):
            return f"does not meet the constraints (violation {size}): {solution.remedy}"
        return (
            f"constraints violated by {size}, and every solver violates them: they contradict each "
            "other, at least near the start; drop one, or start elsewhere"
        )
    excess = (solution.value - objective) / max(abs(objective), TINY)
    gradient = f"scaled gradient {solution.scaled_gradient:.0e}"
    if solution.is_converged and excess > 1e-6:
        return f"another stationary point: its criterion exceeds the best by {excess:.2g} of it"
    if solution.is_converged and excess < -1e-6:
        return f"a better point than the reference: its criterion is {-excess:.2g} lower"
    if "iteration" in solution.status.lower() or solution.status == "Limit_Reached":
        return f"its limit of iterations was reached, {gradient}; {entry.rule}"
    goes_by_gradient = solution.status in _BY_GRADIENT and entry.name not in (TRUST_CONSTR, SLSQP)
    if not goes_by_gradient and _FLAT < resolution and solution.scaled_gradient < 10 * resolution:
        return (
            f"stopped in the rounding error of the criterion (scaled gradients below "
            f"{resolution:.0e} do not show in its value), {gradient}; {entry.rule}"
        )
    if solution.is_converged:
        return f"stopped by its own rule, {gradient}, criterion {excess:.0e} off; {entry.rule}"
    return f"stopped early ({solution.status}), {gradient}; {entry.rule}"
