"""Noise that grows with what a sensor reads: when it is seen, and the sizes that follow."""

from __future__ import annotations

import numpy as np
import pytest

from casid.estimation.simulation.input_noise.growing_noise import (
    Readings,
    growing_level,
    size_of_readings,
)


def decay(seed: int, M: int = 60, **noise: float) -> Readings:
    """A concentration that falls a hundredfold, sampled at random instants.

    Its noise: `share` of it, `constant`, and a `misfit` that falls with it and swings.
    """
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 10, M))
    y = 20 * np.exp(-0.46 * t)
    sd = np.hypot(noise.get("share", 0.0) * y, noise.get("constant", 0.0))
    return Readings(t, y, sd * rng.standard_normal(M) + noise.get("misfit", 0.0) * y * np.sin(t))


def test_noise_in_proportion_is_seen_with_its_level():
    """Eight per cent of 20 to 0.2, and 0.04 at least: the level is 0.5.

    Of the 60 samples a third lie below the level; its logarithm is known to about a third.
    """
    levels = [growing_level([decay(seed, share=0.08, constant=0.04)]) for seed in range(10)]
    assert all(level is not None for level in levels)
    # The highest of the levels that are as likely lies about a standard error above.
    assert 0.25 < np.median([level for level in levels if level is not None]) < 1.5


def test_noise_of_one_size_is_not_seen_to_grow():
    """At a level of 1e-3, three of 100 records are such by chance in 2 of 10 000 cases."""
    found = [growing_level([decay(seed, constant=0.5)]) for seed in range(100)]
    assert sum(level is not None for level in found) < 3


def test_outliers_are_no_noise_that_grows():
    """Two samples 30 standard deviations off, where most is read."""
    seen = 0
    for seed in range(20):
        r = decay(seed, constant=0.1)
        r.error[[2, 7]] += 3.0
        seen += growing_level([r]) is not None
    assert seen == 0


def test_a_misfit_that_grows_with_the_motion_is_no_noise():
    """An oscillation that decays, ten samples a period, and a misfit of a fifth of it in phase.

    It is thirty times the noise at first, and its differences from neighbours follow each other.
    """
    rng = np.random.default_rng(3)
    t = np.arange(400.0)
    y = np.exp(-t / 100) * np.sin(2 * np.pi * t / 10)
    error = 0.2 * np.exp(-t / 100) * np.cos(2 * np.pi * t / 10) + 0.006 * rng.standard_normal(400)
    assert growing_level([Readings(t, y, error)]) is None


def passage(seed: int, **errors: float) -> Readings:
    """A sweep past a resonance, 14 samples a period, with noise of 0.01 of the largest reading.

    Besides: a `misfit` in quadrature, in proportion to the motion, and noise as a `share` of it.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(3000.0)
    y = np.exp(-0.5 * ((t - 1500) / 240) ** 2) * np.exp(2j * np.pi * t / 14)
    sd = np.hypot(errors.get("share", 0.0) * y.imag, 0.01)
    misfit = errors.get("misfit", 0.0) * y.real
    return Readings(t, y.imag, misfit + sd * rng.standard_normal(len(t)))


def test_a_misfit_of_few_samples_a_period_at_a_resonance_is_no_noise():
    """Differences from neighbours leave a tenth of a misfit of 0.3, which is three times the noise.

    They are too few for their products to show it. Of differences that are taken twice a hundredth
    is left, and noise that grows is as large as before.
    """
    assert all(growing_level([passage(seed, misfit=0.3)]) is None for seed in range(5))
    assert all(growing_level([passage(seed, share=0.05)]) is not None for seed in range(5))


def test_a_record_whose_readings_differ_little_needs_no_sizes():
    """A level between 18 and 22: whether its noise is of one size makes no difference."""
    rng = np.random.default_rng(4)
    t = np.arange(500.0)
    y = 20 + 2 * np.sin(t / 30)
    assert growing_level([Readings(t, y, 0.05 * y * rng.standard_normal(500))]) is None


def test_sizes_follow_the_simulation_unless_the_readings_are_far_from_it():
    """Twice the readings are taken as they are; a simulation ten times too large is cut at three.

    Where a simulation breaks down, the median of three readings, which an outlier has no part in.
    """
    measured = np.array([1.0, 1.0, 50.0, 1.0, 1.0, 1.0, 1.0])
    simulated = np.array([2.0, -2.0, 2.0, 10.0, np.nan, 2.0, 0.1])
    used = np.array([1, 1, 1, 1, 1, 0, 1], dtype=bool)
    sizes = size_of_readings(measured, simulated, used)
    assert sizes == pytest.approx([2.0, 2.0, 2.0, 3.0, 1.0, 2.0, 1 / 3])
