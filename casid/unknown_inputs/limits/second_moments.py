"""Covariances of linear forms of signals, and long-run covariances of their products.

With a = A x and b = B x, rows of stationary zero-mean signals, the mean over N samples of
f_k = a_k(t) b_k(t) has covariance Q / N with

    Q_kl = sum_tau { r_akal(tau) r_bkbl(tau) + r_akbl(tau) r_bkal(tau) } + kurtosis            (1)

over all lags tau (Isserlis 1918, for Gaussian externals); each external with excess kurtosis
kappa adds kappa lambda^2 m_k m_l, m_k = sum_t h_a(t) h_b(t) with the impulse responses from it.
In frequency, sum_tau r_1 r_2 is the mean of S_1 conj(S_2) over the circle. On M points
its error is the remainder of the responses after M samples, about the square of that after
M/2: rounding, once they have died out to 1e-8 there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.algebra.exact_field import ExactField
from casid.arrays import Array
from casid.errors import ModelError
from casid.linear.filters import Filter, as_filter, require_stable
from casid.unknown_inputs.limits.linear_signals import LinearSignals

Atom = tuple[str, int, bool]
"""A signal, its lag in samples, and whether it is prefiltered."""

FIRST_POINTS = 64
MOST_POINTS = 2**18
_DIED_OUT = 1e-8  # of the largest value of a signal's impulse responses, within half the grid
_ROUNDING = 1e-15  # of the largest value of all: where terms cancel, this remains


@dataclass(frozen=True, slots=True, eq=False)
class SecondMoments:
    """Moments of atoms x = G e, static or on a frequency grid.

    Attributes
    ----------
    G : (M, n, ne) response on M points of the circle; M = 1 for a static system. Floats, complex
        numbers or field elements.
    variances : (ne,) of the externals, kurtosis : (ne,) excess.
    second : (n, n) E x x'.
    field : of the elements, where they are symbolic.
    """

    atoms: tuple[Atom, ...]
    G: Array
    variances: Array
    kurtosis: Array
    second: Array
    field: ExactField | None

    def row(self, terms: Sequence[tuple[Atom, Any]]) -> Array:
        """A linear form (n,) of the atoms."""
        made = self.zeros(len(self.atoms))
        for atom, value in terms:
            made[self.atoms.index(atom)] += value
        return made

    def zeros(self, *shape: int) -> Array:
        """Zeros of the kind of numbers used here."""
        return np.zeros(shape, dtype=object if self.field else float)

    def variance(self, form: Array) -> Any:
        """Variance of a linear form (n,), a sum of squares."""
        response = form @ self.G
        if self.field is not None:
            return np.sum(response[0] * response[0] * self.variances)
        return float(np.mean(np.abs(response) ** 2 @ self.variances))

    def product_covariance(self, A: Array, B: Array) -> Array:
        """Q (p, p) of (1), for A and B (p, n)."""
        U, V = A @ self.G, B @ self.G
        return product_covariance(U, V, self.variances, self.kurtosis)


def product_covariance(U: Array, V: Array, variances: Array, kurtosis: Array) -> Array:
    """Q (p, p) of (1) from the responses U of a and V of b, (M, p, ne); M = 1 where static."""
    UH, VH = _hermitian(U), _hermitian(V)
    aa, bb = (U * variances) @ UH, (V * variances) @ VH
    ab, ba = (U * variances) @ VH, (V * variances) @ UH
    weights = kurtosis * variances * variances
    if U.dtype == object:
        m = U[0] * V[0]
        return np.asarray(aa[0] * bb[0] + ab[0] * ba[0] + (m * weights) @ m.T)
    m = np.real(np.mean(U * np.conj(V), axis=0))
    second = np.real(np.mean(aa * np.conj(bb) + ab * np.conj(ba), axis=0))
    return np.asarray(second + (m * weights) @ m.T)


def second_moments(
    system: LinearSignals,
    atoms: Sequence[Atom],
    prefilter: Filter | None = None,
) -> SecondMoments:
    """The moments of these atoms.

    Parameters
    ----------
    atoms : distinct.
    prefilter : L(q) of the atoms that are prefiltered.

    Raises
    ------
    ModelError
        If the responses last too long for the finest grid.
    """
    names = list(dict.fromkeys(name for name, _, _ in atoms))
    variances = list(system.variances.values())
    kurtosis = [system.excess_kurtosis.get(name, 0.0) for name in system.externals]
    is_static = system.is_static and prefilter is None and not any(k for _, k, _ in atoms)
    if is_static:
        G = system.gains(names)[[names.index(name) for name, _, _ in atoms]]
        if not system.symbols:
            G, weights = G.astype(float)[None], np.array(variances, dtype=float)
            second = G[0] @ (weights[:, None] * G[0].T)
            return SecondMoments(tuple(atoms), G, weights, np.array(kurtosis), second, None)
        field = ExactField([*G.ravel(), *variances])
        G, weights = field.of(G), field.of(np.array(variances, dtype=object))
        second = G @ (weights[:, None] * G.T)
        extra = field.of(np.array(kurtosis, dtype=object))
        return SecondMoments(tuple(atoms), G[None], weights, extra, second, field)
    if system.symbols:
        raise ModelError(
            f"lags or a prefilter on a system with the symbols "
            f"{', '.join(map(str, system.symbols))}: put numbers in their place with system.at"
        )
    G = settled_response(system, atoms, names, prefilter)
    weights = np.array(variances, dtype=float)
    second = np.real(np.mean((G * weights) @ _hermitian(G), axis=0))
    return SecondMoments(tuple(atoms), G, weights, np.array(kurtosis), second, None)


def checked_prefilter(prefilter: Any, system: LinearSignals) -> Filter:
    """A prefilter as a filter, stable and of the system's sample time.

    Raises
    ------
    ModelError
        If it is neither.
    """
    made = as_filter(prefilter, "prefilter")
    require_stable(made, "prefilter")
    own = system.Ts
    if made.Ts is not None and own is not None and not np.isclose(made.Ts, own, rtol=1e-9, atol=0):
        raise ModelError(
            f"prefilter has sample time {made.Ts:g} s, the system {own:g} s; resample it"
        )
    return made


def circle(points: int) -> Array:
    """So many points of the unit circle, from z = 1."""
    return np.asarray(np.exp(2j * np.pi * np.arange(points) / points))


def delay_polynomial(coefficients: Array, z: Array) -> Array:
    """A polynomial in 1/z, constant term first, at points z (F,)."""
    return np.asarray(np.polynomial.polynomial.polyval(1 / z, coefficients))


def settled_response(
    system: LinearSignals,
    atoms: Sequence[Atom],
    names: Sequence[str],
    prefilter: Filter | None = None,
    points: int = FIRST_POINTS,
) -> Array:
    """Response (M, n, ne) on a grid so fine that impulse responses die out in half of it.

    Raises
    ------
    ModelError
        If `MOST_POINTS` are not enough: some filter hardly forgets, or is not stable.
    """
    # A delay beyond the grid would be aliased into it: begin with more points than that.
    reach = system.reach + max((k for _, k, _ in atoms), default=0)
    reach += prefilter.reach if prefilter is not None else 0
    while points < 4 * (reach + 1):
        points *= 2
    while True:
        G = _on_grid(system, atoms, names, prefilter, points)
        impulse = np.roll(np.abs(np.fft.ifft(G, axis=0)), system.lead, axis=0)
        lasting = impulse[points // 2 :].max(axis=(0, 2)) > _negligible(impulse)
        if not lasting.any():
            return G
        if points >= MOST_POINTS:
            slow = dict.fromkeys(n for (n, _, _), is_slow in zip(atoms, lasting, strict=True)
                                 if is_slow)  # fmt: skip
            raise ModelError(
                f"the responses of {', '.join(slow)} have not died out after {points // 2} "
                "samples: a pole is too near the unit circle, or the response is not stable and "
                "causal. Sample more slowly, or give the stable closed loop"
            )
        points *= 2


def _on_grid(
    system: LinearSignals,
    atoms: Sequence[Atom],
    names: Sequence[str],
    prefilter: Filter | None,
    points: int,
) -> Array:
    """Response (M, n, ne) of the atoms on M points."""
    z = circle(points)
    per_name = system.response(z, names)
    filtered = prefilter(z) if prefilter is not None else np.ones(points)
    G = np.empty((points, len(atoms), per_name.shape[2]), dtype=complex)
    for i, (name, lag, is_filtered) in enumerate(atoms):
        factor = z ** (-lag) * (filtered if is_filtered else 1.0)
        G[:, i, :] = factor[:, None] * per_name[:, names.index(name), :]
    return G


def _negligible(impulse: Array) -> Array:
    """(n,) what counts as zero of each signal's impulse responses (M, n, ne)."""
    each = impulse.max(axis=(0, 2))
    return np.asarray(np.maximum(_DIED_OUT * each, _ROUNDING * each.max(initial=0.0)))


def _hermitian(values: Array) -> Array:
    return _conjugate(np.swapaxes(values, -1, -2))


def _conjugate(values: Array) -> Array:
    return values if values.dtype == object else np.conj(values)
