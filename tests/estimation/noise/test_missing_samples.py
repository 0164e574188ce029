"""The noise of records from which samples are missing, and whitening under what there is of it.

Independent truth: dense covariance matrices of the samples that there are, and the simulator of
`tests.support.truth`, whose noise is known.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import irfft

import casid
from casid.arrays import Array, BoolArray
from casid.estimation.errors_in_variables.removal import without_input_noise
from casid.estimation.noise import missing_samples
from casid.estimation.noise.innovations import innovations_of
from casid.estimation.noise.missing_samples import (
    PartialInnovations,
    UnbrokenInnovations,
    unbroken,
)
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from problems import pendulum
from tests.support import truth

OUTPUT, INPUT = 0.01, 0.01  # rad/s, m/s^2: the truth's white noise


def spectrum(omega: Array, ny: int) -> Array:
    """White noise of unit size in every output, and one force that moves all through a peak."""
    z = np.exp(1j * omega)
    gains = np.stack([0.3 / (1 - 1.88 / z + 0.95 / z**2), 0.2 / (1 - 0.8 / z)], axis=1)[:, :ny]
    return np.asarray(np.einsum("fi,fj->fij", gains, gains.conj()) + np.eye(ny))


def covariance(S: Array, N: int) -> Array:
    """(N ny, N ny) of N samples, sample by sample."""
    ny = S.shape[1]
    lags = np.arange(N)[:, None] - np.arange(N)
    out = np.zeros((N * ny, N * ny))
    for i in range(ny):
        for j in range(ny):
            row = irfft(S[:, i, j])
            out[i::ny, j::ny] = row[lags % len(row)]
    return out


def gaps(kind: str, N: int, ny: int, rng: np.random.Generator) -> BoolArray:
    used = np.ones((N, ny), dtype=bool)
    if kind == "a fifth at random":
        return np.asarray(rng.random((N, ny)) > 0.2)
    if kind == "four fifths at random":
        return np.asarray(rng.random((N, ny)) > 0.8)
    if kind == "bursts":
        for first in rng.integers(0, N - 30, 4):
            used[first : first + 30, rng.integers(ny)] = False
    else:
        used[:, -1] = np.arange(N) % 5 == 0
    return used


@pytest.mark.parametrize("few", [0, missing_samples.FEW])
@pytest.mark.parametrize("ny", [1, 2])
@pytest.mark.parametrize("kind", ["a fifth at random", "bursts", "every fifth sample"])
def test_whitened_columns_have_the_inner_products_of_what_there_is(
    monkeypatch: pytest.MonkeyPatch, kind: str, ny: int, few: int
) -> None:
    """a_o' Gamma_oo^-1 b_o, with the dense covariance of the samples that there are.

    By conjugate gradients, and by the projection that there is of few missing samples.
    """
    monkeypatch.setattr(missing_samples, "FEW", few)
    monkeypatch.setattr(missing_samples, "FEW_SEEN", 0)
    N, rng = 300, np.random.default_rng(5)
    omega = np.linspace(0.0, np.pi, 2049)
    S, used = spectrum(omega, ny), gaps(kind, 300, ny, rng)
    partial = PartialInnovations(innovations_of(omega, S, N), used)
    columns = rng.standard_normal((N, ny, 3))
    white = partial.whiten(np.where(used[:, :, None], columns, 1e3)).reshape(-1, 3)
    seen = used.ravel()
    there, flat = covariance(S, N)[np.ix_(seen, seen)], columns.reshape(-1, 3)[seen]
    exact = flat.T @ np.linalg.solve(there, flat)
    assert white.T @ white == pytest.approx(exact, rel=1e-5, abs=1e-5 * np.abs(exact).max())
    # The determinant leaves out what the ends of a record have beside: a few of N ny log units.
    logs = float(np.linalg.slogdet(there)[1])
    assert partial.log_determinant(N) == pytest.approx(logs, abs=0.02 * N * ny)


@pytest.mark.parametrize("ny", [1, 2])
def test_a_few_samples_are_whitened_at_once_by_their_own_covariance(
    monkeypatch: pytest.MonkeyPatch, ny: int
) -> None:
    """The record that they make expected, whitened, has a_o' Gamma_oo^-1 b_o: no step is needed.

    The determinant is that of their covariance, ends of the record and all.
    """
    N, rng, omega = 400, np.random.default_rng(6), np.linspace(0.0, np.pi, 2049)
    S, used = spectrum(omega, ny), gaps("four fifths at random", N, ny, rng)
    partial = PartialInnovations(innovations_of(omega, S, N), used)
    monkeypatch.setattr(partial, "_near", None)
    columns = rng.standard_normal((N, ny, 3))
    white = partial.whiten(np.where(used[:, :, None], columns, 1e3)).reshape(-1, 3)
    seen = used.ravel()
    there, flat = covariance(S, N)[np.ix_(seen, seen)], columns.reshape(-1, 3)[seen]
    exact = flat.T @ np.linalg.solve(there, flat)
    assert white.T @ white == pytest.approx(exact, abs=1e-7 * np.abs(exact).max())
    logs = float(np.linalg.slogdet(there)[1])
    assert partial.log_determinant(N) == pytest.approx(logs, rel=1e-6)


def test_neighbours_that_are_far_are_left_to_the_steps_of_conjugate_gradients(monkeypatch):
    """Four of five samples missing, and noise that lasts 90 samples beside white noise.

    The band of far neighbours, a hundred wide, is for the determinant alone: whitened columns have
    the inner products that its steps end with, and half a dozen steps more cost less than it does.
    """
    monkeypatch.setattr(missing_samples, "FEW", 0)
    monkeypatch.setattr(missing_samples, "FEW_SEEN", 0)
    N, rng, omega = 2000, np.random.default_rng(8), np.linspace(0.0, np.pi, 2049)
    S = (1e-3 + 1e-2 / np.abs(1 + 90j * omega) ** 2)[:, None, None]
    used = np.zeros((N, 1), dtype=bool)
    used[rng.choice(N, N // 5, replace=False)] = True
    partial = PartialInnovations(innovations_of(omega, S, N), used)
    columns = rng.standard_normal((N, 1, 3))
    white = partial.whiten(columns)[:, 0]
    assert "_wide" not in vars(partial)
    steps = []
    monkeypatch.setattr(partial, "_near", lambda b, near=partial._near: steps.append(0) or near(b))
    partial.whiten(columns)
    assert len(steps) < 20
    partial._factor = partial._wide
    wide = partial.whiten(columns)[:, 0]
    assert len(partial._factor) > 100
    np.testing.assert_allclose(white.T @ white, wide.T @ wide, rtol=1e-6, atol=1.0)


def test_a_column_of_a_simulation_that_all_but_diverges_is_whitened_to_no_number(monkeypatch):
    """Its squares are beyond all numbers: a search takes that for a step that is too long."""
    monkeypatch.setattr(missing_samples, "FEW", 0)
    N, rng = 300, np.random.default_rng(5)
    omega = np.linspace(0.0, np.pi, 2049)
    partial = PartialInnovations(
        innovations_of(omega, spectrum(omega, 1), N), gaps("bursts", N, 1, rng)
    )
    columns = rng.standard_normal((N, 1, 2))
    with np.errstate(all="ignore"):
        white = partial.whiten(columns * [1.0, 1e200])
    assert np.isfinite(white).all(axis=(0, 1)).tolist() == [True, False]
    np.testing.assert_allclose(white[:, :, 0], partial.whiten(columns)[:, :, 0], atol=1e-4)


@pytest.mark.parametrize("ny", [1, 2])
def test_a_record_that_lacks_its_ends_is_a_shorter_record(ny: int) -> None:
    """Inner products and determinant are those of the dense covariance of what there is."""
    N, rng = 300, np.random.default_rng(7)
    used = np.ones((N, ny), dtype=bool)
    used[:40], used[-7:] = False, False
    rows = unbroken(used)
    assert rows == slice(40, 293)
    omega = np.linspace(0, np.pi, 2 * N + 1)
    S = spectrum(omega, ny)
    whitener = UnbrokenInnovations(innovations_of(omega, S, 253), rows)
    columns = rng.standard_normal((N, ny, 3))
    e = whitener.whiten(columns).reshape(N * ny, 3)
    there = used.ravel()
    dense = covariance(S, N)[np.ix_(there, there)]
    r = columns.reshape(N * ny, 3)[there]
    # What the whitener leaves out of (2) of `innovations` is worth a hundredth of one sample.
    np.testing.assert_allclose(e.T @ e, r.T @ np.linalg.solve(dense, r), atol=0.05)
    assert whitener.log_determinant(N) == pytest.approx(np.linalg.slogdet(dense)[1], abs=0.05)
    used[150, 0] = False
    assert unbroken(used) is None


def test_completed_residuals_are_white_and_keep_every_inner_product():
    """Of a process with a peak, a third missing: N ordinates of a periodogram with mean one."""
    N, rng = 2000, np.random.default_rng(6)
    omega = np.linspace(0.0, np.pi, 4097)
    S = spectrum(omega, 1)
    used = rng.random((N, 1)) > 0.33
    partial = PartialInnovations(innovations_of(omega, S, N), used)
    root = np.linalg.cholesky(covariance(S, N))
    columns = np.stack([root @ rng.standard_normal(N), rng.standard_normal(N)], axis=1)[:, None, :]
    white = partial.whiten(columns)
    whole = partial.completed(white[:, :, :1], rng)[:, 0, 0]
    # The draw is orthogonal to them as far as conjugate gradients go.
    most = missing_samples.CONVERGED * np.linalg.norm(whole) * np.linalg.norm(white[:, 0, 1])
    assert whole @ white[:, 0, 1] == pytest.approx(white[:, 0, 0] @ white[:, 0, 1], abs=most)
    # One square has the variance 2; without what is missing the mean would be 0.67.
    assert np.mean(whole**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / N))
    for lag in (1, 2, 5):
        assert abs(np.mean(whole[lag:] * whole[:-lag])) < 4 / np.sqrt(N)


def fitted(seed: int, kind: str):
    hidden = truth.cart_pendulum(seed=seed, duration=60.0)
    record = casid.Record(
        {n: c for n, c in hidden.columns.items() if n != "t"},
        {n: u for n, u in hidden.units.items() if n != "t"},
        Ts=hidden.Ts,
    )
    used = gaps(kind, record.N, 1, np.random.default_rng(seed))
    record = record.mark_missing("gyro", ~used[:, 0])
    criterion = SimulationError(pendulum.problem.model, [casid.Experiment(record, {}, "r")])
    return minimize_simulation_error(criterion)


@pytest.mark.parametrize(
    "kind", ["a fifth at random", pytest.param("every fifth sample", marks=pytest.mark.slow)]
)
def test_the_noise_is_that_of_the_samples_that_there_are(kind: str) -> None:
    """No variance is smaller for what is missing: the periodogram's mean is known for any gaps."""
    found = []
    for seed in range(40, 46):
        fit = fitted(seed, kind)
        noise = estimate_noise(fit.criterion, fit.x)
        found.append([noise.output_sd[0], noise.source_sd["accel"]])
    mean = np.mean(found, axis=0)
    # Of 4800 or 1200 samples: sd of an sd 1 or 2 %, 0.4 or 0.8 % for the mean of six. What the
    # input gives shows in a few per cent of the band, folded with the rest where one in five is.
    assert mean[0] == pytest.approx(OUTPUT, rel=0.02 if kind == "a fifth at random" else 0.05)
    assert mean[1] == pytest.approx(INPUT, rel=0.08 if kind == "a fifth at random" else 0.35)


def test_the_bias_of_input_noise_is_removed_where_samples_are_missing():
    """A fifth of the output is missing: the noises found are those of the truth all the same."""
    found = without_input_noise(fitted(40, "a fifth at random"), {})
    assert found.is_removed
    assert found.input_sd is not None
    assert found.noise is not None
    # Of 4800 samples: sd of an sd 1 %; what the input gives shows in a few per cent of the band.
    assert found.noise.output_sd[0] == pytest.approx(OUTPUT, rel=0.05)
    assert found.input_sd["accel"] == pytest.approx(INPUT, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("ny", [1, 2])
def test_drawn_samples_have_the_mean_and_covariance_that_their_neighbours_leave(ny: int):
    """Of a dense Gaussian: mean C_mo C_oo^-1 r_o, covariance C_mm - C_mo C_oo^-1 C_om."""
    N, rng, omega = 80, np.random.default_rng(ny), np.linspace(0, np.pi, 1025)
    used = gaps("a fifth at random", N, ny, rng)
    C = covariance(spectrum(omega, ny), N)
    there = used.ravel()
    residual = rng.multivariate_normal(np.zeros(N * ny), C).reshape(N, ny)
    gain = C[np.ix_(~there, there)] @ np.linalg.inv(C[np.ix_(there, there)])
    mean = gain @ residual.ravel()[there]
    left = C[np.ix_(~there, ~there)] - gain @ C[np.ix_(there, ~there)]
    partial = PartialInnovations(innovations_of(omega, spectrum(omega, ny), N), used)
    draws = np.array([partial.filled(residual * used, rng).ravel() for _ in range(1000)])
    assert np.array_equal(draws[0][there], residual.ravel()[there])
    z = (draws[:, ~there] - mean) @ np.linalg.inv(np.linalg.cholesky(left)).T
    # White z: a mean of 1000 has an sd of 0.032, a variance one of 0.045; some twenty of each.
    assert np.abs(z.mean(axis=0)).max() < 4 * 0.032
    assert np.abs(z.var(axis=0) - 1.0).max() < 4 * 0.045
