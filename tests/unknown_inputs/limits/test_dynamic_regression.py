"""Limits and covariances in dynamic systems, against closed forms, Lyapunov and Monte Carlo."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.regression import FirstStage, Regression, Term, arx, lags
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.limits.second_moments import second_moments

Array = NDArray[np.float64]


def armax(a: float, b: float, c: float, su: float, se: float) -> LinearSignals:
    """y(t) + a y(t-1) = b u(t-1) + e(t) + c e(t-1), white input of variance su."""
    return LinearSignals.of(
        {"u": {"w": 1}, "y": {"u": ([0, b], [1, a]), "e": ([1, c], [1, a])}}, {"w": su, "e": se}
    )


@settings(max_examples=25, deadline=None)
@given(
    a=st.floats(-0.95, 0.95),
    b=st.floats(0.1, 3.0),
    c=st.floats(-0.9, 0.9),
    su=st.floats(0.1, 10.0),
    se=st.floats(0.1, 10.0),
)
def test_least_squares_of_an_armax_system_is_biased_as_the_textbook_says(
    a: float, b: float, c: float, su: float, se: float
) -> None:
    """a* = a - c (1 - a^2) se / (b^2 su + (1 + c^2 - 2 a c) se), b* = b (Soderstrom and Stoica
    1989, Example 2.3): white input, so that b is not biased."""
    found = regression_limit(armax(a, b, c, su, se), Regression("y", arx("y", ["u"], 1, 1)))
    expected = a - c * (1 - a**2) * se / (b**2 * su + (1 + c**2 - 2 * a * c) * se)
    assert found["a1"] == pytest.approx(expected, abs=1e-9)
    assert found["b1[u]"] == pytest.approx(b, rel=1e-9)


@pytest.mark.parametrize("c", [0.9, 0.5, -0.3])
def test_the_autoregression_of_a_moving_average_varies_as_bartlett_says(c: float) -> None:
    """Lag-one correlation of MA(1): N var = 1 - 3 rho^2 + 4 rho^4 (Bartlett 1946).

    A biased limit with coloured residuals: the white-residual formula would say 1 - rho^2.
    """
    system = LinearSignals.of({"y": {"e": ([1, c], [1])}}, {"e": 2.0})
    found = regression_limit(system, Regression("y", {"rho": ("y", 1)}))
    rho = c / (1 + c**2)
    assert found["rho"] == pytest.approx(rho, rel=1e-12)
    assert found.variance("rho") == pytest.approx(1 - 3 * rho**2 + 4 * rho**4, rel=1e-11)


@pytest.mark.parametrize("a", [-0.99, -0.5, 0.0, 0.9])
def test_an_autoregression_varies_by_one_minus_a_squared(a: float) -> None:
    system = LinearSignals.of({"y": {"e": ([1], [1, a])}}, {"e": 3.0})
    found = regression_limit(system, Regression("y", {"a1": ("-y", 1)}), {"a1": a})
    assert found.bias("a1") == pytest.approx(0, abs=1e-11)
    assert found.variance("a1") == pytest.approx(1 - a**2, rel=1e-9)
    assert found.residual_variance == pytest.approx(3.0, rel=1e-10)


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.95])
@pytest.mark.parametrize("phi", [0.0, 0.5, -0.8])
def test_a_gain_under_coloured_noise_varies_by_the_product_of_the_correlations(
    rho: float, phi: float
) -> None:
    """y = b u + v, u and v AR(1): N var = (rv/ru) (1 + rho phi)/(1 - rho phi)."""
    system = LinearSignals.of(
        {"u": {"w": ([1], [1, -rho])}, "v": {"e": ([1], [1, -phi])}, "y": {"u": 2.0, "v": 1}},
        {"w": 1.5, "e": 0.3},
    )
    found = regression_limit(system, Regression("y", {"b": "u"}), {"b": 2})
    ratio = (0.3 / (1 - phi**2)) / (1.5 / (1 - rho**2))
    expected = ratio * (1 + rho * phi) / (1 - rho * phi)
    assert found.variance("b") == pytest.approx(expected, rel=1e-9)


def test_whitening_the_noise_is_generalised_least_squares_and_varies_least() -> None:
    """The prefilter 1/H leaves P = lambda (E phi_L phi_L')^-1, less than any other prefilter's."""
    system = LinearSignals.of(
        {"u": {"w": ([1], [1, -0.5])}, "y": {"u": ([0, 1.0, 0.4], [1]), "e": ([1], [1, -0.8])}},
        {"w": 1.0, "e": 0.5},
    )
    regressors: dict[str, Term] = {"b1": ("u", 1), "b2": ("u", 2)}
    white = regression_limit(system, Regression("y", regressors, prefilter=([1, -0.8], [1])))
    # By hand: u filtered by 1 - 0.8 q^-1 is ARMA(1, 1) with c = -0.8, a = -0.5.
    c, a = -0.8, -0.5
    r0 = (1 + c**2 - 2 * a * c) / (1 - a**2)
    r1 = (1 - a * c) * (c - a) / (1 - a**2)
    np.testing.assert_allclose(
        white.covariance, 0.5 * np.linalg.inv([[r0, r1], [r1, r0]]), rtol=1e-10
    )
    for prefilter in (None, ([1, -0.4], [1]), ([1], [1, -0.5]), ([1, -0.95], [1, 0.3])):
        other = regression_limit(system, Regression("y", regressors, prefilter=prefilter))
        assert np.linalg.eigvalsh(other.covariance - white.covariance).min() > 0
        np.testing.assert_allclose(other.limit, [1.0, 0.4], atol=1e-10)


def random_state_space(seed: int) -> tuple[Array, Array, Array, Array]:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((5, 5))
    A *= 0.97 / np.abs(np.linalg.eigvals(A)).max()
    return A, rng.standard_normal((5, 3)), rng.standard_normal((4, 5)), rng.standard_normal((4, 3))


@pytest.mark.parametrize("seed", range(5))
def test_moments_are_those_of_the_lyapunov_equation(seed: int) -> None:
    A, B, C, D = random_state_space(seed)
    variances = {"e1": 1.0, "e2": 0.3, "e3": 2.0}
    system = LinearSignals.of_state_space((A, B, C, D), variances, signals=["a", "b", "c", "d"])
    L = np.diag(list(variances.values()))
    P = scipy.linalg.solve_discrete_lyapunov(A, B @ L @ B.T)
    zero = C @ P @ C.T + D @ L @ D.T
    one = C @ (A @ P @ C.T + B @ L @ D.T)  # E s(t) s(t-1)'
    atoms = [(n, k, False) for k in (0, 1) for n in "abcd"]
    second = second_moments(system, atoms).second
    np.testing.assert_allclose(second[:4, :4], zero, rtol=1e-9, atol=1e-9 * zero.max())
    np.testing.assert_allclose(second[:4, 4:], one, rtol=1e-9, atol=1e-9 * zero.max())


@pytest.mark.parametrize("seed", range(3))
def test_long_run_covariances_are_those_of_the_summed_lags(seed: int) -> None:
    """Q of LS in a random system: sum over lags of covariances from powers of A."""
    A, B, C, D = random_state_space(seed)
    L = np.diag([1.0, 0.3, 2.0])
    system = LinearSignals.of_state_space(
        (A, B, C, D), {"e1": 1.0, "e2": 0.3, "e3": 2.0}, signals=["y", "b", "c", "d"]
    )
    found = regression_limit(system, Regression("y", {"b": "b", "c": "c"}))
    P = scipy.linalg.solve_discrete_lyapunov(A, B @ L @ B.T)
    r = {0: C @ P @ C.T + D @ L @ D.T}
    state = A @ P @ C.T + B @ L @ D.T
    for k in range(1, 1200):
        r[k] = C @ state
        r[-k] = r[k].T
        state = A @ state
    R = r[0][1:3, 1:3]
    theta = np.linalg.solve(R, r[0][1:3, 0])
    T = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, -theta[0], -theta[1], 0.0]])
    Q = np.zeros((2, 2))
    for rk in r.values():
        m = T @ rk @ T.T
        Q += m[2, 2] * m[:2, :2] + np.outer(m[:2, 2], m[2, :2])
    np.testing.assert_allclose(found.limit, theta, rtol=1e-8)
    expected = np.linalg.solve(R, Q) @ np.linalg.inv(R)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-7)


@settings(max_examples=15, deadline=None)
@given(scale_y=st.floats(1e-3, 1e3), scale_u=st.floats(1e-3, 1e3))
def test_units_scale_the_limit_and_the_standard_error_alike(scale_y: float, scale_u: float) -> None:
    def limit(ky: float, ku: float) -> tuple[Array, Array]:
        base = armax(-0.7, 1.0, 0.5, 1.0, 0.4)
        system = base.with_signals({"y'": {"y": ky}, "u'": {"u": ku}})
        found = regression_limit(system, Regression("y'", arx("y'", ["u'"], 1, 2)))
        return found.limit, found.covariance

    one, P = limit(1.0, 1.0)
    other, Q = limit(scale_y, scale_u)
    T = np.array([1.0, scale_y / scale_u, scale_y / scale_u])
    np.testing.assert_allclose(other / T, one, atol=1e-9)
    np.testing.assert_allclose(Q / np.outer(T, T), P, atol=1e-8)


def test_a_static_system_is_a_dynamic_one_without_memory() -> None:
    signals = {"u": "d + 0.5*t", "y": "2*u - t + e"}
    variances = {"d": 1.0, "t": 0.7, "e": 0.2}
    static = LinearSignals.of(signals, variances)
    assert static.is_static
    delayed = static.with_signals({"ud": {"u": ([0, 1], [1])}, "yd": {"y": ([0, 1], [1])}})
    one = regression_limit(static, Regression("y", {"b": "u"}))
    two = regression_limit(delayed, Regression("yd", {"b": "ud"}))
    three = regression_limit(static, Regression(("y", 1), {"b": ("u", 1)}))
    for other in (two, three):
        np.testing.assert_allclose(other.limit, one.limit, rtol=1e-12)
        np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-12)


@pytest.mark.parametrize("delay", [5, 70, 130, 1000])
def test_a_delay_stays_as_long_as_it_is(delay: int) -> None:
    """A grid of M frequencies cannot tell a delay d from d + M: it has to be finer than that."""
    systems = [LinearSignals.of({"y": {"w": ([0] * delay + [2.0], [1])}}, {"w": 1.0})]
    if delay < 100:
        chain = np.eye(delay, k=-1), 2 * np.eye(delay)[:, :1], np.eye(delay)[-1:], [[0.0]]
        systems.append(LinearSignals.of_state_space(chain, {"w": 1.0}, signals=["y"]))
    for system in systems:
        for at in {delay, delay % 64, delay % 128}:
            found = regression_limit(system, Regression("y", {"b": ("w", at)}))
            assert found["b"] == pytest.approx(2.0 if at == delay else 0.0, abs=1e-12)


@pytest.mark.parametrize("a", [-0.999, -0.9998])
def test_a_slow_pole_is_answered_as_exactly_as_a_fast_one(a: float) -> None:
    system = LinearSignals.of({"y": {"e": ([1], [1, a])}}, {"e": 3.0})
    found = regression_limit(system, Regression("y", {"a1": ("-y", 1)}))
    assert found["a1"] == pytest.approx(a, rel=1e-11)
    assert found.variance("a1") == pytest.approx(1 - a**2, rel=1e-7)


def test_filters_may_be_control_objects_rationals_or_pairs() -> None:
    import control

    from casid.algebra.rational import Rational

    q = Rational.shift(0.1)
    forms = [
        ([0, 0.5], [1, -0.8]),
        control.tf([0.5], [1, -0.8], 0.1),
        control.tf2ss(control.tf([0.5], [1, -0.8], 0.1)),
        0.5 / (q - 0.8),
    ]
    limits = []
    for form in forms:
        system = LinearSignals.of(
            {"u": {"w": ([1], [1, -0.3])}, "y": {"u": form, "e": 1}}, {"w": 1, "e": 0.1}, Ts=0.1
        )
        limits.append(regression_limit(system, Regression("y", arx("y", ["u"], 1, 1))))
        assert system.Ts == 0.1
    for other in limits[1:]:
        np.testing.assert_allclose(other.limit, limits[0].limit, rtol=1e-9)
        np.testing.assert_allclose(other.covariance, limits[0].covariance, rtol=1e-8)


def test_a_network_offers_its_frequency_response() -> None:
    """`of_response` with the closed loop's response equals the loop written as filters."""
    k = 0.4  # y = q^-1/(1 - 0.5 q^-1) u + e, u = r - k y

    def response(z: Array) -> Array:
        G = (1 / z) / (1 - 0.5 / z)
        S = 1 / (1 + k * G)
        return np.stack([np.stack([G * S, S], -1), np.stack([S, -k * S], -1)], axis=1)

    offered = LinearSignals.of_response(["y", "u"], response, {"r": 1.0, "e": 0.5})
    den = [1, -0.5 + k]
    written = LinearSignals.of(
        {"y": {"r": ([0, 1], den), "e": ([1, -0.5], den)},
         "u": {"r": ([1, -0.5], den), "e": ([-k, 0.5 * k], den)}},
        {"r": 1.0, "e": 0.5},
    )  # fmt: skip
    for instruments in (None, lags("r", 1, 2)):
        r = Regression("y", arx("y", ["u"], 1, 1), instruments)
        one, two = regression_limit(offered, r), regression_limit(written, r)
        np.testing.assert_allclose(one.limit, two.limit, rtol=1e-10)
        np.testing.assert_allclose(one.covariance, two.covariance, atol=1e-12)
    np.testing.assert_allclose(one.limit, [-0.5, 1.0], atol=1e-10)  # IV in closed loop


# -- Monte Carlo ---------------------------------------------------------------------------------

RUNS, N = 600, 1500
SYSTEM = LinearSignals.of(
    {
        "u_K": {"r": 1, "w": ([0, 0.6], [1, -0.7])},
        "u_U": {"r": ([0, 0.5], [1]), "w": ([1], [1, -0.8]), "d": 1},
        "v": {"e": ([1, 0.4], [1, -0.6])},
        "y": {"u_K": ([0, 1.0], [1, -0.5]), "u_U": ([0, -0.7], [1, -0.5]), "v": 1},
        "y_U": {"u_U": 1, "n": 1},
    },
    {"r": 1.0, "w": 0.3, "d": 0.4, "e": 0.2, "n": 0.2},
)


@pytest.fixture(scope="module")
def data() -> dict[str, Array]:
    """(RUNS, N) of every signal after the transient; scipy's filter, no code of casid."""
    rng = np.random.default_rng(2)
    burn = 80
    sizes = {"r": 1.0, "w": 0.3, "d": 0.4, "e": 0.2, "n": 0.2}
    x = {k: math.sqrt(v) * rng.standard_normal((RUNS, N + burn)) for k, v in sizes.items()}
    f = scipy.signal.lfilter
    x["u_K"] = x["r"] + f([0, 0.6], [1, -0.7], x["w"])
    x["u_U"] = f([0, 0.5], [1], x["r"]) + f([1], [1, -0.8], x["w"]) + x["d"]
    x["y"] = (
        f([0, 1], [1, -0.5], x["u_K"])
        + f([0, -0.7], [1, -0.5], x["u_U"])
        + f([1, 0.4], [1, -0.6], x["e"])
    )
    x["y_U"] = x["u_U"] + x["n"]
    return {k: v[:, burn - 10 :] for k, v in x.items()}


def at(data: dict[str, Array], term: Term) -> Array:
    name, lag = (term, 0) if isinstance(term, str) else term
    sign = -1.0 if name.startswith("-") else 1.0
    return sign * data[name.lstrip("-")][:, 10 - lag : 10 - lag + N]


def solved(y: Array, phi: list[Array], zeta: list[Array]) -> Array:
    Phi, Zeta = np.stack(phi, axis=1), np.stack(zeta, axis=1)
    right = Zeta @ y[:, :, None]
    return np.asarray(np.linalg.solve(Zeta @ np.swapaxes(Phi, 1, 2), right)[:, :, 0])


def by_simulation(r: Regression, data: dict[str, Array]) -> Array:
    own = dict(data)
    if r.prefilter is not None:
        own = {k: scipy.signal.lfilter(*r.prefilter, v, axis=1) for k, v in data.items()}
    y, phi = at(own, r.output), []
    for term in r.regressors.values():
        name, lag = (term, 0) if isinstance(term, str) else term
        if name in r.generated:
            stage = r.generated[name]
            psi = [at(data, t) for t in stage.known]
            gamma = solved(at(data, stage.measured), psi, psi)
            parts = [(t, 0) if isinstance(t, str) else t for t in stage.known]
            phi.append(
                sum(gamma[:, [i]] * at(data, (n, k + lag)) for i, (n, k) in enumerate(parts))
            )
        else:
            phi.append(at(own, term))
    zeta = phi
    if r.instruments is not None:
        zeta = [at(data, t) for t in r.instruments]
        if len(zeta) > len(phi):
            Z = np.stack(zeta, axis=1)
            P = np.stack(phi, axis=1)
            first = np.linalg.solve(Z @ np.swapaxes(Z, 1, 2), Z @ np.swapaxes(P, 1, 2))
            zeta = list(np.moveaxis(np.swapaxes(first, 1, 2) @ Z, 1, 0))
    return solved(y, phi, zeta)


MODEL: dict[str, Term] = {"a": ("-y", 1), "bK": ("u_K", 1), "bU": ("u_U", 1)}
MEASURED: dict[str, Term] = {**MODEL, "bU": ("y_U", 1)}
NEGLECTED: dict[str, Term] = {"a": ("-y", 1), "bK": ("u_K", 1)}
CASES = {
    "LS, all known, coloured noise": Regression("y", MODEL),
    "LS, neglected": Regression("y", NEGLECTED),
    "LS, neglected, prefiltered": Regression("y", NEGLECTED, prefilter=([1, -0.6], [1, 0.4])),
    "LS, measured": Regression("y", MEASURED),
    "IV, measured": Regression("y", MEASURED, [("r", 1), ("r", 2), ("d", 1)]),
    "IV, more instruments": Regression("y", MEASURED, lags("r", 1, 4) + lags("d", 1, 2)),
    "two-stage": Regression(
        "y", {**MODEL, "bU": ("uh", 1)}, generated={"uh": FirstStage("y_U", [("r", 1), "d"])}
    ),
    "IV, neglected, wrong": Regression("y", NEGLECTED, lags("r", 1, 5)),
}


@pytest.mark.parametrize("case", CASES)
def test_monte_carlo_of_a_dynamic_system_has_limit_and_covariance(
    case: str, data: dict[str, Array]
) -> None:
    """3.5 Monte Carlo standard errors; estimates differ from their limits by O(1/N) too.

    The bias of an autoregression is (1 + 3 a)/N (Kendall 1954), at most 3 (1 + sd)/N here.
    """
    theory = regression_limit(SYSTEM, CASES[case])
    theta = by_simulation(CASES[case], data)
    P = theory.covariance
    scale = np.sqrt(np.diag(P))
    bound = 3.5 * scale / math.sqrt(N * RUNS) + 3 / N * (1 + scale)
    assert np.all(np.abs(theta.mean(axis=0) - theory.limit) < bound)
    found = N * np.cov(theta.T)
    spread = np.sqrt((np.outer(scale**2, scale**2) + P**2) / RUNS)
    assert np.all(np.abs(found - P) < 3.5 * spread + 8 / N * np.outer(scale, scale))


def test_the_known_system_has_the_known_limit() -> None:
    """Instruments of references alone, however many: no bias (2.44)."""
    truth = {"a": -0.5, "bK": 1.0, "bU": -0.7}
    # v = H e enters y beside the modules: A v is the equation error, coloured.
    for case in ("IV, measured", "IV, more instruments"):
        found = regression_limit(SYSTEM, CASES[case], truth)
        assert [found.bias(n) for n in found.names] == pytest.approx([0, 0, 0], abs=1e-9)
    biased = regression_limit(SYSTEM, CASES["LS, measured"], truth)
    assert abs(biased.bias("bU")) > 3 * biased.std_error("bU", N)
