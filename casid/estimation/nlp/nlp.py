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
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import SolveError
from casid.estimation.nlp.compiled import Compiled, Statement
from casid.estimation.nlp.program_values import at_start, fill, inside, views
from casid.estimation.nlp.single_solve import CriterionProgram, SymbolicProgram, solve_once
from casid.estimation.nlp.solution import Solution, not_converged
from casid.estimation.nlp.solver import Solver, as_solver
from casid.model.quantities import count_text

_IS_SX = (
    "is made of SX symbols, which this program does not know; use the symbols that nlp.variable "
    "and nlp.parameter return (MX), or call an SX function with them: ca.Function('f', [x], [f])(a)"
)


def _require_objective(program: str, objective: Any) -> None:
    """Refuse what can be neither evaluated nor differentiated as an objective."""
    if isinstance(objective, ca.SX):
        raise SolveError(f"{program}: the objective {_IS_SX}")
    if isinstance(objective, ca.MX):
        if objective.shape != (1, 1):
            rows, columns = objective.shape
            raise SolveError(
                f"{program}: the objective has {rows} rows and {columns} columns; give one number, "
                "as ca.sumsqr(...) makes of residuals"
            )
    elif not (hasattr(objective, "evaluate") and hasattr(objective, "n_constraints")):
        raise SolveError(
            f"{program}: the objective is a {type(objective).__name__}, which depends on no "
            "variable; give a CasADi expression of the symbols that nlp.variable returns, or a "
            "Criterion (an object with evaluate and n_constraints)"
        )


class _Variable(NamedTuple):
    symbol: Any  # in physical units
    start: float
    lower: float
    upper: float
    scale: float


class _Constraint(NamedTuple):
    label: str
    expression: Any  # scalar
    lower: float
    upper: float


class Nlp:
    """A nonlinear program under construction: variables, one objective, constraints.

    Example
    -------
    >>> import casid
    >>> nlp = casid.Nlp()
    >>> a, b = nlp.variable("a", 1.0, lower=0.0), nlp.variable("b", 1.0)
    >>> nlp.minimize((a - 2) ** 2 + (b + 1) ** 2)
    >>> nlp.equality(a + b - 2)
    >>> round(nlp.solve()["b"], 6)
    -0.5
    """

    def __init__(self, name: str = "nlp") -> None:
        self.name = name
        self._variables: dict[str, _Variable] = {}
        self._parameters: dict[str, Any] = {}
        self._constraints: list[_Constraint] = []
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

        `scale` (default ``|start|``, or 1) is the size the solver sees as one.

        Raises
        ------
        SolveError
            If the bounds cross, or the start lies outside them.
        """
        if name in self._variables or name in self._parameters:
            raise SolveError(f"{self.name}: variable {name!r} declared twice; give it another name")
        if lower > upper:
            raise SolveError(
                f"{self.name}: bounds of {name} cross ({lower:g} > {upper:g}); exchange them"
            )
        is_number = np.asarray(start).dtype.kind in "biuf"
        if not (is_number and np.isfinite(start)):
            shown = f"{start:g}" if is_number else repr(start)
            raise SolveError(f"{self.name}: start {name} = {shown}; give a finite number")
        if not lower <= start <= upper:
            raise SolveError(
                f"{self.name}: start {name} = {start:g} lies outside its bounds "
                f"[{lower:g}, {upper:g}]; move the start inside or widen the bounds"
            )
        size = abs(float(scale or start)) or 1.0
        added = _Variable(ca.MX.sym(name), float(start), float(lower), float(upper), size)
        self._variables[name] = added
        return added.symbol

    @property
    def _symbols(self) -> list[Any]:
        return [v.symbol for v in self._variables.values()]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables in order."""
        return tuple(self._variables)

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
        if name in self._variables or name in self._parameters:
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
    def start(self) -> Array:
        """The declared starts (n,)."""
        return np.array([v.start for v in self._variables.values()])

    @property
    def limits(self) -> tuple[Array, Array, Array]:
        """Lower and upper bounds and scales of the variables, each (n,)."""
        rows = [(v.lower, v.upper, v.scale) for v in self._variables.values()]
        lower, upper, scale = np.array(rows).reshape(-1, 3).T
        return lower, upper, scale

    @property
    def objective(self) -> Any:
        """What is minimised: a CasADi expression, a `Criterion`, or None before `minimize`."""
        return self._objective

    @property
    def has_criterion(self) -> bool:
        """Whether the objective is a `Criterion`, which is no expression."""
        return self._objective is not None and not isinstance(self._objective, ca.MX)

    def minimize(self, objective: Any) -> None:
        """Set the objective: a scalar CasADi expression of the variables, or a `Criterion`.

        Raises
        ------
        SolveError
            If it is neither, or an expression that is no scalar.
        """
        _require_objective(self.name, objective)
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
        name = name or f"constraint {len(self._constraints) + 1}"
        if any(isinstance(part, ca.SX) for part in (expression, lower, upper)):
            raise SolveError(f"{self.name}: constraint {name} {_IS_SX}")
        for part in (expression, lower, upper):
            if isinstance(part, str):
                raise SolveError(
                    f"{self.name}: constraint {name} holds the text {part!r}; give a number, or an "
                    "expression of the symbols that nlp.variable returns"
                )
        expression = ca.MX(expression)
        rows = expression.shape[0]
        limits: list[Any] = [v if isinstance(v, ca.MX) else ca.DM(v) for v in (lower, upper)]
        for limit in limits:
            if expression.shape[1] != 1 or limit.shape not in ((1, 1), (rows, 1)):
                raise SolveError(
                    f"{self.name}: constraint {name} compares shapes {expression.shape} and "
                    f"{limit.shape}; give columns of one length (ca.vec makes a matrix one)"
                )
        names = [name] if rows == 1 else [f"{name}[{i}]" for i in range(rows)]
        self._require(names, expression, limits, is_equality=lower is upper)

    def _require(
        self, names: Sequence[str], expression: Any, limits: Sequence[Any], *, is_equality: bool
    ) -> None:
        """Add a constraint of several rows, limits that are expressions on its left-hand side."""
        rows = len(names)
        low, high = (  # a row of numbers, or an expression
            limit if isinstance(limit, ca.MX) else np.broadcast_to(np.array(limit).ravel(), rows)
            for limit in limits
        )

        def require(left: Any, floor: Any, ceiling: Any) -> None:
            floor, ceiling = np.broadcast_to(floor, rows), np.broadcast_to(ceiling, rows)
            for i, label in enumerate(names):
                ends = float(floor[i]), float(ceiling[i])
                self._constraints.append(_Constraint(label, left[i], *ends))

        if isinstance(low, ca.MX) and (is_equality or ca.is_equal(low, limits[1], 1)):
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

    def compile(self, solver: Solver | str | None = None) -> Compiled:
        """Build solver and derivatives once, to solve for many values of the parameters.

        Example
        -------
        >>> import casadi as ca
        >>> import casid
        >>> nlp = casid.Nlp("mean")
        >>> a, data = nlp.variable("a", 0.0), nlp.parameter("data", 3)
        >>> nlp.minimize(ca.sumsqr(data - a))
        >>> mean = nlp.compile()
        >>> [round(mean.solve({"data": d})["a"], 6) for d in ([1, 2, 3], [4, 4, 7])]
        [2.0, 5.0]

        Raises
        ------
        SolveError
            If the objective is missing or a `Criterion` (its data are its own, not parameters),
            if no variable is declared, an undeclared symbol is used, or the solver cannot be set
            up.
        """
        self._require_complete()
        if not isinstance(self._objective, ca.MX):
            raise SolveError(
                f"{self.name}: a {type(self._objective).__name__} cannot be compiled, since it "
                "carries its own data; state the objective as a CasADi expression of variables and "
                "parameters, or call solve"
            )
        statement = Statement(
            name=self.name,
            names=self.names,
            parameters=self.parameters,
            function=self._function(),
            start=tuple(v.start for v in self._variables.values()),
            bounds=tuple((v.lower, v.upper) for v in self._variables.values()),
            scale=tuple(v.scale for v in self._variables.values()),
            constraints=tuple(c.label for c in self._constraints),
            limits=tuple((c.lower, c.upper) for c in self._constraints),
        )
        return Compiled(statement, as_solver(solver))

    def _function(self) -> Any:
        """(x, p) -> objective and constraints; refuses symbols that were not declared."""
        own = _column([c.expression for c in self._constraints])
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
        return ca.Function("program", [xs, ps], stated)

    def _require_complete(self) -> None:
        if self._objective is None:
            raise SolveError(f"{self.name}: no objective; call minimize first")
        if not self._variables:
            raise SolveError(
                f"{self.name}: no variables; declare at least one, a = nlp.variable('a', 1.0)"
            )

    def _given(self, parameters: Mapping[str, Any] | None) -> tuple[Any, list[Any]]:
        """Objective and constraints with the parameters' values put in."""
        expressions = [c.expression for c in self._constraints]
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
        solver: Solver | str | None = None,
        start: Sequence[float] | Mapping[str, float] | None = None,
        *,
        parameters: Mapping[str, Any] | None = None,
        throw: bool = True,
        natural_scales: bool = False,
    ) -> Solution:
        """Solve, with values for declared parameters.

        `start` is (n,) in order, or name -> value; what is not named has its declared start. To
        solve for many values, `compile` first. A `solver` may be given by its name alone.

        `natural_scales` takes the criterion's own curvature at the start as the size of its
        variables, and stops at its rounding error: right where the start is of the right order,
        as in simulation; wrong where it is off by many (static regression from far away).

        Raises
        ------
        SolveError
            If no optimum was reached (the solver's reason and a remedy); `throw=False` returns the
            unconverged `Solution` instead. A start outside the bounds (by more than rounding), a
            parameter without a value and a failing evaluation at the start always raise.
        """
        solver = as_solver(solver)
        self._require_complete()
        lower, upper, scale = self.limits
        x0 = at_start(self.name, self.names, start, self.start)
        x0 = inside(self.name, self.names, x0, lower, upper, scale)
        objective, expressions = self._given(parameters)
        x = ca.vertcat(*self._symbols)
        own = _column(expressions)
        limits = np.array([(c.lower, c.upper) for c in self._constraints]).reshape(-1, 2)
        program: SymbolicProgram | CriterionProgram
        if self.has_criterion:
            natural_from = x0 if natural_scales else None
            room = np.minimum(x0 - lower, upper - x0)
            program = CriterionProgram(objective, x, own, scale, solver, natural_from, room)
        else:
            program = SymbolicProgram(x, objective, own, scale, solver)
        solution = solve_once(program, self.name, self.names, x0, (lower, upper, *limits.T))
        if throw and not solution.is_converged:
            raise not_converged(self.name, solution)
        return solution

    def __repr__(self) -> str:
        return (
            f"<Nlp {self.name}: {count_text(len(self._variables), 'variable')}, "
            f"{count_text(len(self._constraints), 'constraint')}>"
        )


def _column(expressions: Sequence[Any]) -> Any:
    """Scalar expressions as a column (m, 1), of no row without any."""
    return ca.vertcat(*expressions) if expressions else ca.MX(0, 1)
