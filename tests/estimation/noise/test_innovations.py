"""Whitening by prediction from the past is whitening by the covariance of the whole record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from casid.estimation.noise import innovations
from casid.estimation.noise.innovations import innovations_of

OMEGA = np.linspace(0.0, np.pi, 2049)
Z = np.exp(-1j * OMEGA)


def one() -> np.ndarray:
    """White noise, and a resonance that rings on for a thousand samples."""
    pole = 0.995 * np.exp(0.1j)
    force = 1 / ((1 - pole * Z) * (1 - pole.conjugate() * Z))
    return (abs(force) ** 2 + 1.0)[:, None, None]


def two() -> np.ndarray:
    """One force of order two that moves two outputs, each with white noise of its own."""
    force = 1 / (1 - 1.6 * Z + 0.8 * Z**2)
    g = np.stack([force, (1 - Z) * force], axis=1)
    return np.einsum("fi,fj->fij", g, g.conj()) + np.diag([0.01, 0.04])


def apart() -> np.ndarray:
    """Two outputs with nothing in common."""
    return two() * np.eye(2)


def three() -> np.ndarray:
    """A slow force on three outputs, and white noise that is a hundredth of what it moves."""
    slow = 1 / (1 - 0.99 * Z)
    g = np.stack([slow, slow / (1 - 0.8 * Z), (1 - Z) * slow], axis=1)
    return np.einsum("fi,fj->fij", g, g.conj()) + np.diag([0.25, 4.0, 0.01])


def covariance(spectrum: np.ndarray, N: int) -> np.ndarray:
    """(N n, N n) of a record, straight from the autocovariances."""
    G = np.fft.irfft(spectrum, axis=0)
    lags = toeplitz(np.arange(N))
    rows = [[G[lags[t, s]] if t >= s else G[lags[t, s]].T for s in range(N)] for t in range(N)]
    return np.block(rows)


@pytest.mark.parametrize("spectrum", [one, two, apart, three])
def test_the_sum_of_squares_is_that_under_the_covariance_of_the_whole_record(spectrum):
    """With its determinant, from the first sample on: neither end of a record is an edge."""
    S, N = spectrum(), 60
    n = S.shape[1]
    whole = covariance(S, N)
    r = np.random.default_rng(1).standard_normal((N, n, 3))
    flat = r.reshape(N * n, 3)
    found = innovations_of(OMEGA, S, N)
    e = found.whiten(r).reshape(N * n, 3)
    assert e.T @ e == pytest.approx(flat.T @ np.linalg.solve(whole, flat), rel=1e-6, abs=1e-6)
    assert found.log_determinant(N) == pytest.approx(np.linalg.slogdet(whole)[1], abs=1e-5)


@pytest.mark.parametrize("spectrum", [one, two, apart, three])
def test_a_record_is_whitened_sample_by_sample(spectrum):
    """The covariance of what comes out is the unit matrix."""
    S, N = spectrum(), 60
    n = S.shape[1]
    every = np.eye(N * n).reshape(N, n, N * n)
    white = innovations_of(OMEGA, S, N).whiten(every).reshape(N * n, N * n)
    assert white @ covariance(S, N) @ white.T == pytest.approx(np.eye(N * n), abs=1e-6)


def test_the_filter_of_a_process_of_order_two_has_its_two_coefficients():
    """And what is unknown at its start is its state: two numbers."""
    found = innovations_of(OMEGA, (abs(1 / (1 - 1.6 * Z + 0.8 * Z**2)) ** 2)[:, None, None], 500)
    coefficients = np.fft.irfft(found.inverse[0, 0], found.size)
    assert coefficients[:4] == pytest.approx([1.0, -1.6, 0.8, 0.0], abs=1e-9)
    assert len(found.added) == 2


def test_what_is_whitened_has_unit_covariance_and_no_memory():
    rng, N = np.random.default_rng(2), 20_000
    force = lfilter([1.0], [1.0, -1.6, 0.8], rng.standard_normal(N))
    r = np.column_stack([force, np.diff(force, prepend=0.0)])
    r += rng.standard_normal((N, 2)) * [0.1, 0.2]
    e = innovations_of(OMEGA, two(), N).whiten(r[:, :, None])[:, :, 0]
    for lag in range(4):
        expected = np.eye(2) if lag == 0 else np.zeros((2, 2))
        assert e[lag:].T @ e[: N - lag] / N == pytest.approx(expected, abs=5 / np.sqrt(N))


def test_parts_of_a_long_record_are_whitened_as_the_whole():
    """The filter is forgotten to 1e-12 where it ends; rounding of its taps adds a few of these."""
    N = 20_000  # twice as many are a length of fast transforms
    omega = np.linspace(0.0, np.pi, N + 1)
    force = 1 / (1 - 1.6 * np.exp(-1j * omega) + 0.8 * np.exp(-2j * omega))
    power = abs(force) ** 2 + 0.1
    found = innovations_of(omega, power[:, None, None] * np.diag([1.0, 4.0]), N)
    assert found.taps is not None
    columns = np.random.default_rng(4).standard_normal((N, 2, 3))
    whole = replace(found, taps=None).whiten(columns)
    assert found.whiten(columns) == pytest.approx(whole, abs=1e-11 * float(np.abs(whole).max()))


@pytest.mark.parametrize(("samples", "calls"), [(40, 1), (1900, 2), (30_000, 30)])
def test_few_transforms_whiten_a_record_by_a_filter_of_two_taps(monkeypatch, samples, calls):
    """z_k - a z_(k-1) in parts of 1024 samples: eight at a time took thousands of calls."""
    taps, columns = np.array([[[1.0, -0.4]]]), np.random.default_rng(0).normal(size=(samples, 1, 3))
    parts, whole = [], innovations.filtered

    def counted(*arguments):
        parts.append(1)
        return whole(*arguments)

    monkeypatch.setattr(innovations, "filtered", counted)
    found = innovations._in_parts(taps, columns)
    expected = lfilter([1.0, -0.4], [1.0], columns, axis=0)
    assert found == pytest.approx(expected, abs=1e-12)
    assert len(parts) <= calls


def test_a_filter_that_remembers_the_record_is_not_cut():
    assert innovations_of(OMEGA, one(), 2000).taps is None


def test_no_columns_stay_none():
    assert innovations_of(OMEGA, two(), 50).whiten(np.zeros((50, 2, 0))).shape == (50, 2, 0)


def test_outputs_that_one_source_moves_are_whitened_though_they_have_no_noise():
    """Their spectrum has rank one at every frequency, and is large in its units."""
    force = 1e5 / (1 - 0.9 * Z)
    g = np.stack([force, 4.5 * force], axis=1)
    found = innovations_of(OMEGA, np.einsum("fi,fj->fij", g, g.conj()), 60)
    drive = np.random.default_rng(2).standard_normal(400)
    r = 1e5 * lfilter([1.0], [1.0, -0.9], drive)[-60:]
    e = found.whiten(np.stack([r, 4.5 * r], axis=1)[:, :, None])[:, :, 0]
    assert e[1:, 0] == pytest.approx(drive[-59:], rel=1e-2, abs=1e-2)
    assert np.isfinite(found.log_determinant(60))
