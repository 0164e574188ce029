"""Noise of a measured input that rings at a resonance: with a gap in the record, and held out.

A load hangs from a trolley whose acceleration an accelerometer records; the angle is linear in it,
and solved exactly between samples that straight lines join.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.estimation.noise import NoiseModel
from casid.estimation.noise_response import Response

Array = np.ndarray

TS, N = 0.04, 2000
LENGTH, DAMPING, GRAVITY = 3.2, 0.05, 9.81
SENSOR, INPUT = 1e-3, 0.02


def load() -> casid.Problem:
    m = casid.Model("load")
    a = m.input("trolley", "m/s^2")
    angle, rate = m.state("theta", "rad"), m.state("omega", "rad/s")
    length = m.parameter("L", "m", start=2.5, lower=0.5, upper=20.0)
    d = m.parameter("d", "1/s", start=0.02, lower=0.0, upper=2.0)
    m.derivative(angle, rate)
    m.derivative(rate, -m.constant("g", GRAVITY, "m/s^2") / length * angle - d * rate - a / length)
    m.output("angle", angle, "rad")
    return casid.Problem("load", m)


def record(seed: int, gap: slice) -> casid.Record:
    rng = np.random.default_rng(seed)
    a = np.convolve(np.repeat(rng.uniform(-0.6, 0.6, N // 40 + 1), 40)[:N], np.ones(5) / 5, "same")
    A = np.zeros((4, 4))
    A[0, 1], A[1, 0], A[1, 1], A[1, 2] = 1.0, -GRAVITY / LENGTH, -DAMPING, -1.0 / LENGTH
    A[2, 3] = 1.0  # the acceleration, and its slope
    step = expm(A * TS)
    x, y = np.zeros(4), np.empty(N)
    for k in range(N):
        y[k] = x[0]
        x[2], x[3] = a[k], (a[min(k + 1, N - 1)] - a[k]) / TS
        x = step @ x
    missing = np.zeros(N, dtype=bool)
    missing[gap] = True
    channels = {"trolley": a + INPUT * rng.standard_normal(N)}
    channels["angle"] = y + SENSOR * rng.standard_normal(N)
    channels["angle"][missing] = np.nan
    units = {"trolley": "m/s^2", "angle": "rad"}
    return casid.Record(channels, units, TS, missing={"angle": missing})


GAP, WHOLE = slice(700, 760), slice(0, 0)


def input_noise(found: casid.Diagnosis) -> float:
    return 1e-3 * float(found.noise["trolley"].split()[-2])  # white input noise 19.3 mm/s^2


@functools.cache
def diagnosed(seed: int, has_gap: bool) -> casid.Diagnosis:
    return casid.diagnose(load(), record(seed, GAP if has_gap else WHOLE), advise=False)


@pytest.mark.parametrize("seed", range(4))
def test_a_gap_in_a_record_is_no_cause(seed):
    found = diagnosed(seed, True)
    assert found.verdict == "adequate", found.sentence


def test_a_gap_leaves_the_noise_of_an_input_as_large_as_it_is():
    """Of 1400 samples 60 are missing: what is estimated from the rest is the same on the average.

    The two estimates of a seed share 96 % of their samples, so that they differ by some 20 % of
    their own spread, which is a tenth; the mean of four by less than 2 % a standard deviation.
    """
    pairs = [(input_noise(diagnosed(s, True)), input_noise(diagnosed(s, False))) for s in range(4)]
    assert np.mean([a / b for a, b in pairs]) == pytest.approx(1.0, abs=0.08)


def test_the_mean_square_of_white_noise_varies_as_chi_squared_does():
    omega = np.linspace(0.0, np.pi, 100)
    response = Response(omega=omega, gain2=np.zeros((100, 1, 0)), sources=())
    noise = NoiseModel(np.array([0.3]), {}, [response], np.ones(1))
    assert noise.spread(0, 500) == pytest.approx(np.sqrt(2 / 500))
