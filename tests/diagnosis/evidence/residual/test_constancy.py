"""A parameter that comes and goes is no constant, and noise makes none of one."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.stats import binom

from casid.diagnosis.evidence.residual.constancy import Unsteady, unsteady
from casid.diagnosis.evidence.residual.linearised_path import Linearised
from casid.diagnosis.evidence.residual.residual_tests import IN_TIME, residual_tests
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.estimation.simulation.fit import FitSettings, fit_model
from tests.support.hidden_forces import Force, fitted, model, record

PERIOD = 40.0 / 3.0
"""Three times in a record [s]: the means of its halves hardly differ."""


def swelling(x: float, v: float, speed: float, t: float) -> float:
    """Damping of 1.5 N s/m that is larger and smaller by 0.75 N s/m."""
    return -0.75 * math.sin(2 * math.pi * t / PERIOD) * v


def found(force: Force, seed: int) -> tuple[Unsteady, str]:
    made = [record(force, seed)]
    at = Weighing(made).weigh(model(), fit_model(model(), made, FitSettings()))
    least = unsteady(at, made, seed=seed)
    assert least is not None
    return least, residual_tests(at, made, seed=seed).verdict


@functools.cache
def constant(seed: int) -> float:
    at, made = fitted("none", seed)
    least = unsteady(at, made, seed=seed)
    assert least is not None
    return least.p_value


@pytest.mark.parametrize("parameter", ["k", "d", "m"])
def test_a_constant_change_of_a_parameter_moves_the_outputs_as_its_sensitivity_does(
    parameter: str,
) -> None:
    at, _ = fitted("none", 22)
    fit = at.unbiased or at.fit
    along = Linearised(fit.criterion, fit.x)
    [[motion]] = along.motions(np.zeros(1), 0)
    change = along.changed(motion, parameter)
    moved = motion.path.respond_to(change, np.ones((motion.signals.N, 1)))[:, :, 0]
    expected = motion.at.jacobian[:, :, fit.criterion.names.index(parameter)]
    np.testing.assert_allclose(moved, expected, atol=1e-12 * np.abs(expected).max())


def test_a_damping_that_comes_and_goes_is_not_constant() -> None:
    """Off the tangent of constant parameters, its sensitivity times a sine explains the misfit."""
    least, verdict = found(swelling, 1)
    assert least.parameter == "d"
    assert least.p_value < 1e-4
    assert verdict == IN_TIME


@pytest.mark.slow
def test_constant_parameters_are_called_unsteady_at_no_more_than_the_rate() -> None:
    """Beyond the 99.5 % quantile of the binomial the rate would not hold."""
    alarms = sum(constant(seed) < 0.05 for seed in range(50, 74))
    assert alarms <= binom.ppf(0.995, 24, 0.05)
