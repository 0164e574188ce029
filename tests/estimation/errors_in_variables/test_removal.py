"""Estimates without the bias of input noise: points at which no noise can be found."""

from __future__ import annotations

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.estimation.errors_in_variables.input_noise import input_noise
from casid.estimation.errors_in_variables.removal import Corrected, _Root
from casid.estimation.simulation.fit import FitSettings, fit_model
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


def test_where_bounds_hold_every_unknown_there_is_no_root():
    """Rain that says little of a river: the steps lead a store's rate and its share to a bound."""
    rng = np.random.default_rng(4)
    rain, flow = rng.exponential(2.0, 200), np.empty(200)
    level = 20.0
    for k in range(200):
        flow[k] = 0.05 * level
        level += 0.4 * rain[k] - flow[k]
    m = casid.Model("river")
    P, S = m.input("P", "1/s", hold="zoh"), m.state("S", "1", initial=20.0)
    rate = m.parameter("rate", "1/s", start=0.05, lower=0.04, upper=0.06)
    share = m.parameter("share", "1", start=0.4, lower=0.3, upper=0.5)
    m.derivative(S, share * P - rate * S)
    m.output("Q", rate * S, "1/s")
    channels = {"P": rain, "Q": flow + 0.01 * rng.standard_normal(200)}
    record = casid.Record(channels, {"P": "1/s", "Q": "1/s"}, Ts=1.0)
    fit = fit_model(m, [casid.Experiment(record, {}, "r")], FitSettings(starts=1))
    found = input_noise(fit.criterion, fit.x, {})
    root = _Root(fit, {}, np.array([False, False]), found, 0)
    assert root.why_not == "the equations without it lead every unknown to a bound"


def test_why_noise_was_not_removed_is_a_whole_sentence():
    fit = SimpleNamespace(criterion=SimpleNamespace(model=None))
    said = Corrected(fit, why_not="it is fitted in segments").text
    assert said == "noise on inputs is not removed, since it is fitted in segments"
    still = Corrected(fit, np.eye(1), input_sd={"u": 0.0}, bias={"k": 0.0}).text
    assert still == "noise on inputs moves no unknown by more than 0.1 standard errors"
