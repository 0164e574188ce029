"""A problem is simulated with steps as fine as it needs, as a fit of it would."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import casid
from casid.estimation.fitted.parts import SimulationSettings
from casid.estimation.fitted.simulation_inputs import starting_model


def driven(terms):
    """A mass of 1 kg under a force that changes its sign every second, sampled every 0.1 s."""
    m = casid.Model("mass")
    v, F = m.state("v", "m/s"), m.input("F", "N", hold="zoh", known=True)
    M = m.constant("M", 1.0, "kg")
    m.balance(v, "force", inertia=M, terms=[F, *terms(m, v)])
    m.output("speed", v, "m/s")
    force = np.where(np.arange(400) // 10 % 2, 2.0, -2.0)
    record = casid.Record({"F": force}, {"F": "N"}, Ts=0.1, name="square wave")
    return casid.Problem("mass", m), casid.Experiment(record)


def test_what_is_too_stiff_for_one_step_a_sample_is_simulated_with_more():
    """A brake of 50 N s/m: one step of 0.1 s diverges, and nobody need resample the inputs."""
    problem, data = driven(lambda m, v: [-m.constant("d", 50.0, "N s/m") * v])
    speed = starting_model(problem, data).simulate(data)["speed"]
    assert np.abs(speed).max() == pytest.approx(2 / 50, rel=1e-3)


def test_dry_friction_is_simulated_as_finely_as_a_fit_would():
    """Smoothed below 2 mm/s, it chatters about rest where a sample has sixteen steps."""
    problem, data = driven(lambda m, v: [-m.constant("F_c", 1.0, "N") * ca.tanh(v / 0.002)])
    fitted = starting_model(problem, data)
    finest = replace(fitted, settings=SimulationSettings(512)).simulate(data)["speed"]
    assert np.abs(fitted.simulate(data)["speed"] - finest).max() < 1e-4
    coarse = replace(fitted, settings=SimulationSettings(16)).simulate(data)["speed"]
    assert np.abs(coarse - finest).max() > 1e-4


def test_a_speed_that_grows_without_bound_is_refused_all_the_same():
    problem, data = driven(lambda m, v: [m.constant("a", 5.0, "kg s/m^2") * v**3])
    with pytest.raises(casid.SolveError, match="the simulation of square wave diverges at t = "):
        starting_model(problem, data)
