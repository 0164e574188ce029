"""Intervals by the profile of the criterion: as the standard error where it is a parabola."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom, chi2

import casid
from casid.estimation.covariance import sandwich
from casid.estimation.errors_in_variables.removal import without_input_noise
from casid.estimation.intervals.choice import patience_since
from casid.estimation.intervals.profile import profile_interval
from casid.estimation.intervals.scaled_criterion import ScaledCriterion, tilted
from casid.estimation.intervals.thresholds import PROFILE_SEARCH
from casid.estimation.noise.residual_autoregressions import coloured_covariance
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.identification.identify import identify


def gain_and_offset():
    """An integrator of a known input, linear in its gain and its offset."""
    m = casid.Model("integrator")
    x = m.state("x", "m", initial=0.0)
    u = m.input("u", "m/s", hold="zoh")
    b = m.parameter("b", "1", start=0.5, lower=-10, upper=10)
    c = m.parameter("c", "m", start=0.0, lower=-10, upper=10)
    m.derivative(x, b * u)
    m.output("y", x + c, "m")
    return casid.Problem("integrator", m, noise={"u": 0.0}, starts=1)


def linear_record(*, colour=0.0, samples=600, seed=3):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(samples // 20), 20)
    x = np.concatenate([[0.0], np.cumsum(0.1 * u)[:-1]])
    noise = lfilter([1.0], [1.0, -colour], 0.2 * rng.standard_normal(samples))
    return casid.Record({"u": u, "y": 1.2 * x + 0.3 + noise}, {"u": "m/s", "y": "m"}, 0.1)


def noisy_lag():
    """A lag of 0.5 s, its slow input read with noise as large as itself, and its record."""
    rng = np.random.default_rng(8)
    u = lfilter([1.0], [1.0, -0.95], 0.3 * rng.standard_normal(1500))
    pole = np.exp(-0.1 / 0.5)
    x = lfilter([0.0, 1 - pole], [1.0, -pole], u)
    columns = {"u": u + rng.standard_normal(1500), "y": 2.0 * x + 0.02 * rng.standard_normal(1500)}
    m = casid.Model("lag")
    y, of = m.state("x", "1"), m.input("u", "1", hold="zoh")
    K, tau = m.parameter("K", "1", start=1.8), m.parameter("tau", "s", start=0.6, lower=0.01)
    m.derivative(y, (K * of - y) / tau)
    m.output("y", y, "1")
    return m, casid.Record(columns, {"u": "1", "y": "1"}, Ts=0.1)


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_of_a_linear_model_it_is_the_interval_of_the_standard_error(colour):
    """Also where the weights are not those of the noise: the drop is scaled by the sandwich."""
    found = identify(gain_and_offset(), linear_record(colour=colour), intervals="profile")
    for p in found.parameters:
        assert p.interval_kind == "profile"
        low, high = p.interval
        half = 1.96 * p.std_error
        assert low == pytest.approx(p.value - half, abs=0.01 * half)
        assert high == pytest.approx(p.value + half, abs=0.01 * half)


def test_at_a_root_of_equations_the_criterion_is_flat_and_curved_as_its_matrix():
    """Noise on the input has moved both: the raw criterion is neither, by ten times as much.

    Over a tenth of a standard error third derivatives are left, a few per cent of the matrix.
    """
    m, record = noisy_lag()
    fit = fit_model(m, [casid.Experiment(record, {}, "r")], FitSettings(starts=1))
    root = without_input_noise(fit, {"u": 1.0})
    assert root.covariance is not None
    of_root = tilted(root.fit, root.covariance)
    x, errors = root.fit.x, np.sqrt(np.diag(root.covariance))
    size = np.outer(errors, errors)
    matrix = of_root.evaluate(x).hessian * size

    def bent(criterion):
        steps = [0.1 * errors * row for row in np.eye(len(x))]
        ends = [
            (criterion.evaluate(x + s).gradient, criterion.evaluate(x - s).gradient) for s in steps
        ]
        return np.array([(up - down) / 0.2 for up, down in ends]) * errors - matrix

    assert of_root.evaluate(x).gradient == pytest.approx(0.0, abs=1e-9)
    left, raw = np.abs(bent(of_root)).max(), np.abs(bent(root.fit.criterion)).max()
    assert left < 0.05 * np.abs(matrix).max()
    assert raw > 10 * left


def test_coloured_noise_is_what_the_scale_allows_for():
    """The unscaled drop of white noise would give a third of the length of AR(1) noise of 0.8."""
    fit = fit_model(
        gain_and_offset().model,
        [casid.Experiment(linear_record(colour=0.8), {}, "a")],
        FitSettings(starts=1),
    )
    covariance, _ = coloured_covariance(fit, np.ones(2, dtype=bool))
    scaled = ScaledCriterion(fit, covariance)
    white = 2 * fit.solution.value / (fit.criterion.n_samples - 2)
    i = fit.criterion.names.index("c")
    # The spectrum of AR(1) at low frequencies, (1 - a^2) / (1 - a)^2 = 9 times its variance.
    assert scaled.path(i)[0] / white == pytest.approx(9.0, rel=0.35)


def lag_problem():
    """A first-order lag of unknown gain: over less than its time constant a ramp that bends."""
    m = casid.Model("lag")
    x = m.state("x", "1", initial=0.0)
    u = m.input("u", "1", hold="zoh")
    K = m.parameter("K", "1", start=1.0, lower=1e-3, upper=30)
    tau = m.parameter("tau", "s", start=1.0, lower=1e-3, upper=30)
    m.derivative(x, (K * u - x) / tau)
    m.output("y", x, "1")
    return casid.Problem("lag", m, noise={"u": 0.0}, starts=1)


def step_response(seed, *, length=0.6, samples=300, sd=0.12):
    """Of gain and time constant one, by its closed form."""
    rng = np.random.default_rng(seed)
    t = length / samples * np.arange(samples)
    y = 1 - np.exp(-t) + sd * rng.standard_normal(samples)
    return casid.Record({"u": np.ones(samples), "y": y}, {"u": "1", "y": "1"}, length / samples)


@pytest.mark.parametrize("reached", [0.0, 0.01])
def test_where_refits_end_short_of_their_minima_the_interval_is_normal_and_says_so(
    monkeypatch, reached
):
    """Their drop rejects nothing: the interval had shrunk to the estimate, or next to it."""

    def short(scaled, i, held, start):
        is_near = abs(held - scaled.x[i]) < reached * scaled.std_error(i)
        return (0.0 if is_near else 1e6), start

    monkeypatch.setattr(ScaledCriterion, "refit", short)
    found = identify(gain_and_offset(), linear_record(), intervals="profile")
    for row in found.parameters:
        low, high = row.interval
        assert high - low == pytest.approx(2 * 1.96 * row.std_error, rel=1e-3)
    assert sum("the refits of its profile ended short" in w for w in found.warnings) == 2


@pytest.mark.slow
def test_a_time_constant_longer_than_the_record_is_covered_as_stated():
    """Where the normal interval is not: over 50 draws, within what binomial draws allow.

    Of half a time constant and this much noise the normal interval covers four times in five.
    """
    draws, by_profile, normal = 50, 0, 0
    model = lag_problem().model
    for seed in range(draws):
        record = casid.Experiment(step_response(seed, length=0.5, sd=0.2), {}, "a")
        fit = fit_model(model, [record], FitSettings(starts=1, substeps=1), check_rank=False)
        i = fit.criterion.names.index("tau")
        everything = np.ones(2, dtype=bool)
        covariance, _ = sandwich(fit.solution.hessian, fit.criterion.scores(fit.x), everything)
        scaled = ScaledCriterion(fit, covariance)
        interval = profile_interval(scaled, "tau")
        by_profile += interval.lower <= 1.0 <= interval.upper
        normal += abs(fit.x[i] - 1.0) <= 1.96 * scaled.std_error(i)
    least, most = binom.ppf([0.005, 0.995], draws, 0.95)
    assert least <= by_profile <= most
    assert normal < least
    assert by_profile > normal


def test_the_end_is_where_the_likelihood_ratio_has_its_quantile():
    """By brute force on the closed form of the response, with its gain eliminated."""
    samples, length = 300, 0.6
    found = identify(lag_problem(), step_response(4, sd=0.02), intervals="profile")
    low, high = found.parameter("tau").interval
    t, y = length / samples * np.arange(samples), step_response(4, sd=0.02)["y"]

    def least_squares(tau):
        shape = 1 - np.exp(-t / tau)
        gain = min(max(shape @ y / (shape @ shape), 1e-3), 30.0)
        return float(np.sum((y - gain * shape) ** 2))

    tau = found["tau"]
    beside = 1e-4 * tau
    bend = (
        least_squares(tau + beside) - 2 * least_squares(tau) + least_squares(tau - beside)
    ) / beside**2
    scale = found.parameter("tau").std_error ** 2 * bend / 2  # lambda of one unknown's profile
    for end in (low, high):
        drop = (least_squares(end) - least_squares(tau)) / scale
        # The curvature of Gauss-Newton is that of the profile up to the residual's second order.
        assert drop == pytest.approx(chi2.ppf(0.95, 1), rel=0.03)


def spring_problem():
    """A mass on a spring with a damping that has to be positive."""
    m = casid.Model("spring")
    x, v = m.state("x", "m", initial=1.0), m.state("v", "m/s", initial=0.0)
    d = m.parameter("d", "1/s", start=0.05, lower=0.0, upper=5)
    k = m.parameter("k", "1/s^2", start=1.0, lower=0.1, upper=10)
    m.derivative(x, v)
    m.balance(v, "force", inertia=1.0, terms=[-d * v, -k * x], unit="m/s^2")
    m.output("x", x, "m")
    return casid.Problem("spring", m, starts=1)


def swing(seed, d):
    """The closed form of a free swing of unit frequency, for so small a damping."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(300)
    w = np.sqrt(1 - d**2 / 4)
    x = np.exp(-d / 2 * t) * (np.cos(w * t) + d / (2 * w) * np.sin(w * t))
    return casid.Record({"x": x + 0.3 * rng.standard_normal(300)}, {"x": "m"}, 0.1)


@pytest.mark.slow
def test_at_a_bound_the_interval_has_an_end_on_the_other_side_and_covers():
    """At least 95 %, and at most 97.5 %, of draws (Self and Liang 1987); 1 % binomial tails."""
    draws, covered, at_bound = 60, 0, 0
    for seed in range(draws):
        found = identify(spring_problem(), swing(seed, 0.0))
        d = found.parameter("d")
        low, high = d.interval
        if d.std_error is None:
            at_bound += 1
            assert d.interval_kind == "profile"
            assert low == 0.0
            assert 0.0 < high < 1.0
        covered += low <= 0.0 <= high
    assert binom.cdf(covered, draws, 0.95) > 0.01
    # Half of the estimates of a damping of zero are at its bound.
    least, most = binom.ppf([0.005, 0.995], draws, 0.5)
    assert least <= at_bound <= most


def test_profiles_that_nobody_requested_take_no_longer_than_the_estimate_twice(monkeypatch):
    """Or some seconds; a budget that is given is theirs to use. The clock is the test's."""
    monkeypatch.setattr("casid.estimation.intervals.choice.wall_clock", lambda: 1000.0)
    assert patience_since(999.0, None) == PROFILE_SEARCH.seconds
    assert patience_since(900.0, None) == PROFILE_SEARCH.of_estimate * 100.0
    assert patience_since(900.0, 500.0) == np.inf


def test_an_interval_that_patience_ends_is_normal_and_said_to_be_so(monkeypatch):
    """A skewed estimate without time for its profile; requested, it has one all the same."""
    monkeypatch.setattr("casid.identification.task.patience_since", lambda *_: 0.0)
    found = identify(lag_problem(), step_response(4, sd=0.03))
    assert found.parameter("tau").interval_kind == "quick"
    assert found.not_done
    assert any("raise it (--budget SECONDS)" in w for w in found.warnings)
    requested = identify(lag_problem(), step_response(4, sd=0.03), intervals="profile")
    assert requested.parameter("tau").interval_kind == "profile"
    assert not requested.not_done
