"""Estimates without the bias of input noise: points at which no noise can be found."""

from __future__ import annotations

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.estimation.errors_in_variables.removal import _Root
from casid.estimation.simulation.simulation_error import SimulationError
from problems import pendulum
from tests.support.shared import shared


@pytest.mark.parametrize(("rate", "is_usable"), [(0.5, True), (5.0, False)])
def test_a_simulation_whose_fourth_powers_overflow_is_no_place_to_find_noise(rate, is_usable):
    """x' = a x + u over 50 s: at a = 5/s exp(a t) ends at 1e108, whose square is a number.

    The variance of a noise is a square, and the variance of that estimate a fourth power.
    """
    m = casid.Model("unstable")
    x, u = m.state("x", "m", initial=0.0), m.input("u", "m/s")
    a = m.parameter("a", "1/s", start=rate, lower=0.0, upper=10.0)
    m.derivative(x, a * x + u)
    m.output("y", x, "m")
    record = casid.Record({"u": np.ones(1000), "y": np.zeros(1000)}, {"u": "m/s", "y": "m"}, 0.05)
    criterion = SimulationError(m, [casid.Experiment(record, {}, "r")], weights=np.ones(1))
    assert np.isfinite(criterion.simulated(criterion.start, 0).residual ** 2).all()
    root = SimpleNamespace(criterion=criterion, x=criterion.start)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert _Root._is_finite(root) == is_usable


def test_half_a_second_of_a_pendulum_is_identified_without_an_overflow():
    """49 samples: a step away from the bias ends where the pendulum falls over."""
    whole = pendulum.problem.read(shared("cases/pendulum/case_000.csv"), name="run")
    r = whole.record
    part = replace(whole, record=r.between(r.t0, r.t0 + 48.5 * r.Ts))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = casid.identify(pendulum.problem, part)
    assert found.is_converged
