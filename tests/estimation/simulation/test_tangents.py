"""No standard error is given where the tangent of a simulation is not its slope."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.estimation.errors_in_variables.error_bars import robust_bars
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation_estimate import steeper_than_simulation


def doubling(gain: float) -> casid.Model:
    """x' = g sin(x), sampled so coarsely that a step of Runge-Kutta is a chaotic map."""
    import casadi as ca

    m = casid.Model("map")
    x = m.state("x", "1", start=0.3)
    m.derivative(x, m.parameter("g", "1/s", start=gain) * ca.sin(x))
    m.output("x", ca.sin(x), "1")
    return m


def experiment(noise: float = 0.01) -> casid.Experiment:
    rng = np.random.default_rng(0)
    values = 0.5 + noise * rng.standard_normal(60)
    return casid.Experiment(casid.Record({"x": values}, {"x": "1"}, Ts=1.0, name="r"))


def test_a_chaotic_simulation_has_no_slope_and_a_smooth_one_has():
    """Errors grow by the largest exponent of the map a sample: 60 of them make powers of ten."""
    for gain, is_chaotic in ((7.0, True), (0.1, False)):
        c = SimulationError(doubling(gain), [experiment()])
        at = c.evaluate(c.start)
        assert (steeper_than_simulation(c, c.start, at.hessian) != []) is is_chaotic


def test_an_estimate_from_a_chaotic_simulation_has_no_standard_errors_and_says_why():
    from casid.estimation.simulation_estimate import ASSUMES, estimate_of

    problem = casid.Problem("map", doubling(7.0), starts=1)
    settings = FitSettings(starts=1, substeps=1)
    fit = fit_model(problem.model, [experiment()], settings, throw=False, check_rank=False)
    estimate = estimate_of(problem, fit, bars=robust_bars(fit, ASSUMES))
    row = estimate.parameter("g")
    assert row.std_error is None
    assert "chaotic" in row.note
    assert any("no standard error is valid" in w for w in estimate.warnings)


def test_a_tiny_standard_error_of_noiseless_data_is_valid():
    """A decay without noise determines its rate to rounding, and its tangent is its slope."""
    m = casid.Model("decay")
    x = m.state("x", "1", start=1.0)
    m.derivative(x, -m.parameter("a", "1/s", start=0.9) * x)
    m.output("x", x, "1")
    record = casid.Record({"x": np.exp(-0.01 * np.arange(500.0))}, {"x": "1"}, Ts=0.01)
    found = casid.identify(casid.Problem("decay", m, starts=1), record, intervals="quick")
    assert found.parameter("a").value == pytest.approx(1.0, abs=1e-6)
    assert found.parameter("a").std_error is not None
