"""A nonlinear program built once and solved for many values of its parameters.

Solver, derivatives and judging functions are CasADi functions that read and write fixed buffers: a
quadratic program in three variables takes little longer than Ipopt's own start-up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.nlp.program_values import at_start, fill, inside, views
from casid.estimation.nlp.solution import (
    Evaluation,
    Solution,
    account,
    judged,
    not_converged,
    not_finite,
)
from casid.estimation.nlp.solver import Solver, as_solver, gave_up, set_up


class _Buffered:
    """A CasADi function on arrays that it keeps, dense, columns one after another."""

    def __init__(
        self,
        function: Any,
        arguments: Mapping[str, Array],
        results: Mapping[str, Array] | None = None,
    ) -> None:
        self._function = function  # the buffer does not keep it alive
        self._buffer, self._call = function.buffer()
        self.arguments = dict(arguments)
        for name, array in self.arguments.items():
            self._buffer.set_arg(function.index_in(name), array.data)
        self.results = {
            name: (results or {}).get(name, np.zeros(function.nnz_out(i)))
            for i, name in enumerate(function.name_out())
        }
        for name, array in self.results.items():
            assert len(array) == function.nnz_out(name) == function.numel_out(name), name
            self._buffer.set_res(function.index_out(name), array.data)

    def __call__(self) -> None:
        self._call()

    def stats(self) -> Mapping[str, Any]:
        """The solver's own account of the last call."""
        try:
            return dict(self._buffer.stats())
        except RuntimeError:  # sqpmethod has no words for a QP that failed
            return {"return_status": "Subproblem_Failed", "iter_count": 0}


class Compiled:
    """What `Nlp.compile` returns: solve it for as many values of the parameters as there are data.

    It pickles (and is built again where it is opened); one object serves one thread at a time.

    The objective reaches the solver in units of its own curvature at the start, each constraint in
    units of its own slope there, so that the solver's tolerance means the same for every record.
    """

    def __init__(
        self,
        *,
        name: str,
        names: tuple[str, ...],
        parameters: Mapping[str, tuple[int, int]],
        function: Any,
        start: tuple[float, ...],
        lower: tuple[float, ...],
        upper: tuple[float, ...],
        scale: tuple[float, ...],
        constraints: tuple[str, ...],
        limits: tuple[tuple[float, float], ...],
        solver: Solver,
    ) -> None:
        self._state = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        self.name, self.names, self.constraints, self.solver = name, names, constraints, solver
        self.parameters = dict(parameters)  # rows and columns of each
        n, m = len(names), len(limits)
        try:  # scalar operations are evaluated several times faster
            function = function.expand()
        except RuntimeError:  # a callback, a rootfinder: stay with matrices
            pass
        self.function = function  # (x, p) -> (f, g), physical units
        self._start = np.array(start, dtype=float)
        self._scale = np.array(scale, dtype=float)
        lower_, upper_ = np.array(lower, dtype=float), np.array(upper, dtype=float)
        ends = np.array(limits, dtype=float).reshape(m, 2)
        self._box = (lower_, upper_, ends[:, 0].copy(), ends[:, 1].copy())

        symbol: Any = ca.SX if function.is_a("SXFunction") else ca.MX
        self._values = np.zeros(function.numel_in(1))
        self._windows = views(self.parameters, self._values)
        derivatives = _derivatives(function, symbol)
        self._curvature = _curvature(function, symbol)
        self._derivatives = _Buffered(derivatives, {"x": np.zeros(n), "p": self._values})

        size = len(self._values)
        z, p, unit, slope = (symbol.sym(*a) for a in (("z", n), ("p", size), ("u",), ("s", m)))
        f, g = function(self._scale * z, p)
        problem = {"x": z, "p": ca.vertcat(p, unit, slope), "f": f / unit, "g": g / slope}
        nlpsol = set_up(name, solver, problem, solver.nlpsol_options())
        arguments = {key: np.zeros(nlpsol.numel_in(key)) for key in nlpsol.name_in()}
        arguments["lbx"][:], arguments["ubx"][:] = lower_ / self._scale, upper_ / self._scale
        self._solver = _Buffered(nlpsol, arguments)
        self._counted = 0  # evaluations so far: CasADi's counters are never reset
        # The start is prepared, and the result judged, on the solver's own arrays.
        self._prepare = _Buffered(
            _preparation(derivatives, symbol, self._scale, self._box),
            {"x": np.zeros(n), "p": self._values},
            {key: arguments[key] for key in ("x0", "lbg", "ubg")} | {"units": arguments["p"]},
        )
        found = self._solver.results
        self._judge = _Buffered(
            _judgement(derivatives, symbol, self._scale, self._box),
            {"z": found["x"], "p": self._values, "lam": found["lam_g"], "units": arguments["p"]},
        )

    def __reduce__(self) -> Any:
        return _build, (self._state,)

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
        """What the solver sees as one (n,)."""
        return self._scale.copy()

    @property
    def box(self) -> tuple[Array, Array, Array, Array]:
        """Lower and upper bounds of the variables (n,), limits of the constraints (m,)."""
        return self._box

    def with_solver(self, solver: Solver | str) -> Compiled:
        """The same program for another solver."""
        return Compiled(**(self._state | {"solver": as_solver(solver)}))

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
        held = {*solution.at_lower, *solution.at_upper}
        free = np.array([name not in held for name in self.names])
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
        told = (solution.status, solution.iterations, solution.evaluations)
        found = judged(self.names, x, at, self._scale, self._box, told, solution.solver)
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
        return _evaluation(self._derivatives.results, len(self.names))

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
            need it: a solver's tolerance is relative to the start, not to what is left.

        Raises
        ------
        SolveError
            As `Nlp.solve`; a missing, misshapen or non-finite value always raises.
        """
        self.put(values or {})
        names, scale, (lower, upper, _, _) = self.names, self._scale, self._box
        x = self._start
        if start is not None:
            x = at_start(self.name, names, start, x)
            x = inside(self.name, names, x, lower, upper, scale)
        self._prepare.arguments["x"][:] = x
        self._prepare()
        if not math.isfinite(self._prepare.results["finite"][0]):
            raise not_finite(self.name, names, x)
        try:
            self._solver()
        except RuntimeError as error:
            raise gave_up(self.name, self.solver.name, error) from error
        self._judge()
        out, stats = self._judge.results, self._solver.stats()
        status, iterations, counted = account(stats)
        evaluations, self._counted = counted - self._counted, counted
        at, x = _evaluation(out, len(names)), out["x"].copy()
        size = float(out["scaled_gradient"][0])
        if size < _PROVEN and out["relative"][0] < _ROUNDING:
            held = out["held"].tolist()
            solution = Solution(
                names=names,
                x=x,
                value=at.value,
                status=status,
                iterations=iterations,
                scaled_gradient=size,
                constraint_violation=float(out["violation"][0]),
                at_lower=tuple(n for n, side in zip(names, held, strict=True) if int(side) & 1),
                at_upper=tuple(n for n, side in zip(names, held, strict=True) if int(side) & 2),
                hessian=at.hessian,
                constraint_jacobian=at.jacobian,
                solver=self.solver.name,
                evaluations=evaluations,
            )
        else:
            told = (status, iterations, evaluations)
            solution = judged(names, x, at, scale, self._box, told, self.solver.name)
            if polish and math.isfinite(solution.scaled_gradient):
                solution = self.polished(solution, out["pull"].copy())
        if throw and not solution.is_converged:
            raise not_converged(self.name, solution)
        return solution


# The solver's multipliers prove an optimum when the Lagrangian's gradient vanishes with them; where
# it does not (they are in another scaling, or missing) better ones are sought by least squares.
_PROVEN = 1e-10
_ROUNDING = 1e-14  # of a constraint, relative to the sum of its terms


def _evaluation(out: Mapping[str, Array], n: int) -> Evaluation:
    """Copies of the arrays that the derivatives were written to."""
    return Evaluation(
        float(out["f"][0]),
        out["gradient"].copy(),
        out["hessian"].reshape(n, n).copy(),
        out["g"].copy(),
        out["jacobian"].reshape(-1, n, order="F").copy(),
    )


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


_NAMES = ["f", "gradient", "hessian", "g", "jacobian"]


def _derivatives(function: Any, symbol: Any) -> Any:
    """(x, p) -> criterion, gradient, Hessian, constraints, their Jacobian; all dense."""
    x, p = (symbol.sym(name, function.numel_in(i)) for i, name in enumerate("xp"))
    f, g = function(x, p)
    hessian, gradient = ca.hessian(f, x)
    results = [ca.densify(e) for e in (f, gradient, hessian, g, ca.jacobian(g, x))]
    return ca.Function("derivatives", [x, p], results, ["x", "p"], _NAMES)


def _curvature(function: Any, symbol: Any) -> Any:
    """(x, p, lam) -> Hessian of the Lagrangian f + lam'g."""
    x, p = (symbol.sym(name, function.numel_in(i)) for i, name in enumerate("xp"))
    lam = symbol.sym("lam", function.numel_out(1))
    f, g = function(x, p)
    return ca.Function("curvature", [x, p, lam], [ca.densify(ca.hessian(f + lam.T @ g, x)[0])])


def _preparation(derivatives: Any, symbol: Any, scale: Array, box: Any) -> Any:
    """(x, p) -> what the solver begins with, and a number that is finite if f and gradient are."""
    x, p = (symbol.sym(name, derivatives.numel_in(i)) for i, name in enumerate("xp"))
    f, gradient, hessian, _, jacobian = derivatives(x, p)
    # The steepest is 100, where Ipopt's own scaling leaves off: less lets its barrier rule.
    unit = 1e-2 * ca.fmax(ca.norm_inf(gradient * scale), ca.norm_inf(ca.diag(hessian) * scale**2))
    slope = ca.vertcat(
        *[ca.mmax(ca.fabs(jacobian[i, :].T * scale)) for i in range(len(box[2]))], symbol(0, 1)
    )
    unit, slope = (ca.if_else((0 < e) * (e < np.inf), e, 1.0) for e in (unit, slope))
    return ca.Function(
        "preparation",
        [x, p],
        [
            x / scale,
            box[2] / slope,
            box[3] / slope,
            ca.vertcat(p, unit, slope),
            f + ca.sum1(gradient),
        ],
        ["x", "p"],
        ["x0", "lbg", "ubg", "units", "finite"],
    )


def _judgement(derivatives: Any, symbol: Any, scale: Array, box: Any) -> Any:
    """(z, p, lam, units) -> x, its derivatives and how far it is from an optimum.

    The measure is that of `nlp_solution`, with the solver's multipliers `lam` (m,) of the
    scaled program.
    """
    lower, upper, low, high = box
    n, m = len(scale), len(low)
    size = derivatives.numel_in(1)
    z, p, lam = symbol.sym("z", n), symbol.sym("p", size), symbol.sym("lam", m)
    units = symbol.sym("units", size + 1 + m)
    x = ca.fmin(ca.fmax(z * scale, lower), upper)
    f, gradient, hessian, g, jacobian = derivatives(x, p)
    h, weighs = ca.diag(hessian), ca.fmax(ca.fabs(x), scale)
    level = ca.fabs(f) + ca.norm_inf(gradient * weighs)
    safe = ca.if_else(level > 0, level, 1.0)
    curved = h * weighs**2 > 1e-12 * level
    root = ca.sqrt(ca.if_else(curved, h, 1.0))
    weight = ca.if_else(curved, 1 / root, weighs / ca.sqrt(safe))
    unit = ca.if_else(curved, ca.fmax(ca.sqrt(ca.fabs(f)), 1e-4 * root * weighs), ca.sqrt(safe))
    # Only a constraint at its limit has a multiplier, and it pushes inwards.
    tolerance = 1e-6 * ca.fmax(ca.mtimes(ca.fabs(jacobian), weighs), TINY)
    _, objective, rows = ca.vertsplit(units, [0, size, size + 1, size + 1 + m])
    pull = lam * objective / rows
    at_low, at_high = ca.fabs(low - g) < tolerance, ca.fabs(high - g) < tolerance
    pull = ca.if_else(
        low == high,
        pull,
        ca.if_else(at_low, ca.fmin(pull, 0.0), 0.0) + ca.if_else(at_high, ca.fmax(pull, 0.0), 0.0),
    )
    slope = (gradient + ca.mtimes(jacobian.T, pull)) * weight
    held_low, held_high = x <= lower + 1e-6 * scale, x >= upper - 1e-6 * scale
    slope = ca.if_else(held_low, ca.fmin(slope, 0.0), slope)
    slope = ca.if_else(held_high, ca.fmax(slope, 0.0), slope)
    concave = ca.mmax((h * weighs**2 < -1e-12 * level) * (1 - held_low) * (1 - held_high))
    violation = ca.mmax(ca.vertcat(0.0, low - g, g - high))
    relative = ca.mmax(ca.vertcat(0.0, (low - g) / tolerance, (g - high) / tolerance)) * 1e-6
    return ca.Function(
        "judgement",
        [z, p, lam, units],
        [
            *[ca.densify(e) for e in (x, f, gradient, hessian, g, jacobian)],
            ca.if_else(concave, np.inf, ca.norm_inf(slope / unit)),
            ca.densify(violation),
            ca.densify(relative),
            ca.densify(pull),
            ca.densify(held_low + 2 * held_high),
        ],
        ["z", "p", "lam", "units"],
        ["x", *_NAMES, "scaled_gradient", "violation", "relative", "pull", "held"],
    )


def _build(state: dict[str, Any]) -> Compiled:
    """A compiled program from what it was built of."""
    return Compiled(**state)
