"""A nonlinear program built once and solved for many values of its parameters.

Solver, derivatives and judging functions are CasADi functions that read and write fixed buffers: a
quadratic program in three variables takes little longer than Ipopt's own start-up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.nlp.buffered_functions import (
    Buffered,
    curvature_of,
    derivatives_of,
    evaluation_of,
    optimality_of,
    preparation_of,
)
from casid.estimation.nlp.program_values import at_start, fill, inside, views
from casid.estimation.nlp.solution import (
    Evaluation,
    Solution,
    account,
    assembled,
    judged,
    not_converged,
    not_finite,
)
from casid.estimation.nlp.solver import Solver, as_solver, gave_up, set_up


@dataclass(frozen=True, slots=True, eq=False)
class Statement:
    """A nonlinear program in physical units: what is minimised, under which limits."""

    name: str
    names: tuple[str, ...]  # of the variables
    parameters: Mapping[str, tuple[int, int]]  # rows and columns of each
    function: Any  # (x, p) -> (f, g)
    start: tuple[float, ...]
    bounds: tuple[tuple[float, float], ...]  # of the variables
    scale: tuple[float, ...]
    constraints: tuple[str, ...]
    limits: tuple[tuple[float, float], ...]  # of the constraints


class Compiled:
    """What `Nlp.compile` returns: solve it for as many values of the parameters as there are data.

    It pickles (and is built again where it is opened); one object serves one thread at a time.

    The objective reaches the solver in units of its own curvature at the start, each constraint in
    units of its own slope there, so that the solver's tolerance means the same for every record.
    """

    def __init__(self, statement: Statement, solver: Solver) -> None:
        self._statement, self.solver = statement, solver
        self.name, self.names = statement.name, statement.names
        self.constraints, function = statement.constraints, statement.function
        self.parameters = dict(statement.parameters)  # rows and columns of each
        n, m = len(statement.names), len(statement.limits)
        try:  # scalar operations are evaluated several times faster
            function = function.expand()
        except RuntimeError:  # a callback, a rootfinder: stay with matrices
            pass
        self.function = function  # (x, p) -> (f, g), physical units
        self._start = np.array(statement.start, dtype=float)
        self._scale = np.array(statement.scale, dtype=float)
        sides = np.array(statement.bounds, dtype=float).reshape(n, 2)
        ends = np.array(statement.limits, dtype=float).reshape(m, 2)
        self._box = (*sides.T.copy(), *ends.T.copy())

        symbol: Any = ca.SX if function.is_a("SXFunction") else ca.MX
        self._values = np.zeros(function.numel_in(1))
        self._windows = views(self.parameters, self._values)
        derivatives = derivatives_of(function, symbol)
        self._curvature = curvature_of(function, symbol)
        self._derivatives = Buffered(derivatives, {"x": np.zeros(n), "p": self._values})

        size = len(self._values)
        z, p, unit, slope = (symbol.sym(*a) for a in (("z", n), ("p", size), ("u",), ("s", m)))
        f, g = function(self._scale * z, p)
        problem = {"x": z, "p": ca.vertcat(p, unit, slope), "f": f / unit, "g": g / slope}
        nlpsol = set_up(self.name, solver, problem, solver.nlpsol_options())
        arguments = {key: np.zeros(nlpsol.numel_in(key)) for key in nlpsol.name_in()}
        arguments["lbx"][:], arguments["ubx"][:] = (side / self._scale for side in self._box[:2])
        self._solver = Buffered(nlpsol, arguments)
        self._counted = 0  # evaluations so far: CasADi's counters are never reset
        # The start is prepared, and the result judged, on the solver's own arrays.
        self._prepare = Buffered(
            preparation_of(derivatives, symbol, self._scale, self._box),
            {"x": np.zeros(n), "p": self._values},
            {key: arguments[key] for key in ("x0", "lbg", "ubg")} | {"units": arguments["p"]},
        )
        found = self._solver.results
        self._optimality = Buffered(
            optimality_of(derivatives, symbol, self._scale, self._box),
            {"z": found["x"], "p": self._values, "lam": found["lam_g"], "units": arguments["p"]},
        )

    def __reduce__(self) -> Any:
        return Compiled, (self._statement, self.solver)

    def __repr__(self) -> str:
        given = ", ".join(f"{k} {r}x{c}" for k, (r, c) in self.parameters.items())
        return (
            f"<Compiled {self.name}: {len(self.names)} variables, {len(self.constraints)} "
            f"constraints, parameters {given or 'none'}, {self.solver.name}>"
        )

    @property
    def start(self) -> Array:
        """The declared starts (n,)."""
        return self._start.copy()

    @property
    def scale(self) -> Array:
        """Units (n,) of the solver's variables."""
        return self._scale.copy()

    @property
    def box(self) -> tuple[Array, Array, Array, Array]:
        """Lower and upper bounds of the variables (n,), limits of the constraints (m,)."""
        return self._box

    def with_solver(self, solver: Solver | str) -> Compiled:
        """The program for another solver."""
        return Compiled(self._statement, as_solver(solver))

    def put(self, values: Mapping[str, Any]) -> None:
        """Give the parameters values, without solving.

        Raises
        ------
        SolveError
            If a value is missing, unknown, not finite or of another shape than was declared.
        """
        fill(self.name, self._windows, values, self._values)

    def lagrangian_hessian(self, x: Array, lam: Array) -> Array:
        """Hessian (n, n) of f + lam'g at `x` (n,), `lam` (m,), at the last values given."""
        return np.array(self._curvature(x, self._values, lam))

    def polished(self, solution: Solution, lam: Array | None = None) -> Solution:
        """The better one of `solution` and what Newton steps lead to from there.

        A step solves the optimality conditions, linearised, for the variables that no bound holds
        and the constraints at their limits; steps go on while each is less than half the one
        before. `lam` (m,) are the multipliers to begin with; without them equalities alone count as
        active.
        """
        lower, upper, low, high = self._box
        lam = np.zeros(len(low)) if lam is None else lam
        free = solution.is_free
        active = np.flatnonzero((low == high) | (lam != 0))
        limit = np.where(lam > 0, high, low)[active]
        x, last = solution.x, np.inf
        at = self.evaluate(x)
        for _ in range(6):
            W = self.lagrangian_hessian(x, lam)[np.ix_(free, free)]
            A = at.jacobian[active][:, free]
            size = np.maximum(np.abs(x), self._scale)[free]
            step = _newton_step(W, A, at.gradient[free], at.constraints[active] - limit, size)
            if step is None:
                break
            length = np.max(np.abs(step[: len(W)]) / size, initial=0.0)
            if length > 0.5 * last:
                break
            x, lam, last = x.copy(), np.zeros(len(low)), length
            x[free] += step[: len(W)]
            lam[active] = step[len(W) :]
            x = np.minimum(np.maximum(x, lower), upper)
            at = self.evaluate(x)
            if length < 1e-15:
                break
        ending = (solution.status, solution.iterations, solution.evaluations)
        found = judged(self.names, x, at, self._scale, self._box, ending, solution.solver)
        is_better = (
            found.scaled_gradient <= max(solution.scaled_gradient, _PROVEN)
            and found.constraint_violation <= max(solution.constraint_violation, 1e-12)
            and np.isfinite(x).all()
        )
        return found if is_better else solution

    def evaluate(self, x: Array) -> Evaluation:
        """Criterion, constraints and their derivatives at `x` (n,), at the last values given."""
        self._derivatives.arguments["x"][:] = x
        self._derivatives()
        return evaluation_of(self._derivatives.results, len(self.names))

    def solve(
        self,
        values: Mapping[str, Any] | None = None,
        start: Sequence[float] | Array | Mapping[str, float] | None = None,
        *,
        throw: bool = True,
        polish: bool = True,
    ) -> Solution:
        """Solve for these values of the parameters, from `start` or the declared starts.

        Parameters
        ----------
        values : one array of the declared shape for each parameter, physical units; vectors may
            have shape (rows,). A program without parameters needs none.
        start : (n,) in order, or name -> value; what is not named keeps its declared start.
        polish : where the solver stops short of 1e-10 in the scaled gradient, take Newton steps on
            the optimality conditions of the limits that it found active. Data with little noise
            need it: a solver's tolerance is relative to the start, not to the residual.

        Raises
        ------
        SolveError
            As `Nlp.solve`; a missing, misshapen or non-finite value always raises.
        """
        self.put(values or {})
        self._begin(start)
        try:
            self._solver()
        except RuntimeError as error:
            raise gave_up(self.name, self.solver.name, error) from error
        solution = self._found(polish)
        if throw and not solution.is_converged:
            raise not_converged(self.name, solution)
        return solution

    def _begin(self, start: Sequence[float] | Array | Mapping[str, float] | None) -> None:
        """Prepare the solver's arguments for a start."""
        x, (lower, upper, _, _) = self._start, self._box
        if start is not None:
            x = at_start(self.name, self.names, start, x)
            x = inside(self.name, self.names, x, lower, upper, self._scale)
        self._prepare.arguments["x"][:] = x
        self._prepare()
        if not math.isfinite(self._prepare.results["finite"][0]):
            raise not_finite(self.name, self.names, x)

    def _found(self, polish: bool) -> Solution:
        """The point where the solver stopped, judged and where need be polished."""
        self._optimality()
        out, names = self._optimality.results, self.names
        status, iterations, counted = account(self._solver.stats())
        evaluations, self._counted = counted - self._counted, counted
        at, x = evaluation_of(out, len(names)), out["x"].copy()
        size = float(out["scaled_gradient"][0])
        ending = (status, iterations, evaluations)
        if size < _PROVEN and out["relative"][0] < _ROUNDING:
            optimality = size, float(out["violation"][0])
            sides = out["held"].astype(int)
            held = (sides & 1) > 0, (sides & 2) > 0
            return assembled(names, x, at, optimality, held, ending, self.solver.name)
        solution = judged(names, x, at, self._scale, self._box, ending, self.solver.name)
        if polish and math.isfinite(solution.scaled_gradient):
            solution = self.polished(solution, out["pull"].copy())
        return solution


# The solver's multipliers prove an optimum when the Lagrangian's gradient vanishes with them; where
# it does not (they are in another scaling, or missing) better ones are sought by least squares.
_PROVEN = 1e-10
_ROUNDING = 1e-14  # of a constraint, relative to the sum of its terms


def _newton_step(W: Array, A: Array, gradient: Array, g: Array, size: Array) -> Array | None:
    """Step of the variables and new multipliers (n + m,), None where the system is singular.

    W (n, n) is the Hessian of the Lagrangian, A (m, n) the Jacobian of the active constraints g;
    `size` (n,) is what the variables weigh.
    """
    n = len(size)
    W, A = W * np.outer(size, size), A * size
    unit, rows = np.abs(W).max(initial=0.0), np.abs(A).max(axis=1, initial=0.0)
    if not (unit > 0 and rows.all()):
        return None
    A = A / rows[:, None]
    kkt = np.block([[W / unit, A.T], [A, np.zeros((len(rows), len(rows)))]])
    try:
        step: Array = -np.linalg.solve(kkt, np.r_[gradient * size / unit, g / rows])
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(step).all():
        return None
    step = np.r_[step[:n] * size, step[n:] * unit / rows]
    return step
