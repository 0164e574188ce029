"""Nonlinear regression of one response on measured columns, with bounds and constraints.

The criterion is V(theta) = 1/2 sum_k r_k(theta)^2. It is stated as an `Nlp` and solved twice:
with the exact Hessian J'J + sum r_k r_k'', which survives poor starts and large residuals, and with
the Gauss-Newton matrix J'J, which does not follow directions of negative curvature out to infinity.
Neither wins everywhere, so both optima are polished and the lower one is kept.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import TINY
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError, nearest
from casid.estimation.nlp.nlp import Array, Evaluation, Nlp, Solver
from casid.model.expressions import names, parse

HESSIANS = ("exact", "gauss-newton")
_OFFSET = 1e-6  # relative offset of a converged fit; Bates & Watts (1981) are content with 1e-3
_RELATION = re.compile(r"(<=|>=|==|=|<|>)")


@dataclass(frozen=True, slots=True)
class Attempt:
    """One solve on the way to the estimate."""

    hessian: str
    status: str
    iterations: int
    rss: float  # after the polish; infinite where the solver stopped without a point
    is_optimum: bool


@dataclass(frozen=True, slots=True, eq=False)
class RegressionEstimate:
    """Parameters of a regression, how sure they are, and whether the optimum may be trusted.

    The standard errors are those of the regression linearised at the estimate, with the covariance
    s^2 inv(J'J), s^2 = rss / dof (on the constraints' tangent space, and given the parameters at a
    bound). They assume independent residuals of one variance, exact regressors, a true model, and
    residuals small enough for the linearisation (Seber & Wild 1989, section 2.1).
    """

    model: str
    parameters: tuple[str, ...]
    values: Array  # (n,)
    std_errors: Array  # (n,) NaN for a parameter at a bound, or without degrees of freedom
    covariance: Array  # (n, n)
    start: Array  # (n,)
    rss: float  # sum of squared residuals, response units squared
    N: int
    dof: int  # N minus the free directions
    rank: int  # of J on the free directions
    singular_values: Array  # (rank,) of J there, columns scaled to length one, descending
    residuals: Array  # (N,) response - prediction
    relative_offset: float  # |projection of r on the tangent plane| / |r|: 0 at an optimum
    constraint_violation: float
    at_bound: tuple[str, ...]
    hessian: str  # the attempt that was kept
    status: str
    iterations: int
    solver: str
    attempts: tuple[Attempt, ...]
    notes: tuple[str, ...] = ()
    _predict: Callable[[Mapping[str, Any]], Array] = field(
        repr=False, default=lambda _: np.empty(0)
    )

    @property
    def residual_sd(self) -> float:
        """Residual standard deviation sqrt(rss / dof), response units; NaN without dof."""
        return float(np.sqrt(self.rss / self.dof)) if self.dof > 0 else float("nan")

    def __getitem__(self, name: str) -> float:
        if name not in self.parameters:
            raise ModelError(
                f"{self.model}: {name!r} was not estimated{nearest(name, self.parameters)}"
            )
        return float(self.values[self.parameters.index(name)])

    def std_error(self, name: str) -> float:
        """Standard error of one parameter, in the parameter's unit."""
        self[name]
        return float(self.std_errors[self.parameters.index(name)])

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Two-sided confidence interval from Student's t with `dof` degrees of freedom.

        Raises
        ------
        IdentifiabilityError
            If the parameter has no standard error (at a bound, or no degrees of freedom).
        """
        import scipy.stats

        error = self.std_error(name)
        if not np.isfinite(error):
            raise IdentifiabilityError(
                f"{self.model}: {name} has no standard error (at a bound, or as many parameters as "
                "data); free it or add data"
            )
        half = float(scipy.stats.t.ppf((1 + level) / 2, self.dof)) * error
        return self[name] - half, self[name] + half

    def predict(self, data: Mapping[str, Any]) -> Array:
        """Right-hand side of the model at the estimate, (N,), for columns of equal length."""
        return self._predict(data)

    def references(self) -> tuple[str, ...]:
        """Papers behind the numbers."""
        return (
            "G.A.F. Seber, C.J. Wild, Nonlinear Regression, Wiley 1989 (standard errors, sec. 2.1)",
            "D.M. Bates, D.G. Watts, A relative offset orthogonality convergence criterion for "
            "nonlinear least squares, Technometrics 23(2), 1981",
            "A. Waechter, L.T. Biegler, On the implementation of an interior-point filter "
            "line-search algorithm, Math. Program. 106, 2006",
        )

    def __repr__(self) -> str:
        bound = f", {len(self.at_bound)} at bound" if self.at_bound else ""
        return (
            f"<RegressionEstimate {self.model}: converged, {len(self.parameters)} parameters"
            f"{bound}, N = {self.N}, residual sd {self.residual_sd:.4g}>"
        )

    def __str__(self) -> str:
        lines = [
            f"Regression {self.model} ({self.N} data)",
            f"  status        {self.status} in {self.iterations} iterations ({self.solver}, "
            f"{self.hessian} Hessian); relative offset {self.relative_offset:.1e}",
            f"  {'parameter':12}  {'estimate':>16}  {'std. error':>12}  {'start':>12}  note",
        ]
        for i, name in enumerate(self.parameters):
            note = "at bound: no standard error" if name in self.at_bound else ""
            error = f"{self.std_errors[i]:.5g}" if np.isfinite(self.std_errors[i]) else "--"
            row = (
                f"  {name:12}  {self.values[i]:16.10g}  {error:>12}  {self.start[i]:12.6g}  {note}"
            )
            lines.append(row.rstrip())
        smallest = self.singular_values[-1] if len(self.singular_values) else float("nan")
        lines += [
            f"  residuals     rss {self.rss:.10g}, sd {self.residual_sd:.6g} ({self.dof} dof)",
            f"  identifiable  all (rank {self.rank} of {self.rank}; smallest singular value "
            f"{smallest:.1e}, columns scaled)",
            "  error bars    independent residuals of one variance, exact regressors, linearised",
            *(f"  note          {note}" for note in self.notes),
        ]
        return "\n".join(lines)


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
        If J has not full rank at the optimum; names the combination that the data do not see.

    Notes
    -----
    An optimum is judged by the relative offset (Bates & Watts 1981), not by the solver's status. A
    local method finds a local optimum: compare several starts where that matters.

    Example
    -------
    >>> t = np.arange(6.0)
    >>> fit = regress("y ~ a*exp(-b*t)", {"y": 3 * np.exp(-0.5 * t), "t": t}, {"a": 1, "b": 1})
    >>> round(fit["b"], 9)
    0.5
    """
    problem = _Problem(model, data, start, bounds or {}, known or {}, constraints)
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
        point = problem.polish(solution.x)
        points.append((point, len(attempts)))
        attempts.append(
            Attempt(hessian, solution.status, solution.iterations, point.rss, point.is_optimum)
        )
    if not points:
        raise failures[0]
    return problem.estimate(points, tuple(attempts), solver)


class _Problem:
    """The regression as functions of theta: residuals, their derivatives, constraints."""

    def __init__(
        self,
        model: str | tuple[Any, Any],
        data: Mapping[str, Any],
        start: Mapping[str, float],
        bounds: Mapping[str, tuple[float | None, float | None]],
        known: Mapping[str, float],
        constraints: Sequence[str],
    ) -> None:
        self.parameters = tuple(start)
        if not start:
            raise ModelError(f"{model}: nothing to estimate; give start={{'b1': 1.0}}")
        self.name = model if isinstance(model, str) else f"{model[0]} ~ {model[1]}"
        self.start = np.array([float(v) for v in start.values()])
        self.bounds = bounds
        for first, second, a, b in (
            ("start", "known", start, known),
            ("start", "data", start, data),
            ("known", "data", known, data),
        ):
            both = sorted(set(a) & set(b))
            if both:
                raise ModelError(
                    f"{self.name}: {both[0]!r} stands in {first} and in {second}; remove one"
                )
        for name in bounds:
            if name not in start:
                raise ModelError(
                    f"{self.name}: bounds for {name!r}, which is not estimated"
                    f"{nearest(name, self.parameters)}"
                )
        sides = self._sides(model)
        used = set(names(sides[0])) | set(names(sides[1])) if isinstance(model, str) else None
        if used is None:
            used = {s.name() for side in sides for s in ca.symvar(side)}
        for name in sorted(used):
            if name not in start and name not in data and name not in known:
                raise ModelError(
                    f"{self.name}: {name!r} is no column, parameter or known value"
                    f"{nearest(name, [*data, *start, *known])} Add it to start to estimate it."
                )
        self.columns = tuple(c for c in data if c in used)
        theta = {p: ca.SX.sym(p) for p in self.parameters}
        row = {c: ca.SX.sym(c) for c in self.columns}
        symbols = {**theta, **row, **{k: ca.SX(float(v)) for k, v in known.items()}}
        if isinstance(model, str):
            response, prediction = (parse(s, symbols, where=self.name) for s in sides)
        else:
            inputs = ca.symvar(ca.veccat(*sides))
            response, prediction = ca.Function("sides", inputs, list(sides))(
                *[symbols[s.name()] for s in inputs]
            )
        p = ca.vertcat(*theta.values())
        self._check_shape(response, prediction, p, used)
        x = ca.vertcat(*row.values())
        residual = response - prediction
        curvature, slope = ca.hessian(residual, p)
        one = ca.Function("sample", [p, x], [residual, slope, residual * ca.densify(curvature)])
        self._side = ca.Function("sides", [p, x], [response, prediction])
        self.data = self._table(data)
        self.N = self.data.shape[1]
        self._residuals = one.map("residuals", "serial", self.N, [0], [2])
        self._constrain(constraints, {k: v for k, v in symbols.items() if k not in row}, p)

        n_free = len(self.parameters) - sum(low == high for low, high in self.limits)
        if self.N + len(self.equalities) < n_free:
            raise DataError(
                f"{self.name}: {n_free} parameters, but only {self.N} data; add data, or move "
                "parameters to known"
            )
        response_0, _ = self._side.map(self.N)(np.tile(self.start[:, None], self.N), self.data)
        y = np.array(response_0).ravel()
        if not np.all(np.isfinite(y)):
            k = int(np.flatnonzero(~np.isfinite(y))[0])
            raise DataError(
                f"{self.name}: the response is not finite at row {k}; leave that row out, or write "
                "the response another way"
            )
        # The criterion is divided by the response's own spread: its unit must not move Ipopt's
        # absolute tolerances. The level counts for what rounding can reach.
        self.level = float(np.linalg.norm(y)) or 1.0
        self.unit = float(np.sum((y - y.mean()) ** 2)) or self.level**2

    def _sides(self, model: str | tuple[Any, Any]) -> tuple[Any, Any]:
        if not isinstance(model, str):
            return model
        parts = model.split("~")
        if len(parts) != 2:
            raise ModelError(
                f"{model!r}: expected one '~' between response and prediction; write "
                "'y ~ b1 + b2*x'"
            )
        return parts[0], parts[1]

    def _check_shape(self, response: Any, prediction: Any, p: Any, used: set[str]) -> None:
        if response.shape != (1, 1) or prediction.shape != (1, 1):
            raise ModelError(
                f"{self.name}: both sides must be scalar, got {response.shape} and "
                f"{prediction.shape}; state one response a regression"
            )
        if ca.depends_on(response, p):
            raise ModelError(
                f"{self.name}: the response holds a parameter, so a small response would pass "
                "for a good fit; move it to the right of '~'"
            )
        for name in self.parameters:
            if name not in used:
                raise ModelError(
                    f"{self.name}: parameter {name!r} does not appear"
                    f"{nearest(name, used)} Or take it out of start."
                )

    def _table(self, data: Mapping[str, Any]) -> Array:
        """Used columns as rows (columns, N), checked."""
        table = {}
        for name in self.columns:
            if name not in data:
                raise DataError(f"{self.name}: column {name!r} is missing{nearest(name, data)}")
            table[name] = np.asarray(data[name], dtype=float)
            if table[name].ndim != 1:
                raise DataError(
                    f"{self.name}: column {name!r} has shape {table[name].shape}; pass a vector"
                )
            bad = np.flatnonzero(~np.isfinite(table[name]))
            if bad.size:
                raise DataError(
                    f"{self.name}: column {name!r} holds {bad.size} non-finite values, the first "
                    f"at row {bad[0]}; leave these rows out"
                )
        lengths = {name: len(v) for name, v in table.items()}
        if not lengths or len(set(lengths.values())) != 1 or 0 in lengths.values():
            raise DataError(
                f"{self.name}: columns need one common length above zero, got {lengths}; pass the "
                "columns of one table"
            )
        return np.array(list(table.values()))

    def _constrain(self, constraints: Sequence[str], symbols: dict[str, Any], p: Any) -> None:
        rows, self.constraint_limits = [], []
        self.constraints = tuple(constraints)
        for text in constraints:
            parts = _RELATION.split(text)
            if len(parts) != 3:
                raise ModelError(
                    f"{self.name}: constraint {text!r} needs one of = <= >=; write 'b1 + b2 = 1'"
                )
            where = f"{self.name}: constraint {text!r}"
            rows.append(
                parse(parts[0], symbols, where=where) - parse(parts[2], symbols, where=where)
            )
            relation = parts[1][0]
            self.constraint_limits.append(
                (0.0 if relation in "=>" else -np.inf, 0.0 if relation in "=<" else np.inf)
            )
        self.equalities = [i for i, (a, b) in enumerate(self.constraint_limits) if a == b]
        open_ends = [self.bounds.get(name, (None, None)) for name in self.parameters]
        self.limits = [
            (-np.inf if a is None else float(a), np.inf if b is None else float(b))
            for a, b in open_ends
        ]
        g = ca.vertcat(*rows) if rows else ca.SX(0, 1)
        lam = ca.SX.sym("lam", len(rows))
        curvature = ca.densify(ca.hessian(ca.dot(lam, g), p)[0]) if rows else ca.DM(0, 0)
        self._g = ca.Function("g", [p], [g, ca.densify(ca.jacobian(g, p))])
        self._g_curvature = ca.Function("g_curvature", [p, lam], [curvature])

    def residuals(self, theta: Array) -> tuple[Array, Array, Array]:
        """Residuals (N,), their Jacobian (N, n) and sum r r'' (n, n)."""
        r, slopes, curvature = self._residuals(theta, self.data)
        return np.array(r).ravel(), np.array(slopes).T, np.array(curvature)

    def nlp(self, *, exact: bool) -> Nlp:
        """The regression as an NLP, its criterion in parts of the response's sum of squares."""
        nlp = Nlp(self.name)
        symbols = {
            name: nlp.variable(name, value, lower=low, upper=high)
            for name, value, (low, high) in zip(
                self.parameters, self.start, self.limits, strict=True
            )
        }
        nlp.minimize(_LeastSquares(self, exact))
        if self.constraints:
            g = self._g(ca.vertcat(*symbols.values()))[0]
            for i, (text, (low, high)) in enumerate(
                zip(self.constraints, self.constraint_limits, strict=True)
            ):
                nlp.between(g[i], low, high, text)
        return nlp

    def at(self, theta: Array) -> _Point:
        """Fit, tangent space and distance from the optimum at one point."""
        with np.errstate(all="ignore"):
            r, J, curvature = self.residuals(theta)
            g, A = (np.array(v) for v in self._g(theta))
        return _Point(self, theta, r, J, curvature, g.ravel(), A.reshape(-1, len(theta)))

    def polish(self, theta: Array) -> _Point:
        """Newton steps in QR form until they gain nothing.

        Ipopt works with J'J, whose condition is that of J squared: up to half of the digits are
        lost. The steps here solve least-squares problems in J and gain them back.
        """
        point = self.at(theta)
        for _ in range(40):
            if not point.is_usable:
                return point
            step = point.newton_step()
            for shorten in 0.5 ** np.arange(12):
                lower, upper = np.array(self.limits).T
                candidate = self.at(np.clip(point.theta + shorten * step, lower, upper))
                if candidate.is_better_than(point):
                    break
            else:
                return point
            point = candidate
        return point

    def estimate(
        self, points: list[tuple[_Point, int]], attempts: tuple[Attempt, ...], solver: Solver
    ) -> RegressionEstimate:
        """The lowest optimum with its uncertainty, or a refusal."""
        stationary = [(p, i) for p, i in points if p.is_stationary]
        if not stationary:
            best, i = min(points, key=lambda p: p[0].rss)
            tried = "; ".join(f"{a.hessian}: {a.status}" for a in attempts)
            deficient = f" {best.deficiency()}" if best.is_usable and best.is_deficient else ""
            raise SolveError(
                f"{self.name}: no optimum reached ({tried}; relative offset {best.offset:.1e}, "
                f"constraint violation {best.violation:.1e}).{deficient} Start nearer to the "
                "solution, bound the parameters, or raise max_iterations."
            )
        # Equal up to rounding is the same optimum, and then the sharper one is taken.
        lowest = min((p for p, _ in stationary), key=lambda p: p.rss)
        limit = lowest.rss * (1 + 1e-10) + 10 * lowest.rounding * (
            np.sqrt(lowest.rss) + lowest.rounding
        )
        equal = [(p, i) for p, i in stationary if p.rss <= limit]
        best, chosen = min(equal, key=lambda p: (p[0].is_deficient, p[0].offset))
        if best.is_deficient:
            full = [p for p, _ in stationary if not p.is_deficient]
            other = (
                f" Another optimum has rss {full[0].rss:g} against {best.rss:g}." if full else ""
            )
            raise IdentifiabilityError(f"{self.name}: {best.deficiency()}{other}")
        notes = []
        lower_seen = [a for a in attempts if not a.is_optimum and a.rss < best.rss * (1 - 1e-6)]
        if lower_seen:
            notes.append(
                f"a lower rss ({lower_seen[0].rss:.6g}) was seen at a point that is no optimum: "
                "try other starts or bounds"
            )
        if best.dof <= 0:
            notes.append("as many parameters as data: no standard errors")
        best.average_rounding()
        bound = [name for name, held in zip(self.parameters, best.held, strict=True) if held]
        covariance = best.covariance()
        arrays = {
            "values": best.theta,
            "std_errors": np.sqrt(np.diag(covariance)),
            "covariance": covariance,
            "start": self.start,
            "singular_values": best.singular_values,
            "residuals": best.r,
        }
        for array in arrays.values():
            array.flags.writeable = False
        kept = attempts[chosen]

        def predict(data: Mapping[str, Any]) -> Array:
            rows = {c: data[c] for c in self.columns if c in data}
            length = len(np.atleast_1d(next(iter(rows.values())))) if rows else 0
            # A column of the response alone is not needed; zeros would do, but ones have a log.
            table = self._table({c: rows.get(c, np.ones(length)) for c in self.columns})
            theta = np.tile(best.theta[:, None], table.shape[1])
            return np.array(self._side.map(table.shape[1])(theta, table)[1]).ravel()

        return RegressionEstimate(
            model=self.name,
            parameters=self.parameters,
            rss=best.rss,
            N=self.N,
            dof=best.dof,
            rank=best.rank,
            relative_offset=best.offset,
            constraint_violation=best.violation,
            at_bound=tuple(bound),
            hessian=kept.hessian,
            status=kept.status,
            iterations=kept.iterations,
            solver=solver.name,
            attempts=attempts,
            notes=tuple(notes),
            _predict=predict,
            **arrays,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _LeastSquares:
    """`casid.estimation.nlp.nlp.Criterion` of a regression, divided by the response's spread."""

    problem: _Problem
    exact: bool
    n_constraints: int = 0

    def evaluate(self, x: Array) -> Evaluation:
        with np.errstate(all="ignore"):
            r, J, curvature = self.problem.residuals(x)
            unit = self.problem.unit
            hessian = J.T @ J + curvature if self.exact else J.T @ J
            return Evaluation(0.5 * float(r @ r) / unit, J.T @ r / unit, hessian / unit)


class _Point:
    """Everything about one theta: a QR factor of J on the free directions carries most of it.

    With columns scaled to length one (D), constraints A D = active rows, Z a basis of their null
    space and J D Z = Q R, the Gauss-Newton step is -D Z inv(R) Q'r, the covariance
    s^2 D Z inv(R) inv(R)' Z' D, and the relative offset |Q'r| / |r|.
    """

    def __init__(
        self,
        problem: _Problem,
        theta: Array,
        r: Array,
        J: Array,
        curvature: Array,
        g: Array,
        A: Array,
    ) -> None:
        self.problem, self.theta, self.r, self.J = problem, theta, r, J
        self.curvature, self.g = curvature, g
        with np.errstate(over="ignore"):
            self.rss = float(r @ r)
        low, high = np.array(problem.constraint_limits).reshape(-1, 2).T
        scale = 1.0 + np.abs(A) @ np.abs(theta)
        self.violation = float(np.max(np.r_[0.0, (low - g) / scale, (g - high) / scale]))
        self.is_usable = bool(
            np.isfinite(self.rss)
            and np.all(np.isfinite(J))
            and np.all(np.isfinite(curvature))
            and np.all(np.isfinite(A))
        )
        if not self.is_usable:
            self.offset, self.is_stationary, self.is_deficient = float("inf"), False, False
            return
        length = np.linalg.norm(J, axis=0)
        self.d = np.where(length > 0, 1 / np.where(length > 0, length, 1.0), 1.0)
        gradient = J.T @ r
        lower, upper = np.array(problem.limits).T
        span = 1e-7 * np.maximum(np.abs(problem.start), 1e-3)
        at_lower, at_upper = theta <= lower + span, theta >= upper - span
        self.held = (at_lower & (gradient > 0)) | (at_upper & (gradient < 0)) | (lower == upper)
        near = np.abs(np.array([low - g, high - g]))
        active = (low == high) | (np.min(near, axis=0) < 1e-6 * scale)
        for _ in range(2):  # once more without inequalities that do not hold the optimum back
            self.A, self.active = A[active], active
            self._basis()
            self.multipliers = self._multipliers(gradient)
            at_low = near[0] <= near[1]
            pulls_off = np.where(at_low[active], self.multipliers > 0, self.multipliers < 0)
            wrong = pulls_off & (low != high)[active]
            if not wrong.any():
                break
            active = active.copy()
            active[np.flatnonzero(active)[wrong]] = False
        tangent = (J * self.d) @ self.Z
        self.Q, self.R = np.linalg.qr(tangent)
        self.singular_values = np.linalg.svd(self.R, compute_uv=False)
        tolerance = 10 * np.finfo(float).eps * max(tangent.shape)
        top = self.singular_values[0] if self.singular_values.size else 1.0
        self.rank = int(np.sum(self.singular_values > tolerance * max(top, TINY)))
        self.dof = len(r) - self.Z.shape[1]
        self.is_deficient = self.rank < self.Z.shape[1]
        projected = self._project(r)
        self.offset = float(np.linalg.norm(projected)) / max(float(np.sqrt(self.rss)), TINY)
        # Below the rounding of the model's own evaluation no direction of r means anything.
        self.rounding = 4 * np.finfo(float).eps * problem.level
        small = self.offset < _OFFSET or float(np.linalg.norm(projected)) < 25 * self.rounding
        self.is_stationary = bool(small and self.violation < 1e-8)

    @property
    def is_optimum(self) -> bool:
        return self.is_stationary and not self.is_deficient

    def is_better_than(self, other: _Point) -> bool:
        if not self.is_usable or self.violation > max(other.violation, 1e-13):
            return False
        if self.violation < 0.5 * other.violation:
            return True
        # What rounding in the residuals makes of the rss: 2 |r| |dr|.
        noise = 2 * np.sqrt(other.rss) * self.rounding
        nearer = self.offset < 0.9 * other.offset
        return bool(self.rss < other.rss - noise or (nearer and self.rss <= other.rss + noise))

    def _basis(self) -> None:
        """Z: orthonormal basis, scaled coordinates, of what constraints and bounds leave free."""
        n = len(self.theta)
        rows = np.vstack([self.A * self.d, np.eye(n)[self.held]])
        size = np.linalg.norm(rows, axis=1, keepdims=True)
        self.rows = rows / np.where(size > 0, size, 1.0)
        if not len(rows):
            self.Z = np.eye(n)
            return
        _, s, vt = np.linalg.svd(self.rows)
        self.Z = vt[int(np.sum(s > 1e-12)) :].T

    def _multipliers(self, gradient: Array) -> Array:
        if not len(self.A):
            return np.zeros(0)
        free = ~self.held
        rows = (self.A * self.d)[:, free]
        return np.asarray(np.linalg.lstsq(rows.T, -(gradient * self.d)[free], rcond=None)[0])

    def _project(self, r: Array) -> Array:
        """Part of r that the free directions of full rank can explain."""
        if not self.is_deficient:
            return np.asarray(self.Q.T @ r)
        u = np.linalg.svd(self.R)[0][:, : self.rank]
        return np.asarray(u.T @ (self.Q.T @ r))

    def newton_step(self) -> Array:
        """Step in theta: Newton where J'J + sum r r'' is positive definite, else Gauss-Newton.

        R'(I + C) R is the Hessian on the free directions, C = inv(R)' Z'D S D Z inv(R).
        """
        correction = np.zeros(len(self.theta))
        r = self.r
        if len(self.A):
            low, high = np.array(self.problem.constraint_limits).T
            missing = (np.where(np.abs(low - self.g) <= np.abs(high - self.g), low, high) - self.g)[
                self.active
            ]
            correction = np.linalg.lstsq(self.A * self.d, missing, rcond=None)[0]
            correction[self.held] = 0.0
            r = r + (self.J * self.d) @ correction
        if self.is_deficient:
            return np.asarray(
                self.d * (correction - self.Z @ (np.linalg.pinv(self.R) @ (self.Q.T @ r)))
            )
        curvature = self.curvature
        if len(self.A):
            lam = np.zeros(len(self.g))
            lam[self.active] = self.multipliers
            curvature = curvature + np.array(self.problem._g_curvature(self.theta, lam))
        inner = self.Z.T @ (curvature * np.outer(self.d, self.d)) @ self.Z
        half = np.linalg.solve(self.R.T, inner)
        C = np.linalg.solve(self.R.T, half.T)
        right = self.Q.T @ r
        eigenvalues, vectors = np.linalg.eigh(0.5 * (C + C.T))
        if eigenvalues.size and eigenvalues[0] > -0.9:
            right = vectors @ ((vectors.T @ right) / (1 + eigenvalues))
        return np.asarray(self.d * (correction - self.Z @ np.linalg.solve(self.R, right)))

    def average_rounding(self, repetitions: int = 64) -> None:
        """Sharpen rss where it is little more than rounding of the model's own evaluation.

        Shifting theta by single units in the last place redraws the rounding of every residual; the
        mean of many draws, without its part in the tangent plane, has that share reduced by the
        root of their number. Lanczos1 of NIST (rss 1e-25 of data near 1) gains half a digit.
        """
        if not self.is_usable or self.rss > (1e3 * self.rounding) ** 2:
            return
        draws = np.random.default_rng(0).uniform(-8, 8, (repetitions, len(self.theta)))
        draws = draws * np.finfo(float).eps * ~self.held
        r = np.mean([self.problem.residuals(self.theta * (1 + d))[0] for d in draws], axis=0)
        r = r - self.Q @ (self.Q.T @ r)
        self.rss = float(r @ r)

    def covariance(self) -> Array:
        """(n, n) covariance of theta; NaN rows and columns for parameters at a bound."""
        n = len(self.theta)
        if self.dof <= 0:
            return np.full((n, n), np.nan)
        half = self.d[:, None] * (self.Z @ np.linalg.inv(self.R))
        result = self.rss / self.dof * half @ half.T
        result[self.held, :] = np.nan
        result[:, self.held] = np.nan
        return np.asarray(result)

    def deficiency(self) -> str:
        """What the data do not see, in words."""
        v = self.Z @ np.linalg.svd(self.R)[2][-1]
        change = self.d * v / np.where(self.theta != 0, np.abs(self.theta), 1.0)
        change = change / np.max(np.abs(change))
        change = change * np.sign(change[np.abs(change) > 1e-3][0])
        parts = [
            f"{name} by {c:+.3g}{' %' if value else ''}"
            for name, c, value in zip(self.problem.parameters, change, self.theta, strict=True)
            if abs(c) > 1e-3
        ]
        what = "together" if len(parts) > 1 else "alone"
        return (
            f"the data do not identify all parameters (rank {self.rank} of {self.Z.shape[1]}): "
            f"changing {', '.join(parts)} {what} leaves the fit as it is. Move one of them to "
            "known, add a constraint, or add data where they act differently."
        )
