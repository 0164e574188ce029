"""What a measured input does between its samples is not known, and no cause is made of it."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import norm

import casid
from casid.diagnosis.evidence.scores.score_tests import ScoreTable, score_test
from casid.diagnosis.thresholds import SCORES
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.channels.delays import time_delay

TS = 0.02  # s
SAMPLES = 8  # time constant of what drives the system, in samples
RATE = 3.0  # 1/s, of the system


@functools.cache
def record(noise: float = 0.0, seed: int = 0) -> casid.Record:
    """x' = RATE (u - x), u' = (r - u) / T; r is held and steps at samples. Exact there."""
    rng = np.random.default_rng(seed)
    n = 4000
    r = np.repeat(rng.standard_normal(n // 25), 25)
    T = SAMPLES * TS
    a = np.array([[-RATE, RATE, 0.0], [0.0, -1 / T, 1 / T], [0.0, 0.0, 0.0]])
    step = expm(a * TS)
    z = np.zeros((n, 3))
    for k in range(n - 1):
        z[k, 2] = r[k]
        z[k + 1] = step @ z[k]
    y = z[:, 0] + noise * rng.standard_normal(n)
    return casid.Record({"y": y, "u": z[:, 1]}, {"y": "m", "u": "m"}, Ts=TS, name="lag")


def model(hold: str) -> casid.Model:
    m = casid.Model("a lag")
    x = m.state("x", "m")
    u = m.input("u", "m", hold=hold)
    rate = m.parameter("rate", "1/s", start=2.0, lower=0.1, upper=20.0)
    gain = m.parameter("gain", "1", start=1.0, lower=0.1, upper=10.0)
    m.derivative(x, rate * (gain * u - x))
    m.output("y", x, "m")
    return m


def fitted(m: casid.Model, r: casid.Record) -> Fit:
    return fit_model(m, [casid.Experiment(r, {}, r.name)], FitSettings(starts=1), check_rank=False)


def table(hold: str) -> ScoreTable:
    fit = fitted(model(hold), record(0.05, seed=3))
    return score_test(fit, [time_delay(fit.criterion.model, "u", 0.1)], input_sd={}, draws=50)


def test_a_line_between_samples_of_a_first_order_response_is_a_delay_of_ts_squared_over_12_t():
    """The line lies above a decay by Ts^2/8 u'' at most and Ts^2/12 u'' on average, u'' = -u'/T.

    Tolerance: the next term of the mean, relative (Ts/T)/2, and the curvature that is left.
    """
    base = model("foh")
    late, names = time_delay(base, "u", 0.1).extended(base, starts={"delay_u": 0.001})
    fit = fitted(late, record())
    assert fit.values[names[0]] == pytest.approx(TS / (12 * SAMPLES), rel=1 / SAMPLES)


def test_the_allowance_is_that_of_eight_samples():
    assert SCORES.between_samples == pytest.approx(1 / (12 * SAMPLES), rel=0.05)


def test_a_delay_s_p_is_the_largest_within_the_allowance():
    """A delay's score changes by its energy for each second of delay, and it has one sign.

    z^2 / unrobust is the variance that the score has by chance, over its energy. Tolerance: the
    score's law is Student's, with some hundred degrees of freedom.
    """
    (score,) = table("foh").scores
    assert score.z > 0.5
    sd = np.sqrt(score.unrobust) / score.z
    allowed = SCORES.between_samples * TS * np.sqrt(score.energy) / sd
    assert allowed > 0.25
    assert norm.isf(score.p_value) == pytest.approx(score.z - allowed, abs=0.02)


def test_a_held_input_is_known_between_its_samples():
    """Of a held command there is nothing that is not known: p is that of z alone."""
    (score,) = table("zoh").scores
    assert norm.isf(score.p_value) == pytest.approx(score.z, rel=0.05)
