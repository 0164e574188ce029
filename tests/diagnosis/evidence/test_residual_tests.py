"""What is left is called noise, a disturbance, deterministic or changing, as it is."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.stats import binom

from casid.diagnosis.evidence.residual_tests import (
    DETERMINISTIC,
    DISTURBANCE,
    NOISE,
    ResidualTests,
    _bridge,
    _spectrum,
    residual_tests,
)
from tests.support.hidden_forces import fitted


@functools.cache
def told(kind: str, seed: int, disturbance: float = 0.0) -> ResidualTests:
    at, made = fitted(kind, seed, disturbance)
    return residual_tests(at, made, seed=seed)


def test_noise_alone_is_noise_at_the_stated_rate():
    """Beyond the 99.5 % quantile of the binomial at 5 % the rate would not hold."""
    alarms = sum(told("none", seed).verdict != NOISE for seed in range(20, 32))
    assert alarms <= binom.ppf(0.995, 12, 0.05)


@pytest.mark.parametrize(
    "kind", ["cubic spring", "quadratic damping", "dry friction", "damping by place"]
)
def test_a_force_of_the_states_is_deterministic(kind: str) -> None:
    for seed in (1, 2):
        found = told(kind, seed)
        assert found.verdict == DETERMINISTIC
        assert found.correlated is not None
        assert found.correlated.share > 0.5


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
    bands, p = _spectrum(("y",), [e[:, None]], [0.01])
    loudest = min(bands, key=lambda b: b.p_value)
    assert loudest.low < 3.0 < loudest.high
    assert p < 1e-6


def test_spectra_of_white_noise_reject_at_no_more_than_their_rate():
    p = [
        _spectrum(("y",), [np.random.default_rng(s).standard_normal((1000, 1))], [0.01])[1]
        for s in range(200)
    ]
    assert binom.ppf(0.0005, 200, 0.02) <= np.sum(np.array(p) < 0.05)
    assert np.sum(np.array(p) < 0.05) <= binom.ppf(0.999, 200, 0.05)


def test_power_that_doubles_halfway_is_seen_and_steady_power_is_not():
    rng = np.random.default_rng(5)
    e = rng.standard_normal(2000)
    assert _bridge(e**2) > 0.01
    e[1000:] *= np.sqrt(2.0)
    assert _bridge(e**2) < 1e-6
