"""How much of what the data hold an estimator uses: against the best there is, computed by hand."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.signal import lfilter

import casid
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.nlp.nlp import Nlp
from casid.identification.moment_estimators import instrumental_variables
from problems.pendulum import TABLE_7_2, indirect_model

TS = 0.05
POINTS = 4096
BACK = np.exp(-2j * np.pi * np.arange(POINTS) / POINTS)


def polynomials() -> tuple[Any, Any, Any]:
    """A, B of the indirect model and D of the closed loop, by hand from (7.34) and (7.55)."""
    v = TABLE_7_2
    S = v["M"] * v["z_g"]
    I_2 = v["I_x"] + v["M"] * v["z_g"] * (v["z_g"] - v["z_s"])
    alpha1, alpha2, beta1 = v["d"] / I_2, v["k"] / I_2, -S / I_2
    den = 4 + 2 * alpha1 * TS + alpha2 * TS**2
    A = np.array([1, (2 * alpha2 * TS**2 - 8) / den, (4 - 2 * alpha1 * TS + alpha2 * TS**2) / den])
    b0, c, g, z_s = 2 * beta1 * TS / den, 2 / TS, 9.81, v["z_s"]
    fn = np.array([z_s * c**2 + g, 2 * g - 2 * z_s * c**2, z_s * c**2 + g])
    return A, b0 * np.array([1.0, 0.0, -1.0]), A - b0 / c * fn


def record(N: int, seed: int, noise: float) -> casid.Record:
    """White noise on the gyro alone: the equation error is A e, so 1/(A H) = 1/A, (2.47)."""
    A, B, D = polynomials()
    rng = np.random.default_rng(seed)
    a = lfilter([1.0], [1.0, -0.9], 0.3 * rng.standard_normal(N))
    gyro, accel = -lfilter(B, D, a), -lfilter(A, D, a)
    return casid.Record(
        {"gyro": gyro + noise * rng.standard_normal(N), "accel": accel, "a": a},
        {"gyro": "rad/s", "accel": "m/s^2", "a": "m/s^2"},
        Ts=TS,
    )


def best_covariance(N: int, noise: float) -> Any:
    """sigma^2 (N E[z z'])^-1, z = 1/A times the noise-free regressors: (2.47)-(2.48)."""
    A, B, D = (np.polynomial.polynomial.polyval(BACK, p) for p in polynomials())
    shape = 0.3 / (1 - 0.9 * BACK)
    y, u = -B / D * shape, -A / D * shape
    z = [-BACK * y / A, -(BACK**2) * y / A, (1 - BACK**2) * u / A]
    R = np.array([[np.mean(p * q.conj()).real for q in z] for p in z])
    return noise**2 * np.linalg.inv(R) / N


@pytest.mark.slow
def test_refined_instruments_and_prefilter_reach_the_variance_of_the_ideal_ones() -> None:
    """Algorithm 2.1 with an MA(2) model of A e against (2.47)-(2.48), and what L = 1 costs.

    16 records: a standard deviation is known to 1/sqrt(32) = 18 %, three of them allowed.
    """
    N, noise = 6000, 0.05
    model = indirect_model().with_known(m=0.0)
    ideal = best_covariance(N, noise)
    A, B, _ = polynomials()
    truth = np.array([A[1], A[2], B[0]])
    found: dict[str, list[Any]] = {"refined": [], "plain": []}
    stated: list[Any] = []
    for seed in range(16):
        e = casid.Experiment(record(N, seed, noise), {}, "run")
        for name, orders in (("refined", (0, 2)), ("plain", None)):
            settings = MomentSettings(noise_model=orders, iterations=4)
            estimate = instrumental_variables(
                model, e, Instruments("a", n_delta=0, n_y=3, n_u=3), settings=settings
            )
            found[name].append(estimate.stages[0].thetas[0])
            if name == "refined":
                part = estimate.stages[0]
                at = [part.values[0][q] for q in part.parts[0].equation.parameters]
                slope = np.asarray(part.parts[0].equation.jacobian(at)[1])
                index = [part.parts[0].equation.parameters.index(n) for n in estimate.names]
                G = slope[:, index]
                stated.append(np.diag(G @ estimate.covariance @ G.T))
    best = np.sqrt(np.diag(ideal))
    refined, plain = (np.std(found[n], axis=0, ddof=1) for n in ("refined", "plain"))
    assert refined == pytest.approx(best, rel=0.54)
    assert np.sqrt(np.mean(stated, axis=0)) == pytest.approx(best, rel=0.1)
    assert np.all(plain > 1.3 * refined)
    centre = np.mean(found["refined"], axis=0)
    assert np.all(np.abs(centre - truth) < 4 * refined / np.sqrt(16))


# -- the network (5.6): excitation that only the confounded signals carry -------------------------

B, S_DELTA, S_S, S_J, S_I = 0.8, 0.5, 1.0, 0.3, 0.4


def network(N: int, seed: int) -> tuple[Any, Any, Any]:
    """w_j = b w_s + tau_j, w_I = w_s + tau_I, w_s = delta + tau_s: (5.6) with gains for modules."""
    rng = np.random.default_rng(seed)
    delta, tau_s, tau_j, tau_i = (s * rng.standard_normal(N) for s in (S_DELTA, S_S, S_J, S_I))
    w_s = delta + tau_s
    return B * w_s + tau_j, w_s + tau_i, delta


def errors_in_variables(*, noise_known: bool) -> Any:
    """Maximum likelihood: (w_j, w_I) given delta is normal with mean (b, 1) g delta and covariance
    [[b^2 s + v_j, b s], [b s, s + v_i]]; sample moments are all that the likelihood needs."""
    nlp = Nlp("errors in variables")
    b = nlp.variable("b", 1.0, lower=0.1, upper=3.0)
    g = nlp.variable("g", 0.9, lower=0.1, upper=3.0)
    s = nlp.variable("s", 0.8, lower=1e-3, upper=10.0)
    v_j = nlp.variable("v_j", 0.1, lower=1e-4, upper=2.0)
    v_i = S_I**2 if noise_known else nlp.variable("v_i", 0.1, lower=1e-4, upper=2.0)
    ww, wd, dd = nlp.parameter("ww", 2, 2), nlp.parameter("wd", 2), nlp.parameter("dd")
    mean = g * ca.vertcat(b, 1.0)
    residual = ww - wd @ mean.T - mean @ wd.T + dd * (mean @ mean.T)
    P = ca.vertcat(ca.horzcat(b**2 * s + v_j, b * s), ca.horzcat(b * s, s + v_i))
    determinant = P[0, 0] * P[1, 1] - P[0, 1] ** 2
    adjugate = ca.vertcat(ca.horzcat(P[1, 1], -P[0, 1]), ca.horzcat(-P[0, 1], P[0, 0]))
    nlp.minimize(ca.log(determinant) + ca.trace(adjugate @ residual) / determinant)
    return nlp.compile()


def estimated(program: Any, w_j: Any, w_i: Any, delta: Any) -> float:
    w = np.vstack([w_j, w_i])
    N = len(delta)
    given = {"ww": w @ w.T / N, "wd": w @ delta / N, "dd": np.array([[delta @ delta / N]])}
    return float(program.solve(given, throw=False)["b"])


def cramer_rao(N: int, *, noise_known: bool) -> float:
    """Lower bound of var(b): the inverse information of the normal above, by its derivatives."""
    x = ca.SX.sym("x", 5)
    b, g, s, v_j, v_i = x[0], x[1], x[2], x[3], x[4]
    mean = g * ca.vertcat(b, 1.0)
    P = ca.vertcat(ca.horzcat(b**2 * s + v_j, b * s), ca.horzcat(b * s, s + v_i))
    at = [B, 1.0, S_S**2, S_J**2, S_I**2]
    inverse = np.linalg.inv(np.array(ca.Function("P", [x], [P])(at)))
    flat = np.array(ca.Function("dP", [x], [ca.jacobian(ca.vec(P), x)])(at))
    slopes = [flat[:, i].reshape(2, 2) for i in range(5)]
    information = np.array(
        [[0.5 * np.trace(inverse @ p @ inverse @ q) for q in slopes] for p in slopes]
    )
    d_mean = np.array(ca.Function("dm", [x], [ca.jacobian(mean, x)])(at))
    information += S_DELTA**2 * d_mean.T @ inverse @ d_mean
    keep = slice(0, 4 if noise_known else 5)
    return float(np.linalg.inv(information[keep, keep])[0, 0] / N)


@pytest.mark.slow
def test_instruments_waste_the_excitation_that_only_noise_knowledge_could_use() -> None:
    """var of IV: (s_j^2 + b^2 s_I^2)/(N s_delta^2); maximum likelihood reaches its bound, which is
    no lower while the noise on w_I is unknown, and much lower once it is known.

    400 runs: a variance is known to sqrt(2/400) = 7 %, three of them allowed.
    """
    N, runs = 500, 400
    drawn = [network(N, seed) for seed in range(runs)]
    iv = [float(d @ j / (d @ i)) for j, i, d in drawn]
    programs = [errors_in_variables(noise_known=known) for known in (False, True)]
    blind, knowing = ([estimated(p, *w) for w in drawn] for p in programs)
    formula = (S_J**2 + B**2 * S_I**2) / (N * S_DELTA**2)
    assert np.var(iv) == pytest.approx(formula, rel=0.21)
    assert cramer_rao(N, noise_known=False) == pytest.approx(formula, rel=1e-9)
    assert np.var(blind) == pytest.approx(formula, rel=0.25)
    bound = cramer_rao(N, noise_known=True)
    assert np.var(knowing) == pytest.approx(bound, rel=0.21)
    assert bound < 0.5 * formula
