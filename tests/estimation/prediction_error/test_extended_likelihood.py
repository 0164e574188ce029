"""The extended Kalman likelihood against the exact one, joint densities and published numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.stats import multivariate_normal, norm

import casid
from casid.estimation.prediction_error.disturbances import (
    Disturbance,
    stationary_spread,
    with_disturbances,
)
from casid.estimation.prediction_error.extended_likelihood import ExtendedPredictionError
from casid.estimation.prediction_error.likelihood import PredictionError
from casid.identification.grey_box import minimize_extended_prediction_error
from casid.linear.filtering.noisy_model import White

K, D, TS = 4.0, 0.4, 0.1


def mass(law=lambda x: x, accelerometer=False, hold="foh"):
    """A mass on a spring, of a given law, under a recorded force."""
    m = casid.Model("mass")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold=hold)
    k = m.parameter("k", "N/m", start=K, lower=0.1, upper=100)
    d = m.parameter("d", "N s/m", start=D, lower=0, upper=200)
    m.derivative(x, v)
    terms = [F, -k * law(x), -d * v]
    m.balance(v, "force", inertia=m.parameter("m", "kg", value=1.0), terms=terms, unit="N")
    m.output("x", x, "m")
    if accelerometer:
        m.output("a", m.der("v"), "m/s^2")
    return m


def record(samples=80, seed=0):
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.standard_normal(samples // 10), 10)
    y = 0.1 * np.cumsum(rng.standard_normal(samples))
    return casid.Record({"F": force, "x": y}, {"F": "N", "x": "m"}, TS)


def criteria(spectrum="peak", law=lambda x: x, **options):
    model, sources = with_disturbances(mass(law), [Disturbance("force", spectrum)])
    noise = [White("x", 0.02), *sources]
    return model, [casid.Experiment(record(), {}, "a")], noise, options


@pytest.mark.parametrize("spectrum", ["white", "first", "peak"])
def test_for_a_linear_model_it_is_the_exact_one_but_for_the_fourth_order_of_the_steps(spectrum):
    """Value, gradient, information and scores, each error sixteen times less at half the step."""
    model, experiments, noise, _ = criteria(spectrum)
    initial = dict.fromkeys(model.states, 0.3)
    exact = PredictionError(model, experiments, noise, initial=initial)
    x = exact.start
    errors = []
    for substeps in (4, 8):
        own = ExtendedPredictionError(model, experiments, noise, initial=initial, substeps=substeps)
        assert own.names == exact.names
        a, b = own.evaluate(x), exact.evaluate(x)
        errors.append(
            [
                abs(a.value - b.value),
                np.max(np.abs(a.gradient - b.gradient)),
                np.max(np.abs(a.hessian - b.hessian)),
                np.max(np.abs(own.scores(x) - exact.scores(x))),
            ]
        )
        assert own.value(x) == pytest.approx(a.value, rel=1e-12)
        density = -a.value - 0.5 * own.n_samples * np.log(2 * np.pi)
        assert own.log_likelihood(x) == pytest.approx(density, rel=1e-12)
    ratio = np.array(errors[0]) / np.array(errors[1])
    assert np.all((ratio > 10) & (ratio < 20)), ratio


def test_the_likelihood_of_a_record_with_gaps_is_the_joint_density_of_its_samples():
    """All samples at once: mean and covariance by matrix exponentials, missing rows left out.

    Two outputs whose samples are missing at different times; an initial value of a stationary
    force, and physical ones that are known.
    """
    size, corner, sd = 0.7, 1.3, (0.02, 0.05)
    m = mass()
    m.output("v", m.symbol("v"), "m/s")
    model, sources = with_disturbances(m, [Disturbance("force", "first")])
    rng, N = np.random.default_rng(3), 60
    y = 0.3 * rng.standard_normal((N, 2))
    missing = {"x": rng.random(N) < 0.3, "v": rng.random(N) < 0.6}
    data = casid.Record(
        {"F": np.zeros(N), "x": y[:, 0], "v": y[:, 1]},
        {"F": "N", "x": "m", "v": "m/s"},
        TS,
        missing=missing,
    )
    names = {"size of disturbance in force": size, "corner of disturbance in force": corner}
    start = {"x(0)": 0.4, "v(0)": -0.2, "k": K, "d": D, **names}
    own = ExtendedPredictionError(
        model,
        [casid.Experiment(data, {}, "a")],
        [White("x", sd[0]), White("v", sd[1]), *sources],
        initial=stationary_spread(model, [Disturbance("force", "first")]),
        start=start,
        substeps=16,
    )
    A = np.array([[0.0, 1.0, 0.0], [-K, -D, 1.0], [0.0, 0.0, -corner]])
    G = np.array([[0.0], [0.0], [np.sqrt(2 * corner) * size]])
    P0 = np.diag([0.0, 0.0, size**2])
    # cov x(s), x(t) = e^{A s} P0 e^{A' t} + int: by the stationary covariance, of which P0 - it
    # decays.
    stationary = solve_continuous_lyapunov(A, -G @ G.T)
    C = np.eye(3)[:2]
    steps = [expm(A * TS * t) for t in range(N)]
    mean = np.array([C @ s @ [0.4, -0.2, 0.0] for s in steps])
    at = [s @ (P0 - stationary) @ s.T + stationary for s in steps]
    covariance = np.zeros((N, 2, N, 2))
    for s in range(N):
        for t in range(s, N):
            covariance[t, :, s] = C @ steps[t - s] @ at[s] @ C.T
            covariance[s, :, t] = covariance[t, :, s].T
    covariance = covariance.reshape(2 * N, 2 * N) + np.diag(np.tile(np.square(sd), N))
    there = ~np.column_stack([missing["x"], missing["v"]]).ravel()
    joint = multivariate_normal(
        mean.ravel()[there], covariance[np.ix_(there, there)], allow_singular=False
    )
    assert own.n_samples == there.sum()
    expected = joint.logpdf(y.ravel()[there])
    assert own.log_likelihood(own.start) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("spectrum", ["white", "first", "peak"])
def test_the_gradient_is_that_of_the_value_as_it_is_computed(spectrum):
    """Central differences; of the information, which is an expectation, nothing is claimed."""
    model, experiments, noise, _ = criteria(spectrum, law=lambda x: x + x**3)
    disturbances = [Disturbance("force", spectrum)]
    initial = stationary_spread(model, disturbances)
    own = ExtendedPredictionError(model, experiments, noise, initial=initial, substeps=2)
    x = own.start * 1.1 + 0.01
    gradient = own.evaluate(x).gradient
    assert own.scores(x).sum(axis=0) == pytest.approx(gradient, rel=1e-9)
    for i in range(len(x)):
        h = 1e-5 * max(abs(x[i]), 1e-2)
        up, down = (own.value(x + s * h * np.eye(len(x))[i]) for s in (1, -1))
        assert gradient[i] == pytest.approx((up - down) / (2 * h), rel=1e-5, abs=1e-4), own.names[i]


class OfR:
    """R's generator: Mersenne Twister seeded by set.seed, normal numbers by inversion."""

    def __init__(self, seed):
        state = []
        for j in range(50 + 625):
            seed = (69069 * seed + 1) % 2**32
            if j >= 50:
                state.append(seed)
        self._bits = np.random.RandomState()
        self._bits.set_state(("MT19937", np.array(state[1:], dtype=np.uint32), 624))

    def normal(self, n):
        raw = np.frombuffer(self._bits.bytes(8 * n), dtype="<u4").reshape(n, 2)
        u, big = raw * 2.3283064365386963e-10, 2**27
        return norm.ppf((np.floor(big * u[:, 0]) + u[:, 1]) / big)


def ornstein_uhlenbeck():
    """The record of ctsmTMB's "Getting Started": 101 samples, every other twice as noisy.

    Euler and Maruyama's scheme with theta = 10, mu = 1, sigma_x = 1, sigma_y = 0.1 and seed 10.
    """
    r, fine = OfR(10), 1e-3
    dw = np.sqrt(fine) * r.normal(1000)
    x = [3.0]
    for step in dw:
        x.append(x[-1] + 10 * (1 - x[-1]) * fine + step)
    y = np.array(x)[::10] + 0.1 * r.normal(101)
    odd = np.arange(101) % 2 == 1
    columns, missing = {"Y": y, "Y2": y}, {"Y": odd, "Y2": ~odd}
    return casid.Record(columns, {"Y": "1", "Y2": "1"}, 0.01, missing=missing)


def ornstein_uhlenbeck_model():
    """dX = theta (mu - X) dt + sigma_x dw, seen with noise of 0.1, and of 0.1 sqrt(2)."""
    m = casid.Model("Ornstein-Uhlenbeck")
    X = m.state("X", "1", start=3.0)
    theta = m.parameter("theta", "1/s", start=5.0, lower=0.0, upper=20.0)
    mu = m.parameter("mu", "1", start=0.0, lower=-10.0, upper=10.0)
    sigma = m.parameter("sigma_x", "1/s^0.5", start=0.1, lower=1e-5, upper=5.0)
    m.derivative(X, theta * (mu - X) + sigma * m.unknown_input("w", "1/s^0.5"))
    m.output("Y", X, "1")
    m.output("Y2", X, "1")
    noise = [White("Y", 0.1, is_known=True), White("Y2", 0.1 * 2**0.5, is_known=True)]
    return m, [*noise, White("w", 1.0, is_known=True)]


def test_the_generator_of_r_is_r_s():
    """set.seed(10); rnorm(5)."""
    printed = [0.01874617, -0.18425254, -1.37133055, -0.59916772, 0.29454513]
    assert OfR(10).normal(5) == pytest.approx(printed, abs=5e-9)


def test_estimate_errors_and_likelihood_are_those_that_ctsmtmb_prints():
    """phillipbvetter.github.io/ctsmTMB, "Getting Started": printed to these digits.

    Both integrate by one Runge-Kutta step a sample; x(0) ~ N(3, 0.1). The errors printed are those
    of the Hessian, here by differences of the gradient.
    """
    model, noise = ornstein_uhlenbeck_model()
    data = [casid.Experiment(ornstein_uhlenbeck(), {}, "a")]
    initial = {"X": 0.1**0.5}
    at_start = ExtendedPredictionError(model, data, noise, initial=initial)
    assert -at_start.log_likelihood(at_start.start) == pytest.approx(823.96514, abs=5e-6)
    found = minimize_extended_prediction_error(model, data, noise, initial=initial, substeps=1)
    assert -found.log_likelihood == pytest.approx(-35.157143, abs=5e-7)
    printed = {"theta": 16.257194, "mu": 1.072440, "sigma_x": 1.211858}
    for name, value in printed.items():
        assert found[name] == pytest.approx(value, rel=2e-5)
    x = np.array(list(printed.values()))
    steps = 1e-5 * np.diag(x)
    hessian = np.array(
        [
            (at_start.evaluate(x + s).gradient - at_start.evaluate(x - s).gradient) / (2 * s[i])
            for i, s in enumerate(steps)
        ]
    )
    errors = np.sqrt(np.diag(np.linalg.inv(hessian)))
    assert errors == pytest.approx([3.48181119, 0.07919093, 0.15827877], rel=1e-5)


def test_steps_are_made_finer_until_they_no_longer_matter():
    """A spring of 14 rad/s at 20 samples a second: one step a sample makes it another spring."""
    w, Ts, N = 14.0, 0.05, 600
    rng = np.random.default_rng(5)
    step = expm(np.array([[0.0, 1.0], [-(w**2), -D]]) * Ts)
    x, y = np.array([0.05, 0.0]), []
    for _ in range(N):
        y.append(x[0] + 0.001 * rng.standard_normal())
        x = step @ x + [0.0, 0.05 * rng.standard_normal()]
    data = casid.Record({"F": np.zeros(N), "x": np.array(y)}, {"F": "N", "x": "m"}, Ts)
    model, sources = with_disturbances(mass(law=lambda x: 5.0 * x), [Disturbance("force", "white")])
    start = {"k": 38.0, "d": D, "size of disturbance in force": 0.2}
    given = model, [casid.Experiment(data, {}, "a")], [White("x", 0.001), *sources]
    found = minimize_extended_prediction_error(*given, start=start)
    assert found.criterion.substeps > 1
    finest = minimize_extended_prediction_error(*given, start=start, substeps=16)
    for name in found.criterion.names:
        row = found.parameter(name)
        assert abs(row.value - finest[name]) < 0.06 * row.std_error, name
    k = finest.parameter("k")
    assert abs(k.value - w**2 / 5.0) < 3 * k.std_error


def test_a_search_that_unstable_steps_led_astray_begins_anew_with_finer_ones():
    """A damper of 30 /s at 10 samples a second: the covariance decays at 60 /s, begun at 20 /s."""
    d, samples = 30.0, 400
    rng = np.random.default_rng(1)
    force = np.repeat(20 * rng.standard_normal(samples // 10), 10)
    step = expm(np.array([[0.0, 1.0, 0.0], [-K, -d, 1.0], [0.0, 0.0, 0.0]]) * TS)
    x, y = np.zeros(2), []
    for F in force:
        y.append(x[0] + 0.002 * rng.standard_normal())
        x = (step @ [*x, F])[:2] + [0.0, 0.5 * rng.standard_normal()]
    data = casid.Record({"F": force, "x": np.array(y)}, {"F": "N", "x": "m"}, TS)
    held = mass(hold="zoh").with_unknown(d=10.0)
    model, sources = with_disturbances(held, [Disturbance("force", "white")])
    found = minimize_extended_prediction_error(
        model,
        [casid.Experiment(data, {}, "a")],
        [White("x", 0.002), *sources],
        start={"size of disturbance in force": 2.0},
    )
    row = found.parameter("d")
    assert abs(row.value - d) < 3 * row.std_error


def test_white_noise_that_an_output_feels_at_once_is_refused():
    model, sources = with_disturbances(mass(accelerometer=True), [Disturbance("force", "white")])
    data = casid.Record(
        {"F": np.zeros(50), "x": np.zeros(50), "a": np.ones(50)},
        {"F": "N", "x": "m", "a": "m/s^2"},
        TS,
    )
    noise = [White("x", 0.1), White("a", 0.1), *sources]
    with pytest.raises(casid.ModelError, match=r"output a responds .* at once.*first or peak"):
        ExtendedPredictionError(model, [casid.Experiment(data, {}, "a")], noise)


def test_noise_that_is_held_is_refused():
    model, experiments, noise, _ = criteria("white")
    held = [White(noise[1].where, 1.0, held=True), noise[0]]
    with pytest.raises(casid.ModelError, match="held over samples"):
        ExtendedPredictionError(model, experiments, held)


def test_an_extended_filter_has_no_steady_gain():
    model, noise = ornstein_uhlenbeck_model()
    data = [casid.Experiment(ornstein_uhlenbeck(), {}, "a")]
    found = minimize_extended_prediction_error(model, data, noise, initial={"X": 0.3})
    with pytest.raises(casid.ModelError, match="no steady state"):
        found.predictor()


def test_a_minimum_and_a_limit_do_not_break_the_derivatives():
    """fmin in a law is differentiated on the side where it is."""
    model, experiments, noise, _ = criteria("first", law=lambda x: ca.fmin(x, 0.2))
    own = ExtendedPredictionError(model, experiments, noise, substeps=2)
    assert np.all(np.isfinite(own.evaluate(own.start).gradient))
