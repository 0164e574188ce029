"""How much noise of its inputs a residual allows."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.prewhitening import Weighing
from casid.estimation.errors_in_variables.left_by_noise import share_that_is_there
from casid.estimation.input_noise_floor import input_noise_floor
from casid.estimation.noise import estimate_noise
from casid.estimation.simulation.fit import FitSettings, fit_model

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


def test_a_diagnosis_counts_no_more_noise_of_an_input_than_least_squares_left(monkeypatch):
    """Whatever the spectra of residual and input allow."""
    fit = fit_of(1, 0.0)
    weighing = Weighing(fit.criterion.experiments)
    floor = input_noise_floor(fit.criterion.data, ["u"])
    monkeypatch.setattr(Weighing, "input_sd", lambda *_: floor)
    at = weighing.estimated(fit)
    least = np.sqrt(np.mean(fit.criterion.simulated(fit.x, 0).residual ** 2))
    assert at.full.quiet(at.input_sd).floor(0)[0] < 1.05 * least
