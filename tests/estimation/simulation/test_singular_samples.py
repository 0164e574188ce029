"""A division by an input that is zero in a record is named, with the instant and the remedy."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.estimation.simulation.fit import FitSettings, fit_model

FLOW = np.repeat([1e-4, 0.0, 2e-4], 20)
"""Shut off from 20 s to 40 s, m^3/s."""


def mixer(inflow=lambda a, q, F, c: F * (a * q / F - c)):
    """What flows in mixes with what is there; the first law divides by the flow, and multiplies."""
    m = casid.Model("mixer")
    c = m.state("c", "kg/m^3", start=10.0)
    F, q = (m.input(n, unit, hold="zoh", known=True) for n, unit in (("F", "m^3/s"), ("q", "kg/s")))
    V = m.parameter("V", "m^3", start=0.1, lower=0.01)
    a = m.parameter("a", "1", start=1.0, lower=0.1)
    m.balance(c, "mass", inertia=V, terms=[inflow(a, q, F, c)], unit="kg/s")
    m.output("c_out", c, "kg/m^3")
    return m


def record(flow=FLOW):
    channels = {"F": flow, "q": np.full(len(flow), 1e-3), "c_out": np.linspace(10, 9, len(flow))}
    units = {"F": "m^3/s", "q": "kg/s", "c_out": "kg/m^3"}
    return casid.Experiment(casid.Record(channels, units, Ts=1.0, name="shut off"))


def refused(model, data, match):
    with pytest.raises(casid.SolveError, match=match) as caught:
        fit_model(model, [data], FitSettings(starts=1), check_rank=False)
    return str(caught.value)


def test_a_fit_names_the_input_that_is_zero_and_when():
    said = refused(mixer(), record(), r"divide by F, which is 0 at t = 20 s, in 20 of 60 samples")
    assert "or take a window without these samples" in said
    assert "if the model is unstable" not in said


def test_where_it_is_zero_all_the_time_no_window_is_advised():
    said = refused(mixer(), record(0 * FLOW), "which is 0 at t = 0 s, in 60 of 60 samples")
    assert "window" not in said


def test_a_slope_that_divides_by_it_is_named_as_well():
    law = mixer(lambda a, q, F, c: q - ca.sqrt(a * F**2) * c)
    refused(
        law, record(), r"slopes of the equations divide by 2 \* sqrt\(a \* F\^2\), which is 0 at"
    )


def test_a_simulation_that_grows_without_bound_divides_by_nothing():
    law = mixer(lambda a, q, F, c: a * c**5)
    said = refused(law, record(), "diverges at t")
    assert "divide" not in said


def test_a_simulation_names_it_too():
    """With known values: `casid simulate`, and everything that a fitted model is driven by."""
    problem = casid.Problem("mixer", mixer())
    model = casid.identify(problem, record(np.abs(FLOW) + 1e-4)).model
    with pytest.raises(casid.SolveError, match=r"divide by F, which is 0 at t = 20 s"):
        model.simulate(record())
