"""A nonlinear regression as functions of its parameters, and as a nonlinear program."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import DataError, ModelError, nearest
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Evaluation
from casid.model.expressions import names, parse

_RELATION = re.compile(r"(<=|>=|==|=|<|>)")


class RegressionProblem:
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
        self._refuse_clashes(start, known, data)
        sides = self._sides(model)
        used = self._used(sides, [*data, *start, *known])
        self.columns = tuple(c for c in data if c in used)
        theta = {p: ca.SX.sym(p) for p in self.parameters}
        row = {c: ca.SX.sym(c) for c in self.columns}
        symbols = {**theta, **row, **{k: ca.SX(float(v)) for k, v in known.items()}}
        response, prediction = self._expressions(sides, symbols)
        p, x = ca.vertcat(*theta.values()), ca.vertcat(*row.values())
        self._check_shape(response, prediction, p, used)
        residual = response - prediction
        curvature, slope = ca.hessian(residual, p)
        one = ca.Function("sample", [p, x], [residual, slope, residual * ca.densify(curvature)])
        self._side = ca.Function("sides", [p, x], [response, prediction])
        self.data = self._table(data)
        self.N = self.data.shape[1]
        self._residuals = one.map("residuals", "serial", self.N, [0], [2])
        self._constrain(constraints, {k: v for k, v in symbols.items() if k not in row}, p)
        self._require_data()
        # The criterion is divided by the response's own spread: its unit must not move Ipopt's
        # absolute tolerances. The level counts for what rounding can reach.
        y = self._response()
        self.level = float(np.linalg.norm(y)) or 1.0
        self.unit = float(np.sum((y - y.mean()) ** 2)) or self.level**2

    def _refuse_clashes(
        self, start: Mapping[str, Any], known: Mapping[str, Any], data: Mapping[str, Any]
    ) -> None:
        """A name is one thing only, and bounds are of what is estimated."""
        for first, second, a, b in (
            ("start", "known", start, known),
            ("start", "data", start, data),
            ("known", "data", known, data),
        ):
            both = sorted(set(a) & set(b))
            if both:
                raise ModelError(
                    f"{self.name}: {both[0]!r} is in {first} and in {second}; remove one"
                )
        for name in self.bounds:
            if name not in start:
                raise ModelError(
                    f"{self.name}: bounds for {name!r}, which is not estimated"
                    f"{nearest(name, self.parameters)}"
                )

    def _used(self, sides: tuple[Any, Any], given: Sequence[str]) -> set[str]:
        """Names in the model; refuses one that is not given."""
        if isinstance(sides[0], str):
            used = {*names(sides[0]), *names(sides[1])}
        else:
            used = {s.name() for side in sides for s in ca.symvar(side)}
        for name in sorted(used - set(given)):
            raise ModelError(
                f"{self.name}: {name!r} is no column, parameter or known value; to "
                f"estimate it, add it to start{nearest(name, given)}"
            )
        return used

    def _expressions(self, sides: tuple[Any, Any], symbols: dict[str, Any]) -> tuple[Any, Any]:
        """Response and prediction in the problem's own symbols."""
        if isinstance(sides[0], str):
            response, prediction = (parse(s, symbols, where=self.name) for s in sides)
        else:
            inputs = ca.symvar(ca.veccat(*sides))
            response, prediction = ca.Function("sides", inputs, list(sides))(
                *[symbols[s.name()] for s in inputs]
            )
        return response, prediction

    def _require_data(self) -> None:
        n_free = len(self.parameters) - sum(low == high for low, high in self.limits)
        if self.N + len(self.equalities) < n_free:
            raise DataError(
                f"{self.name}: {n_free} parameters, but only {self.N} data; add data, or move "
                "parameters to known"
            )

    def _response(self) -> Array:
        """The response (N,), which the parameters do not change."""
        theta = np.tile(self.start[:, None], self.N)
        y = np.array(self._side.map(self.N)(theta, self.data)[0]).ravel()
        if not np.all(np.isfinite(y)):
            k = int(np.flatnonzero(~np.isfinite(y))[0])
            raise DataError(
                f"{self.name}: the response is not finite at row {k}; leave that row out, or write "
                "the response another way"
            )
        return y

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
                    f"{self.name}: parameter {name!r} does not appear; take it out "
                    f"of start{nearest(name, used)}"
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
        nlp.minimize(LeastSquares(self, exact))
        if self.constraints:
            g = self._g(ca.vertcat(*symbols.values()))[0]
            for i, (text, (low, high)) in enumerate(
                zip(self.constraints, self.constraint_limits, strict=True)
            ):
                nlp.between(g[i], low, high, text)
        return nlp

    def constraints_at(self, theta: Array) -> tuple[Array, Array]:
        """Constraints (m,) and their Jacobian (m, n)."""
        g, A = (np.array(v) for v in self._g(theta))
        return g.ravel(), A.reshape(-1, len(theta))

    def constraint_curvature(self, theta: Array, multipliers: Array) -> Array:
        """Hessian (n, n) of the constraints times their multipliers (m,)."""
        return np.array(self._g_curvature(theta, multipliers))

    def predict(self, theta: Array, data: Mapping[str, Any]) -> Array:
        """The prediction (N,) for columns of equal length."""
        rows = {c: data[c] for c in self.columns if c in data}
        length = len(np.atleast_1d(next(iter(rows.values())))) if rows else 0
        # A column of the response alone is not needed; zeros would do, but ones have a log.
        table = self._table({c: rows.get(c, np.ones(length)) for c in self.columns})
        points = np.tile(theta[:, None], table.shape[1])
        return np.array(self._side.map(table.shape[1])(points, table)[1]).ravel()


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquares:
    """`Criterion` of a regression, divided by the response's spread."""

    problem: RegressionProblem
    exact: bool
    n_constraints: int = 0

    def evaluate(self, x: Array) -> Evaluation:
        """Half the sum of squares at `x` (n,), with the exact or the Gauss-Newton Hessian."""
        with np.errstate(all="ignore"):
            r, J, curvature = self.problem.residuals(x)
            unit = self.problem.unit
            hessian = J.T @ J + curvature if self.exact else J.T @ J
            return Evaluation(0.5 * float(r @ r) / unit, J.T @ r / unit, hessian / unit)
