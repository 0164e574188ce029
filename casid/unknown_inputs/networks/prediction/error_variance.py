"""The exact variance of filtered white noise, and its innovations form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from casid.algebra.rational import Rational
from casid.algebra.realisation import matrices
from casid.algebra.transfer_matrix import RationalMatrix
from casid.arrays import Array
from casid.errors import ModelError
from casid.linear.filtering.kalman import Predictor, steady_state
from casid.linear.filtering.noisy_system import NoisySystem
from casid.unknown_inputs.networks.network import Signal


def noise_system(
    filters: Mapping[str, Rational], sources: Mapping[str, Signal], Ts: float = 1.0
) -> NoisySystem:
    """v = sum_n filters[n] tau_n as x+ = A x + w, v = C x + n, with tau_n = H_n e_n, e_n white.

    Raises
    ------
    ModelError
        If a filter is improper or holds parameters without a value.
    """
    names = [n for n in filters if sources[n].variance > 0 and not filters[n].is_zero]
    if not names:
        empty = np.zeros((0, 0))
        return NoisySystem(
            empty, np.zeros((0, 0)), np.zeros((1, 0)), np.zeros((1, 0)), empty, np.zeros((1, 1))
        )
    row = RationalMatrix((tuple(filters[n] * sources[n].model for n in names),))
    A, B, C, D = matrices(row)
    L = np.diag([sources[n].variance for n in names])
    return NoisySystem(
        A,
        np.zeros((len(A), 0)),
        C,
        np.zeros((1, 0)),
        _symmetric(B @ L @ B.T),
        _symmetric(D @ L @ D.T),
        B @ L @ D.T,
        Ts,
    )


def variance(filters: Mapping[str, Rational], sources: Mapping[str, Signal]) -> float:
    """E v^2 of v = sum_n filters[n] tau_n: infinite where a filter is not stable.

    The squared H2 norm, by the Lyapunov equation of a realisation.
    """
    used = [n for n in filters if sources[n].variance > 0]
    if not all((filters[n] * sources[n].model).is_stable for n in used):
        return float("inf")
    s = noise_system(filters, sources)
    if not s.nx:
        return float(s.R[0, 0])
    P = solve_discrete_lyapunov(s.A, s.Q)
    return float((s.C @ P @ s.C.T + s.R)[0, 0])


def innovations(
    filters: Mapping[str, Rational], sources: Mapping[str, Signal], Ts: float = 1.0
) -> Predictor:
    """The spectral factor H of v = H eps, as the steady-state predictor of v from its own past.

    (2.32)-(2.34): H = C (qI - A)^-1 K + 1, eps of variance F.

    Raises
    ------
    ModelError
        If v has no term that is new at every sample, or a mode on the unit circle keeps the
        Riccati equation from a solution.
    """
    s = noise_system(filters, sources, Ts)
    if s.R[0, 0] <= 0:
        raise ModelError(
            f"the error of {' + '.join(filters)} has no term without delay, so it has no "
            "innovations form; add the disturbance of the node itself"
        )
    return steady_state(s)


def spectrum(
    filters: Mapping[str, Rational], sources: Mapping[str, Signal], omega: Sequence[float]
) -> Array:
    """(F,) spectrum of v at frequencies [rad/sample]; its mean over -pi to pi is E v^2."""
    z = np.exp(1j * np.asarray(omega, dtype=float))
    total = np.zeros(z.shape)
    for n, f in filters.items():
        total += sources[n].variance * np.abs((f * sources[n].model).response(z)) ** 2
    return total


def _symmetric(M: Array) -> Array:
    return np.asarray(0.5 * (M + M.T))
