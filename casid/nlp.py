"""Nonlinear programs with named, scaled variables, bounds and constraints.

Every estimator of casid states its problem here and hands it to a solver, which is a value:
``Solver("ipopt")`` by default, any other CasADi ``nlpsol`` plug-in by name. An objective is either
a CasADi expression (exact derivatives) or a `Criterion`, a Python object whose value, gradient and
Gauss-Newton matrix come from one pass over the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casid.errors import SolveError

Array = NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """A criterion, its derivatives and its own constraints at one point."""

    value: float
    gradient: Array  # (n,)
    hessian: Array  # (n, n), Gauss-Newton or exact, symmetric
    constraints: Array = field(default_factory=lambda: np.zeros(0))  # (m,), to be zero
    jacobian: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (m, n)


class Criterion(Protocol):
    """What is minimised when the data are too many for a symbolic objective."""

    @property
    def n_constraints(self) -> int:
        """Number of equality constraints that the criterion brings along."""
        ...

    def evaluate(self, x: Array) -> Evaluation:
        """Value, gradient, Gauss-Newton matrix and own constraints at `x` (n,), physical units."""
        ...


_QUIET: dict[str, dict[str, Any]] = {
    "ipopt": {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "print_time": False,
        "ipopt.tol": 1e-9,
        "ipopt.acceptable_tol": 1e-7,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.bound_relax_factor": 0.0,
    },
    "sqpmethod": {
        "print_header": False,
        "print_iteration": False,
        "print_status": False,
        "print_time": False,
        "qpsol": "qrqp",
        "convexify_strategy": "eigen-reflect",  # its QP cannot use negative curvature
        "max_iter_ls": 25,  # after the default of 3 halvings it takes the step, however bad
        "tol_du": 1e-9,
        "tol_pr": 1e-9,
        "qpsol_options": {
            "print_iter": False,
            "print_header": False,
            "print_info": False,
            "error_on_fail": False,
        },
        "error_on_fail": False,
    },
}

_MENDS = {
    "Infeasible_Problem_Detected": "the constraints contradict each other near the start: "
    "drop one, or start from values that satisfy them",
    "Maximum_Iterations_Exceeded": "raise max_iterations, or start nearer to the solution",
    "Invalid_Number_Detected": "the model gives NaN or Inf near the start: tighten the bounds or "
    "change the start values",
    "Restoration_Failed": "the constraints cannot be met from this start: try several starts",
    "Subproblem_Failed": "its quadratic program has no solution here: use Solver('ipopt')",
    "Diverging_Iterates": "a parameter runs to infinity: give it bounds, or fix it",
}


@dataclass(frozen=True, slots=True)
class Solver:
    """An NLP solver by its CasADi plug-in name, with the plug-in's own options.

    Parameters
    ----------
    name : "ipopt" (default), "sqpmethod", or any installed `casadi.nlpsol` plug-in.
    max_iterations : iterations before the solver gives up.
    options : passed to `casadi.nlpsol` unchanged; they win over casid's defaults.
    """

    name: str = "ipopt"
    max_iterations: int = 300
    options: Mapping[str, Any] = field(default_factory=dict)

    def nlpsol_options(self) -> dict[str, Any]:
        """Options as `casadi.nlpsol` takes them."""
        # NaN on the way is the line search's business; one at the start is refused before.
        merged = dict(_QUIET.get(self.name, {"print_time": False})) | {"show_eval_warnings": False}
        key = {"ipopt": "ipopt.max_iter", "sqpmethod": "max_iter"}.get(self.name)
        if key is not None:
            merged[key] = self.max_iterations
        merged.update(self.options)
        return merged


@cache
def _is_installed(name: str) -> bool:
    """Whether CasADi finds the plug-in; asked once, since a missing one makes CasADi chatter."""
    return bool(ca.has_nlpsol(name))


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where a solver stopped, why, and whether that is an optimum."""

    names: tuple[str, ...]
    x: Array  # (n,) physical units
    value: float
    status: str
    iterations: int
    scaled_gradient: float  # largest |dL/dx_i| / sqrt(H_ii f): 0 at an optimum, without units
    constraint_violation: float
    at_lower: tuple[str, ...]
    at_upper: tuple[str, ...]
    hessian: Array  # (n, n) of the criterion at x
    constraint_jacobian: Array  # (m, n)
    solver: str

    @property
    def is_converged(self) -> bool:
        """True if the scaled gradient vanishes and the constraints hold, whatever the status."""
        return bool(self.scaled_gradient < 1e-5 and self.constraint_violation < 1e-6)

    @property
    def mend(self) -> str:
        """What to try when it did not converge."""
        return _MENDS.get(
            self.status, "try other start values (starts=...), bounds, or fix a parameter"
        )

    def __getitem__(self, name: str) -> float:
        return float(self.x[self.names.index(name)])


class _Callback(ca.Callback):
    """A NumPy function as a CasADi function."""

    def __init__(self, name: str, function: Any, n_in: list[int], out: list[Any], jac: Any = None):
        ca.Callback.__init__(self)
        self._function, self._n_in, self._out, self._jac = function, n_in, out, jac
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._n_in)

    def get_n_out(self) -> int:
        return len(self._out)

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense(self._n_in[i], 1)

    def get_sparsity_out(self, i: int) -> Any:
        return self._out[i]

    def eval(self, arguments: Any) -> Any:
        return self._function(*[np.array(a, dtype=float).ravel() for a in arguments])

    def has_jacobian(self) -> bool:
        return self._jac is not None

    def get_jacobian(self, *_: Any) -> Any:
        return self._jac


# The criterion and its variables come in their natural units: Ipopt need not scale again, and a
# gradient of 1e-8 means that a step would lower the criterion by 1e-16 of its first value.
_SCALED_IPOPT: dict[str, Any] = {
    "ipopt.nlp_scaling_method": "none",
    "ipopt.tol": 1e-8,
    "ipopt.acceptable_tol": 1e-6,
    "ipopt.acceptable_iter": 5,
}


def _natural_scales(first: Evaluation, scale: Array) -> tuple[Array, float]:
    """The step that changes the criterion by about itself, for each variable, and that value.

    Kept within a factor of 1000 of the declared scale, where a sensitivity vanishes at the start.
    """
    if not np.isfinite(first.value) or first.value <= 0:
        return scale, 1.0
    curvature = np.diag(first.hessian)
    with np.errstate(all="ignore"):
        natural = np.sqrt(first.value / np.where(curvature > 0, curvature, np.nan))
    natural = np.where(np.isfinite(natural), natural, scale)
    return np.clip(natural, 1e-3 * scale, 1e3 * scale), float(first.value)


class _OnePass:
    """A criterion that remembers its last point: value, gradient and Hessian share one pass.

    After `budget` passes it answers NaN without one, so that a line search that finds no descent
    (a kink) ends at once where it stands.
    """

    def __init__(self, criterion: Criterion, budget: int) -> None:
        self.criterion = criterion
        self.budget = budget
        self._key: bytes | None = None
        self._at: Evaluation | None = None

    def __call__(self, point: Array) -> Evaluation:
        key = point.tobytes()
        if self._at is None or key != self._key:
            self.budget -= 1
            if self.budget < 0:
                n, m = len(point), self.criterion.n_constraints
                nan = np.full((n, n), np.nan)
                return Evaluation(np.nan, nan[0], nan, np.full(m, np.nan), np.full((m, n), np.nan))
            self._key, self._at = key, self.criterion.evaluate(point)
        return self._at

    def judged(self, point: Array) -> Evaluation:
        """The criterion at `point`, whatever was spent."""
        self.budget = max(self.budget, 1)
        return self(point)


class Nlp:
    """A nonlinear program under construction: variables, one objective, constraints.

    Example
    -------
    >>> nlp = Nlp()
    >>> a, b = nlp.variable("a", 1.0, lower=0.0), nlp.variable("b", 1.0)
    >>> nlp.minimize((a - 2) ** 2 + (b + 1) ** 2)
    >>> nlp.equality(a + b - 2)
    >>> round(nlp.solve()["b"], 6)
    -0.5
    """

    def __init__(self, name: str = "nlp") -> None:
        self.name = name
        self._symbols: list[Any] = []
        self._names: list[str] = []
        self._start: list[float] = []
        self._lower: list[float] = []
        self._upper: list[float] = []
        self._scale: list[float] = []
        self._constraints: list[tuple[str, Any, float, float]] = []
        self._objective: Any = None

    def variable(
        self,
        name: str,
        start: float,
        *,
        lower: float = -np.inf,
        upper: float = np.inf,
        scale: float | None = None,
    ) -> Any:
        """Declare a scalar variable; returns its CasADi symbol in physical units.

        `scale` (default |start|, or 1) is the size the solver sees as one.

        Raises
        ------
        SolveError
            If the bounds cross, or the start lies outside them.
        """
        if name in self._names:
            raise SolveError(f"{self.name}: variable {name!r} declared twice; give it another name")
        if lower > upper:
            raise SolveError(
                f"{self.name}: bounds of {name} cross ({lower:g} > {upper:g}); exchange them"
            )
        if not np.isfinite(start):
            raise SolveError(f"{self.name}: start {name} = {start:g}; give a finite number")
        if not lower <= start <= upper:
            raise SolveError(
                f"{self.name}: start {name} = {start:g} lies outside its bounds "
                f"[{lower:g}, {upper:g}]; move the start inside or widen the bounds"
            )
        symbol = ca.MX.sym(name)
        self._symbols.append(symbol)
        self._names.append(name)
        self._start.append(float(start))
        self._lower.append(float(lower))
        self._upper.append(float(upper))
        self._scale.append(abs(float(scale)) if scale else (abs(float(start)) or 1.0))
        return symbol

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables in order."""
        return tuple(self._names)

    def minimize(self, objective: Any) -> None:
        """Set the objective: a scalar CasADi expression of the variables, or a `Criterion`."""
        self._objective = objective

    def equality(self, expression: Any, value: float = 0.0, name: str = "") -> None:
        """Require `expression == value`."""
        self.between(expression, value, value, name)

    def between(self, expression: Any, lower: float, upper: float, name: str = "") -> None:
        """Require `lower <= expression <= upper`."""
        if lower > upper:
            raise SolveError(
                f"{self.name}: constraint {name or expression} has lower {lower:g} above upper "
                f"{upper:g}; exchange them"
            )
        name = name or str(expression)
        self._constraints.append((name, expression, float(lower), float(upper)))

    def solve(
        self,
        solver: Solver | None = None,
        start: Sequence[float] | None = None,
        *,
        throw: bool = True,
        natural_scales: bool = False,
    ) -> Solution:
        """Solve from `start` (n,) or the declared starts.

        `natural_scales` takes the criterion's own curvature at the start as the size of its
        variables, and stops at its rounding error: right where the start is of the right order,
        as in simulation; wrong where it is off by many (static regression from far away).

        Raises
        ------
        SolveError
            If no optimum was reached (the solver's reason and a mend); `throw=False` returns the
            unconverged `Solution` instead. A failing evaluation at the start always raises.
        """
        solver = solver or Solver()
        scale = np.array(self._scale)
        lower, upper = np.array(self._lower), np.array(self._upper)
        x0: Array = np.array(self._start if start is None else start, dtype=float).ravel()
        if len(x0) != len(scale):
            raise SolveError(
                f"{self.name}: start has {len(x0)} values for {len(scale)} variables; give one for "
                f"each of {', '.join(self._names)}"
            )
        x0 = np.clip(x0, lower, upper)
        n = len(scale)
        if self._objective is None:
            raise SolveError(f"{self.name}: no objective; call minimize first")

        x = ca.vertcat(*self._symbols)
        z = ca.MX.sym("z", n)
        physical = ca.DM(scale) * z
        own = ca.vertcat(*[c[1] for c in self._constraints]) if self._constraints else ca.MX(0, 1)
        g_user = ca.Function("g", [x], [own])
        m_user = len(self._constraints)
        lbg = [c[2] for c in self._constraints]
        ubg = [c[3] for c in self._constraints]
        options = solver.nlpsol_options()
        keep: list[Any] = []  # callbacks must outlive the solver

        if isinstance(self._objective, ca.MX):
            f = ca.Function("f", [x], [self._objective])
            problem = {"x": z, "f": f(physical), "g": g_user(physical)}
            hess, grad = ca.hessian(self._objective, x)
            derivatives = ca.Function("df", [x], [self._objective, grad, ca.densify(hess)])

            def evaluate(point: Array) -> Evaluation:
                v, gr, h = derivatives(point)
                return Evaluation(float(v), np.array(gr).ravel(), np.array(h))
        else:
            one_pass = _OnePass(self._objective, 5 * solver.max_iterations)
            unit = 1.0
            if natural_scales:
                scale, unit = _natural_scales(one_pass(x0), scale)
            physical = ca.DM(scale) * z
            if natural_scales and solver.name == "ipopt":
                for key, value in _SCALED_IPOPT.items():
                    if key not in solver.options:
                        options[key] = value
                if (m_user or self._objective.n_constraints) and "ipopt.tol" not in solver.options:
                    options["ipopt.tol"] = 1e-9  # the tolerance of the constraints as well
            evaluate = one_pass.judged
            problem, m_own = self._with_criterion(
                one_pass, solver, options, keep, z, physical, scale, unit, g_user, m_user
            )
            lbg = [0.0] * m_own + lbg
            ubg = [0.0] * m_own + ubg

        first = evaluate(x0)
        if not (np.isfinite(first.value) and np.all(np.isfinite(first.gradient))):
            raise SolveError(
                f"{self.name}: the criterion is not finite at the start "
                f"({', '.join(f'{k} = {v:g}' for k, v in zip(self._names, x0, strict=True))}); "
                "change the start values or tighten the bounds"
            )
        if not _is_installed(solver.name):
            raise SolveError(
                f"{self.name}: solver {solver.name!r} is no CasADi plug-in that loads here; use "
                "Solver('ipopt') or Solver('sqpmethod')"
            )
        try:
            nlpsol = ca.nlpsol("nlp", solver.name, problem, options)
        except RuntimeError as error:
            raise SolveError(
                f"{self.name}: solver {solver.name!r} cannot be set up: "
                f"{str(error).strip().splitlines()[-1]}; check Solver(options=...)"
            ) from error
        try:
            result = nlpsol(x0=x0 / scale, lbx=lower / scale, ubx=upper / scale, lbg=lbg, ubg=ubg)
        except RuntimeError as error:
            raise SolveError(
                f"{self.name}: {solver.name} stopped: {str(error).strip().splitlines()[-1]}; "
                "change the start values or tighten the bounds"
            ) from error
        try:
            stats = nlpsol.stats()
        except RuntimeError:  # sqpmethod has no words for a QP that failed
            stats = {"return_status": "Subproblem_Failed", "iter_count": 0}
        solution = self._judge(solver, evaluate, g_user, result, stats, scale, lbg, ubg)
        if throw and not solution.is_converged:
            raise SolveError(
                f"{self.name}: {solver.name} stopped with {solution.status} after "
                f"{solution.iterations} iterations (scaled gradient {solution.scaled_gradient:.1e},"
                f" constraint violation {solution.constraint_violation:.1e}): {solution.mend}"
            )
        return solution

    def _with_criterion(
        self,
        evaluate: _OnePass,
        solver: Solver,
        options: dict[str, Any],
        keep: list[Any],
        z: Any,
        physical: Any,
        scale: Array,
        unit: float,
        g_user: Any,
        m_user: int,
    ) -> tuple[dict[str, Any], int]:
        """State the NLP around one cached pass of the criterion; returns (nlp, m).

        The objective is the criterion in units of `unit`.
        """
        n, m = len(scale), evaluate.criterion.n_constraints

        def values(point: Array) -> list[Any]:
            at = evaluate(point)
            return [at.value / unit, at.constraints]

        def jacobians(point: Array, *_: Array) -> list[Any]:
            at = evaluate(point)
            return [at.gradient.reshape(1, n) / unit, at.jacobian.reshape(m, n)]

        dense = ca.Sparsity.dense
        jac = _Callback("jac_criterion", jacobians, [n, 1, m], [dense(1, n), dense(m, n)])
        call = _Callback("criterion", values, [n], [dense(1, 1), dense(m, 1)], jac)

        lam = ca.MX.sym("lam", m_user)
        xs = ca.MX.sym("x", n)
        if m_user:
            curvature = ca.densify(ca.hessian(ca.dot(lam, g_user(xs)), xs)[0])
            g_hess = ca.Function("g_hess", [xs, lam], [curvature])

        def hessian(point: Array, _p: Array, lam_f: Array, lam_g: Array) -> list[Any]:
            at = evaluate(point * scale)
            h = lam_f[0] * at.hessian / unit
            if m_user:
                h = h + np.array(g_hess(point * scale, lam_g[m:]))
            h = h * np.outer(scale, scale)
            # Ipopt takes the upper triangle of a custom Hessian, sqpmethod the full matrix.
            return [np.triu(h)] if solver.name == "ipopt" else [h]

        pattern = ca.Sparsity.upper(n) if solver.name == "ipopt" else dense(n, n)
        options["hess_lag"] = _Callback("curvature", hessian, [n, 0, 1, m + m_user], [pattern])
        keep += [jac, call, options["hess_lag"]]
        f, own = call(physical)
        return {"x": z, "f": f, "g": ca.vertcat(own, g_user(physical))}, m

    def _judge(
        self,
        solver: Solver,
        evaluate: Any,
        g_user: Any,
        result: Any,
        stats: Any,
        scale: Array,
        lbg: list[float],
        ubg: list[float],
    ) -> Solution:
        """Measure the optimality of the point returned, apart from the solver's own verdict."""
        lower, upper = np.array(self._lower), np.array(self._upper)
        x = np.clip(np.array(result["x"]).ravel() * scale, lower, upper)
        at = evaluate(x)
        span = 1e-6 * scale
        at_lower, at_upper = x <= lower + span, x >= upper - span
        symbol = ca.MX.sym("x", len(x))
        jac = np.array(ca.Function("j", [symbol], [ca.jacobian(g_user(symbol), symbol)])(x))
        jacobian = np.vstack([at.jacobian.reshape(-1, len(x)), jac.reshape(-1, len(x))])
        g = np.concatenate([at.constraints, np.array(g_user(x)).ravel()])
        low, high = np.array(lbg), np.array(ubg)
        violation = float(np.max(np.r_[0.0, low - g, g - high]))
        size = _scaled_gradient(
            at, jacobian, low - g, high - g, np.maximum(np.abs(x), scale), at_lower, at_upper
        )
        return Solution(
            names=self.names,
            x=x,
            value=at.value,
            status=str(stats["return_status"]),
            iterations=int(stats["iter_count"]),
            scaled_gradient=size,
            constraint_violation=violation,
            at_lower=tuple(n for n, held in zip(self._names, at_lower, strict=True) if held),
            at_upper=tuple(n for n, held in zip(self._names, at_upper, strict=True) if held),
            hessian=at.hessian,
            constraint_jacobian=jacobian,
            solver=solver.name,
        )


def _scaled_gradient(
    at: Evaluation,
    jacobian: Array,
    to_lower: Array,
    to_upper: Array,
    size: Array,
    at_lower: Array,
    at_upper: Array,
) -> float:
    """Largest |dL/dx_i| / sqrt(H_ii f), a number without units that vanishes at an optimum.

    Multipliers of active constraints are found by least squares in the metric of H: the solver's
    own are in its scaling, and not every plug-in returns them. `size` (n,) is what each variable
    weighs, `to_lower` and `to_upper` (m,) the way from the constraints to their limits.
    """
    h, raw = np.diag(at.hessian), at.gradient
    finite = [np.all(np.isfinite(v)) for v in (at.value, raw, h, jacobian)]
    if not all(finite):
        return float("inf")
    level = abs(at.value) + float(np.max(np.abs(raw) * size, initial=0.0))
    # A variable without curvature of its own (a linear objective) is measured by what f gains when
    # the variable changes by its size.
    curved = h * size**2 > 1e-12 * level
    root = np.sqrt(np.where(curved, h, 1.0))
    weight = np.where(curved, 1 / root, size / np.sqrt(level or 1.0))
    # Where f vanishes (data without noise) no direction of the gradient means anything: a Newton
    # step below 1e-9 of the variable is then converged.
    unit = np.where(
        curved, np.maximum(np.sqrt(abs(at.value)), 1e-4 * root * size), np.sqrt(level or 1.0)
    )
    rows = jacobian * weight
    length = np.linalg.norm(rows, axis=1)
    rows = rows / np.where(length > 0, length, 1.0)[:, None]
    tolerance = 1e-6 * np.maximum(np.abs(jacobian) @ size, 1e-300)
    near_lower, near_upper = np.abs(to_lower) < tolerance, np.abs(to_upper) < tolerance
    equality = to_lower == to_upper
    active = np.flatnonzero(equality | near_lower | near_upper)
    free = ~(at_lower | at_upper)
    gradient = raw * weight
    if not len(active) and np.any((h * size**2 < -1e-12 * level) & free):
        return float("inf")  # a maximum along that variable
    while len(active):  # leave out the inequalities that do not hold the optimum back
        lam = np.linalg.lstsq(rows[active][:, free].T, -gradient[free], rcond=None)[0]
        pulls_off = np.where(near_lower[active], lam > 1e-9, lam < -1e-9) & ~equality[active]
        if not pulls_off.any():
            gradient = gradient + rows[active].T @ lam
            break
        active = active[~pulls_off]
    gradient = np.where(at_lower, np.minimum(gradient, 0.0), gradient)
    gradient = np.where(at_upper, np.maximum(gradient, 0.0), gradient)
    return float(np.max(np.abs(gradient) / unit, initial=0.0))
