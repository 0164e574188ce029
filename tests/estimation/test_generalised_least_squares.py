"""Least squares weighted by the spectrum of its residual: most certain, if that is noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

import casid
from casid.arrays import Array
from casid.estimation.generalised_least_squares import (
    GAIN,
    SpectralWeights,
    weighted_by_spectrum,
)
from casid.estimation.noise.residual_autoregressions import residual_autoregressions
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit

ONCE = FitSettings(starts=1, substeps=1)
N = 1200
AR = np.poly(0.97 * np.exp(np.array([0.1j, -0.1j]))).real
"""Noise with a resonance at a period of 63 samples, where the input has most of its power."""


def line() -> casid.Model:
    """The integral of a known input, with a gain, an offset and a gain of the input itself."""
    m = casid.Model("line")
    x, u = m.state("x", "m", initial=0.0), m.input("u", "m/s", hold="zoh", known=True)
    m.derivative(x, u)
    b, c = m.parameter("b", "1", start=0.5), m.parameter("c", "m", start=0.0)
    m.output("y", b * x + c + m.parameter("g", "s", start=0.0) * u, "m")
    return m


def regressors() -> Array:
    """(N, 3) of b, c and g: the integral of an input, one, and the input."""
    u = np.repeat(np.random.default_rng(0).standard_normal(N // 40), 40)
    return np.column_stack([np.concatenate([[0.0], np.cumsum(u)[:-1]]), np.ones(N), u])


def record(
    seed: int, *, square: float = 0.0, poles: Array = AR, gaps: bool = False
) -> casid.Record:
    """b = 1.2, c = 0.3, g = 0.5, with noise of so many poles and what is square in the integral."""
    X, rng = regressors(), np.random.default_rng(seed)
    noise = lfilter([1.0], poles, 0.2 * rng.standard_normal(N + 500))[500:]
    y = X @ [1.2, 0.3, 0.5] + square * X[:, 0] ** 2 + noise
    missing = {"y": rng.random(N) < 0.3} if gaps else {}
    return casid.Record({"u": X[:, 2], "y": y}, {"u": "m/s", "y": "m"}, 1.0, missing=missing)


def plain_fit(of: casid.Record) -> Fit:
    return fit_model(line(), [casid.Experiment(of)], ONCE)


@pytest.mark.parametrize("gaps", [False, True])
def test_it_is_aitkens_estimate_under_the_covariance_of_the_autoregression(gaps: bool) -> None:
    """(X' Gamma^-1 X)^-1 X' Gamma^-1 y by full matrices, samples that are missing passed over."""
    of = record(1, gaps=gaps)
    fit = plain_fit(of)
    found = weighted_by_spectrum(fit)
    assert isinstance(found, SpectralWeights)
    (model,), _ = residual_autoregressions(fit, np.ones(3, dtype=bool))
    there = ~of.is_missing("y")
    X, y = regressors()[there], of["y"][there]
    inverse = np.linalg.inv(toeplitz(model.autocovariances(int(there.sum()))))
    expected = np.linalg.solve(X.T @ inverse @ X, X.T @ inverse @ y)
    values = [found.fit.values[name] for name in ("b", "c", "g")]
    assert values == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_its_error_is_the_least_there_is_and_as_stated() -> None:
    """Over 60 draws, against the bound (X' Gamma^-1 X)^-1 of the true noise.

    A standard deviation of 60 draws is known to 9 %, three of them allowed; plain least squares has
    (X'X)^-1 X' Gamma X (X'X)^-1, here more than twice the bound in g. Of 460 draws one simulates
    so much worse than least squares that it is not made: two of 60 come with a probability of 1 %.
    """
    X = regressors()
    impulse = lfilter([0.2], AR, np.eye(1, N)[0])
    gamma = toeplitz(np.correlate(impulse, impulse, "full")[N - 1 :])
    least = np.sqrt(np.diag(np.linalg.inv(X.T @ np.linalg.solve(gamma, X))))
    inverse = np.linalg.inv(X.T @ X)
    plain = np.sqrt(np.diag(inverse @ X.T @ gamma @ X @ inverse))
    assert plain[2] > 2 * least[2]
    values, stated = [], []
    for seed in range(60):
        found = weighted_by_spectrum(plain_fit(record(seed)))
        if isinstance(found, str):
            assert "the simulation errs by" in found
            continue
        names = found.fit.criterion.names
        order = [names.index(name) for name in ("b", "c", "g")]
        values.append(found.fit.x[order])
        stated.append(np.sqrt(np.diag(found.covariance(np.ones(3, dtype=bool))))[order])
    assert len(values) >= 59
    error = np.sqrt(np.mean((np.array(values) - [1.2, 0.3, 0.5]) ** 2, axis=0))
    assert error == pytest.approx(least, rel=3 * 0.09)
    assert np.mean(stated, axis=0) == pytest.approx(least, rel=0.15)


def test_plain_least_squares_stays_where_nobody_would_see_a_difference() -> None:
    """White noise, and a first order so fast that the input's power is all below it."""
    for poles in ([1.0], [1.0, -0.2]):
        assert weighted_by_spectrum(plain_fit(record(2, poles=np.array(poles)))) == ""


def test_what_the_model_lacks_is_no_noise() -> None:
    """A square beside the noise: it follows the motion, and the result says so."""
    why = weighted_by_spectrum(plain_fit(record(3, square=0.02)))
    assert isinstance(why, str)
    assert "follows the motion (p < 1e-300)" in why  # nobody reads a p of 0
    assert "the model is incomplete (casid diagnose)" in why


def test_noise_is_seldom_called_a_misfit() -> None:
    """At 1e-3 of either test: one of 15 draws would have a probability of 3 %."""
    kept = [weighted_by_spectrum(plain_fit(record(seed))) for seed in range(100, 115)]
    assert all(isinstance(found, SpectralWeights) for found in kept)


def test_the_result_says_that_it_is_weighted_and_its_residual_is_that_of_the_record() -> None:
    of = record(1)
    found = casid.identify(line(), of, settings=ONCE, intervals="profile")
    weights = weighted_by_spectrum(plain_fit(of))
    assert isinstance(weights, SpectralWeights)
    assert found.method.endswith("weighted by the spectrum of the residual")
    assert "autoregression of order 2" in found.assumes
    assert weights.gained[1] > GAIN
    said = found.trust.evidence["weights"]
    assert f"{1 / weights.gained[1]:.2g} times the standard error of plain least squares" in said
    for p in found.parameters:
        assert p.value == pytest.approx(weights.fit.values[p.name], rel=1e-9)
        # Linear: the profile of the weighted criterion is the interval of the standard error.
        half = 1.96 * p.std_error
        assert p.interval == pytest.approx((p.value - half, p.value + half), abs=0.02 * half)
    # The RMS error is that of the simulation, not of what is left of it.
    (rmse,) = (v for d in found.rmse.values() for v in d.values())
    X = regressors()
    simulated = X @ [found[name] for name in ("b", "c", "g")]
    assert rmse == pytest.approx(np.sqrt(np.mean((of["y"] - simulated) ** 2)), rel=1e-6)
