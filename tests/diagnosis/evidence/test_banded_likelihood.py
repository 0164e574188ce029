"""The likelihood of a cause with the noise estimated again under it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from casid.diagnosis.evidence.banded_likelihood import BandedLikelihood

N = 3000


def columns(rng: np.random.Generator, size: float) -> tuple[np.ndarray, ...]:
    """White noise with a slow signature in it, whitened as if octaves of it were noise.

    Residual, a constant as tangent, four signatures, and what the sensor alone would give.
    """
    slow = np.cumsum(rng.standard_normal((N, 4)), axis=0)
    slow = (slow - slow.mean(axis=0)) / slow.std(axis=0)
    e = rng.standard_normal(N) + size * slow[:, 0]
    power = np.abs(np.fft.rfft(e)) ** 2 / N
    noise = np.ones(len(power))
    for a, b in pairwise([0, *(2 ** np.arange(3, 11)).tolist(), len(power)]):
        noise[a:b] = max(power[a:b].mean(), 1.0) if size else 1.0

    def white(x: np.ndarray) -> np.ndarray:
        return np.fft.irfft(np.fft.rfft(x, axis=0) / np.sqrt(noise)[:, None], N, axis=0)

    return white(e[:, None])[:, 0], white(np.ones((N, 1))), white(slow), 1 / noise[:, None]


def gains(size: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    e, tangent, psi, least = columns(np.random.default_rng(seed), size)
    likelihood = BandedLikelihood(outputs=1)
    likelihood.add((e, tangent, psi), None, least)
    return likelihood.gains(tangent.shape[1])


def test_a_cause_that_passed_for_noise_gains_the_logarithm_of_the_power_that_it_explains():
    """A score whitened by it sees one square a line, some 20 of them; others gain less."""
    gain, size = gains(3.0, seed=1)
    assert size[0] == pytest.approx(3.0, rel=0.05)
    assert gain[0] > 100
    assert gain[0] > 2 * gain[1:].max()


def test_where_nothing_is_missing_the_gains_are_those_of_chance():
    """Chi-squared with one degree of freedom: of 160 the mean is 1 within 0.4 (3.6 sd)."""
    found = np.concatenate([gains(0.0, seed)[0] for seed in range(40)])
    assert np.mean(found) == pytest.approx(1.0, abs=0.4)


def test_a_signature_that_overflows_gains_nothing_and_harms_no_other():
    e, tangent, psi, least = columns(np.random.default_rng(2), 1.0)
    broken = psi.copy()
    broken[-1, 2] = np.inf
    found = []
    for signatures in (psi, broken):
        likelihood = BandedLikelihood(outputs=1)
        with np.errstate(all="ignore"):
            likelihood.add((e, tangent, signatures), None, least)
        found.append(likelihood.gains(1)[0])
    assert found[1][2] == 0.0
    assert found[1][[0, 1, 3]] == pytest.approx(found[0][[0, 1, 3]], rel=1e-6)
