"""Noise of a measured input that rings at a resonance: with a gap in the record, and held out.

A load hangs from a trolley whose acceleration an accelerometer records; the angle is linear in it,
and solved exactly between samples that straight lines join.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2
from scipy.stats import f as f_distribution

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.thresholds import JUDGING
from casid.diagnosis.verdict.gain import chance_over_floor
from casid.estimation.holdout import split_records
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import Response
from casid.estimation.simulation.fit import FitSettings, fit_model

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


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2, 3))])
def test_a_gap_in_a_record_is_no_cause(seed):
    found = diagnosed(seed, True)
    assert found.verdict == "adequate", found.sentence


@pytest.mark.slow
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


@pytest.mark.parametrize("every", [1, 5])
def test_a_line_is_extrapolated_as_far_off_as_its_errors_say(every):
    """y = x(0) + a t + e, of which the last 30 % are held out: least squares, P = s^2 (X'X)^-1.

    The error of the line alone gives the mean square tr(X_h P X_h') / n_h, and held-out errors
    above what chance allows are as rare as one in a thousand: none in 300, most likely. More than
    a tenth above the floor there are many. A sample of the clock without a reading counts for
    nothing.
    """
    n, s = 100 * every, 0.2
    m = casid.Model("a line")
    m.derivative(m.state("x", "m"), m.parameter("a", "m/s"))
    m.output("y", m.symbol("x"), "m")
    t, is_read = np.arange(n) * 1.0, np.arange(n) % every == 0
    kept = is_read & (t < 0.7 * n)
    held = is_read & ~kept
    X = np.column_stack([t, np.ones(n)])
    P = s**2 * np.linalg.inv(X[kept].T @ X[kept])
    e = s * np.random.default_rng(0).standard_normal((300, n))
    y = np.where(is_read, 0.1 * t + e[0], np.nan)
    whole = casid.Record({"y": y}, {"y": "m"}, Ts=1.0, name="line", missing={"y": ~is_read})
    split = split_records([casid.Experiment(whole, {}, "line")], 0.3)
    fit = fit_model(m, split.fitted, FitSettings(starts=1))
    assert fit.criterion.names == ("a", "x(0)")
    at = Weighing(split.fitted).weigh(m, fit)
    chance = chance_over_floor(fit, P, at, split, {"y": s})["y"]
    added = np.trace(X[held] @ P @ X[held].T) / held.sum() / s**2
    expected = f_distribution.isf(1e-3, held.sum(), kept.sum()) + chi2.isf(1e-3, 1) * added
    # The lines of the spectrum end a thousandth short of pi: so far off are degrees of freedom.
    assert chance == pytest.approx(np.sqrt(expected), rel=1e-3)
    left = e.T - X @ np.linalg.lstsq(X[kept], e.T[kept], rcond=None)[0]
    over = np.sqrt(np.mean(left[held] ** 2, axis=0)) / s
    assert np.mean(over > chance) <= 1 / 300
    assert np.mean(over > JUDGING.at_floor) > 0.2


def continued_line(seed: int, bend: float = 0.0) -> casid.Diagnosis:
    """A line of which a quarter is fitted; its slope changes by `bend` [m/s] after that."""
    m = casid.Model("a line")
    m.derivative(m.state("x", "m"), m.parameter("a", "m/s"))
    m.output("y", m.symbol("x"), "m")
    t = np.arange(200.0)
    y = 0.1 * t + bend * np.maximum(t - 50.0, 0.0)
    y = y + 0.2 * np.random.default_rng(seed).standard_normal(200)
    record = casid.Record({"y": y}, {"y": "m"}, Ts=1.0, name="line")
    problem = casid.Problem("a line", m, starts=1)
    return casid.diagnose(problem, record, hold_out=0.75, advise=False)


@pytest.mark.parametrize("seed", [5, 10, 18])
def test_what_the_errors_of_the_estimates_do_to_what_was_held_out_leaves_the_model_adequate(seed):
    """The error there is twice the floor: the line is known from 50 samples of 200."""
    found = continued_line(seed)
    assert found.held_out["baseline_rmse"]["y"] > 1.5 * found.held_out["noise_floor"]["y"]
    assert found.verdict == "adequate", found.sentence


@pytest.mark.slow
def test_what_the_errors_of_the_estimates_do_not_explain_is_sought_in_the_whole_record():
    """A slope that changes where the held-out part begins; noise of 0.2 m hides 0.2 / 0.05 s."""
    found = continued_line(1, bend=0.05)
    jump = found.causes[0]
    assert (jump.kind, jump.where) == ("parameter_jump", "a")
    size, time = jump.parameters
    assert size.value == pytest.approx(0.05, abs=4 * size.std_error)
    assert size.std_error < 0.003
    assert time.value == pytest.approx(50.0, abs=4.0)
    assert any(
        "fits the first 25 % of each record fails in what follows" in note for note in found.notes
    )
