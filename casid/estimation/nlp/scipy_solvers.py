"""SciPy's solvers on a program's own CasADi functions, with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from casid.arrays import Array
from casid.errors import SolveError
from casid.estimation.nlp.solution import Evaluation, Solution, judged, stacked
from casid.estimation.nlp.solver_catalogue import SLSQP
from casid.estimation.nlp.solver_processes import timed


class Program(Protocol):
    """What SciPy's solvers need of a program; `casid.estimation.nlp.compiled.Compiled` has it."""

    @property
    def start(self) -> Array:
        """(n,)"""
        ...

    @property
    def scale(self) -> Array:
        """(n,)"""
        ...

    @property
    def box(self) -> tuple[Array, Array, Array, Array]:
        """Bounds of the variables (n,), limits of the constraints (m,)."""
        ...

    def evaluate(self, x: Array) -> Evaluation:
        """Criterion with all constraints at x (n,)."""
        ...

    def lagrangian_hessian(self, x: Array, lam: Array) -> Array:
        """(n, n)"""
        ...


@dataclass(slots=True, eq=False)
class StackedProgram:
    """A `Criterion` with the declared constraints, as a `Program`."""

    criterion: Any
    constraints: Any  # Compiled: the constraints alone, under an objective of zero
    _kept: tuple[bytes, Evaluation] | None = field(default=None, init=False)

    @property
    def start(self) -> Array:
        """(n,)"""
        return np.array(self.constraints.start)

    @property
    def scale(self) -> Array:
        """(n,)"""
        return np.array(self.constraints.scale)

    @property
    def box(self) -> tuple[Array, Array, Array, Array]:
        """Bounds and limits, the criterion's own constraints first."""
        lower, upper, low, high = self.constraints.box
        own = np.zeros(self.criterion.n_constraints)
        return lower, upper, np.r_[own, low], np.r_[own, high]

    def evaluate(self, x: Array) -> Evaluation:
        """Criterion with all constraints at x (n,)."""
        key = x.tobytes()
        if self._kept is None or self._kept[0] != key:
            at, declared = self.criterion.evaluate(x), self.constraints.evaluate(x)
            self._kept = key, stacked(at, declared.constraints, declared.jacobian)
        return self._kept[1]

    def lagrangian_hessian(self, x: Array, lam: Array) -> Array:
        """(n, n); the criterion's own constraints count as linear, as they do in `Nlp.solve`."""
        curved = self.constraints.lagrangian_hessian(x, lam[self.criterion.n_constraints :])
        return np.asarray(self.evaluate(x).hessian + curved)


def run_scipy(
    name: str, names: tuple[str, ...], program: Program, start: Array | None
) -> tuple[Solution, float]:
    """SciPy's trust-constr or SLSQP on the program's own scaled functions.

    Raises
    ------
    SolveError
        If the criterion is not finite at the start.
    """
    from scipy.optimize import minimize

    scale, (lower, upper, *_) = program.scale, program.box
    x0 = program.start if start is None else np.asarray(start, dtype=float)
    first = program.evaluate(x0)
    if not (np.isfinite(first.value) and np.isfinite(first.gradient).all()):
        raise SolveError(f"{name}: the criterion is not finite at the start; change the start")
    unit = 1e-2 * max(
        np.abs(first.gradient * scale).max(initial=0.0),
        np.abs(np.diag(first.hessian) * scale**2).max(initial=0.0),
    )
    unit = unit if np.isfinite(unit) and unit > 0 else 1.0
    slope = np.abs(first.jacobian * scale).max(axis=1, initial=0.0)
    slope = np.where(slope > 0, slope, 1.0)
    arguments = _functions(program, scale, unit)
    counts = arguments.pop("counts")
    options, constraints = _method(name, program, scale, unit, slope)

    def solve() -> Solution:
        """One run from the start, judged by the derivatives where it ends."""
        counts.clear()
        result = minimize(
            **arguments,
            x0=x0 / scale,
            bounds=list(zip(lower / scale, upper / scale, strict=True)),
            constraints=constraints,
            **options,
        )
        x = np.minimum(np.maximum(result.x * scale, lower), upper)
        ending = (str(result.message).rstrip("."), int(result.nit), len(counts))
        return judged(names, x, program.evaluate(x), scale, program.box, ending, name)

    return timed(solve)


def _functions(program: Program, scale: Array, unit: float) -> dict[str, Any]:
    """Objective, gradient and their counter in the solver's variables."""
    counts: list[int] = []

    def value(z: Array) -> float:
        counts.append(1)
        return float(program.evaluate(z * scale).value / unit)

    def gradient(z: Array) -> Array:
        return np.asarray(program.evaluate(z * scale).gradient * scale / unit)

    return {"fun": value, "jac": gradient, "counts": counts}


def _method(
    name: str, program: Program, scale: Array, unit: float, slope: Array
) -> tuple[dict[str, Any], Any]:
    """Method with tight tolerances, and constraints as that method takes them."""
    from scipy.optimize import NonlinearConstraint

    _, _, low, high = program.box

    def g(z: Array) -> Array:
        return program.evaluate(z * scale).constraints / slope

    def jacobian(z: Array) -> Array:
        return np.asarray(program.evaluate(z * scale).jacobian * scale / slope[:, None])

    if name == SLSQP:
        rows = []
        for kind, which, limit, sign in (
            ("eq", low == high, low, 1.0),
            ("ineq", (low != high) & np.isfinite(low), low, 1.0),
            ("ineq", (low != high) & np.isfinite(high), high, -1.0),
        ):
            if which.any():
                rows.append(
                    {
                        "type": kind,
                        "fun": lambda z, w=which, v=limit, s=sign: s * (g(z) - v / slope)[w],
                        "jac": lambda z, w=which, s=sign: s * jacobian(z)[w],
                    }
                )
        return {"method": "SLSQP", "options": {"ftol": 1e-16, "maxiter": 300}}, rows

    def hessian(z: Array) -> Array:
        return np.asarray(program.evaluate(z * scale).hessian * np.outer(scale, scale) / unit)

    def curvature(z: Array, v: Array) -> Array:
        x = z * scale
        curved = program.lagrangian_hessian(x, v / slope) - program.evaluate(x).hessian
        return np.asarray(curved * np.outer(scale, scale))

    second: Any = curvature  # scipy's stubs know one argument
    constraints = (
        NonlinearConstraint(g, low / slope, high / slope, jac=jacobian, hess=second)
        if len(low)
        else ()
    )
    tight = {"gtol": 1e-14, "xtol": 1e-14, "barrier_tol": 1e-14, "maxiter": 300}
    return {"method": "trust-constr", "hess": hessian, "options": tight}, constraints
