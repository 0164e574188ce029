"""Noise of an input that is filled between its samples: what the residual shows of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.arrays import BoolArray
from casid.estimation.noise.filled_noise import filled_spectrum
from casid.model.declarations import Hold
from tests.estimation.errors_in_variables.test_input_noise import A, B, model, record


def gaps(kind: str, N: int) -> BoolArray:
    if kind == "one in five":
        return np.asarray(np.arange(N) % 5 > 0)
    there = np.cumsum(np.random.default_rng(1).integers(1, 4, N))
    out = np.ones(N, dtype=bool)
    out[[0, *there[there < N]]] = False  # gaps of up to two samples
    return out


def joined(values: np.ndarray, filled: BoolArray, hold: Hold) -> np.ndarray:
    """Values of the recorded samples as they stand in all of them (N,)."""
    there, every = np.flatnonzero(~filled), np.arange(len(filled))
    if hold == "zoh":
        return np.asarray(values[np.searchsorted(there, every, side="right") - 1])
    return np.asarray(np.interp(every, there, values))


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("kind", ["one in five", "gaps of up to two"])
def test_the_spectrum_of_joined_noise_is_its_mean_periodogram(hold: Hold, kind: str) -> None:
    N, draws, rng = 400, 2000, np.random.default_rng(2)
    filled = gaps(kind, N)
    total = np.zeros(N // 2 + 1)
    for _ in range(draws):
        w = joined(rng.standard_normal(int(np.sum(~filled))), filled, hold)
        total += np.abs(np.fft.rfft(w)) ** 2 / N
    spectrum = filled_spectrum(filled, hold, 2 * np.pi * np.arange(N // 2 + 1) / N)
    # A line is exponential: sd 1 / sqrt(2000); the ends of a record, some samples of 400.
    assert total / draws == pytest.approx(spectrum, rel=5 / np.sqrt(draws) + 0.03, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["one in five", "gaps of up to two"])
def test_the_bias_of_noise_is_removed_of_an_input_with_another_clock(kind: str) -> None:
    """24 records: the noise of the samples there are, joined by lines, is part of the residual."""
    z = []
    for seed in range(24):
        r = record(seed)
        r = replace(r, missing={"u": gaps(kind, r.N)})
        problem = casid.Problem("first order", model(), starts=1)
        estimate = casid.identify(problem, r, intervals="quick")
        assert "without the bias of input noise" in estimate.method
        rows = [estimate.parameter(name) for name in ("a", "b")]
        z.append([(p.value - t) / p.std_error for p, t in zip(rows, (A, B), strict=True)])
    z = np.array(z)
    # The mean of 24 has an sd of 0.20, the variance of 24 one of 0.29.
    assert np.all(np.abs(z.mean(axis=0)) < 3 * 0.20)
    assert np.all(np.abs(z.var(axis=0) - 1.0) < 3 * 0.29)
