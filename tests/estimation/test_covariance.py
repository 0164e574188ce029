"""Covariances are those of the textbook sums, and cover what repeated experiments show."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import casid
from casid.arrays import scaled_inverse
from casid.estimation.covariance import (
    autocorrelation,
    bartlett_lags,
    long_run_covariance,
    robust_covariance,
    sample_through,
    sandwich,
    taken_by_fit,
    whiteness,
)
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError


def test_the_inverse_of_an_information_keeps_its_digits_in_any_units():
    """(S M S)^-1 = S^-1 M^-1 S^-1 for units S that differ by 18 orders: cond(M) rounding errors."""
    rng = np.random.default_rng(5)
    T = rng.normal(size=(30, 4))
    M, S = T.T @ T, np.diag(10.0 ** np.array([-9, -2, 3, 9]))
    wanted = np.linalg.inv(S) @ np.linalg.inv(M) @ np.linalg.inv(S)
    assert scaled_inverse(S @ M @ S) == pytest.approx(wanted, rel=1e-12)


def test_a_direction_without_information_has_no_part_in_the_inverse():
    """The sum of two unknowns that act alike is known, their difference is left out."""
    t = np.random.default_rng(5).normal(size=(30, 1))
    T = np.hstack([t, t])
    assert scaled_inverse(T.T @ T) @ T.T @ (3 * t[:, 0]) == pytest.approx([1.5, 1.5], rel=1e-12)


@pytest.mark.parametrize("lags", [0, 1, 7, 40])
def test_the_long_run_covariance_is_the_bartlett_sum(lags):
    """Sum of w_l Gamma_l, w_l = 1 - |l| / (L + 1) (Newey and West 1987, (5))."""
    s = np.random.default_rng(3).normal(size=(200, 3)) @ np.array(
        [[1.0, 0.5, 0.0], [0.0, 2.0, 1.0], [0.0, 0.0, 0.1]]
    )
    c = s - s.mean(axis=0)
    total = c.T @ c
    for lag in range(1, lags + 1):
        gamma = c[lag:].T @ c[:-lag]
        total += (1 - lag / (lags + 1)) * (gamma + gamma.T)
    assert long_run_covariance(s, lags) == pytest.approx(total, rel=1e-9, abs=1e-9)


def test_the_number_of_lags_follows_andrews_for_a_first_order_autoregression():
    """1.1447 (alpha(1) n)^(1/3), alpha(1) = 4 rho^2 / ((1 - rho)^2 (1 + rho)^2) (Andrews 1991)."""
    n, rho = 4000, 0.8
    s = lfilter([1.0], [1.0, -rho], np.random.default_rng(3).normal(size=n))[:, None]
    wanted = 1.1447 * (4 * rho**2 / ((1 - rho) ** 2 * (1 + rho) ** 2) * n) ** (1 / 3)
    # sd of the estimated rho is 0.0095; it moves the number by 1.7 % a 0.01.
    assert bartlett_lags(s) == pytest.approx(wanted, rel=0.10)
    assert bartlett_lags(np.random.default_rng(4).normal(size=(n, 1))) <= 5


def test_white_residuals_give_the_least_squares_covariance():
    """H^-1 (sum s s') H^-1 with unit weights is sigma^2 (J'J)^-1 (Ljung 1999, (9.42))."""
    rng = np.random.default_rng(3)
    J, n = rng.normal(size=(4000, 2)), 4000
    r = 0.5 * rng.normal(size=n)
    P, _ = sandwich(J.T @ J, J * r[:, None], np.array([True, True]))
    theory = 0.25 * np.linalg.inv(J.T @ J)
    # A variance from n samples has relative error sqrt(2 / n) = 2 %; some lags add as much each.
    assert np.diag(P) == pytest.approx(np.diag(theory), rel=0.12)


@pytest.mark.parametrize("lags", [0, 3, 60])
def test_what_a_fit_takes_of_its_scores_is_the_bartlett_sum(lags):
    """Sum over k and |l| <= L of w_l A_k H^-1 A_{k-l}, A_k = J_k' J_k, of 50 samples."""
    J = np.random.default_rng(3).normal(size=(50, 2, 3))
    A, P = np.einsum("kin,kim->knm", J, J), np.linalg.inv(np.einsum("kin,kim->nm", J, J))
    total = np.zeros((3, 3))
    length = min(lags, 49) + 1
    for k in range(50):
        for m in range(max(k - length + 1, 0), min(k + length, 50)):
            total += (1 - abs(k - m) / length) * A[k] @ P @ A[m]
    assert taken_by_fit(J, P, lags) == pytest.approx(total, rel=1e-9, abs=1e-12)


def test_the_error_of_what_one_sample_determines_is_that_of_the_sample():
    """A knock takes all of the error out of its sample: its scores say that it is exact."""
    n, sd = 400, 0.5
    rng = np.random.default_rng(3)
    J = np.stack([rng.normal(size=n), np.arange(n) == 200], axis=1)
    free, H = np.ones(2, dtype=bool), J.T @ J
    found, without, z = [], [], []
    for _ in range(200):
        e = sd * rng.normal(size=n)
        x = np.linalg.lstsq(J, e, rcond=None)[0]
        r = e - J @ x
        P, _ = robust_covariance([r[:, None]], [J[:, None, :]], H, free)
        found.append(P[1, 1])
        without.append(sandwich(H, J * r[:, None], free)[0][1, 1])
        z.append(x[1] / np.sqrt(P[1, 1]))
    # sd^2 times 1 and the relative error of a variance from 400 samples, sqrt(2 / 400) = 7 %.
    assert np.mean(found) == pytest.approx(sd**2, rel=0.03)
    assert np.max(without) < 1e-2 * sd**2
    # 200 draws of a standard normal: 95 % within 1.96, give or take 3 times 1.5 %.
    assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=0.046)


def test_a_constraint_takes_its_direction_out_of_the_covariance():
    rng = np.random.default_rng(3)
    J = rng.normal(size=(500, 3))
    A = np.array([[1.0, -2.0, 0.5]])
    P, _ = sandwich(J.T @ J, J * rng.normal(size=(500, 1)), np.ones(3, dtype=bool), A)
    assert A @ P @ A.T == pytest.approx(np.zeros((1, 1)), abs=1e-12)
    assert np.linalg.matrix_rank(P, tol=1e-9) == 2


def test_a_parameter_at_its_bound_has_no_variance():
    rng = np.random.default_rng(3)
    J = rng.normal(size=(500, 2))
    P, _ = sandwich(J.T @ J, J * rng.normal(size=(500, 1)), np.array([True, False]))
    assert P[1, 1] == 0.0
    assert P[0, 0] > 0.0


def test_autocorrelation_is_that_of_the_definition():
    r = np.random.default_rng(3).normal(size=300)
    c = r - r.mean()
    wanted = [float(c[k:] @ c[:-k] / (c @ c)) for k in range(1, 11)]
    assert autocorrelation(r, 10) == pytest.approx(wanted, abs=1e-12)


def test_white_noise_leaves_the_band_as_rarely_as_it_says_and_coloured_noise_often():
    white = np.random.default_rng(3).normal(size=(50, 2000))
    outside = sum(whiteness(w) for w in white)
    # Binomial(1000, 0.05): mean 50, sd 6.9; four of them.
    assert 50 - 28 <= outside <= 50 + 28
    assert whiteness(lfilter([1.0], [1.0, -0.9], white[0])) >= 10


def test_draws_that_fail_are_left_out_and_their_share_is_reported():
    """sqrt of N(1, 1) fails with probability Phi(-1) = 0.1587."""
    drawn = sample_through(
        lambda x: np.sqrt(x), np.array([1.0]), np.array([[1.0]]), draws=10_000, seed=3
    )
    sd = np.sqrt(0.1587 * 0.8413 / 10_000)
    assert drawn.share_invalid == pytest.approx(0.1587, abs=4 * sd)
    assert len(drawn.values) == round(10_000 * (1 - drawn.share_invalid))


def test_a_linear_map_of_draws_has_the_covariance_of_the_linear_map():
    P = np.array([[2.0, 0.6], [0.6, 1.0]])
    a = np.array([1.0, -2.0])
    drawn = sample_through(lambda x: a @ x, np.array([3.0, 1.0]), P, draws=20_000, seed=3)
    sd = float(np.sqrt(a @ P @ a))
    assert drawn.mean[0] == pytest.approx(1.0, abs=4 * sd / np.sqrt(20_000))
    assert drawn.std[0] == pytest.approx(sd, rel=4 / np.sqrt(2 * 20_000))
    low, high = drawn.interval(0.95)[:, 0]
    assert high - low == pytest.approx(2 * 1.96 * sd, rel=0.05)
    assert drawn.share_invalid == 0.0


def test_draws_that_the_caller_calls_invalid_are_left_out():
    drawn = sample_through(
        lambda x: x, np.array([0.0]), np.eye(1), draws=4000, seed=3, valid=lambda v: v[0] > 0
    )
    assert drawn.share_invalid == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(4000))
    assert np.all(drawn.values > 0)


def _first_order() -> casid.Model:
    m = casid.Model("first order")
    x = m.state("x", "m", initial=0.0)
    u = m.input("u", "m", hold="zoh", known=True)
    a = m.parameter("a", "1/s", start=1.0, lower=0.01)
    b = m.parameter("b", "1/s", start=1.0)
    m.derivative(x, -a * x + b * u)
    m.output("y", x, "m")
    return m


def test_standard_errors_cover_repeated_experiments_with_coloured_noise():
    """The sandwich holds for autocorrelated residuals (Newey and West 1987); white errors do not.

    The input is slow, so that the noise, AR(1) with rho = 0.8, has up to (1 + rho) / (1 - rho) = 9
    times the power of white noise of the same size where the estimate listens.
    """
    Ts, n, runs, rho = 0.1, 600, 60, 0.8
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 20 + 1), 20)[:n]
    decay = np.exp(-Ts)
    clean = lfilter([0.0, 1 - decay], [1.0, -decay], u)
    found, sandwiches, naive = [], [], []
    for _ in range(runs):
        e = lfilter([1.0], [1.0, -rho], rng.normal(size=n + 100))[100:] * np.sqrt(1 - rho**2)
        record = casid.Record({"u": u, "y": clean + 0.05 * e}, {"u": "m", "y": "m"}, Ts=Ts)
        criterion = SimulationError(_first_order(), [casid.Experiment(record, {}, "r")])
        fit = minimize_simulation_error(criterion, check_rank=False)
        H, s = fit.solution.hessian, criterion.scores(fit.x)
        P, _ = sandwich(H, s, np.array([True, True]))
        found.append(fit.x)
        sandwiches.append(np.sqrt(np.diag(P)))
        naive.append(np.sqrt(np.diag(np.linalg.inv(H)) * 2 * fit.solution.value / n))
    empirical = np.std(found, axis=0, ddof=1)
    ratio = np.mean(sandwiches, axis=0) / empirical
    # The empirical sd of 60 runs has relative error 1 / sqrt(118) = 9 %: three of them; Bartlett's
    # weights lose up to a tenth of the long-run variance at this length.
    assert np.all(ratio > 1 - 0.28 - 0.05)
    assert np.all(ratio < 1 + 0.28)
    assert np.all(np.mean(naive, axis=0) / empirical < 0.6)
    bias = np.abs(np.mean(found, axis=0) - 1.0)
    assert np.all(bias < 4 * empirical / np.sqrt(runs) + 0.01)
