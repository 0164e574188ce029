"""One point of a nonlinear regression: fit, tangent space, distance from the optimum."""

from __future__ import annotations

import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.regression.regression_problem import RegressionProblem

_OFFSET = 1e-6  # relative offset of a converged fit; Bates & Watts (1981) are content with 1e-3


class RegressionPoint:
    """Everything about one theta: a QR factor of J on the free directions carries most of it.

    With columns scaled to length one (D), constraints A D = active rows, Z a basis of their null
    space and J D Z = Q R, the Gauss-Newton step is -D Z inv(R) Q'r, the covariance
    s^2 D Z inv(R) inv(R)' Z' D, and the relative offset |Q'r| / |r|.
    """

    def __init__(self, problem: RegressionProblem, theta: Array) -> None:
        with np.errstate(all="ignore"):
            r, J, curvature = problem.residuals(theta)
            g, A = problem.constraints_at(theta)
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
        self._find_active(A, scale)
        self._factorize()

    def _find_active(self, A: Array, scale: Array) -> None:
        """Bounds and constraints that hold the optimum back, and the directions that are free."""
        problem, theta = self.problem, self.theta
        low, high = np.array(problem.constraint_limits).reshape(-1, 2).T
        gradient = self.J.T @ self.r
        lower, upper = np.array(problem.limits).T
        span = 1e-7 * np.maximum(np.abs(problem.start), 1e-3)
        at_lower, at_upper = theta <= lower + span, theta >= upper - span
        self.held = (at_lower & (gradient > 0)) | (at_upper & (gradient < 0)) | (lower == upper)
        near = np.abs(np.array([low - self.g, high - self.g]))
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

    def _factorize(self) -> None:
        """J on the free directions as Q R, its rank, and the relative offset."""
        tangent = (self.J * self.d) @ self.Z
        self.Q, self.R = np.linalg.qr(tangent)
        self.singular_values = np.linalg.svd(self.R, compute_uv=False)
        tolerance = 10 * np.finfo(float).eps * max(tangent.shape)
        top = self.singular_values[0] if self.singular_values.size else 1.0
        self.rank = int(np.sum(self.singular_values > tolerance * max(top, TINY)))
        self.dof = len(self.r) - self.Z.shape[1]
        self.is_deficient = self.rank < self.Z.shape[1]
        projected = self._project(self.r)
        self.offset = float(np.linalg.norm(projected)) / max(float(np.sqrt(self.rss)), TINY)
        # Below the rounding of the model's own evaluation no direction of r means anything.
        self.rounding = 4 * np.finfo(float).eps * self.problem.level
        small = self.offset < _OFFSET or float(np.linalg.norm(projected)) < 25 * self.rounding
        self.is_stationary = bool(small and self.violation < 1e-8)

    @property
    def is_optimum(self) -> bool:
        """True if it is stationary and the only such point nearby."""
        return self.is_stationary and not self.is_deficient

    def is_better_than(self, other: RegressionPoint) -> bool:
        """True if it violates less, has a lower rss beyond rounding, or is nearer to stationary."""
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
            curvature = curvature + self.problem.constraint_curvature(self.theta, lam)
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
        """The directions that the data do not determine, in words."""
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


def polished(problem: RegressionProblem, theta: Array) -> RegressionPoint:
    """Newton steps in QR form until they gain nothing.

    Ipopt works with J'J, whose condition is that of J squared: up to half of the digits are
    lost. The steps here solve least-squares problems in J and gain them back.
    """
    point = RegressionPoint(problem, theta)
    lower, upper = np.array(problem.limits).T
    for _ in range(40):
        if not point.is_usable:
            return point
        step = point.newton_step()
        for shorten in 0.5 ** np.arange(12):
            shortened = np.clip(point.theta + shorten * step, lower, upper)
            candidate = RegressionPoint(problem, shortened)
            if candidate.is_better_than(point):
                break
        else:
            return point
        point = candidate
    return point
