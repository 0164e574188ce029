"""The programs of a stage: its physical parameters from moment equations, in each of the forms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import ModelError, SolveError
from casid.estimation.moments.equations.moment_equations import MomentEquations
from casid.estimation.moments.equations.moment_nlp import Condensed, LinearNlp, PhysicalNlp
from casid.estimation.moments.stages.coefficient_map import CoefficientMap
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.nlp.solution import Solution, not_converged
from casid.linear.constrained_least_squares import null_space_least_squares
from casid.linear.sampled.difference_equation import DifferenceEquation
from casid.model.declarations import Parameter


class StagePrograms:
    """Programs that are derived once and solved for any moments of the same form.

    Parameters
    ----------
    equations : of each part.
    parameters : that are free.
    known : of each part, those of the free ones that are known in its record.
    """

    def __init__(
        self,
        equations: Sequence[DifferenceEquation],
        parameters: Sequence[Parameter],
        known: Sequence[frozenset[str]],
        settings: MomentSettings,
        *,
        name: str,
    ) -> None:
        self.equations, self.parameters, self.known = equations, parameters, known
        self.settings, self.name = settings, name
        self.free = tuple(p.name for p in parameters)
        self.low = np.array([p.lower for p in parameters])
        self.high = np.array([p.upper for p in parameters])
        self.map = CoefficientMap(equations, parameters, known, name=name)
        self._physical: PhysicalNlp | None = None
        self._linear: dict[int, LinearNlp] = {}

    def solve(
        self,
        equations: Sequence[MomentEquations],
        roots: Sequence[Array],
        values: Sequence[Mapping[str, float]],
        start: Array,
        *,
        on_the_way: bool = False,
    ) -> tuple[Array, list[Array], Solution]:
        """(theta_p, theta of each part, solution) of one set of moment equations.

        `on_the_way` to the last refinement the linear form is solved in closed form.
        """
        data = [Condensed.of(e, r) for e, r in zip(equations, roots, strict=True)]
        if self.settings.form == "linear":
            closed = on_the_way or isinstance(self.settings.solver, str)
            return self._solve_linear(data, values, start, closed=closed)
        if self._physical is None:
            if isinstance(self.settings.solver, str):
                raise ModelError(
                    f"{self.name}: solver {self.settings.solver!r} is for form='linear' alone; "
                    "leave it out, and the program is solved by Ipopt"
                )
            self._physical = PhysicalNlp(
                self.equations,
                self.parameters,
                self.known,
                lifted=self.settings.form == "lifted",
                constraints=self.settings.constraints,
                solver=self.settings.solver,
                name=self.name,
            )
        solution = self._physical.solve(data, values, start.tolist(), throw=False)
        if not solution.is_converged:
            solution = self._by_least_squares(data, values, solution)
        if solution.at_lower or solution.at_upper:
            solution = self._from_elsewhere(self._physical, data, values, start, solution)
        theta_p = np.array([solution[f] for f in self.free])
        return theta_p, self.map.split(self.map.theta(theta_p, values)), solution

    def _by_least_squares(
        self, data: Sequence[Condensed], values: Sequence[Mapping[str, float]], found: Solution
    ) -> Solution:
        """The optimum from where a solver stopped short, by orthogonal factors of the residual.

        A solver of general programs sees squares: where coefficients are nearly dependent half of
        the digits are gone. A scaled gradient is then the largest cosine between the residual and
        a column of its Jacobian.
        """
        if self.settings.constraints or not np.all(np.isfinite(found.x)):
            raise not_converged(self.name, found)
        from scipy.optimize import least_squares

        low, high = self.low, self.high
        metric = _block_diagonal([d.right for d in data])
        left = np.concatenate([d.left for d in data])
        rest = sum(d.rest for d in data)
        x0 = np.clip(np.array([found[f] for f in self.free]), low, high)

        def residual(at: Array) -> Array:
            return np.asarray(left - metric @ self.map.theta(at, values))

        def jacobian(at: Array) -> Array:
            return np.asarray(-metric @ self.map.jacobian(at, values))

        result = least_squares(
            residual,
            x0,
            jacobian,
            bounds=(low, high),
            x_scale="jac",
            ftol=1e-14,
            xtol=1e-14,
            gtol=1e-14,
            max_nfev=200,
        )
        x, r = np.asarray(result.x), np.asarray(result.fun)
        J = jacobian(x)
        span = 1e-6 * np.maximum(np.abs(x), 1e-3)
        at_low, at_high = x <= low + span, x >= high - span
        inside = ~(at_low | at_high)
        length = max(float(np.sqrt(r @ r + rest)), TINY)
        cosines = np.abs(J.T @ r) / np.maximum(np.linalg.norm(J, axis=0), TINY) / length
        solution = replace(
            found,
            names=self.free,
            x=x,
            value=(float(r @ r) + rest) / 2,
            status=f"least squares after {found.status}",
            scaled_gradient=float(np.max(cosines[inside], initial=0.0)),
            constraint_violation=0.0,
            at_lower=tuple(f for f, held in zip(self.free, at_low, strict=True) if held),
            at_upper=tuple(f for f, held in zip(self.free, at_high, strict=True) if held),
            hessian=J.T @ J,
            constraint_jacobian=np.zeros((0, len(x))),
        )
        if not solution.is_converged:
            raise not_converged(self.name, solution)
        return solution

    def _from_elsewhere(
        self,
        nlp: PhysicalNlp,
        data: Sequence[Condensed],
        values: Sequence[Mapping[str, float]],
        start: Array,
        found: Solution,
    ) -> Solution:
        """A bound may hold a local optimum: four more starts, the best optimum counts."""
        rng = np.random.default_rng(17)
        low, high = self.low, self.high
        for _ in range(4):
            beside = np.where(start == 0.0, 0.1, start) * np.exp(
                0.5 * rng.standard_normal(len(start))
            )
            try:
                other = nlp.solve(data, values, np.clip(beside, low, high).tolist())
            except SolveError:
                continue
            if other.value < found.value * (1 - 1e-9):
                found = other
        return found

    def _solve_linear(
        self,
        data: Sequence[Condensed],
        values: Sequence[Mapping[str, float]],
        start: Array,
        *,
        closed: bool,
    ) -> tuple[Array, list[Array], Solution]:
        if self.settings.constraints:
            raise ModelError(
                f"{self.name}: constraints on physical parameters need form='eliminated' or "
                "'lifted'; the linear form has theta alone"
            )
        B, b = self.map.constraints(values, start)
        metric = _block_diagonal([d.right for d in data])
        if closed:
            solution = self._closed_form(data, metric, B, b)
        else:
            rows = len(b)
            if rows not in self._linear:
                solver = self.settings.solver
                self._linear[rows] = LinearNlp(
                    self.equations,
                    rows,
                    solver=None if isinstance(solver, str) else solver,
                    name=self.name,
                )
            theta0 = self.map.theta(start, values)
            solution = self._linear[rows].solve(data, B, b, theta0)
        theta_p = self.map.inverse(solution.x, values, start, metric)
        low, high = self.low, self.high
        # Coefficients outside the image of the box: theta_p is on its boundary.
        at_lower = tuple(f for f, held in zip(self.free, theta_p <= low, strict=True) if held)
        at_upper = tuple(f for f, held in zip(self.free, theta_p >= high, strict=True) if held)
        solution = replace(solution, at_lower=at_lower, at_upper=at_upper)
        return theta_p, self.map.split(solution.x), solution

    def _closed_form(
        self, data: Sequence[Condensed], metric: Array, B: Array, b: Array
    ) -> Solution:
        """The optimum of the linear form by the null space of B."""
        left = np.concatenate([d.left for d in data])
        theta = null_space_least_squares(metric, left, B, b)
        residual = left - metric @ theta
        return Solution(
            names=tuple(f"{c}#{k}" for k, e in enumerate(self.equations) for c in e.coefficients),
            x=theta,
            value=(float(residual @ residual) + sum(d.rest for d in data)) / 2,
            status="Closed_Form",
            iterations=0,
            scaled_gradient=0.0,
            constraint_violation=float(np.max(np.abs(B @ theta - b), initial=0.0)),
            at_lower=(),
            at_upper=(),
            hessian=metric.T @ metric,
            constraint_jacobian=B,
            solver="null space",
        )


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    n = sum(len(b) for b in blocks)
    out = np.zeros((n, n))
    at = 0
    for b in blocks:
        out[at : at + len(b), at : at + len(b)] = b
        at += len(b)
    return out
