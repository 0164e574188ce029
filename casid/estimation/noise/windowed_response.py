"""What white noise of a source leaves of records that are simulated window by window.

Each window begins in a state of its own, which is fitted. A source adds to it from its beginning
on, and the fit of the state takes out what an initial state makes up for: of an unstable model
nearly all, as that magnifies both alike. With g the pulse response of the sampled model, H the
triangular matrix of its shifts within a window of L samples, and Q an orthonormal basis of what
initial states do there, the outputs have the mean spectra

    S_ik(w) = 1/L sum_s f(w)^H [R_i]_s [R_k]_s^H f(w),    R = (1 - Q Q') H,                     (1)

f(w) = exp(j w t). A frequency response would count what is summed or grows without end, at
frequencies that no window contains.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import rfft

from casid.arrays import Array, basis_of
from casid.errors import SolveError

COLUMNS = 128
"""Instants of a window at which a pulse is tried, at most: (1) is a mean over all of them."""


def windowed_spectra(
    slopes: tuple[Array, Array, Array, Array, Array], samples: int, weights: Array, omega: Array
) -> Array:
    """(F, ny, ny, ns) spectra and cross-spectra (1) of each source's white noise of unit variance.

    Parameters
    ----------
    slopes : of one sample, A (nx, nx), B0 and B1 (nx, ns) of the sources at a sample and at the
        next one, C (ny, nx), D (ny, ns).
    samples : of a window.
    weights : (ny,) of the outputs in the fit of the initial states.
    omega : (F,) rad/sample.
    """
    a, b0, b1, c, d = slopes
    ny, ns = d.shape
    free, pulse = [c], [d + c @ b1]
    state = b0 + a @ b1
    for _ in range(samples - 1):
        free.append(free[-1] @ a)
        pulse.append(c @ state)
        state = a @ state
    if not (np.isfinite(free).all() and np.isfinite(pulse).all()):
        raise SolveError(
            f"the response to noise overflows within a window of {samples} samples; change the "
            "start values, or fix a parameter"
        )
    g, weighted = np.array(pulse), weights[:, None]
    basis = basis_of((np.array(free) * weighted).reshape(samples * ny, -1))
    starts = np.unique(np.linspace(0, samples - 1, min(samples, COLUMNS)).astype(int))
    grid = np.linspace(0, np.pi, samples + 1)
    out = np.zeros((len(omega), ny, ny, ns), dtype=complex)
    for j in range(ns):
        H = np.zeros((samples, ny, len(starts)))
        for column, first in enumerate(starts):
            H[first:, :, column] = g[: samples - first, :, j]
        H[0, :, 0] = d[:, j]  # what leads to the first sample is part of the initial state
        flat = (H * weighted).reshape(samples * ny, -1)
        left = (flat - basis @ (basis.T @ flat)).reshape(H.shape) / weighted
        lines = rfft(left, 2 * samples, axis=0)
        mean = np.einsum("fis,fks->fik", lines, lines.conj()) / len(starts)
        for i in range(ny):
            for k in range(ny):
                out[:, i, k, j] = np.interp(omega, grid, mean[:, i, k])
    return out
