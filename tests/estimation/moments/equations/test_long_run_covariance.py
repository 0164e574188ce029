"""The long-run covariance of instruments and errors, where one has a peak and the other a notch."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, freqz, lfilter

from casid.estimation.moments.equations.long_run_covariance import (
    LONGEST_SEGMENT,
    independent_covariances,
    segments,
)
from casid.linear.sampled.lagged_columns import Column

TS = 0.02
A = np.poly(np.exp(TS * (-0.7 + 5.24j * np.array([1.0, -1.0])))).real
"""The ship's roll: 5.3 rad/s, damped with 0.13."""


def product(N: int, seed: int, low: tuple[np.ndarray, np.ndarray]) -> float:
    """S of an error A(q) L(q) e and an instrument L(q)/A(q) u, e and u white of variance 1."""
    e, u = np.random.default_rng(seed).standard_normal((2, N + 2000))
    error = lfilter(*low, lfilter(A, [1.0], e))[2000:]
    z = lfilter(*low, lfilter([1.0], A, u))[2000:]
    column = Column("z[t]", (("z", 0, 1.0),))
    found = independent_covariances([error], [[column]], [{"z": z - z.mean()}])
    return float(found[0, 0])


@pytest.mark.parametrize("N", [1805, 3160])
def test_the_notch_of_an_error_is_not_smeared_over_its_instruments_peak(N):
    """Phi_error Phi_z = |A L|^2 |L/A|^2 = |L|^4 whatever A is, and S is its mean.

    36 and 63 s: one draw of S has a relative spread of 0.3 (some 20 of its frequencies count), the
    mean of 40 one of 0.05, of which three are allowed. Segments of an eighth of the record and
    less, as they were, give 1.6 and 1.2 times S.
    """
    low = butter(3, 1.0, fs=1 / TS)
    wanted = np.mean(np.abs(freqz(*low, 8192, whole=True)[1]) ** 4)
    found = np.mean([product(N, seed, low) for seed in range(40)])
    assert found == pytest.approx(wanted, rel=0.15)


def test_without_a_filter_the_variance_of_the_mean_is_that_of_white_noise():
    """|A|^2 |1/A|^2 = 1: S = 1; one draw of 63 s has a spread of 0.04, the mean of 20 of 0.01."""
    one = (np.array([1.0]), np.array([1.0]))
    assert np.mean([product(3160, seed, one) for seed in range(20)]) == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize("N", [20, 100, 1805, 3160, 30_000, 10**6])
def test_seven_segments_that_overlap_by_half_fit_into_a_record(N):
    length = segments(N)
    assert length % 2 == 0  # the highest frequency is one of the transform's
    assert length <= LONGEST_SEGMENT
    if N >= 64:
        assert 1 + (N - length) // (length // 2) >= 7
        assert length == LONGEST_SEGMENT or length > N / 6.1
