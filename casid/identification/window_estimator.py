"""Estimates of a few parameters from windows of a stream, calibrated on a reference stretch.

With the mean moments s_c(theta) = Y_c - Phi_c g(theta, eta) of window c, known parameters eta,

    estimate:  theta_hat = argmin ||s_W(theta) - s_0||^2_{V^-1} + ||theta - start||^2_{P^-1},  (1)
    one step:  u_c = theta_0 + G (s_c(theta_0) - s_0),  G = (J' V^-1 J)^-1 J' V^-1,            (2)

J = Phi dg/dtheta. A reference stretch, on which theta_0 is known, gives V, the covariance of a
window's moments as their spread over its windows (batch means: whatever the colour of the errors,
as long as windows are longer than their memory), and s_0, the moments at theta_0 where model and
system agree, up to noise. Subtracting s_0 (`differential`) removes model errors that are the same
before and after; the calibration's errors then count only as far as they are another error at
another load.

(2) is linear in the moments, so that it needs no iteration, has no bias of short windows, and is
the one-step estimate of the local approach (Benveniste, Basseville & Moustakides 1987, IEEE Trans.
Automatic Control 32, 583-592).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError
from casid.estimation.cross_moments.gram import Moments
from casid.estimation.moments.stages.prior import Prior
from casid.linear.sampled.difference_equation import difference_equation
from casid.linear.sampled.lagged_columns import Column
from casid.model.model import Model
from casid.model.units import difference_to_si


@dataclass(frozen=True, slots=True, eq=False)
class MonitoredParameters:
    """The parameters that may change and the known ones, in the units that the model declares.

    Attributes
    ----------
    known : calibrated parameters with their covariance; those of the model that are neither here
        nor free are taken at their own values, as exact.
    free : parameter -> its value theta_0 on the reference stretch.
    start : free parameter -> its value and standard error before the stream, which counts in the
        estimates as one more measurement; theta_0 without one by default.
    """

    known: Prior
    free: Mapping[str, float]
    start: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        twice = [n for n in self.free if n in self.known.values]
        if twice or not self.free:
            raise ModelError(
                f"monitor: {twice[0] + ' is free and known at once' if twice else 'nothing free'}. "
                "Name what may change in free=, and what was calibrated in known=."
            )


class WindowEstimator:
    """Estimates (1) and (2) from the moments of windows.

    Parameters
    ----------
    model : indirect model with one output, without unknown inputs.
    Ts : sample time [s].
    reference : windows of the reference stretch, in order, made as those to come.
    instruments : columns on channels of the windows, such as `windowed_moments.on_simulated`.
    differential : subtract s_0 of the reference stretch.
    method : discretisation of the model.

    Raises
    ------
    ModelError, DataError, IdentifiabilityError
        As `Monitor`.
    """

    def __init__(
        self,
        model: Model,
        Ts: float,
        parameters: MonitoredParameters,
        reference: Sequence[Moments],
        instruments: Sequence[Column],
        *,
        differential: bool = True,
        method: str = "bilinear",
    ) -> None:
        if len(model.outputs) != 1:
            raise ModelError(
                f"{model.name} has outputs {', '.join(model.outputs)}; one is monitored. Take the "
                "others out of the model, or monitor each."
            )
        for name in (*parameters.known.values, *parameters.free):
            model.parameter_named(name)
        known, free = parameters.known.in_si(model), model.in_si(parameters.free)
        self.differential = differential
        self.free, self.known = tuple(free), tuple(known.values)
        self._equation = difference_equation(model, next(iter(model.outputs)), Ts, method=method)
        self._instruments = tuple(instruments)
        self.values = model.nominal_values | {
            n: float(v) for n, v in {**known.values, **free}.items()
        }
        self._known_covariance = known.matrix()
        given = {
            n: (model.in_si({n: value})[n], float(difference_to_si(error, model.unit_of(n))))
            for n, (value, error) in parameters.start.items()
        }
        start = [given.get(n, (v, math.inf)) for n, v in free.items()]
        self._start = np.array([value for value, _ in start])
        self._prior = np.diag([1.0 / spread**2 for _, spread in start])
        self._theta_0 = np.array([float(v) for v in free.values()])
        self._calibrate(reference)

    def _calibrate(self, reference: Sequence[Moments]) -> None:
        """V, s_0 and G of the reference stretch."""
        n, nz = len(reference), len(self._instruments)
        if n < max(2 * nz, 10):
            raise DataError(
                f"monitor: a reference stretch of {n} windows for {nz} instruments; the spread of "
                f"their moments needs {max(2 * nz, 10)} or more. Record longer, or cut shorter "
                "windows."
            )
        theta, slope, known_slope = self._coefficients(self._theta_0)
        self._coefficients_0 = theta
        pairs = [self._moments(m) for m in reference]
        s = np.stack([Y - Phi @ theta for Y, Phi in pairs])
        self._reference_power = float(np.mean([self._power(m, theta) for m in reference]))
        self._n_reference = n
        mean = s.mean(axis=0)
        self._spread = (s - mean).T @ (s - mean) / (n - 1)
        self._Phi_0 = np.mean([Phi for _, Phi in pairs], axis=0)
        self._known_slope_0 = self._Phi_0 @ known_slope
        self._offset = mean if self.differential else np.zeros(nz)
        size = np.sqrt(np.maximum(np.diag(self._spread), TINY))
        values, vectors = np.linalg.eigh(self._spread / np.outer(size, size))
        keep = values > 1e-10 * values[-1]
        self._root = (vectors[:, keep] / np.sqrt(values[keep])).T / size  # R'R = V^-1
        A = self._root @ self._Phi_0 @ slope
        norms = np.linalg.norm(A, axis=0)
        shares = A / np.where(norms > 0.0, norms, 1.0)
        if len(A) < len(self.free) or np.linalg.svd(shares, compute_uv=False)[-1] < 1e-6:
            lost = [f for f, v in zip(self.free, norms, strict=True) if v == 0.0] or self.free
            point = ", ".join(f"{n} = {v:g}" for n, v in zip(self.free, self._theta_0, strict=True))
            raise IdentifiabilityError(
                f"monitor: at {point} the moments do not "
                f"determine {' and '.join(lost)}. Monitor fewer parameters, take more "
                "instruments, or start from another load."
            )
        self._gain = np.linalg.solve(A.T @ A, A.T @ self._root)

    def one_step(self, window: Moments) -> Array:
        """u_c of (2), (nfree,)."""
        Y, Phi = self._moments(window)
        return np.asarray(
            self._theta_0 + self._gain @ (Y - Phi @ self._coefficients_0 - self._offset)
        )

    def power(self, window: Moments) -> float:
        """Mean square of the equation error at theta_0, relative to the reference stretch."""
        return self._power(window, self._coefficients_0) / self._reference_power

    def _moments(self, window: Moments) -> tuple[Array, Array]:
        phi = (self._equation.left, *self._equation.columns)
        cross = window.between(self._instruments, phi) / float(window.total[-1, -1])
        return cross[:, 0], cross[:, 1:]

    def _power(self, window: Moments, theta: Array) -> float:
        phi = (self._equation.left, *self._equation.columns)
        v = np.concatenate([[1.0], -theta])
        return max(float(v @ window.between(phi, phi) @ v) / float(window.total[-1, -1]), TINY)

    def _coefficients(self, theta_p: Array) -> tuple[Array, Array, Array]:
        """g, dg/d free, dg/d known."""
        names = self._equation.parameters
        at = {**self.values, **dict(zip(self.free, theta_p.tolist(), strict=True))}
        theta, J = self._equation.jacobian([at[n] for n in names])
        J = np.asarray(J)

        def columns(of: Sequence[str]) -> Array:
            zero = np.zeros(len(J))
            found = [J[:, names.index(n)] if n in names else zero for n in of]
            return np.stack(found, axis=1) if found else np.zeros((len(J), 0))

        return np.asarray(theta).ravel(), columns(self.free), columns(self.known)

    def estimate(self, sums: Moments, windows: float) -> tuple[Array, Array]:
        """Free parameters, and the joint covariance of free and known ones, from sums.

        Parameters
        ----------
        sums : of some windows.
        windows : their number; with forgetting, (sum w)^2/(sum w^2).
        """
        Y, Phi = self._moments(sums)
        theta_p, R = self._theta_0.copy(), self._root
        own = self.power(sums) / windows
        # V of the window, and of s_0
        factor = own + (1.0 / self._n_reference if self.differential else 0.0)

        def cost(point: Array) -> float:
            e = R @ (Y - Phi @ self._coefficients(point)[0] - self._offset)
            d = point - self._start
            return float(e @ e) / factor + float(d @ self._prior @ d)

        value = cost(theta_p)
        for _ in range(50):
            theta, slope, _ = self._coefficients(theta_p)
            A = R @ Phi @ slope
            e = R @ (Y - Phi @ theta - self._offset)
            H = A.T @ A / factor + self._prior
            gradient = A.T @ e / factor - self._prior @ (theta_p - self._start)
            step = np.linalg.solve(H, gradient)
            if gradient @ step < 1e-8:  # a ten-thousandth of a standard error from the optimum
                break
            size = 1.0
            while (new := cost(theta_p + size * step)) > value and size > 1e-8:
                size *= 0.5
            if size <= 1e-8:
                break
            theta_p, value = theta_p + size * step, new
        else:
            raise SolveError(
                f"monitor: no estimate of {', '.join(self.free)} after 50 steps of Gauss-Newton. "
                "Take a longer span, or give prior knowledge of them in start=."
            )
        _, slope, known_slope = self._coefficients(theta_p)
        A = R @ Phi @ slope
        H = A.T @ A / factor + self._prior
        D = Phi @ known_slope - (self._known_slope_0 if self.differential else 0.0)
        inverse = np.linalg.inv(H)
        T = -inverse @ A.T @ R @ D / factor
        n = len(self.free)
        joint = np.zeros((n + len(self.known),) * 2)
        joint[:n, :n] = inverse + T @ self._known_covariance @ T.T
        joint[:n, n:] = T @ self._known_covariance
        joint[n:, :n] = joint[:n, n:].T
        joint[n:, n:] = self._known_covariance
        return theta_p, joint
