"""The exact variance of the one-step prediction error as a function of the coefficients.

    eps = (D/C) (A y - sum_i (B_i/F_i) u_i),   V(theta) = 1/2 E eps^2                          (1)

(2.19) and (2.36)-(2.38) of Linder (2017) for infinitely many samples: V is a mean over frequencies,
exact up to rounding once impulse responses have died out in half the grid. C and F enter through
reflection coefficients in (-1, 1), whose image under the Levinson recursion is every stable
polynomial (Barndorff-Nielsen and Schou 1973), so that the bounds of the program keep them stable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.nlp.solution import Evaluation
from casid.estimation.prediction_error.polynomial.orders import Layout
from casid.unknown_inputs.limits.second_moments import circle, delay_polynomial

Expr = Any


def step_up(reflection: list[Any]) -> list[Any]:
    """The monic polynomial's free coefficients from its reflection coefficients."""
    a: list[Any] = []
    for k in reflection:
        a = [own + k * mirrored for own, mirrored in zip(a, reversed(a), strict=True)] + [k]
    return a


def step_down(coefficients: Array) -> Array:
    """Reflection coefficients of a stable monic polynomial from its free coefficients."""
    a, found = np.asarray(coefficients, dtype=float), []
    while len(a):
        k = a[-1]
        found.append(k)
        a = (a[:-1] - k * a[-2::-1]) / (1 - k * k) if len(a) > 1 else a[:0]
    return np.array(found[::-1])


class PredictionCriterion:
    """(1) on a grid.

    Parameters
    ----------
    signals : (M, 1 + nu, ne) response of y and the inputs from the externals on the full circle.
    variances : (ne,).
    """

    n_constraints = 0

    def __init__(self, layout: Layout, signals: Array, variances: Array) -> None:
        self.layout, self.signals, self.variances = layout, signals, variances
        self.z = circle(len(signals))
        half = len(signals) // 2 + 1
        self._weight = np.full(half, 2.0 / len(signals))
        self._weight[[0, -1]] /= 2  # frequencies that occur once on the circle
        self._half, self._factors = self.z[:half], self._spectral_factors()[:half]
        self.unit = max(float(np.sum(self._weight @ np.abs(self._factors[:, 0]) ** 2)), TINY)
        x = ca.SX.sym("x", layout.n)
        theta = ca.vertcat(*self._from_reflections(ca.vertsplit(x) if layout.n else []))
        self._theta = ca.Function("theta", [x], [theta, ca.jacobian(theta, x)])

    # -- coordinates -------------------------------------------------------------------------

    def blocks(self) -> list[tuple[int, int, bool]]:
        """First index, length, and whether it is kept stable, of each polynomial in theta."""
        own = self.layout
        sizes = [(own.na, False), *((n, False) for n in own.nb)]
        sizes += [(own.nc, True), (own.nd, False), *((n, True) for n in own.nf)]
        made, place = [], 0
        for n, stable in sizes:
            made.append((place, n, stable))
            place += n
        return made

    def _from_reflections(self, x: list[Any]) -> list[Any]:
        made: list[Any] = []
        for first, n, stable in self.blocks():
            own = x[first : first + n]
            made += step_up(own) if stable else own
        return made

    def theta_of(self, x: Array) -> Array:
        """Coefficients (n,) from reflection coefficients in the place of C and F."""
        return np.array(self._theta(x)[0]).ravel()

    def x_of(self, theta: Array) -> Array:
        """Reflection coefficients in the place of those of C and F."""
        x = theta.copy()
        for first, n, stable in self.blocks():
            if stable and n:
                x[first : first + n] = step_down(theta[first : first + n])
        return x

    # -- values ------------------------------------------------------------------------------

    def evaluate(self, x: Array) -> Evaluation:
        """V / E y^2, gradient and Gauss-Newton matrix in reflection coefficients x (n,)."""
        values, slopes = self._theta(x)
        J = np.array(slopes)
        V, gradient, matrix = self.at(np.array(values).ravel())
        return Evaluation(V / self.unit, J.T @ gradient / self.unit, J.T @ matrix @ J / self.unit)

    def at(self, theta: Array) -> tuple[float, Array, Array]:
        """V, its gradient (n,) and E psi psi' (n, n) at theta."""
        eps, psi = _errors(self.layout, theta, self._factors, self._half)
        rows = np.concatenate([psi, eps], axis=1) * np.sqrt(self._weight)[:, None, None]
        n = self.layout.n
        flat = np.moveaxis(rows, 1, 0).reshape(n + 1, -1)
        total = np.real(flat @ np.conj(flat.T))
        return 0.5 * float(total[n, n]), -total[:n, n], total[:n, :n]

    def errors(self, theta: Array) -> tuple[Array, Array]:
        """Responses of eps (M, 1, ne) and of -d eps/d theta (M, n, ne) at theta."""
        return _errors(self.layout, theta, self.signals, self.z)

    def curvature(self, theta: Array) -> Array:
        """V'' = E psi psi' - E psi' eps (n, n) at theta, exact."""
        n, columns = self._factors.shape[1:]
        data = [self._half.real, self._half.imag, self._weight]
        for k in range(columns):
            for i in range(n):
                data += [self._factors[:, i, k].real, self._factors[:, i, k].imag]
        every = self._curvature_at_one_point(n, columns).map(len(self._half))
        parts = np.array(every(np.tile(theta[:, None], len(self._half)), np.array(data)))
        size = self.layout.n
        return np.asarray(parts.reshape(size, len(self._half), size).sum(axis=1))

    def _spectral_factors(self) -> Array:
        """(M, 1 + nu, k) whose products with their conjugate transposes are the spectra."""
        scaled = self.signals * np.sqrt(self.variances)
        if scaled.shape[2] <= scaled.shape[1]:
            return np.asarray(scaled)
        values, vectors = np.linalg.eigh(scaled @ np.conj(np.swapaxes(scaled, 1, 2)))
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])

    def _curvature_at_one_point(self, n: int, columns: int) -> Any:
        """Hessian of half the weighted |eps|^2 at one frequency, of theta and a row of data."""
        theta, row = ca.SX.sym("theta", self.layout.n), ca.SX.sym("row", 3 + 2 * n * columns)
        p = _Parts(self.layout, theta, _Complex(row[0], row[1]))
        front = p.D.over(p.C)
        modules = [b.over(f) for b, f in zip(p.B, p.F, strict=True)]
        total: Expr = 0
        for k in range(columns):
            own = row[3 + 2 * n * k : 3 + 2 * n * (k + 1)]
            signals = [_Complex(own[2 * i], own[2 * i + 1]) for i in range(n)]
            inside = p.A.times(signals[0])
            for module, signal in zip(modules, signals[1:], strict=True):
                inside = inside.minus(module.times(signal))
            eps = front.times(inside)
            total += 0.5 * row[2] * (eps.re**2 + eps.im**2)
        hessian, _ = ca.hessian(total, theta)
        return ca.Function("hessian", [theta, row], [ca.densify(hessian)])


def _errors(layout: Layout, theta: Array, signals: Array, z: Array) -> tuple[Array, Array]:
    """Responses of eps (M, 1, k) and of -d eps/d theta (M, n, k)."""
    p = layout.split(theta)
    A, C, D = (delay_polynomial(c, z) for c in (p.A, p.C, p.D))
    B, F = [delay_polynomial(c, z) for c in p.B], [delay_polynomial(c, z) for c in p.F]
    y, inputs = signals[:, 0], np.moveaxis(signals[:, 1:], 1, 0)
    modules = [(b / f)[:, None] * u for b, f, u in zip(B, F, inputs, strict=True)]
    inside = A[:, None] * y - sum(modules, np.zeros_like(y))
    front = (D / C)[:, None]
    eps = front * inside
    # Each slope is a signal, delayed by the coefficient's lag.
    rows = [-_delayed(front * y, k, z) for k in range(1, layout.na + 1)]
    for u, f, nb, nk in zip(inputs, F, layout.nb, layout.nk, strict=True):
        rows += [_delayed(front * u / f[:, None], k, z) for k in range(nk, nk + nb)]
    rows += [_delayed(eps / C[:, None], k, z) for k in range(1, layout.nc + 1)]
    rows += [-_delayed(inside / C[:, None], k, z) for k in range(1, layout.nd + 1)]
    for m, f, nf in zip(modules, F, layout.nf, strict=True):
        rows += [-_delayed(front * m / f[:, None], k, z) for k in range(1, nf + 1)]
    return eps[:, None, :], np.stack(rows, axis=1)


def _delayed(signal: Array, lag: int, z: Array) -> Array:
    return np.asarray(signal * (z ** (-lag))[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class _Complex:
    """A complex CasADi number."""

    re: Expr
    im: Expr

    def times(self, o: _Complex) -> _Complex:
        return _Complex(self.re * o.re - self.im * o.im, self.re * o.im + self.im * o.re)

    def over(self, o: _Complex) -> _Complex:
        size = o.re**2 + o.im**2
        return _Complex(
            (self.re * o.re + self.im * o.im) / size, (self.im * o.re - self.re * o.im) / size
        )

    def minus(self, o: _Complex) -> _Complex:
        return _Complex(self.re - o.re, self.im - o.im)


class _Parts:
    """The polynomials of theta at one point z of the unit circle."""

    def __init__(self, layout: Layout, theta: Expr, z: _Complex) -> None:
        back = _Complex(z.re, -z.im)  # 1 / z
        longest = max([layout.longest_lag, layout.nc, layout.nd, *layout.nf, 1])
        powers = [_Complex(ca.SX(1), ca.SX(0)), back]
        while len(powers) <= longest:
            powers.append(powers[-1].times(back))
        place = 0

        def take(n: int, first: int, monic: bool) -> _Complex:
            """The next polynomial of `theta` at z: `n` coefficients from the power `first` on."""
            nonlocal place
            own = ca.vertsplit(theta[place : place + n]) if n else []
            place += n
            made = _Complex(ca.SX(1 if monic else 0), ca.SX(0))
            for value, power in zip(own, powers[first : first + n], strict=True):
                made = _Complex(made.re + value * power.re, made.im + value * power.im)
            return made

        self.A = take(layout.na, 1, True)
        self.B = [take(n, k, False) for n, k in zip(layout.nb, layout.nk, strict=True)]
        self.C, self.D = take(layout.nc, 1, True), take(layout.nd, 1, True)
        self.F = [take(n, 1, True) for n in layout.nf]
