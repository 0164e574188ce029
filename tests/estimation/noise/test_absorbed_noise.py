"""What a fit takes out of the spectrum of its residual, against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest

from casid.arrays import Array
from casid.estimation.noise.absorbed_noise import absorbed
from casid.estimation.noise.noise_response import Response


@pytest.mark.parametrize("N", [64, 65])
def test_the_residual_of_a_fit_has_the_mean_periodogram_that_dense_matrices_give(N: int) -> None:
    """Periodic noise through two gains, three sensitivities, weights of their own: exact."""
    rng, ny, n = np.random.default_rng(N), 2, 3
    omega = np.linspace(0.0, np.pi, 2 * N + 1)
    z = np.exp(1j * omega)
    gain = np.stack([1 / (1 - 0.7 / z), 0.5 / z / (1 - 0.4 / z)], axis=1)[:, :, None]
    T, W = rng.standard_normal((2, N, ny, n))
    change = absorbed([Response(omega, np.abs(gain) ** 2, ("u",), gain)], [T], [W])[0]
    B = W.reshape(-1, n) @ np.linalg.inv(T.reshape(-1, n).T @ W.reshape(-1, n))
    left = np.eye(N * ny) - T.reshape(-1, n) @ B.T

    def periodogram(covariance: Array) -> Array:
        root = np.linalg.eigh(covariance)
        columns = (root.eigenvectors * np.sqrt(np.maximum(root.eigenvalues, 0.0))).T
        lines = np.fft.rfft(columns.reshape(-1, N, ny), axis=1)
        return np.sum(np.abs(lines) ** 2, axis=0) / N

    steps = 2 * np.pi * np.arange(N) / N
    on_circle = np.stack([np.interp(np.minimum(steps, 2 * np.pi - steps), omega, g.real)
                          + 1j * np.sign(np.pi - steps)
                          * np.interp(np.minimum(steps, 2 * np.pi - steps), omega, g.imag)
                          for g in gain[:, :, 0].T], axis=1)  # fmt: skip
    on_circle[steps == np.pi] = on_circle[steps == np.pi].real
    impulse = np.fft.ifft(on_circle, axis=0).real
    G = np.zeros((N, ny, N))
    for k in range(N):
        G[:, :, k] = np.roll(impulse, k, axis=0)
    flat = G.reshape(N * ny, N)
    both = {2: flat @ flat.T} | {i: np.diag(np.tile(np.eye(ny)[i], N)) for i in range(ny)}
    for source, covariance in both.items():
        expected = periodogram(left @ covariance @ left.T) - periodogram(covariance)
        assert change[:, :, source] == pytest.approx(expected, rel=1e-6, abs=1e-6)
