"""The rise of a criterion with one unknown held, in units in which it is chi squared.

Least squares with weights that are not those of the noise is no likelihood. With the criterion V,
its matrix H and the covariance P of the estimate, whatever noise P allows for, the drop

    D(theta_i) = 2 (min V with theta_i held - min V) / lambda,   lambda = P_ii / (H^-1)_ii    (1)

is chi squared with one degree of freedom at the true value (Kent 1982; the scaling of Chandler and
Bate 2007). Of a criterion that is a parabola, its interval is that of the standard error. Where the
estimate is the root of equations that differ from the gradient of V by a bias, that of noise on
inputs, V is lessened by the bias of its gradient at the estimate times the way from there, and by
the parabola that the bias gives to it: noise on inputs moves the curvature of V away from H, since
the residual and the second derivatives of a simulation hold the same noise. That means something
near the estimate alone: further away the bias is another one, and V without a limit below. No
unknown goes further there than so many of its standard errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from casid.arrays import Array, scaled_inverse
from casid.errors import OutOfTimeError, SolveError
from casid.estimation.intervals.thresholds import PROFILE_SEARCH
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Evaluation, Solution
from casid.estimation.nlp.solver import Solver, as_solver
from casid.estimation.simulation.minimization import Constraint
from casid.estimation.unknowns import Variable
from casid.model.model import Model

_WARM = {"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-9}
"""A refit begins where it will end."""


class Minimised(Protocol):
    """A criterion over named unknowns."""

    @property
    def model(self) -> Model:
        """The model."""
        ...

    @property
    def variables(self) -> Sequence[Variable]:
        """The unknowns, n of them."""
        ...

    @property
    def names(self) -> Sequence[str]:
        """Names of the unknowns."""
        ...

    @property
    def n_constraints(self) -> int:
        """Number of constraints of its own."""
        ...

    def evaluate(self, x: Array) -> Evaluation:
        """Value, gradient and matrix at x (n,)."""
        ...


class Minimum(Protocol):
    """A minimum of a criterion: of simulation errors, or of prediction errors."""

    @property
    def criterion(self) -> Minimised:
        """The criterion that was minimised."""
        ...

    @property
    def solution(self) -> Solution:
        """The solution found."""
        ...

    @property
    def x(self) -> Array:
        """(n,) the unknowns."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Tilted:
    """A criterion whose minimum is a point: without its slope there, and curved as its matrix says.

    Attributes
    ----------
    slope : (n,) gradient of the criterion at `x`, of unknowns that are free.
    bent : (n, n) by which its curvature there exceeds its matrix.
    """

    criterion: Minimised
    x: Array
    slope: Array
    bent: Array

    @property
    def n_constraints(self) -> int:
        """Number of constraints of the criterion."""
        return self.criterion.n_constraints

    def evaluate(self, x: Array) -> Evaluation:
        """Value, gradient and matrix at `x` (n,)."""
        at, way = self.criterion.evaluate(x), x - self.x
        bent = self.bent @ way
        value = at.value - float((self.slope + 0.5 * bent) @ way)
        return replace(at, value=value, gradient=at.gradient - self.slope - bent)


def tilted(fit: Minimum, covariance: Array) -> Tilted:
    """The criterion of which the root of equations is the minimum, by 2 n evaluations.

    Its curvature is that of central differences of the gradient; where these are not finite, it is
    left as it is.

    Parameters
    ----------
    fit : at the root.
    covariance : (n, n) of the root: a share of its standard errors is the step.
    """
    x, free = fit.x, fit.solution.is_free
    at = fit.criterion.evaluate(x)
    steps = PROFILE_SEARCH.difference * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    moves = np.flatnonzero(free & (steps > 0.0))
    curvature = at.hessian.copy()
    for j in moves:
        step = np.where(np.arange(len(x)) == j, steps, 0.0)
        low, high = (fit.criterion.evaluate(x + way * step).gradient for way in (-1, 1))
        curvature[moves, j] = ((high - low) / (2 * steps[j]))[moves]
    bent = 0.5 * (curvature + curvature.T) - at.hessian
    if not np.all(np.isfinite(bent)):
        bent = np.zeros(bent.shape)
    return Tilted(fit.criterion, x, np.where(free, at.gradient, 0.0), bent)


class ScaledCriterion:
    """(1) for each unknown of a fit.

    Parameters
    ----------
    fit : a minimum, or the root of equations without the bias of noise on inputs.
    covariance : (n, n) of the estimate; for unknowns at a bound as if they were not.
    root : of a root of equations, the criterion of which it is the minimum.
    solver, constraints : of the fit.
    """

    def __init__(
        self,
        fit: Minimum,
        covariance: Array,
        *,
        root: Tilted | None = None,
        solver: Solver | str | None = None,
        constraints: Sequence[Constraint] = (),
    ) -> None:
        self.names, self.x, self.is_root = tuple(fit.criterion.names), fit.x, root is not None
        self.lower, self.upper = (
            np.array([getattr(v, side) for v in fit.criterion.variables])
            for side in ("lower", "upper")
        )
        self._farthest = np.full(len(self.x), np.inf)
        if self.is_root:
            error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
            self._farthest = PROFILE_SEARCH.farthest_of_root * error
            self.lower = np.maximum(self.lower, np.minimum(self.x, self.x - self._farthest))
            self.upper = np.minimum(self.upper, np.maximum(self.x, self.x + self._farthest))
        solution = fit.solution
        self.free = solution.is_free
        at = fit.criterion.evaluate(self.x)
        self.criterion = root or fit.criterion
        self.smallest, self.hessian = at.value, at.hessian
        self.tied = solution.constraint_jacobian
        self.covariance, self.constraints = covariance, constraints
        self._scales = [v.scale for v in fit.criterion.variables]
        solver = as_solver(solver)
        if solver.name == "ipopt":
            solver = replace(solver, options={**_WARM, **solver.options})
        self.solver = solver

    def is_far(self, value: float, i: int) -> bool:
        """True where an unknown is so far from a root that the criterion means nothing."""
        return self.is_root and abs(value - self.x[i]) >= (1 - 1e-9) * self._farthest[i]

    def std_error(self, i: int) -> float:
        """Standard error of an unknown by its place."""
        return float(np.sqrt(max(self.covariance[i, i], 0.0)))

    def path(self, i: int) -> tuple[float, Array]:
        """lambda of (1), and the change (n,) of all unknowns with that one, the others refitted."""
        free = self.free.copy()
        free[i] = True
        index = np.flatnonzero(free)
        basis = np.eye(len(self.x))[:, index]
        if self.tied.size:
            _, s, vt = np.linalg.svd(self.tied[:, index])
            rank = int(np.sum(s > 1e-10 * s.max(initial=0.0)))
            basis = basis @ vt[rank:].T
        column = basis @ (scaled_inverse(basis.T @ self.hessian @ basis) @ basis[i])
        return float(self.covariance[i, i] / column[i]), np.asarray(column / column[i])

    def drop(self, value: float, i: int) -> float:
        """(1) of a value of the criterion."""
        scale, _ = self.path(i)
        return 2 * (value - self.smallest) / scale

    def refit(self, i: int, held: float, start: Array) -> tuple[float, Array]:
        """The drop (1) with an unknown held, and the point (n,); infinite where there is none."""
        x = np.clip(start, self.lower, self.upper)
        x[i] = held
        if len(x) == 1:
            return self.drop(self.criterion.evaluate(x).value, i), x
        nlp = Nlp(f"profile of {self.names[i]}")
        symbols = {}
        bounds = zip(self.lower.tolist(), self.upper.tolist(), strict=True)
        for j, (name, (low, high)) in enumerate(zip(self.names, bounds, strict=True)):
            if j == i:
                low = high = held
            symbols[name] = nlp.variable(
                name, float(x[j]), lower=low, upper=high, scale=self._scales[j]
            )
        nlp.minimize(self.criterion)
        for constraint in self.constraints:
            nlp.equality(constraint(symbols))
        try:
            found = nlp.solve(self.solver, x.tolist(), throw=False, natural_scales=True)
        except OutOfTimeError:
            raise
        except SolveError:
            return np.inf, x
        if not np.isfinite(found.value):
            return np.inf, x
        return self.drop(found.value, i), found.x
