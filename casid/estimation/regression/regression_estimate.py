"""The estimate of a nonlinear regression: values, their errors, and evidence of an optimum."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from casid.arrays import Array
from casid.errors import IdentifiabilityError, ModelError, nearest
from casid.grouping import Grouped
from casid.presentation import Presented


@dataclass(frozen=True, slots=True)
class Attempt:
    """One solve on the way to the estimate."""

    hessian: str
    status: str
    iterations: int
    rss: float  # after the polish; infinite where the solver stopped without a point
    is_optimum: bool


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of the response, and their statistics."""

    residuals: Array  # (N,) response - prediction
    rss: float  # sum of squared residuals, response units squared
    dof: int  # N minus the free directions

    @property
    def N(self) -> int:
        """Number of data."""
        return len(self.residuals)


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """Whether the values are an optimum, and a unique one."""

    attempt: Attempt  # the one that was kept
    solver: str
    relative_offset: float  # |projection of r on the tangent plane| / |r|: 0 at an optimum
    constraint_violation: float
    at_bound: tuple[str, ...]
    rank: int  # of J on the free directions
    singular_values: Array  # (rank,) of J there, columns scaled to length one, descending


@dataclass(frozen=True, slots=True, eq=False)
class RegressionEstimate(Presented):
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
    fit: Residuals
    optimum: Optimum
    attempts: tuple[Attempt, ...]
    notes: tuple[str, ...] = ()
    _predict: Callable[[Mapping[str, Any]], Array] = field(
        repr=False, default=lambda _: np.empty(0)
    )

    @property
    def residual_sd(self) -> float:
        """Residual standard deviation sqrt(rss / dof), response units; NaN without dof."""
        return float(np.sqrt(self.rss / self.dof)) if self.dof > 0 else float("nan")

    rss: ClassVar[Grouped[float]] = Grouped("fit")
    N: ClassVar[Grouped[int]] = Grouped("fit")  # Number of data
    dof: ClassVar[Grouped[int]] = Grouped("fit")  # N minus the free directions
    residuals: ClassVar[Grouped[Array]] = Grouped("fit")  # (N,) response - prediction
    rank: ClassVar[Grouped[int]] = Grouped("optimum")  # Rank of J on the free directions
    singular_values: ClassVar[Grouped[Array]] = Grouped("optimum")
    relative_offset: ClassVar[Grouped[float]] = Grouped("optimum")
    constraint_violation: ClassVar[Grouped[float]] = Grouped("optimum")
    at_bound: ClassVar[Grouped[tuple[str, ...]]] = Grouped("optimum")
    solver: ClassVar[Grouped[str]] = Grouped("optimum")  # Name of the solver

    @property
    def hessian(self) -> str:
        """The Hessian of the attempt that was kept."""
        return self.optimum.attempt.hessian

    @property
    def status(self) -> str:
        """The solver's status in that attempt."""
        return self.optimum.attempt.status

    @property
    def iterations(self) -> int:
        """The solver's iterations in that attempt."""
        return self.optimum.attempt.iterations

    def __getitem__(self, name: str) -> float:
        """The value of a parameter."""
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
