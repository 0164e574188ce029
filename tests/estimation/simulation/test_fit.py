"""Outputs of different noise: each counts in units of the error that it leaves."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.estimation.simulation.fit import FitSettings, fit_model, weighted_by_errors

ONE = FitSettings(starts=1, substeps=1)


def decay() -> casid.Model:
    m = casid.Model("decay")
    x = m.state("x", "1")
    a = m.parameter("a", "1/s", start=1.0)
    m.derivative(x, -a * x)
    m.output("coarse", x, "1")
    m.output("fine", x, "1")
    return m


def test_the_weights_are_those_of_the_likelihood_with_unknown_variances():
    """One over the RMS errors at their own fit, so that the finer sensor has the word."""
    rng, t = np.random.default_rng(3), 0.05 * np.arange(200)
    sd = {"coarse": 0.2, "fine": 0.001}
    y = {name: np.exp(-1.3 * t) + s * rng.standard_normal(200) for name, s in sd.items()}
    record = casid.Record(y, dict.fromkeys(sd, "1"), Ts=0.05)
    first = fit_model(decay(), [casid.Experiment(record, {}, "r")], ONE)
    fit = weighted_by_errors(first, ONE)
    residual = fit.criterion.simulated(fit.x, 0).residual
    rms = np.sqrt(np.mean(residual**2, axis=0))
    assert fit.criterion.weights == pytest.approx(1 / rms, rel=0.05)
    # Five standard errors of the fine sensor alone: sd / sqrt(sum (t exp(-1.3 t))^2).
    error = sd["fine"] / np.sqrt(np.sum((t * np.exp(-1.3 * t)) ** 2))
    assert fit.values["a"] == pytest.approx(1.3, abs=5 * 2 * error)
    assert abs(first.values["a"] - 1.3) > abs(fit.values["a"] - 1.3)


def test_a_single_output_keeps_its_fit():
    record = casid.Record({"x": np.exp(-np.arange(50) * 0.1)}, {"x": "1"}, Ts=0.1)
    m = casid.Model("decay")
    x, a = m.state("x", "1"), m.parameter("a", "1/s", start=0.5)
    m.derivative(x, -a * x)
    m.output("x", x, "1")
    fit = fit_model(m, [casid.Experiment(record, {}, "r")], ONE)
    assert weighted_by_errors(fit, ONE) is fit
