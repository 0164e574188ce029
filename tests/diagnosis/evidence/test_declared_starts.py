"""Under a disturbance a model is begun where it is declared to start, too."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.evidence.whitening.fit_points import moved
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.robust_errors import std_error
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.diagnosis.search.disturbance.disturbance_price import under_likelier_disturbance
from casid.diagnosis.thresholds import RESTARTS
from casid.estimation.noise.variances import error_over_noise
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.initial_state import with_states_anew
from casid.estimation.simulation.minimization import Fit

TS, N = 0.2, 2000
HUB, PANEL, K, C = 90.0, 30.0, 12.0, 0.6
NOISE = 4e-5


def satellite() -> casid.Model:
    """A hub turned by a torque, and a panel on a spring that nobody measures."""
    m = casid.Model("satellite")
    w, e, v = m.state("w", "rad/s"), m.state("e", "rad"), m.state("v", "rad/s")
    u = m.input("u", "N m", hold="zoh", known=True)
    hub = m.parameter("hub", "kg m^2", start=110.0, lower=10.0, upper=1000.0)
    panel = m.parameter("panel", "kg m^2", start=25.0, lower=1.0, upper=500.0)
    k = m.parameter("k", "N m/rad", start=10.0, lower=0.5, upper=200.0)
    c = m.parameter("c", "N m s/rad", start=0.3, lower=0.0, upper=20.0)
    spring = k * e + c * (w - v)
    m.derivative(e, w - v)
    m.balance(w, "hub", inertia=hub, terms=[-u, -spring])
    m.balance(v, "panel", inertia=panel, terms=[spring])
    m.output("gyro", w, "rad/s")
    return m


def pointed(seed: int) -> casid.Record:
    """Attitude held by a loop against a slow torque on the hub, held between samples."""
    rng = np.random.default_rng(seed)
    A = np.zeros((5, 5))  # w, e, v, attitude, torque on the hub
    A[0, :3] = -C / HUB, -K / HUB, C / HUB
    A[1, [0, 2]] = 1.0, -1.0
    A[2, :3] = C / PANEL, K / PANEL, -C / PANEL
    A[3, 0], A[0, 4] = 1.0, 1.0 / HUB
    step = expm(A * TS)
    reference = np.repeat(rng.uniform(-0.15, 0.15, N // 200), 200)
    x, gust = np.zeros(5), 0.0
    u, gyro = np.empty(N), np.empty(N)
    for i, target in enumerate(reference):
        gyro[i] = x[0] + NOISE * rng.standard_normal()
        u[i] = np.clip(2.0 * (x[3] - target) + 18.0 * gyro[i], -0.2, 0.2)
        gust = 0.98 * gust + 0.004 * np.sqrt(1 - 0.98**2) * rng.standard_normal()
        x[4] = gust - u[i]
        x = step @ x
    return casid.Record({"u": u, "gyro": gyro}, {"u": "N m", "gyro": "rad/s"}, Ts=TS)


@functools.cache
def fitted(seed: int) -> Fit:
    """Least squares. Nobody changes it."""
    return fit_model(satellite(), [casid.Experiment(pointed(seed))], FitSettings(starts=1))


@functools.cache
def beside_a_disturbance(seed: int) -> Weighted:
    """The likeliest model from there. Nobody changes it."""
    weighing = Weighing(fitted(seed).criterion.experiments).with_disturbances()
    return weighing.weigh(satellite(), fitted(seed), rounds=1)


@pytest.mark.parametrize(
    ("seed", "states"),
    [
        (1, {}),
        pytest.param(2, {}, marks=pytest.mark.slow),
        pytest.param(1, {"e(0)": -20.0, "v(0)": 300.0}, marks=pytest.mark.slow),
    ],
)
def test_a_model_that_went_astray_is_begun_again_where_it_is_declared_to_start(seed, states):
    """A small stiff panel lies behind a hill of the likelihood, of 6 units and of 380.

    So do initial states that a stiff spring alone brings to rest within a sample or two.
    """
    model, base, best = satellite(), fitted(seed), beside_a_disturbance(seed)
    lost = {**base.values, "hub": 131.0, "panel": 1.5, "k": 125.0, "c": 1.0, **states}
    astray = moved(base, base.criterion, np.array([lost[n] for n in base.criterion.names]))
    weighing = Weighing(base.criterion.experiments)
    assert error_over_noise(astray, weighing.weigh(model, base).full) > RESTARTS.far
    found = weighing.with_disturbances().weigh(model, astray, rounds=1)
    assert minus_log_likelihood(found) == pytest.approx(minus_log_likelihood(best), abs=1.0)
    assert list(found.noise.spectra) == ["hub"]
    likeliest = found.unbiased or found.fit
    for name, true in {"hub": HUB, "panel": PANEL, "k": K, "c": C}.items():
        assert likeliest.values[name] == pytest.approx(true, rel=0.1)
        assert abs(likeliest.values[name] - true) < 4 * std_error(likeliest, name) < 0.4 * true


def test_a_bound_that_holds_least_squares_alone_hides_no_disturbance():
    """Least squares follow the disturbance to a bound, at which the likelihood has no maximum."""
    base, found = fitted(1), beside_a_disturbance(1)
    likeliest = found.unbiased or found.fit

    def held(fit: Fit) -> Fit:
        at_bound = {"hub": 131.0, "panel": 1.0, "k": 125.0, "c": 1.0}
        values = {**fit.values, **at_bound}
        return moved(fit, fit.criterion, np.array([values[n] for n in fit.criterion.names]))

    def under(bare: Weighted) -> Weighted | None:
        search = SimpleNamespace(under_disturbance=lambda fit: bare)
        start = replace(found, noise_absorbs_misfit=True)
        return under_likelier_disturbance(search, start, held(base))

    assert held(base).solution.at_lower == ("panel",)
    assert under(found) is found
    assert under(replace(found, unbiased=held(likeliest))) is None


def test_initial_states_stay_where_the_simulation_diverges(capfd: pytest.CaptureFixture[str]):
    """No step comes of sensitivities that are no numbers, nor a complaint of a library's."""
    criterion = fitted(1).criterion
    values = {"panel": 1e-9, "k": 1e12, "c": 0.0, "hub": 1e-9, "e(0)": 1e150}
    x = np.array([values.get(v.name, v.start) for v in criterion.variables])
    with np.errstate(all="ignore"):
        assert not np.isfinite(criterion.evaluate(x).value)
        assert np.array_equal(with_states_anew(criterion, x), x)
    assert capfd.readouterr().out == ""
