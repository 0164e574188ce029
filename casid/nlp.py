"""Nonlinear programs with named, scaled variables, bounds and constraints.

Every estimator of casid states its problem here and hands it to a solver, which is a value:
``Solver("ipopt")`` by default, any other CasADi ``nlpsol`` plug-in by name. An objective is either
a CasADi expression (exact derivatives) or a `Criterion`, a Python object whose value, gradient and
Gauss-Newton matrix come from one pass over the data.

An expression may depend on parameters, numbers that are given when it is solved: the moments of a
record, say. ``Nlp.compile`` builds such a program once, to be solved for many records.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casid.errors import SolveError

if TYPE_CHECKING:
    from casid.compiled import Compiled

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

# What each plug-in calls the number of iterations; the others keep their own default.
_MAX_ITERATIONS = {
    "ipopt": "ipopt.max_iter",
    "sqpmethod": "max_iter",
    "feasiblesqpmethod": "max_iter",
    "qrsqp": "max_iter",
    "scpgen": "max_iter",
    "blocksqp": "max_iter",
    "fatrop": "fatrop.max_iter",
    "uno": "uno.max_iterations",
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
        key = _MAX_ITERATIONS.get(self.name)
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
    evaluations: int = 0  # of the objective, 0 where the solver does not count them

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
        self._parameters: dict[str, Any] = {}
        self._constraints: list[tuple[str, Any, float, float]] = []  # one scalar each
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
        if name in self._names or name in self._parameters:
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

    def parameter(self, name: str, rows: int = 1, columns: int = 1) -> Any:
        """Declare numbers that are given when the program is solved; returns their CasADi symbol.

        Returns
        -------
        (rows, columns) CasADi MX, physical units, to be used in the objective, in constraints and
        in the limits of constraints.

        Raises
        ------
        SolveError
            If the name is taken.
        """
        if name in self._names or name in self._parameters:
            raise SolveError(
                f"{self.name}: parameter {name!r} declared twice; give it another name"
            )
        if rows < 1 or columns < 1:
            raise SolveError(
                f"{self.name}: parameter {name} has {rows} rows and {columns} columns; "
                "give at least one of each"
            )
        self._parameters[name] = ca.MX.sym(name, rows, columns)
        return self._parameters[name]

    @property
    def parameters(self) -> Mapping[str, tuple[int, int]]:
        """Rows and columns of each declared parameter."""
        return {name: symbol.shape for name, symbol in self._parameters.items()}

    @property
    def limits(self) -> tuple[Array, Array, Array]:
        """Lower and upper bounds and scales of the variables, each (n,)."""
        return np.array(self._lower), np.array(self._upper), np.array(self._scale)

    @property
    def objective(self) -> Any:
        """What is minimised: a CasADi expression, a `Criterion`, or None before `minimize`."""
        return self._objective

    @property
    def has_criterion(self) -> bool:
        """Whether the objective is a `Criterion`, which is no expression."""
        return self._objective is not None and not isinstance(self._objective, ca.MX)

    def minimize(self, objective: Any) -> None:
        """Set the objective: a scalar CasADi expression of the variables, or a `Criterion`."""
        self._objective = objective

    def equality(self, expression: Any, value: Any = 0.0, name: str = "") -> None:
        """Require `expression == value`; a column (m, 1) states m constraints."""
        self.between(expression, value, value, name)

    def between(self, expression: Any, lower: Any, upper: Any, name: str = "") -> None:
        """Require `lower <= expression <= upper`.

        `expression` is a scalar or a column (m, 1). The limits are numbers, or CasADi expressions
        of the parameters, scalar or (m, 1); such a limit is taken to the left-hand side.

        Raises
        ------
        SolveError
            If numeric limits cross, or the shapes do not agree.
        """
        expression = ca.MX(expression)
        rows = expression.shape[0]
        name = name or f"constraint {len(self._constraints) + 1}"
        limits: list[Any] = [v if isinstance(v, ca.MX) else ca.DM(v) for v in (lower, upper)]
        for limit in limits:
            if expression.shape[1] != 1 or limit.shape not in ((1, 1), (rows, 1)):
                raise SolveError(
                    f"{self.name}: constraint {name} compares shapes {expression.shape} and "
                    f"{limit.shape}; give columns of one length (ca.vec makes a matrix one)"
                )
        low, high = (  # a row of numbers, or an expression
            limit if isinstance(limit, ca.MX) else np.broadcast_to(np.array(limit).ravel(), rows)
            for limit in limits
        )
        names = [name] if rows == 1 else [f"{name}[{i}]" for i in range(rows)]

        def require(left: Any, floor: Any, ceiling: Any) -> None:
            floor, ceiling = np.broadcast_to(floor, rows), np.broadcast_to(ceiling, rows)
            for i, label in enumerate(names):
                self._constraints.append((label, left[i], float(floor[i]), float(ceiling[i])))

        if isinstance(low, ca.MX) and (lower is upper or ca.is_equal(low, limits[1], 1)):
            require(expression - low, 0.0, 0.0)
        elif isinstance(low, ca.MX) or isinstance(high, ca.MX):
            for limit, sign in ((low, 1.0), (high, -1.0)):  # sign * (expression - limit) >= 0
                if isinstance(limit, ca.MX):
                    require(sign * (expression - limit), 0.0, np.inf)
                elif np.any(np.isfinite(limit)):
                    ends = (limit, np.inf) if sign > 0 else (-np.inf, limit)
                    require(expression, *ends)
        else:
            for i, label in enumerate(names):
                if not low[i] <= high[i]:
                    raise SolveError(
                        f"{self.name}: constraint {label} has lower {low[i]:g} above upper "
                        f"{high[i]:g}; exchange them"
                    )
            require(expression, low, high)

    def compile(self, solver: Solver | None = None) -> Compiled:
        """Build solver and derivatives once, to solve for many values of the parameters.

        Example
        -------
        >>> nlp = Nlp("mean")
        >>> a, data = nlp.variable("a", 0.0), nlp.parameter("data", 3)
        >>> nlp.minimize(ca.sumsqr(data - a))
        >>> mean = nlp.compile()
        >>> [round(mean.solve({"data": d})["a"], 6) for d in ([1, 2, 3], [4, 4, 7])]
        [2.0, 5.0]

        Raises
        ------
        SolveError
            If the objective is missing or a `Criterion` (its data are its own, not parameters),
            if an undeclared symbol is used, or the solver cannot be set up.
        """
        from casid.compiled import Compiled

        if self._objective is None:
            raise SolveError(f"{self.name}: no objective; call minimize first")
        if not isinstance(self._objective, ca.MX):
            raise SolveError(
                f"{self.name}: a {type(self._objective).__name__} cannot be compiled, since it "
                "carries its own data; state the objective as a CasADi expression of variables and "
                "parameters, or call solve"
            )
        own = ca.vertcat(*[c[1] for c in self._constraints]) if self._constraints else ca.MX(0, 1)
        arguments: list[Any] = [*self._symbols, *self._parameters.values()]
        try:
            results: list[Any] = [self._objective, own]
            inner = ca.Function("inner", arguments, results)
        except RuntimeError as error:
            free = ", ".join(
                str(s)
                for s in ca.symvar(ca.veccat(self._objective, own))
                if not any(ca.is_equal(s, a) for a in arguments)
            )
            raise SolveError(
                f"{self.name}: objective or constraints use {free or 'undeclared symbols'}; "
                "declare them with variable or parameter"
            ) from error
        symbols = list(self._parameters.values())
        ends = np.cumsum([0] + [symbol.numel() for symbol in symbols]).tolist()
        xs, ps = ca.MX.sym("x", len(self._symbols)), ca.MX.sym("p", ends[-1])
        given = [
            ca.reshape(ps[first:last], *symbol.shape)
            for symbol, first, last in zip(symbols, ends, ends[1:], strict=False)
        ]
        stated: list[Any] = list(inner(*ca.vertsplit(xs), *given))
        function = ca.Function("program", [xs, ps], stated)
        return Compiled(
            name=self.name,
            names=self.names,
            parameters=self.parameters,
            function=function,
            start=tuple(self._start),
            lower=tuple(self._lower),
            upper=tuple(self._upper),
            scale=tuple(self._scale),
            constraints=tuple(c[0] for c in self._constraints),
            limits=tuple((c[2], c[3]) for c in self._constraints),
            solver=solver or Solver(),
        )

    def _given(self, parameters: Mapping[str, Any] | None) -> tuple[Any, list[Any]]:
        """Objective and constraints with the parameters' values put in."""
        expressions = [c[1] for c in self._constraints]
        if not self._parameters and not parameters:
            return self._objective, expressions
        flat = np.empty(sum(symbol.numel() for symbol in self._parameters.values()))
        windows = views(self.parameters, flat)
        fill(self.name, windows, parameters or {}, flat)
        symbols = list(self._parameters.values())
        values: list[Any] = [ca.MX(ca.DM(window)) for window in windows.values()]
        is_expression = isinstance(self._objective, ca.MX)
        put = ca.substitute(
            [*expressions, *([self._objective] if is_expression else [])], symbols, values
        )
        return (put[-1] if is_expression else self._objective), put[: len(expressions)]

    def solve(
        self,
        solver: Solver | None = None,
        start: Sequence[float] | None = None,
        *,
        parameters: Mapping[str, Any] | None = None,
        throw: bool = True,
        natural_scales: bool = False,
    ) -> Solution:
        """Solve from `start` (n,) or the declared starts, with values for declared parameters.

        To solve for many values, `compile` first.

        `natural_scales` takes the criterion's own curvature at the start as the size of its
        variables, and stops at its rounding error: right where the start is of the right order,
        as in simulation; wrong where it is off by many (static regression from far away).

        Raises
        ------
        SolveError
            If no optimum was reached (the solver's reason and a mend); `throw=False` returns the
            unconverged `Solution` instead. A start outside the bounds (by more than rounding), a
            parameter without a value and a failing evaluation at the start always raise.
        """
        solver = solver or Solver()
        scale = np.array(self._scale)
        lower, upper = np.array(self._lower), np.array(self._upper)
        x0: Array = np.array(self._start if start is None else start, dtype=float).ravel()
        x0 = inside(self.name, self.names, x0, lower, upper, scale)
        n = len(scale)
        if self._objective is None:
            raise SolveError(f"{self.name}: no objective; call minimize first")
        objective, expressions = self._given(parameters)

        x = ca.vertcat(*self._symbols)
        z = ca.MX.sym("z", n)
        physical = ca.DM(scale) * z
        own = ca.vertcat(*expressions) if expressions else ca.MX(0, 1)
        g_user = ca.Function("g", [x], [own])
        m_user = len(self._constraints)
        lbg = [c[2] for c in self._constraints]
        ubg = [c[3] for c in self._constraints]
        options = solver.nlpsol_options()
        keep: list[Any] = []  # callbacks must outlive the solver

        if isinstance(objective, ca.MX):
            f = ca.Function("f", [x], [objective])
            problem = {"x": z, "f": f(physical), "g": g_user(physical)}
            hess, grad = ca.hessian(objective, x)
            derivatives = ca.Function("df", [x], [objective, grad, ca.densify(hess)])

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
            raise not_finite(self.name, self.names, x0)
        nlpsol = set_up(self.name, solver, problem, options)
        try:
            result = nlpsol(x0=x0 / scale, lbx=lower / scale, ubx=upper / scale, lbg=lbg, ubg=ubg)
        except RuntimeError as error:
            raise gave_up(self.name, solver.name, error) from error
        try:
            stats = nlpsol.stats()
        except RuntimeError:  # sqpmethod has no words for a QP that failed
            stats = {"return_status": "Subproblem_Failed", "iter_count": 0}
        solution = self._judge(solver, evaluate, g_user, result, stats, scale, lbg, ubg)
        if throw and not solution.is_converged:
            raise not_converged(self.name, solution)
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
        symbol = ca.MX.sym("x", len(x))
        jac = np.array(ca.Function("j", [symbol], [ca.jacobian(g_user(symbol), symbol)])(x))
        at = Evaluation(
            at.value,
            at.gradient,
            at.hessian,
            np.concatenate([at.constraints, np.array(g_user(x)).ravel()]),
            np.vstack([at.jacobian.reshape(-1, len(x)), jac.reshape(-1, len(x))]),
        )
        box = (lower, upper, np.array(lbg), np.array(ubg))
        return judged(self.names, x, at, scale, box, account(stats), solver.name)


def views(shapes: Mapping[str, tuple[int, int]], flat: Array) -> dict[str, Array]:
    """Windows of declared shape on the vector that holds all parameters."""
    found: dict[str, Array] = {}
    place = 0
    for name, (rows, columns) in shapes.items():
        found[name] = flat[place : place + rows * columns].reshape((rows, columns), order="F")
        place += rows * columns
    return found


def fill(
    program: str, windows: Mapping[str, Array], values: Mapping[str, Any], flat: Array
) -> None:
    """Put values into the windows of their parameters, which look at `flat`.

    Raises
    ------
    SolveError
        If a value is missing, unknown, not finite or of another shape than was declared.
    """
    if values.keys() != windows.keys():
        missing = [name for name in windows if name not in values]
        unknown = [name for name in values if name not in windows]
        words = [f"no value for parameter {', '.join(missing)}"] if missing else []
        words += [f"no parameter is called {', '.join(unknown)}"] if unknown else []
        raise SolveError(
            f"{program}: {' and '.join(words)}; give values for exactly "
            f"{', '.join(windows) or 'none'}"
        )
    for name, window in windows.items():
        value = np.asarray(values[name], dtype=float)
        if value.shape != window.shape:
            if value.size != window.size or max(window.shape) != window.size:
                raise SolveError(
                    f"{program}: parameter {name} has shape {value.shape}; give {window.shape}, "
                    "as it was declared"
                )
            value = value.reshape(window.shape)  # a vector, lying or standing
        window[...] = value
    if not np.isfinite(flat).all():
        bad = [name for name, window in windows.items() if not np.isfinite(window).all()]
        raise SolveError(
            f"{program}: parameter {', '.join(bad)} holds values that are not finite; mend the "
            "data that they come from (record.mark_missing, record.between)"
        )


def inside(
    program: str, names: Sequence[str], x: Array, lower: Array, upper: Array, scale: Array
) -> Array:
    """A start within its bounds, put onto a bound that it misses by rounding alone.

    Raises
    ------
    SolveError
        If the start has another length than the variables, or lies outside by more than 1e-6 of a
        variable's scale: a solver that began elsewhere would silently answer another question.
    """
    if len(x) != len(names):
        raise SolveError(
            f"{program}: start has {len(x)} values for {len(names)} variables; give one for "
            f"each of {', '.join(names)}"
        )
    clipped: Array = np.minimum(np.maximum(x, lower), upper)
    if (np.abs(x - clipped) > 1e-6 * np.maximum(scale, np.abs(clipped))).any():
        i = int(np.argmax(np.abs(x - clipped) / scale))
        raise SolveError(
            f"{program}: start {names[i]} = {x[i]:g} lies outside its bounds "
            f"[{lower[i]:g}, {upper[i]:g}]; move the start inside or widen the bounds"
        )
    return clipped


def not_finite(program: str, names: Sequence[str], x: Array) -> SolveError:
    """The refusal of a start without a value."""
    return SolveError(
        f"{program}: the criterion is not finite at the start "
        f"({', '.join(f'{k} = {v:g}' for k, v in zip(names, x, strict=True))}); "
        "change the start values or tighten the bounds"
    )


def not_converged(program: str, solution: Solution) -> SolveError:
    """The refusal of a point that is no optimum: the solver's reason, the measures and a mend."""
    return SolveError(
        f"{program}: {solution.solver} stopped with {solution.status} after "
        f"{solution.iterations} iterations (scaled gradient {solution.scaled_gradient:.1e},"
        f" constraint violation {solution.constraint_violation:.1e}): {solution.mend}"
    )


def gave_up(program: str, solver: str, error: Exception) -> SolveError:
    """The refusal of a solver that ended in an exception."""
    return SolveError(
        f"{program}: {solver} stopped: {str(error).strip().splitlines()[-1]}; "
        "change the start values or tighten the bounds"
    )


def set_up(program: str, solver: Solver, problem: Mapping[str, Any], options: Any) -> Any:
    """The CasADi solver of a problem.

    Raises
    ------
    SolveError
        If the plug-in is not installed or refuses its options.
    """
    if not _is_installed(solver.name):
        raise SolveError(
            f"{program}: solver {solver.name!r} is no CasADi plug-in that loads here; use "
            "Solver('ipopt') or Solver('sqpmethod')"
        )
    try:
        return ca.nlpsol("nlp", solver.name, problem, options)
    except RuntimeError as error:
        raise SolveError(
            f"{program}: solver {solver.name!r} cannot be set up: "
            f"{str(error).strip().splitlines()[-1]}; check Solver(options=...)"
        ) from error


def judged(
    names: tuple[str, ...],
    x: Array,
    at: Evaluation,
    scale: Array,
    box: tuple[Array, Array, Array, Array],
    told: tuple[str, int, int],
    solver: str,
) -> Solution:
    """The point where a solver stopped, its optimality measured apart from the solver's verdict.

    `at` holds the criterion with all constraints at `x` (n,); `box` the lower and upper bounds of
    the variables (n,) and limits of the constraints (m,); `told` the solver's status, iterations
    and evaluations.
    """
    lower, upper, low, high = box
    span = 1e-6 * scale
    at_lower, at_upper = x <= lower + span, x >= upper - span
    to_lower, to_upper = low - at.constraints, high - at.constraints
    violation = float(max(to_lower.max(initial=0.0), -to_upper.min(initial=0.0)))
    if not np.isfinite(at.constraints).all():
        violation = float("inf")
    size = _scaled_gradient(
        at, at.jacobian, to_lower, to_upper, np.maximum(np.abs(x), scale), at_lower, at_upper
    )
    status, iterations, evaluations = told
    return Solution(
        names=names,
        x=x,
        value=at.value,
        status=status,
        iterations=iterations,
        scaled_gradient=size,
        constraint_violation=violation,
        at_lower=tuple(n for n, held in zip(names, at_lower, strict=True) if held),
        at_upper=tuple(n for n, held in zip(names, at_upper, strict=True) if held),
        hessian=at.hessian,
        constraint_jacobian=at.jacobian,
        solver=solver,
        evaluations=evaluations,
    )


def account(stats: Mapping[str, Any]) -> tuple[str, int, int]:
    """Status in words, iterations and evaluations of the objective, as far as a solver tells."""
    status = stats.get("return_status")
    if not isinstance(status, str):  # a number, or nothing: the word that all plug-ins share
        words = {"SOLVER_RET_SUCCESS": "Solved", "SOLVER_RET_LIMITED": "Limit_Reached"}
        unified = str(stats.get("unified_return_status", ""))
        status = "Solved" if stats.get("success") else words.get(unified, "Not_Solved")
    counters = ("n_call_nlp_f", "n_call_nlp_fg", "n_call_nlp_psi")
    return status, int(stats.get("iter_count", 0)), sum(int(stats.get(c, 0)) for c in counters)


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
