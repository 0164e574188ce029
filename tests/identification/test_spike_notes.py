"""Isolated spikes in what is estimated from: named where the simulation does not follow them."""

from __future__ import annotations

import numpy as np
import pytest

import casid


def integrator() -> casid.Problem:
    m = casid.Model("integrator")
    x = m.state("x", "m", initial=0.0)
    u = m.input("u", "m/s", hold="zoh", known=True)
    m.derivative(x, m.parameter("b", "1", start=1.0) * u)
    m.output("y", x, "m")
    return casid.Problem("integrator", m, starts=1)


@pytest.mark.parametrize("height", [0.0, 2.0])
def test_a_spike_that_counts_in_an_estimate_is_a_warning_with_its_time(height: float) -> None:
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(30), 20)
    y = np.concatenate([[0.0], np.cumsum(0.1 * u)[:-1]]) + 0.01 * rng.standard_normal(600)
    y[250] += height
    record = casid.Record({"u": u, "y": y}, {"u": "m/s", "y": "m"}, 0.1)
    found = [w for w in casid.identify(integrator(), record).warnings if "spike" in w]
    assert len(found) == (1 if height else 0)
    assert all("y: 1 isolated spike, at t = 25 s" in w for w in found)


def test_a_spike_that_the_model_has_too_is_none() -> None:
    """A pulse of a command that an output feels at once."""
    rng = np.random.default_rng(3)
    u = np.zeros(600)
    u[[100, 250, 400]] = 1.0
    m = casid.Model("gain")
    x = m.state("x", "m", initial=0.0)
    command = m.input("u", "m", hold="zoh", known=True)
    m.derivative(x, -m.parameter("a", "1/s", start=1.0, lower=0.1) * (x - command))
    m.output("y", x + m.parameter("b", "1", start=1.0) * command, "m")
    a, response = np.exp(-0.1 * 0.5), np.zeros(600)
    for k in range(599):
        response[k + 1] = a * response[k] + (1 - a) * u[k]
    y = response + 2.0 * u + 0.01 * rng.standard_normal(600)
    record = casid.Record({"u": u, "y": y}, {"u": "m", "y": "m"}, 0.1)
    problem = casid.Problem("gain", m, starts=1)
    assert not [w for w in casid.identify(problem, record).warnings if "spike" in w]
