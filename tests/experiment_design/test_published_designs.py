"""Designed experiments against answers in closed form and in textbooks."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid import Aim


def integrator() -> casid.Problem:
    """dx/dt = theta u from a known start, y = x + noise."""
    m = casid.Model("integrator")
    x, u = m.state("x", "m", initial=0.0), m.input("u", "V")
    theta = m.parameter("theta", "m/(V s)", start=2.0)
    m.derivative(x, theta * u)
    m.output("y", x, "m")
    return casid.Problem("integrator", m, noise={"y": 0.1})


def test_an_integrator_is_driven_at_full_amplitude_all_the_time() -> None:
    """The information on theta is sum (int u)^2 / sigma^2, largest for a constant input."""
    found = casid.design_experiment(
        integrator(),
        Aim.estimate(),
        {"u": (-3, 3)},
        5.0,
        Ts=0.1,
        intervals=10,
        candidates=4,
        starts=1,
    )
    u = found.record["u"][:-1]  # the last interval moves no sample but the one after the record
    assert np.all(np.abs(u) > 2.99)
    assert np.ptp(np.sign(u[:45])) == 0
    t = 0.1 * np.arange(50)
    exact = 0.1 / (3.0 * np.sqrt(np.sum(t**2)))
    assert found.parameters[0].std_error == pytest.approx(exact, rel=0.005)


def damped(zeta: float) -> casid.Problem:
    """x'' = u - d x' - x with d = 2 zeta unknown, from rest."""
    m = casid.Model("second order")
    x, v = m.state("x", "m", initial=0.0), m.state("v", "m/s", initial=0.0)
    u = m.input("u", "m/s^2")
    damping = m.parameter("d", "1/s", start=2 * zeta, lower=0.0)
    stiffness = m.constant("omega_0^2", 1.0, "1/s^2")
    m.derivative(x, v)
    m.derivative(v, u - damping * v - stiffness * x)
    m.output("y", x, "m")
    return casid.Problem("second order", m, noise={"y": 0.01})


def test_the_damping_ratio_is_estimated_at_its_optimal_frequency() -> None:
    """With limited energy all of it goes where |dG/d zeta|, G = 1/(s^2 + 2 zeta s + 1), is largest.

    d/dw of w / ((1 - w)^2 + 4 zeta^2 w)^2 = 0 with w = omega^2 is 3 w^2 - (2 - 4 zeta^2) w - 1 = 0
    (one line suffices for one parameter: Goodwin and Payne 1977, section 6.4).
    """
    zeta, duration = 0.4, 60.0
    found = casid.design_experiment(
        damped(zeta),
        Aim.estimate("d"),
        {"u": (-10, 10)},
        duration,
        Ts=0.5,
        shape="multisine",
        band=(0.05, 0.3),
        max_energy={"u": 30.0},
        intervals=60,
        candidates=6,
        starts=1,
    )
    b = 1 - 2 * zeta**2
    optimum = np.sqrt((b + np.sqrt(b * b + 3)) / 3) / (2 * np.pi)
    power = np.abs(np.fft.rfft(found.record["u"])) ** 2
    lines = np.fft.rfftfreq(found.record.N, 0.5)
    mean = np.sum(power * lines) / np.sum(power)
    assert abs(mean - optimum) < 1 / duration  # within the distance of two lines
    assert 0.5 * np.sum(found.record["u"] ** 2) <= 30.0 * (1 + 1e-6)
    assert found.gain > 1.0


def decay() -> casid.Problem:
    """A free decay, nothing acting."""
    m = casid.Model("decay")
    x = m.state("x", "m")
    rate = m.parameter("a", "1/s", start=0.5, lower=0.0)
    m.derivative(x, -rate * x)
    m.output("y", x, "m")
    return casid.Problem("decay", m, noise={"y": 0.01})


def test_a_free_decay_is_released_from_its_limit() -> None:
    """The information on the rate grows with the square of the displacement.

    With x_0 estimated beside it, its inverse is the last entry of (J'J)^-1 sigma^2 for the columns
    J = (exp(-a t), -x_0 t exp(-a t)).
    """
    found = casid.design_experiment(
        decay(),
        Aim.estimate("a"),
        None,
        6.0,
        Ts=0.1,
        release={"x": (-2, 3)},
        intervals=10,
        candidates=4,
        starts=1,
    )
    assert found.initial["x"] == pytest.approx(3.0, rel=1e-3)
    t = 0.1 * np.arange(60)
    J = np.column_stack([np.exp(-0.5 * t), -3.0 * t * np.exp(-0.5 * t)])
    exact = 0.01 * np.sqrt(np.linalg.inv(J.T @ J)[1, 1])
    assert found.parameters[0].std_error == pytest.approx(exact, rel=2e-3)
