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
from numpy.typing import NDArray

from casid.asymptotics.second_moments import circle
from casid.prediction.polynomial_orders import Layout

Array = NDArray[Any]
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


@dataclass(frozen=True, slots=True, eq=False)
class PredictionCriterion:
    """(1) on a grid.

    Attributes
    ----------
    signals : (M, 1 + nu, ne) response of y and the inputs from the externals on the full circle.
    variances : (ne,).
    """

    layout: Layout
    signals: Array
    variances: Array

    def variance(self, theta: Expr) -> Expr:
        """V as a CasADi expression of theta (n,)."""
        points = len(self.signals)
        half = points // 2 + 1
        weight = np.full(half, 2.0)
        weight[[0, -1]] = 1.0
        factors = self._factors()[:half] * np.sqrt(weight)[:, None, None]
        z = circle(points)[:half]
        n, columns = factors.shape[1:]
        data = [z.real, z.imag]
        data += [part[:, i, k] for k in range(columns) for i in range(n) for part in
                 (factors.real, factors.imag)]  # fmt: skip
        one = self._at_one_point(n, columns)
        every = one.map("every", "serial", half, [0], [])
        return ca.sum2(every(theta, ca.DM(np.array(data)))) / (2 * points)

    def _factors(self) -> Array:
        """(M, 1 + nu, k) whose products with their conjugate transposes are the spectra."""
        scaled = self.signals * np.sqrt(self.variances)
        if scaled.shape[2] <= scaled.shape[1]:
            return np.asarray(scaled)
        values, vectors = np.linalg.eigh(scaled @ np.conj(np.swapaxes(scaled, 1, 2)))
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])

    def _at_one_point(self, n: int, columns: int) -> Any:
        """The weighted |eps|^2 at one frequency: (theta, [re z, im z, factors]) -> number."""
        theta, row = ca.SX.sym("theta", self.layout.n), ca.SX.sym("row", 2 + 2 * n * columns)
        p = _Parts(self.layout, theta, _Complex(row[0], row[1]))
        front = p.D.over(p.C)
        modules = [b.over(f) for b, f in zip(p.B, p.F, strict=True)]
        total: Expr = 0
        for k in range(columns):
            own = row[2 + 2 * n * k : 2 + 2 * n * (k + 1)]
            signals = [_Complex(own[2 * i], own[2 * i + 1]) for i in range(n)]
            inside = p.A.times(signals[0])
            for module, signal in zip(modules, signals[1:], strict=True):
                inside = inside.minus(module.times(signal))
            eps = front.times(inside)
            total += eps.re**2 + eps.im**2
        return ca.Function("one", [theta, row], [total])

    def errors(self, theta: Array) -> tuple[Array, Array]:
        """Responses of eps (M, 1, ne) and of -d eps/d theta (M, n, ne) at theta."""
        z = circle(len(self.signals))
        p = self.layout.split(theta)
        A, C, D = (_value(c, z) for c in (p.A, p.C, p.D))
        B, F = [_value(c, z) for c in p.B], [_value(c, z) for c in p.F]
        y, inputs = self.signals[:, 0], np.moveaxis(self.signals[:, 1:], 1, 0)
        modules = [
            (b / f)[:, None] * u for b, f, u in zip(B, F, inputs, strict=True)
        ]  # each (M, ne)
        inside = A[:, None] * y - sum(modules, np.zeros_like(y))
        front = (D / C)[:, None]
        eps = front * inside
        # Each slope is a signal, delayed by the coefficient's lag.
        rows = [-_delayed(front * y, k, z) for k in range(1, self.layout.na + 1)]
        for u, f, nb, nk in zip(inputs, F, self.layout.nb, self.layout.nk, strict=True):
            rows += [_delayed(front * u / f[:, None], k, z) for k in range(nk, nk + nb)]
        rows += [_delayed(eps / C[:, None], k, z) for k in range(1, self.layout.nc + 1)]
        rows += [-_delayed(inside / C[:, None], k, z) for k in range(1, self.layout.nd + 1)]
        for m, f, nf in zip(modules, F, self.layout.nf, strict=True):
            rows += [-_delayed(front * m / f[:, None], k, z) for k in range(1, nf + 1)]
        return eps[:, None, :], np.stack(rows, axis=1)


def _value(coefficients: Array, z: Array) -> Array:
    return np.asarray(np.polynomial.polynomial.polyval(1 / z, coefficients))


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
