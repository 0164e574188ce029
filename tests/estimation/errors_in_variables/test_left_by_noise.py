"""How much noise of its inputs a residual allows."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.estimation.errors_in_variables.left_by_noise import left_by_noise, share_that_is_there
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.simulation_error import SimulationError

SD = 0.1


def model() -> casid.Model:
    m = casid.Model("store")
    u, x = m.input("u", "1"), m.state("x", "1")
    a, b = m.parameter("a", "1/s", start=0.25, lower=0.0), m.parameter("b", "1/s", start=-0.25)
    m.derivative(x, -a * x + b * u)
    m.output("y", x, "1")
    return m


def fit_of(seed: int, input_sd: float):
    """Of an input drawn anew at every sample, joined by lines, and read with noise."""
    rng = np.random.default_rng(seed)
    u, y = 0.2 * rng.standard_normal(300), np.zeros(300)
    e = np.exp(-0.25)
    for k in range(299):  # a first-order lag behind a straight line
        y[k + 1] = e * y[k] - (1 - e) * u[k] - (u[k + 1] - u[k]) * (1 - 4 * (1 - e))
    columns = {"u": u + input_sd * rng.standard_normal(300)}
    columns["y"] = y + 0.02 * rng.standard_normal(300)
    record = casid.Record(columns, {"u": "1", "y": "1"}, Ts=1.0)
    return fit_model(model(), [casid.Experiment(record, {}, "r")], FitSettings(starts=1))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_white_input_without_noise_is_not_taken_for_noise(seed: int):
    """No spectrum of its own distinguishes it from noise; what least squares leaves does."""
    fit = fit_of(seed, 0.0)
    floor = input_noise_floor(fit.criterion.data, ["u"])
    assert floor["u"] > 0.15
    assert share_that_is_there(fit, estimate_noise(fit.criterion, fit.x), floor) < 0.3


@pytest.mark.parametrize("seed", [1, 2])
def test_noise_that_least_squares_left_is_there(seed: int):
    fit = fit_of(seed, SD)
    assert share_that_is_there(fit, estimate_noise(fit.criterion, fit.x), {"u": SD}) == 1.0


def test_what_noise_leaves_behind_a_resonance_scatters_as_the_power_of_few_lines():
    """var P / (E P)^2 = 2 sum S^2 / (sum S)^2 over the lines of a Gaussian record's spectrum S.

    Here 0.3: as if the power were the same in every record, a root whose noise is half or twice the
    mean was taken for one without it. The standard deviation of 20 logarithms is known to 16 %.
    """
    N, Ts, ring = 1500, 0.1, 3.0
    m = casid.Model("ringing")
    x, v, u = m.state("x", "1"), m.state("v", "1/s"), m.input("u", "1", hold="zoh")
    b = m.parameter("b", "1", start=1.0)
    m.derivative(x, v)
    m.derivative(v, -0.12 * v - ring**2 * x + b * u)
    m.output("y", x, "1")
    rng = np.random.default_rng(2)
    record = casid.Record(
        {"u": rng.standard_normal(N), "y": rng.standard_normal(N)}, {"u": "1", "y": "1"}, Ts=Ts
    )
    c = SimulationError(m, [casid.Experiment(record, {}, "r")])
    free = np.array([name == "b" for name in c.names])
    moved = left_by_noise(c, c.start, free, {"u": 1.0}, np.zeros(1))[:, 0]
    omega = 2 * np.pi * np.arange(1, N) / (N * Ts)
    S = 1 / ((ring**2 - omega**2) ** 2 + (0.12 * omega) ** 2)
    S = S[omega < np.pi / Ts]  # one half of the lines, each with two degrees of freedom
    wanted = np.sqrt(np.sum(S**2)) / np.sum(S)
    assert np.std(np.log(moved), ddof=1) == pytest.approx(wanted, rel=3 * 0.16)


def test_a_diagnosis_counts_no_more_noise_of_an_input_than_least_squares_left(monkeypatch):
    """Whatever the spectra of residual and input allow."""
    fit = fit_of(1, 0.0)
    weighing = Weighing(fit.criterion.experiments)
    floor = input_noise_floor(fit.criterion.data, ["u"])
    monkeypatch.setattr(Weighing, "input_sd", lambda *_: floor)
    at = weighing.estimated(fit)
    least = np.sqrt(np.mean(fit.criterion.simulated(fit.x, 0).residual ** 2))
    assert at.full.quiet(at.input_sd).floor(0)[0] < 1.05 * least
