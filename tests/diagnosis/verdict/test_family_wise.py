"""The p of a cause that samples show is that of the whole diagnosis, not of one test."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

import casid
from casid.diagnosis.thresholds import OUTLIERS


def test_an_outlier_s_p_counts_all_the_tests_of_samples() -> None:
    """Each test of a channel's samples has a share w of the false-alarm rate: its p counts 1/w
    times (Bonferroni's bound with weights), or one record in twenty would show a p of 0.001.

    A sample that differs from the mean of its neighbours by 8.5 standard deviations of one is 6.9
    of the difference's, of one among 400.
    """
    m = casid.Model("store")
    x, u, T = m.state("x", "m"), m.input("u", "m", hold="zoh"), m.parameter("T", "s", start=2.0)
    m.derivative(x, (u - x) / T)
    m.output("y", x, "m")
    rng, N, Ts, sd = np.random.default_rng(4), 400, 0.5, 0.01
    steps = np.repeat(rng.choice([-1.0, 1.0], N // 10), 10)
    y, decay = np.zeros(N), np.exp(-Ts / 3.0)
    for k in range(N - 1):
        y[k + 1] = steps[k] + (y[k] - steps[k]) * decay
    noise = sd * rng.standard_normal(N)
    noise[211] = 0.5 * (noise[210] + noise[212]) + 8.5 * sd
    record = casid.Record({"u": steps, "y": y + noise}, {"u": "m", "y": "m"}, Ts=Ts)
    problem = casid.Problem("store", m, noise={"u": 0.0})
    found = casid.diagnose(problem, record, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("outliers", "y")
    # The spread of 400 differences is known to about 5 %, of which 6.9 makes 0.35.
    z = 8.5 / np.sqrt(1.5)
    low, high = (2 * N * norm.sf(z + by) / OUTLIERS.test_share for by in (1.0, -1.0))
    assert low < cause.p_value < high


@pytest.mark.parametrize("p", [1e-9, 0.5])
def test_no_p_exceeds_one(p: float) -> None:
    from casid.diagnosis.verdict.reported_causes import _family_wise

    assert _family_wise(p) == min(p / OUTLIERS.test_share, 1.0)
