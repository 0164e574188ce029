"""What is left is called noise, a disturbance, deterministic or changing, as it is."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.stats import binom

import casid
from casid.diagnosis.evidence.residual.residual_tests import (
    DETERMINISTIC,
    DISTURBANCE,
    NOISE,
    ResidualTests,
    drift_p_value,
    residual_tests,
    spectral_bands,
)
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.estimation.simulation.fit import fit_model
from tests.support.hidden_forces import fitted


@functools.cache
def told(kind: str, seed: int, disturbance: float = 0.0) -> ResidualTests:
    at, made = fitted(kind, seed, disturbance)
    return residual_tests(at, made, seed=seed)


@pytest.mark.slow
def test_noise_alone_is_noise_at_the_stated_rate():
    """Beyond the 99.5 % quantile of the binomial at 5 % the rate would not hold."""
    alarms = sum(told("none", seed).verdict != NOISE for seed in range(20, 32))
    assert alarms <= binom.ppf(0.995, 12, 0.05)


@pytest.mark.parametrize(
    "kind",
    [
        "cubic spring",
        "quadratic damping",
        pytest.param("dry friction", marks=pytest.mark.slow),
        pytest.param("damping by place", marks=pytest.mark.slow),
    ],
)
def test_a_force_of_the_states_is_deterministic(kind: str) -> None:
    for seed in (1, 2):
        found = told(kind, seed)
        assert found.verdict == DETERMINISTIC
        assert found.correlated is not None
        assert found.correlated.share > 0.5


def looped(seed: int) -> casid.Record:
    """A lag of 1 s under a proportional controller that sees the noise of its sensor, exactly."""
    rng, decay = np.random.default_rng(seed), np.exp(-0.05)
    r = np.repeat(rng.uniform(-1, 1, 30), 40)
    x, rows = 0.0, []
    for reference in r.tolist():
        y = x + 0.002 * rng.standard_normal()
        u = 4.0 * (reference - y)
        rows.append((u, y))
        x = u + (x - u) * decay
    u, y = np.array(rows).T
    return casid.Record({"u": u, "y": y}, {"u": "1", "y": "1"}, Ts=0.05)


@pytest.mark.slow
def test_noise_that_a_controller_feeds_back_is_no_error_that_depends_on_its_command():
    """The command at a sample holds that sample's noise; what the sample feels came before it."""
    m = casid.Model("looped")
    u, x = m.input("u", "1", hold="zoh", known=True), m.state("x", "1")
    m.balance(x, "charge", inertia=m.parameter("tau", "s", start=0.7), terms=[u - x], unit="1")
    m.output("y", x, "1")
    alarms = 0
    for seed in range(8):
        made = [casid.Experiment(looped(seed), {}, "r")]
        at = Weighing(made).weigh(m, fit_model(m, made, casid.FitSettings()))
        alarms += residual_tests(at, made, seed=seed).verdict != NOISE
    assert alarms <= binom.ppf(0.995, 8, 0.05)


@pytest.mark.slow
def test_a_white_disturbance_is_a_disturbance_and_not_deterministic():
    """Pushes of 0.05 N rms in 1 Hz at once: most records tell, none is called deterministic."""
    verdicts = [told("none", seed, 0.05).verdict for seed in range(40, 46)]
    assert DETERMINISTIC not in verdicts
    assert verdicts.count(DISTURBANCE) >= 5


def test_the_band_with_too_much_is_that_of_the_line():
    """White noise with a sine at 3 Hz of a tenth of its power: 2000 samples, 20 of its ordinate."""
    rng = np.random.default_rng(4)
    t = 0.01 * np.arange(4000)
    e = rng.standard_normal(4000) + np.sqrt(0.2) * np.sin(2 * np.pi * 3.0 * t)
    bands, p = spectral_bands(("y",), [e[:, None]], [0.01])
    loudest = min(bands, key=lambda b: b.p_value)
    assert loudest.low < 3.0 < loudest.high
    assert p < 1e-6


def test_spectra_of_white_noise_reject_at_no_more_than_their_rate():
    p = [
        spectral_bands(("y",), [np.random.default_rng(s).standard_normal((1000, 1))], [0.01])[1]
        for s in range(200)
    ]
    assert binom.ppf(0.0005, 200, 0.02) <= np.sum(np.array(p) < 0.05)
    assert np.sum(np.array(p) < 0.05) <= binom.ppf(0.999, 200, 0.05)


def test_power_that_doubles_halfway_is_seen_and_steady_power_is_not():
    rng = np.random.default_rng(5)
    e = rng.standard_normal(2000)
    assert drift_p_value(e**2) > 0.01
    e[1000:] *= np.sqrt(2.0)
    assert drift_p_value(e**2) < 1e-6


def test_a_slow_random_force_wanders_without_changing_in_time():
    """Its mean and power seem to change to tests that take it for white, not in its innovations."""
    m = casid.Model("lag")
    x, u = m.state("x", "1"), m.input("u", "1", hold="zoh", known=True)
    m.balance(x, "charge", inertia=m.parameter("tau", "s", start=0.9), terms=[u - x], unit="1")
    m.output("y", x, "1")
    plain, innovations = 0, 0
    for seed in range(4):
        rng, decay, stays = np.random.default_rng(seed), np.exp(-0.05), np.exp(-0.05 / 10.0)
        command = np.repeat(rng.uniform(-1, 1, 30), 40)
        state = force = 0.0
        y = np.empty(1200)
        for k, level in enumerate(command.tolist()):
            y[k] = state + 0.05 * rng.standard_normal()
            state = level + force + (state - level - force) * decay
            force = stays * force + 0.01 * rng.standard_normal()
        record = casid.Record({"u": command, "y": y}, {"u": "1", "y": "1"}, Ts=0.05)
        made = [casid.Experiment(record, {}, "r")]
        at = Weighing(made).weigh(m, fit_model(m, made, casid.FitSettings(starts=1)))
        plain += residual_tests(at, made, seed=seed).p_time < 0.01
        innovations += residual_tests(at, made, seed=seed, of_any_spectrum=True).p_time < 0.01
    assert plain == 4
    assert innovations <= binom.ppf(0.995, 4, 0.01)
