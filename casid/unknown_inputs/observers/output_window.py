"""Windows of outputs that determine the unknown input at their start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import ModelError
from casid.linear.filtering.kalman import steady_state
from casid.linear.filtering.noisy_system import NoisySystem
from casid.linear.subspaces import (
    TOLERANCE,
    input_scale,
    null_space,
    pseudo_inverse,
    row_space,
    size,
    unobservable_subspace,
)
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem


def output_window(s: UnknownInputSystem, sd: Array) -> tuple[int, Array, Array, Array]:
    """The shortest window that determines u[t]: its delay L, O, K and N."""
    units = input_scale(s.E, s.F)
    column, power = [s.F / units], s.E / units  # the impulse response, for J
    O = s.C  # noqa: E741
    scale = TOLERANCE * max(size(column[0]), size(s.C) * size(power), TINY)
    for delay in range(s.nx + 1):
        J = _block_toeplitz(column)
        weight = np.tile(1 / sd, delay + 1)[:, None]
        K0 = pseudo_inverse(weight * J, scale * float(np.max(weight))) * weight.T
        wanted = np.eye(s.nu, J.shape[1])
        K = wanted @ K0
        if np.max(np.abs(K @ J - wanted)) < 1e-7:
            return delay, O, K / units[:, None], null_space(J.T, scale).T
        column.append(s.C @ power)
        power = s.A @ power
        O = np.vstack([s.C, O @ s.A])  # noqa: E741
    raise ModelError(
        f"{s.name}: no window of outputs determines {', '.join(s.unknown)} (at tolerance "
        f"{TOLERANCE:g}); check the units, signals may be of very different sizes"
    )


def _block_toeplitz(column: Sequence[Array]) -> Array:
    """J: block (i, j) is the impulse response after i - j samples."""
    rows, zero = len(column), np.zeros_like(column[0])
    return np.block([[column[i - j] if i >= j else zero for j in range(rows)] for i in range(rows)])


def observer_gain(
    s: UnknownInputSystem, A: Array, window: Array, E_K: Array, N: Array, sd: Array
) -> Array:
    """H that stabilises the states observed by N, of least variance if windows did not overlap.

    window ((L+1) ny, nx) is O, E_K (nx, (L+1) ny) what the noise of a window does to the states.
    """
    V = unobservable_subspace(A, N @ window, 1e-8)
    observed = row_space(np.eye(s.nx) - V @ V.T, 0.5).T
    U = (
        row_space((N @ window @ observed).T, TOLERANCE * max(size(s.C), TINY))
        if len(N)
        else N[:0, :0]
    )
    if observed.shape[1] == 0 or len(U) == 0:
        return np.zeros((s.nx, len(N)))
    NU = U @ N
    R = np.diag(sd**2)
    into = observed.T @ E_K
    Q = into @ R @ into.T
    Q = Q + 1e-6 * max(float(np.trace(Q)) / len(Q), TINY) * np.eye(len(Q))
    noisy = NoisySystem(
        observed.T @ A @ observed,
        np.zeros((observed.shape[1], 0)),
        NU @ window @ observed,
        np.zeros((len(NU), 0)),
        Q,
        NU @ R @ NU.T,
        -into @ R @ NU.T,
        s.Ts,
    )
    return np.asarray(observed @ steady_state(noisy).K @ U)
