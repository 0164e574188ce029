"""The covariance of least squares under coloured noise, by an autoregression of the residual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import norm
from scipy.stats import t as student

import casid
from casid.arrays import Array
from casid.estimation.noise.residual_autoregressions import (
    Autoregression,
    autoregression,
    coloured_covariance,
    restricted,
    student_factors,
)
from casid.estimation.simulation.fit import FitSettings, fit_model

POLES = 0.97 * np.exp(np.array([0.3j, -0.3j]))
A = np.poly(POLES).real


def noise(n: int, seed: int) -> np.ndarray:
    return lfilter([1.0], A, np.random.default_rng(seed).standard_normal(n + 500))[500:]


def test_the_coefficients_of_an_autoregression_are_found() -> None:
    found = autoregression([noise(4000, 1)])
    assert found.order == 2
    # Of a coefficient near the unit circle: sd sqrt((1 - a_2^2) / N) = 0.0054 (Box and Jenkins).
    assert found.coefficients == pytest.approx(A[1:], abs=4 * 0.0054)
    assert found.variance == pytest.approx(1.0, rel=4 * np.sqrt(2 / 4000))


def test_white_noise_has_no_order() -> None:
    """Schwarz's criterion: chi^2(1) beyond log N of any order has a probability of 0.5 %."""
    orders = [
        autoregression([np.random.default_rng(s).standard_normal(1500)]).order for s in range(40)
    ]
    assert sum(o > 0 for o in orders) <= 2


def test_the_whitening_of_an_autoregression_is_that_of_its_covariance() -> None:
    model = Autoregression(np.array([0.3, -0.5, 0.2]), 0.7)
    impulse = lfilter([np.sqrt(0.7)], [1.0, *model.coefficients], np.eye(1, 3000)[0])
    covariance = toeplitz(np.correlate(impulse, impulse, "full")[2999:3039])
    white = model.whiten(np.eye(40))
    assert white @ covariance @ white.T == pytest.approx(np.eye(40), abs=1e-12)
    assert model.log_determinant(40) == pytest.approx(np.linalg.slogdet(covariance)[1], abs=1e-9)


def test_what_the_unknowns_take_out_of_a_residual_is_not_missing_in_its_spectrum() -> None:
    """Four columns at the pole of the noise: without them in mind its peak is seen too low."""
    n, radius = 400, []
    t = np.arange(n)
    columns = [f(0.3 * t) * 0.97**t * g for f in (np.cos, np.sin) for g in (np.ones(n), t / 30)]
    q, _ = np.linalg.qr(np.column_stack(columns))
    for seed in range(60):
        r = noise(n, seed)
        r -= q @ (q.T @ r)
        plain = Autoregression(autoregression([r]).reflections[:2], 1.0)
        found = restricted([plain], [[(r, q)]])[0]
        radius.append([np.sqrt(m.coefficients[1]) for m in (plain, found)])
    low, mended = np.mean(radius, axis=0) - 0.97
    error = np.std(radius, axis=0)[1] / np.sqrt(60)
    assert low < -4 * error
    assert abs(mended) < 3 * error


def decay(seed: int, N: int = 800) -> casid.Record:
    """exp(-0.5 t) cos(6 t) at 50 ms, with noise whose resonance is that of the motion."""
    t = 0.05 * np.arange(N)
    y = np.exp(-0.1 * t) * np.cos(6 * t) + 0.01 * noise(N, seed)
    return casid.Record({"y": y}, {"y": "m"}, Ts=0.05)


def oscillator() -> casid.Model:
    m = casid.Model("oscillator")
    y, v = m.state("y", "m", start=1.0), m.state("v", "m/s")
    c = m.parameter("c", "1/s^2", start=35.0, lower=0.0)
    b = m.parameter("b", "1/s", start=0.15, lower=0.0)
    m.derivative(y, v)
    m.derivative(v, -c * y - b * v)
    m.output("y", y, "m")
    return m


def test_errors_are_those_of_least_squares_under_the_true_covariance_of_the_noise() -> None:
    fit = fit_model(oscillator(), [casid.Experiment(decay(4), {}, "r")], FitSettings(starts=1))
    found = coloured_covariance(fit, np.ones(len(fit.x), dtype=bool))
    assert found is not None
    c = fit.criterion
    t = c.simulated(fit.x, 0).jacobian[:, 0, :]
    impulse = lfilter([1.0], A, np.eye(1, 4000)[0])
    gamma = np.correlate(impulse, impulse, "full")[3999 : 3999 + len(t)] * 0.01**2
    inverse = np.linalg.inv(t.T @ t)
    true = inverse @ t.T @ toeplitz(gamma) @ t @ inverse
    # At the resonance the spectrum of an autoregression scatters by 25 % with 800 samples.
    ratio = np.diag(found[0]) / np.diag(true)
    assert np.all((ratio > 0.5) & (ratio < 1.6))


def test_estimates_under_coloured_noise_scatter_as_their_errors_say() -> None:
    """25 draws, the noise's resonance beside that of the motion."""
    z, model = [], oscillator().with_unknown(c=80.0)
    truth = {"c": 81.01, "b": 0.2, "y(0)": 1.0, "v(0)": -0.1}
    for seed in range(25):
        t = 0.05 * np.arange(500)
        y = np.exp(-0.1 * t) * np.cos(9 * t) + 0.01 * noise(500, seed)
        record = casid.Record({"y": y}, {"y": "m"}, Ts=0.05)
        experiment = casid.Experiment(record, {}, "r")
        fit = fit_model(model, [experiment], FitSettings(starts=1, substeps=4))
        found = coloured_covariance(fit, np.ones(len(fit.x), dtype=bool))
        assert found is not None
        error = dict(zip(fit.values, np.sqrt(np.diag(found[0])), strict=True))
        z.append([(fit.values[n] - v) / error[n] for n, v in truth.items()])
    z = np.array(z)
    # The variance of 25 has a standard deviation of 0.28, each squared error one of about 0.2.
    assert np.all(z.var(axis=0) < 1 + 3 * 0.35)
    # A share of 95 % of 100, four by four correlated, has a standard deviation of 4.4 % at most.
    assert np.mean(np.abs(z) < 1.96) > 0.95 - 3 * 0.044


def drifting(seed: int) -> casid.Record:
    """A gain of 2 and a rest of 1 under a random walk, which makes the rest all but unknown."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(40), 20)
    y = 2 * u + 1 + 0.02 * np.cumsum(rng.standard_normal(800))
    return casid.Record({"u": u, "y": y}, {"u": "1", "y": "1"}, Ts=1.0)


def gain_and_rest() -> casid.Model:
    m = casid.Model("gain and rest")
    rest, u = m.state("rest", "1"), m.input("u", "1", hold="zoh", known=True)
    m.derivative(rest, 0 * rest / m.constant("s", 1.0, "s"))
    m.output("y", m.parameter("g", "1", start=1.0) * u + rest, "1")
    return m


def test_a_residual_that_wanders_leaves_every_variance_positive() -> None:
    """What is unknown of the mean is 1e4 times what is of the gain, and may not drown it."""
    z = []
    for seed in range(25):
        experiment = casid.Experiment(drifting(seed), {}, "r")
        fit = fit_model(gain_and_rest(), [experiment], FitSettings(starts=1))
        found = coloured_covariance(fit, np.ones(len(fit.x), dtype=bool))
        assert found is not None
        assert np.all(np.linalg.eigvalsh(found[0]) > 0)
        z.append((fit.values["g"] - 2) / np.sqrt(found[0][0, 0]))
    # The variance of 25 has a standard deviation of 0.28.
    assert np.var(z) < 1 + 3 * 0.28


def test_a_memory_is_no_longer_than_the_record_can_show() -> None:
    walk = np.cumsum(np.random.default_rng(2).standard_normal(400))
    found = autoregression([walk])
    assert np.abs(found.reflections).max() <= 1 - 1 / 400
    (both,) = restricted([found], [[(walk, np.ones((400, 1)))]])
    assert np.abs(both.reflections).max() <= 1 - 1 / 400


def test_the_result_names_the_autoregression() -> None:
    settings = FitSettings(starts=1, substeps=2)
    estimate = casid.identify(oscillator(), casid.Experiment(decay(1), {}, "r"), settings=settings)
    assert "an autoregression of order 2" in estimate.assumes


def test_missing_samples_are_passed_over() -> None:
    """Every other sample alone is a record of twice the sample time, to the last digit."""
    whole = decay(1)
    odd = np.arange(whole.N) % 2 == 1
    gaps = casid.Record({"y": whole["y"]}, {"y": "m"}, Ts=whole.Ts, missing={"y": odd})
    half = casid.Record({"y": whole["y"][::2]}, {"y": "m"}, Ts=2 * whole.Ts)
    settings = FitSettings(starts=1, substeps=4)
    found = []
    for record, substeps in ((gaps, 4), (half, 8)):
        fit = fit_model(
            oscillator(), [casid.Experiment(record, {}, "r")], replace(settings, substeps=substeps)
        )
        covariance = coloured_covariance(fit, np.ones(len(fit.x), dtype=bool))
        assert covariance is not None
        found.append(covariance)
    assert [m.order for m in found[0][1]] == [m.order for m in found[1][1]]
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-3)


def gains(*names: str) -> casid.Model:
    """Outputs that are gains times a known state, the integral of a known input."""
    m = casid.Model("gains")
    x, u = m.state("x", "m", initial=0.0), m.input("u", "m/s", hold="zoh", known=True)
    m.derivative(x, u)
    for name in names:
        m.output(name, m.parameter(f"k_{name}", "1", start=0.5) * x, "m")
    return m


def coloured_gains(n: int, there: dict[str, np.ndarray], seed: int) -> tuple[casid.Record, Array]:
    """Gains of 1, with AR(1) noise of pole 0.9 on the samples that each output has; and x."""
    rng = np.random.default_rng(seed)
    u = 0.01 * np.cos(2 * np.pi * np.arange(n) / 400)
    x = np.concatenate([[0.0], np.cumsum(u)[:-1]])
    channels, missing = {"u": u}, {}
    for name, samples in there.items():
        white = rng.standard_normal(int(samples.sum()) + 500)
        channels[name] = x.copy()
        channels[name][samples] += 0.1 * lfilter([1.0], [1.0, -0.9], white)[500:]
        missing[name] = ~samples
    units = {"u": "m/s", **dict.fromkeys(there, "m")}
    return casid.Record(channels, units, Ts=1.0, missing=missing), x


@pytest.mark.slow
def test_outputs_of_two_rates_have_a_spectrum_each() -> None:
    """One of them in every fourth sample alone, either with coloured noise of its own.

    Both gains have the error that (1) has for the true covariance of each output's own samples.
    """
    n = 8000
    there = {"a": np.ones(n, dtype=bool), "b": np.arange(n) % 4 == 0}
    record, x = coloured_gains(n, there, 5)
    estimate = casid.identify(gains(*there), record, settings=FitSettings(starts=1))
    assert "autoregression of order 1 and 1" in estimate.assumes
    for name, samples in there.items():
        t = x[samples]
        gamma = 0.01 * toeplitz(0.9 ** np.arange(len(t))) / (1 - 0.9**2)
        error = np.sqrt(t @ gamma @ t) / (t @ t)
        # sd^2 / (1 - a)^2 of 2000 samples, a known to sqrt((1 - a^2) / 2000) = 0.0097: 10 %.
        assert estimate.parameter(f"k_{name}").std_error == pytest.approx(error, rel=3 * 0.1)


@pytest.mark.slow
def test_bootstrapped_intervals_of_a_record_with_gaps_are_those_of_the_standard_error() -> None:
    """Noise is drawn with the colour of the residual there, too: white noise gives a third.

    The length of an interval of 400 draws has an error of 7 %.
    """
    record, _ = coloured_gains(3000, {"a": np.arange(3000) % 3 != 1}, 6)
    settings = FitSettings(starts=1)
    p = casid.identify(gains("a"), record, settings=settings, intervals="bootstrap").parameters[0]
    assert p.interval is not None
    low, high = p.interval
    assert high - low == pytest.approx(2 * 1.96 * p.std_error, rel=4 * 0.07)


def test_a_spectrum_known_from_few_excursions_widens_errors_as_students_t() -> None:
    """The mean of an autoregression of order one has the variance s^2 / (N (1 - a)^2), nearly.

    Its logarithm has 2/N of the innovations' variance and (2 / (1 - a))^2 (1 - a^2) / N of a.
    """
    samples, a = 600, 0.9
    model = Autoregression(np.array([-a]), 2.0)

    def under(models):
        (m,) = models
        return np.array([[m.variance / (1 + m.coefficients.sum()) ** 2, 0.0], [0.0, m.variance]])

    found = student_factors(under, [model], [samples])
    freedom = 2 / (2 / samples + 4 * (1 + a) / (1 - a) / samples)
    assert freedom == pytest.approx(15.4, abs=0.1)
    # The derivative over a tenth of a standard error errs by a twentieth of its curvature.
    assert found[0] == pytest.approx(student.ppf(0.975, freedom) / norm.ppf(0.975), rel=0.01)
    assert found[1] == pytest.approx(student.ppf(0.975, samples) / norm.ppf(0.975), rel=1e-3)


@pytest.mark.slow
def test_a_constant_beside_a_slow_disturbance_is_in_its_interval() -> None:
    """Of 20 excursions of the noise in a record; a normal interval holds 88 % of the constants."""
    z = []
    for seed in range(80):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal(20), 20)
        slow = lfilter([1.0], [1.0, -0.95], rng.standard_normal(1000))[600:]
        record = casid.Record({"u": u, "y": 2 * u + 1 + slow}, {"u": "1", "y": "1"}, Ts=1.0)
        fit = fit_model(
            gain_and_rest(), [casid.Experiment(record, {}, "r")], FitSettings(starts=1, substeps=1)
        )
        found = coloured_covariance(fit, np.ones(len(fit.x), dtype=bool))
        assert found is not None
        i = list(fit.values).index("rest(0)")
        z.append((fit.values["rest(0)"] - 1) / np.sqrt(found[0][i, i]))
    # A share of 95 % of 80 has a standard deviation of 2.4 %.
    assert np.mean(np.abs(z) < 1.96) > 0.95 - 2 * 0.024


def test_autocovariances_are_those_of_the_impulse_response() -> None:
    model = Autoregression(np.array([0.3, -0.5, 0.2]), 0.7)
    impulse = lfilter([np.sqrt(0.7)], [1.0, *model.coefficients], np.eye(1, 3000)[0])
    covariance = np.correlate(impulse, impulse, "full")[2999:3039]
    assert model.autocovariances(40) == pytest.approx(covariance, abs=1e-12)
    assert model.autocovariances(3) == pytest.approx(covariance[:3], abs=1e-12)
    assert Autoregression(np.zeros(0), 2.0).autocovariances(3) == pytest.approx([2.0, 0.0, 0.0])


def late_ladder(seed: int) -> casid.Record:
    """Two lags in series and a dead time of a sample, driven by levels held for ten samples."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, 23), 10)[:221]
    first = last = 0.0
    y = []
    for held in np.concatenate([[u[0]], u[:-1]]):
        y.append(last)
        for _ in range(10):
            first += 0.1 / 5.6 * (held - first)
            last += 0.1 / 0.4 * (first - last)
    y = np.round(512 * np.array(y)) / 512
    return casid.Record({"u": u, "y": y}, {"u": "V", "y": "V"}, Ts=1e-3)


def test_what_a_model_lacks_is_not_taken_for_noise_that_the_unknowns_hide() -> None:
    """One lag for two and a dead time: the misfit follows the input, in 11 orders of its spectrum.

    A spectrum with poles next to the unit circle, whose excursions the unknowns would have taken
    up, has a higher likelihood (2) and a residual of many times the energy. Errors of some times
    those of a white residual are believable; of 30 to 400 times, in all unknowns, they are not.
    """
    m = casid.Model("one lag")
    u, y = m.input("u", "V", hold="zoh"), m.state("y", "V", start=0.1)
    tau = m.parameter("tau", "s", start=0.008, lower=1e-5, upper=0.1)
    gain, rest = m.parameter("gain", "1", start=1.0), m.parameter("rest", "V", start=0.0)
    m.derivative(y, (rest + gain * u - y) / tau)
    m.output("y", y, "V")
    for seed in (0, 1, 2):
        fit = fit_model(m, [casid.Experiment(late_ladder(seed), {}, "r")], FitSettings(starts=1))
        found = coloured_covariance(fit, np.ones(len(fit.x), dtype=bool))
        assert found is not None
        t = fit.criterion.simulated(fit.x, 0).jacobian[:, 0, :]
        r = fit.criterion.simulated(fit.x, 0).residual[:, 0]
        white = np.diag(np.linalg.inv(t.T @ t)) * (r @ r) / len(r)
        ratio = np.sqrt(np.diag(found[0]) / white)
        assert np.all(ratio < 8)
