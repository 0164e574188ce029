"""Kalman predictors as statements of theory: (2.29)-(2.35) of Linder (2017)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest
from scipy import linalg
from scipy.stats import chi2, multivariate_normal

from casid.data.record import Record
from casid.errors import ModelError
from casid.linear.filtering.kalman import (
    SystemTangent,
    gain_tangent,
    log_likelihood,
    steady_state,
    time_varying,
)
from casid.linear.filtering.noisy_system import NoisySystem, sample_noise, sample_system

Array = np.ndarray[Any, Any]
NAMES = "ABCDQSR"


def system(seed: int = 0, nx: int = 3, ny: int = 2, nu: int = 1) -> NoisySystem:
    """A random stable system whose process and measurement noise are correlated."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((nx, nx))
    A *= 0.9 / np.max(np.abs(np.linalg.eigvals(A)))
    B, C, D = (rng.standard_normal(shape) for shape in ((nx, nu), (ny, nx), (ny, nu)))
    G = rng.standard_normal((nx + ny, nx + ny))
    joint = G @ G.T
    return NoisySystem(A, B, C, D, joint[:nx, :nx], joint[nx:, nx:], joint[:nx, nx:], Ts=0.1)


def record(s: NoisySystem, N: int, seed: int, P0: Array | None = None) -> tuple[Array, Array]:
    """Inputs and outputs of the system, sample by sample."""
    rng = np.random.default_rng(seed)
    joint = np.block([[s.Q, s.S], [s.S.T, s.R]])
    noise = rng.multivariate_normal(np.zeros(s.nx + s.ny), joint, size=N, method="cholesky")
    u = rng.standard_normal((N, s.B.shape[1]))
    x = np.zeros(s.nx) if P0 is None else rng.multivariate_normal(np.zeros(s.nx), P0)
    y = np.empty((N, s.ny))
    for t in range(N):
        y[t] = s.C @ x + s.D @ u[t] + noise[t, s.nx :]
        x = s.A @ x + s.B @ u[t] + noise[t, : s.nx]
    return y, u


def integrator(q: float = 0.01, r: float = 1.0) -> NoisySystem:
    """A random walk seen in noise: K and P in closed form."""
    return NoisySystem([[1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)), [[q]], [[r]])  # type: ignore[arg-type]


# -- steady state ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_steady_state_is_a_fixed_point_of_the_riccati_recursion(seed: int) -> None:
    s = system(seed)
    p = steady_state(s)
    cross = s.A @ p.P @ s.C.T + s.S
    again = s.A @ p.P @ s.A.T + s.Q - cross @ np.linalg.inv(p.F) @ cross.T  # (2.31)
    np.testing.assert_allclose(again, p.P, rtol=0, atol=1e-12 * np.max(p.P))
    np.testing.assert_allclose(p.K @ p.F, cross, atol=1e-12 * np.max(p.P))  # (2.30)
    assert np.max(np.abs(p.poles)) < 1


def test_newton_from_a_neighbour_finds_the_same_steady_state() -> None:
    s = system(2)
    cold, neighbour = steady_state(s), steady_state(replace(s, Q=1.5 * s.Q, R=2 * s.R))
    warm = steady_state(s, near=neighbour.P)
    np.testing.assert_allclose(warm.P, cold.P, atol=1e-12 * np.max(cold.P))
    # A neighbour whose gain does not stabilise is no start: the answer is the same again.
    unstable = replace(s, A=3 * s.A)
    nothing = steady_state(unstable, near=np.zeros((3, 3)))
    np.testing.assert_allclose(nothing.P, steady_state(unstable).P, rtol=1e-9)


def test_random_walk_in_noise_has_the_gain_of_the_quadratic() -> None:
    """P^2 = q P + q r for A = C = 1, so P = (q + sqrt(q^2 + 4 q r)) / 2."""
    q, r = 0.01, 2.0
    p = steady_state(integrator(q, r))
    exact = (q + np.sqrt(q**2 + 4 * q * r)) / 2
    assert p.P[0, 0] == pytest.approx(exact, rel=1e-12)
    assert p.K[0, 0] == pytest.approx(exact / (exact + r), rel=1e-12)


def test_innovations_form_factors_the_spectrum_of_the_noise() -> None:
    """H F H* equals the spectrum of C (qI - A)^-1 w + v on the unit circle (2.34)."""
    s = system(3)
    p = steady_state(s)
    joint = np.block([[s.Q, s.S], [s.S.T, s.R]])
    for angle in np.linspace(0.05, 3.1, 17):
        resolvent = np.linalg.inv(np.exp(1j * angle) * np.eye(s.nx) - s.A)
        through = np.hstack([s.C @ resolvent, np.eye(s.ny)])
        H = s.C @ resolvent @ p.K + np.eye(s.ny)
        spectrum = through @ joint @ through.conj().T
        np.testing.assert_allclose(H @ p.F @ H.conj().T, spectrum, rtol=1e-10, atol=1e-10)


def test_python_control_gets_the_innovations_form() -> None:
    s = system(1)
    p = steady_state(s)
    form = p.to_control()
    assert form.dt == s.Ts
    z = np.exp(0.7j)
    resolvent = np.linalg.inv(z * np.eye(s.nx) - s.A)
    both = np.hstack([s.C @ resolvent @ s.B + s.D, s.C @ resolvent @ p.K + np.eye(s.ny)])
    np.testing.assert_allclose(form(z), both, rtol=1e-12)
    # Driven by the innovations, the form gives the outputs back.
    y, u = record(s, 50, 2)
    e = p.run(y, u).innovations
    back = control.forced_response(form, inputs=np.hstack([u, e]).T).outputs.T
    np.testing.assert_allclose(back, y, atol=1e-10)


def test_signals_have_their_channels_names_where_the_system_has_them() -> None:
    s = replace(system(1), inputs=("rudder",), outputs=("roll", "yaw"), states=("p", "q", "r"))
    p = steady_state(s)
    form = p.to_control()
    assert form.input_labels == ["rudder", "innovation roll", "innovation yaw"]
    assert form.output_labels == ["roll", "yaw"]
    assert steady_state(system(1)).to_control().input_labels[0] == "u1"
    radius = float(np.max(np.abs(p.poles)))
    assert repr(p) == (
        f"<Predictor of roll, yaw: 3 states, 1 inputs, Ts = 0.1 s, slowest pole {radius:.4g}>"
    )


def test_a_record_is_refused_with_the_arrays_that_it_holds() -> None:
    s = replace(system(1), inputs=("rudder",), outputs=("roll", "yaw"))
    y, u = record(s, 50, 2)
    held = Record(
        {"roll": y[:, 0], "yaw": y[:, 1], "rudder": u[:, 0]},
        {"roll": "rad", "yaw": "rad", "rudder": "rad"},
        Ts=0.1,
    )
    p = steady_state(s)
    with pytest.raises(ModelError, match="y is a Record; give an array") as error:
        p.run(held)  # type: ignore[arg-type]
    mend = str(error.value).split("y=")[1]
    again = eval(mend, {"np": np, "record": held})
    np.testing.assert_array_equal(again, y)
    with pytest.raises(ModelError, match=r"u=np.column_stack\(\[record\['rudder'\]\]\)"):
        p.run(y, {"rudder": u[:, 0]})  # type: ignore[arg-type]
    np.testing.assert_array_equal(p.run(again, u).innovations, p.run(y, u).innovations)
    with pytest.raises(ModelError, match=r"the system has 2 outputs and 1 inputs; give y \(N, 2\)"):
        p.run(y[:, :1], u)
    with pytest.raises(ModelError, match=r"give y \(N, 2\)"):
        p.run(np.float64(1.0))  # type: ignore[arg-type]


def test_python_control_finds_the_same_gain() -> None:
    """`control.dlqe` knows no correlation of the noises, so S = 0; L is the predictor's gain."""
    s = system(5)
    s = replace(s, S=np.zeros((s.nx, s.ny)))
    L, P, _ = control.dlqe(s.A, np.eye(s.nx), s.C, s.Q, s.R)
    p = steady_state(s)
    np.testing.assert_allclose(p.P, P, rtol=1e-8, atol=1e-9 * np.max(P))
    np.testing.assert_allclose(p.K, L, rtol=1e-8, atol=1e-9)


def test_innovations_are_white_and_of_the_covariance_that_is_claimed() -> None:
    s = system(2)
    y, u = record(s, 6000, 5)
    white = steady_state(s).run(y, u).whitened[50:]
    N, lags = len(white), 20
    # sum over lags of N trace(C_l C_l') is chi-squared with ny^2 degrees of freedom a lag.
    products = [white[i:].T @ white[: N - i] / N for i in range(lags + 1)]
    portmanteau = N * sum(float(np.sum(c**2)) for c in products[1:])
    assert portmanteau < chi2.ppf(0.999, lags * s.ny**2)
    # Var of an entry of the sample covariance of white normals: 2/N on the diagonal, 1/N off it.
    np.testing.assert_allclose(products[0], np.eye(s.ny), atol=4 * np.sqrt(2 / N))


def test_prediction_error_is_no_smaller_with_another_gain() -> None:
    s = system(4)
    p = steady_state(s)
    for shift in np.random.default_rng(0).standard_normal((5, s.nx, s.ny)):
        K = p.K + 1e-3 * shift
        noise = s.Q - s.S @ K.T - K @ s.S.T + K @ s.R @ K.T
        worse = linalg.solve_discrete_lyapunov(s.A - K @ s.C, noise)
        assert np.linalg.eigvalsh(worse - p.P)[0] > -1e-13 * np.max(p.P)


# -- time-varying ---------------------------------------------------------------------------------


def test_time_varying_predictor_converges_to_the_steady_state_and_says_when() -> None:
    s = system(6)
    y, u = record(s, 400, 1)
    run, p = time_varying(s, y, u, P0=4 * np.eye(s.nx)), steady_state(s)
    assert run.converged_at is not None
    # P - P_inf falls as the square of the slowest pole of A - K C, from about P0 / P_inf.
    slowest = np.max(np.abs(p.poles))
    assert run.converged_at <= np.log(1e-15) / (2 * np.log(slowest)) + 10
    np.testing.assert_allclose(run.covariances[-1], p.F, rtol=1e-12)
    # With the gain never handed over the result is the same.
    whole = time_varying(s, y, u, P0=4 * np.eye(s.nx), tolerance=-1.0)
    assert whole.converged_at is None
    np.testing.assert_allclose(run.innovations, whole.innovations, atol=1e-10)
    assert run.log_likelihood == pytest.approx(whole.log_likelihood, rel=1e-11)


def test_time_varying_from_the_steady_covariance_is_the_steady_state() -> None:
    s = system(7)
    y, u = record(s, 100, 1)
    p = steady_state(s)
    run = time_varying(s, y, u, P0=p.P)
    assert run.converged_at == 0
    np.testing.assert_allclose(run.innovations, p.run(y, u).innovations, atol=1e-12)


@pytest.mark.parametrize("missing", [False, True])
def test_log_likelihood_is_the_density_of_the_whole_record(missing: bool) -> None:
    """Against the multivariate normal of all outputs at once, built from the impulse responses."""
    s = system(8)
    N, rng = 12, np.random.default_rng(4)
    x0, P0 = rng.standard_normal(s.nx), np.diag([1.0, 0.5, 2.0])
    y, u = record(s, N, 3)
    used = rng.random((N, s.ny)) > 0.3 if missing else np.ones((N, s.ny), dtype=bool)
    run = time_varying(s, np.where(used, y, np.nan), u, x0=x0, P0=P0, used=used)

    # y = O x[0] + T_u u + T_w w + v, all samples stacked.
    n, ny = s.nx, s.ny
    powers = [np.linalg.matrix_power(s.A, i) for i in range(N)]
    O = np.vstack([s.C @ a for a in powers])  # noqa: E741
    mean = (O @ x0).reshape(N, ny)
    W = np.zeros((N * ny, N * (n + ny)))  # what [w; v] of every sample does to the outputs
    for t in range(N):
        mean[t] += s.D @ u[t]
        W[t * ny : (t + 1) * ny, t * (n + ny) + n : (t + 1) * (n + ny)] = np.eye(ny)
        for i in range(t):
            step = s.C @ powers[t - 1 - i]
            mean[t] += step @ s.B @ u[i]
            W[t * ny : (t + 1) * ny, i * (n + ny) : i * (n + ny) + n] = step
    joint = np.block([[s.Q, s.S], [s.S.T, s.R]])
    covariance = O @ P0 @ O.T + W @ np.kron(np.eye(N), joint) @ W.T
    at = used.ravel()
    exact = multivariate_normal(mean.ravel()[at], covariance[np.ix_(at, at)]).logpdf(y.ravel()[at])
    assert run.log_likelihood == pytest.approx(exact, rel=1e-9)


def test_log_likelihood_of_independent_innovations_is_the_sum_of_normals() -> None:
    e = np.array([[0.3], [-1.2]])
    F = np.array([[[2.0]], [[0.5]]])
    exact = -0.5 * (0.09 / 2 + np.log(2 * np.pi * 2) + 1.44 / 0.5 + np.log(2 * np.pi * 0.5))
    assert log_likelihood(e, F) == pytest.approx(exact, rel=1e-14)


def test_a_constant_without_noise_is_averaged() -> None:
    """A = 1, Q = 0, P0 = p: after N samples the covariance is r p / (r + N p); no steady state."""
    s = integrator(q=0.0, r=2.0)
    y = np.random.default_rng(1).standard_normal((40, 1))
    run = time_varying(s, y, P0=np.array([[3.0]]))
    assert run.converged_at is None
    assert run.P[0, 0] == pytest.approx(2.0 * 3.0 / (2.0 + 40 * 3.0), rel=1e-12)
    assert run.x[-1, 0] == pytest.approx(3.0 / (2.0 + 40 * 3.0) * y.sum(), rel=1e-10)


def test_static_system_predicts_from_its_inputs_alone() -> None:
    nil = np.zeros((0, 0))
    s = NoisySystem(
        nil, np.zeros((0, 1)), np.zeros((2, 0)), np.array([[2.0], [1.0]]), nil, np.diag([1.0, 4.0])
    )
    u = np.array([[1.0], [3.0], [-2.0]])
    y = u @ s.D.T + np.array([0.5, -1.0])
    for run in (steady_state(s).run(y, u), time_varying(s, y, u)):
        np.testing.assert_allclose(run.innovations, np.tile([0.5, -1.0], (3, 1)))
        one = -0.5 * (0.25 + 0.25 + np.log(4.0) + 2 * np.log(2 * np.pi))
        assert run.log_likelihood == pytest.approx(3 * one)


# -- sampling --------------------------------------------------------------------------------------


def test_exponential_of_a_stack_is_that_of_each() -> None:
    """As sampling needs it, and an imaginary step gives its Frechet derivative."""
    rng = np.random.default_rng(6)
    X, E = 3 * rng.standard_normal((5, 4, 4)), rng.standard_normal((4, 4))
    for got, x in zip(linalg.expm(X), X, strict=True):
        exact = linalg.expm(x)
        np.testing.assert_allclose(got, exact, rtol=1e-11, atol=1e-12 * np.max(np.abs(exact)))
    slope = linalg.expm(X[0] + 1e-40j * E).imag / 1e-40
    exact = linalg.expm_frechet(X[0], E, compute_expm=False)
    np.testing.assert_allclose(slope, exact, rtol=1e-10, atol=1e-11 * np.max(np.abs(exact)))


def test_van_loan_gives_the_covariance_of_an_integrated_random_walk() -> None:
    """x1' = x2, x2' = white noise: Q = q [T^3/3, T^2/2; T^2/2, T]."""
    q, T = 0.7, 0.3
    Q = sample_noise(np.array([[0.0, 1.0], [0.0, 0.0]]), np.diag([0.0, q]), T)
    np.testing.assert_allclose(Q, q * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]]), rtol=1e-13)


def test_sampled_noise_survives_modes_that_decay_within_a_sample() -> None:
    """A = diag(-a) with dense noise: Q_ij = W_ij (1 - e^(-(a_i + a_j) T)) / (a_i + a_j).

    Entries sum positive terms alone, each with a rounding error of 1e-16 a doubling.
    """
    a, W = np.array([0.3, 80.0, 1e4]), np.array([[2.0, 1.0, 0.5], [1.0, 3.0, 1.0], [0.5, 1.0, 1.0]])
    rates = a[:, None] + a[None, :]
    exact = W * -np.expm1(-rates * 0.5) / rates
    np.testing.assert_allclose(sample_noise(np.diag(-a), W, 0.5), exact, rtol=1e-11)


def test_sampled_noise_keeps_the_stationary_covariance() -> None:
    """A P + P A' + W = 0 in continuous time is P = Ad P Ad' + Q at the samples."""
    rng = np.random.default_rng(2)
    A = rng.standard_normal((4, 4)) - 3 * np.eye(4)
    G = rng.standard_normal((4, 2))
    P = linalg.solve_continuous_lyapunov(A, -G @ G.T)
    Ad = linalg.expm(A * 0.2)
    np.testing.assert_allclose(Ad @ P @ Ad.T + sample_noise(A, G @ G.T, 0.2), P, rtol=1e-11)


def test_sampling_is_exact_for_inputs_that_are_held_and_for_straight_lines() -> None:
    """x' = -a x + u: u = 1 held, and u = t as a ramp, in closed form."""
    a, T = 1.7, 0.25
    t = T * np.arange(20)
    for hold, u, exact in (
        ("zoh", np.ones(20), (1 - np.exp(-a * t)) / a),
        ("foh", t, t / a - (1 - np.exp(-a * t)) / a**2),
    ):
        A, B, C, D, shift = sample_system(
            np.array([[-a]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), T, [hold]
        )
        z = -shift[:, 0] * u[0]
        y = np.empty(20)
        for k in range(20):
            y[k] = (C @ z + D[:, 0] * u[k])[0]
            z = A @ z + B[:, 0] * u[k]
        np.testing.assert_allclose(y, exact, rtol=1e-12, atol=1e-13)


def test_derivative_of_the_steady_state_is_that_of_its_own_differences() -> None:
    """Central differences of step h err by h^2 (truncation) + eps / h (rounding): 1e-9 at 1e-5."""
    s = system(9)
    rng = np.random.default_rng(5)
    m, h = 4, 1e-5
    d = {name: rng.standard_normal((m, *getattr(s, name).shape)) for name in NAMES}
    for name in "QR":
        d[name] = d[name] + d[name].transpose(0, 2, 1)
    exact = gain_tangent(steady_state(s), SystemTangent(**d))
    for i in range(m):
        ends = [
            steady_state(replace(s, **{k: getattr(s, k) + sign * h * d[k][i] for k in NAMES}))
            for sign in (1, -1)
        ]
        for name in "KPF":
            numeric = (getattr(ends[0], name) - getattr(ends[1], name)) / (2 * h)
            size = np.max(np.abs(numeric))
            np.testing.assert_allclose(getattr(exact, name)[i], numeric, atol=1e-6 * size)


# -- refusals -------------------------------------------------------------------------------------


def test_a_mode_that_no_output_sees_is_named() -> None:
    hidden = NoisySystem(
        np.diag([0.5, 1.0]),
        np.zeros((2, 0)),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 0)),
        np.eye(2),
        np.eye(1),
        states=("roll", "heading"),
    )
    with pytest.raises(ModelError, match=r"not detectable: the mode at z = 1 \(in heading\)") as e:
        steady_state(hidden)
    assert "measure it" in str(e.value)


def test_a_mode_on_the_circle_without_noise_is_named() -> None:
    with pytest.raises(ModelError, match="no noise moves it") as e:
        steady_state(integrator(q=0.0))
    assert "time_varying" in str(e.value)


def test_outputs_without_noise_of_their_own_are_refused() -> None:
    s = system(0)
    zero = replace(s, R=np.diag([1.0, 0.0]), S=np.zeros((3, 2)), outputs=("gyro", "accel"))
    with pytest.raises(ModelError, match="output accel has no measurement noise") as e:
        steady_state(zero)
    assert "give it a small one" in str(e.value)
    same = replace(s, R=np.ones((2, 2)), S=np.zeros((3, 2)), outputs=("gyro", "accel"))
    with pytest.raises(ModelError, match="gyro and accel is the same up to a factor") as e:
        steady_state(same)
    assert "leave one of the outputs out" in str(e.value)


def test_covariances_that_are_none_are_refused() -> None:
    s = system(0)
    with pytest.raises(ModelError, match="not positive semidefinite.*build it as G G'"):
        replace(s, Q=-s.Q)
    with pytest.raises(ModelError, match="not symmetric.*0.5"):
        replace(s, Q=s.Q + np.triu(np.ones((3, 3)), 1))
    with pytest.raises(ModelError, match=r"D is \(1, 2\).*need \(2, 1\); check"):
        replace(s, D=s.D.T)
    y, u = record(s, 10, 0)
    with pytest.raises(ModelError, match="P0 is not positive semidefinite; give np.diag"):
        time_varying(s, y, u, P0=-np.eye(3))
    with pytest.raises(ModelError, match=r"give y \(N, 2\)"):
        time_varying(s, y[:, :1], u)
