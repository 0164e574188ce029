"""One solve of a program that is not compiled: in the solver's units, judged in physical ones."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.nlp.criterion import (
    FALL,
    PATIENCE,
    PATIENCE_NEAR,
    SCALED_IPOPT,
    Callback,
    Criterion,
    OnePass,
    scales_at_start,
)
from casid.estimation.nlp.solution import (
    Evaluation,
    Solution,
    account,
    judged,
    not_finite,
    stacked,
)
from casid.estimation.nlp.solver import Solver, gave_up, limited, set_up


class SymbolicProgram:
    """An objective and constraints (m,) as expressions of x (n,), physical units."""

    n_own = 0  # constraints that the objective brings along
    end = None  # it always has values

    def __init__(self, x: Any, objective: Any, constraints: Any, scale: Array, solver: Solver):
        self.scale, self.solver = scale, solver
        self.options = solver.nlpsol_options()
        self.constraints = ca.Function("g", [x], [constraints])
        self._objective = ca.Function("f", [x], [objective])
        hess, grad = ca.hessian(objective, x)
        self._derivatives = ca.Function("df", [x], [objective, grad, ca.densify(hess)])

    def evaluate(self, x: Array) -> Evaluation:
        """The objective at `x` (n,)."""
        value, gradient, hessian = self._derivatives(x)
        return Evaluation(float(value), np.array(gradient).ravel(), np.array(hessian))

    def stated(self, z: Any) -> dict[str, Any]:
        """The problem in the solver's variables z = x / scale."""
        x = ca.DM(self.scale) * z
        return {"x": z, "f": self._objective(x), "g": self.constraints(x)}


class CriterionProgram:
    """A criterion, as one pass over its data, with constraints (m,) as expressions of x (n,).

    With `natural_from` (n,) the criterion's curvature there sets the scales of its variables, and
    its value there the unit of the objective; `room` (n,) is its distance from the bounds.
    """

    def __init__(
        self,
        criterion: Criterion,
        x: Any,
        constraints: Any,
        scale: Array,
        solver: Solver,
        natural_from: Array | None = None,
        room: Array | float = np.inf,
    ) -> None:
        self.solver, self.scale, self._unit = solver, scale, 1.0
        self.constraints = ca.Function("g", [x], [constraints])
        self.n_own, self._n_declared = criterion.n_constraints, constraints.numel()
        # With constraints the criterion may have to grow, for as long as they are not met.
        self._is_alone = not (self.n_own or self._n_declared)
        barrier = solver.options.get("ipopt.mu_init", np.inf)
        is_near = natural_from is not None and barrier <= FALL
        patience = (PATIENCE_NEAR if is_near else PATIENCE) if self._is_alone else np.inf
        most = solver.max_iterations
        self._one_pass = OnePass(
            criterion,
            5 * most,
            patience=patience,
            enough=solver.enough if self._is_alone else 0.0,
            below=solver.below,
            known=solver.known,
            steps=most,
        )
        self.evaluate = self._one_pass.judged
        self.options = solver.nlpsol_options()
        self._keep: list[Any] = []  # callbacks must outlive the solver
        if natural_from is None:
            return
        room = np.broadcast_to(room, scale.shape)
        self.scale, self._unit = scales_at_start(self._one_pass(natural_from), scale, room)
        if solver.name == "ipopt":
            self.options |= {k: v for k, v in SCALED_IPOPT.items() if k not in solver.options}
            if self._n_declared + self.n_own and "ipopt.tol" not in solver.options:
                self.options["ipopt.tol"] = 1e-9  # the tolerance of the constraints as well

    def stated(self, z: Any) -> dict[str, Any]:
        """The problem in the solver's variables z = x / scale, around one cached pass."""
        n, m, unit, one_pass = len(self.scale), self.n_own, self._unit, self._one_pass

        def values(point: Array) -> list[Any]:
            """Criterion and constraints at a point, scaled for the solver."""
            if m:
                at = one_pass(point)
                return [at.value / unit, at.constraints]
            value = one_pass.value(point)
            if self.end is not None:
                # Ipopt takes a NaN for a step that is too long, and halves it a thousand times. A
                # step that it takes, to a point without derivatives, ends it at once.
                value = one_pass.lowest - abs(one_pass.lowest) - unit
            return [value / unit, np.zeros(0)]

        def jacobians(point: Array, *_: Array) -> list[Any]:
            at = one_pass(point)
            return [at.gradient.reshape(1, n) / unit, at.jacobian.reshape(m, n)]

        dense = ca.Sparsity.dense
        jac = Callback("jac_criterion", jacobians, [n, 1, m], [dense(1, n), dense(m, n)])
        call = Callback("criterion", values, [n], [dense(1, 1), dense(m, 1)], jac)
        self.options["hess_lag"] = self._curvature()
        self._keep += [jac, call, self.options["hess_lag"]]
        x = ca.DM(self.scale) * z
        f, own = call(x)
        return {"x": z, "f": f, "g": ca.vertcat(own, self.constraints(x))}

    @property
    def end(self) -> tuple[str, Array] | None:
        """Why it gave out no more values, as a status, and the best point (n,) until then."""
        is_ended = self._one_pass.ending and self._is_alone and self.solver.name == "ipopt"
        return (self._one_pass.ending, self._one_pass.best) if is_ended else None

    def _curvature(self) -> Callback:
        """The Hessian of the Lagrangian; the criterion's own constraints count as linear."""
        n, m, declared, scale = len(self.scale), self.n_own, self._n_declared, self.scale
        is_ipopt = self.solver.name == "ipopt"
        lam, x = ca.MX.sym("lam", declared), ca.MX.sym("x", n)
        if declared:
            curved = ca.densify(ca.hessian(ca.dot(lam, self.constraints(x)), x)[0])
            of_constraints = ca.Function("g_hess", [x, lam], [curved])

        def hessian(point: Array, _p: Array, lam_f: Array, lam_g: Array) -> list[Any]:
            """Hessian of the Lagrangian in the solver's variables."""
            h = lam_f[0] * self._one_pass(point * scale).hessian / self._unit
            if declared:
                h = h + np.array(of_constraints(point * scale, lam_g[m:]))
            h = h * np.outer(scale, scale)
            # Ipopt takes the upper triangle of a custom Hessian, sqpmethod the full matrix.
            return [np.triu(h)] if is_ipopt else [h]

        pattern = ca.Sparsity.upper(n) if is_ipopt else ca.Sparsity.dense(n, n)
        return Callback("curvature", hessian, [n, 0, 1, m + declared], [pattern])


def solve_once(
    program: SymbolicProgram | CriterionProgram,
    name: str,
    names: tuple[str, ...],
    x0: Array,
    box: tuple[Array, Array, Array, Array],
) -> Solution:
    """Solve from x0 (n,) and measure the optimality of the point returned.

    `box` is lower and upper bounds (n,) and limits (m,) of the declared constraints.
    """
    lower, upper, low, high = box
    own = np.zeros(program.n_own)
    low, high = np.concatenate([own, low]), np.concatenate([own, high])
    first = program.evaluate(x0)
    if not (np.isfinite(first.value) and np.all(np.isfinite(first.gradient))):
        raise not_finite(name, names, x0)
    scale, solver = program.scale, program.solver
    problem = program.stated(ca.MX.sym("z", len(x0)))
    nlpsol = set_up(name, solver, problem, limited(program.options, solver))
    try:
        result = nlpsol(x0=x0 / scale, lbx=lower / scale, ubx=upper / scale, lbg=low, ubg=high)
    except RuntimeError as error:
        raise gave_up(name, solver.name, error) from error
    try:
        stats = nlpsol.stats()
    except RuntimeError:  # sqpmethod has no statistics after a QP that failed
        stats = {"return_status": "Subproblem_Failed", "iter_count": 0}
    x = np.array(result["x"]).ravel() * scale
    if program.end is not None:
        stats["return_status"], x = program.end
    x = np.clip(x, lower, upper)
    symbol = ca.MX.sym("x", len(x))
    g = program.constraints(symbol)
    declared = ca.Function("j", [symbol], [g, ca.densify(ca.jacobian(g, symbol))])
    values, jacobian = (np.array(v) for v in declared(x))
    at = stacked(program.evaluate(x), values.ravel(), jacobian)
    return judged(names, x, at, scale, (lower, upper, low, high), account(stats), solver.name)
