"""Designed experiments against answers in closed form and in textbooks."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid import Aim
from casid.estimation.simulation.integration.simulator import Simulator
from casid.experiment_design.information import Target, scores


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


def test_the_gain_and_the_time_constant_of_a_lag_are_estimated_at_one_over_root_three() -> None:
    """Of K / (1 + tau s) one line says most, at omega tau = 1 / sqrt(3).

    Gain and phase of one line are two numbers for two parameters, and their determinant is
    Im(dG/dK conj(dG/dtau))^2 = (K omega / (1 + (omega tau)^2)^2)^2 (Goodwin and Payne 1977, ch. 6).
    """
    m = casid.Model("lag")
    x, u = m.state("x", "V", initial=0.0), m.input("u", "V")
    tau, K = m.parameter("tau", "s", start=2.0, lower=0.1), m.parameter("K", "1", start=1.0)
    m.derivative(x, (K * u - x) / tau)
    m.output("y", x, "V")
    duration = 200.0
    found = casid.design_experiment(
        casid.Problem("lag", m, noise={"y": 0.01}),
        Aim.estimate(),
        {"u": (-10, 10)},
        duration,
        Ts=0.5,
        shape="multisine",
        band=(0.01, 0.2),
        max_energy={"u": 30.0},
        intervals=100,
        candidates=6,
        starts=1,
    )
    power = np.abs(np.fft.rfft(found.record["u"])) ** 2
    lines = np.fft.rfftfreq(found.record.N, 0.5)
    mean = np.sum(power * lines) / np.sum(power)
    spacing = 0.01  # twenty lines over the band
    assert abs(mean - 1 / (2 * np.pi * 2.0 * np.sqrt(3))) < 0.5 * spacing


PYOMO = {
    "A1": 84.79085853498033,
    "A2": 371.71773413976416,
    "E1": 7.777032028026428,
    "E2": 15.047135137500822,
}


def reactor(error: float, **values: float) -> casid.Problem:
    """A -> B -> C at a temperature that is set, all three measured: Wang and Dowling (2022)."""
    m = casid.Model("reactor")
    A, B, C = (m.state(n, "mol/l", initial=v) for n, v in (("A", 5.0), ("B", 0.0), ("C", 0.0)))
    T, R = m.input("T", "K", hold="zoh"), m.constant("R", 8.314, "J/(mol K)")
    units = {"A1": "1/h", "A2": "1/h", "E1": "kJ/mol", "E2": "kJ/mol"}
    p = {n: m.parameter(n, u, start=values[n], lower=0.1 * values[n]) for n, u in units.items()}
    k1, k2 = (p["A" + n] * ca.exp(-p["E" + n] / (R * T)) for n in "12")
    m.derivative(A, -k1 * A)
    m.derivative(B, k1 * A - k2 * B)
    m.derivative(C, k2 * B)
    for name, state in (("C_A", A), ("C_B", B), ("C_C", C)):
        m.output(name, state, "mol/l")
    return casid.Problem("reactor", m, noise=dict.fromkeys(("C_A", "C_B", "C_C"), error))


def reactor_information(T: list[float], error: float, **values: float) -> np.ndarray:
    """Relative information of nine samples, an eighth of an hour apart, over A1, A2, E1, E2.

    By exact exponentials: between samples the temperature is constant, and the
    concentrations are combinations of exp(-k1 t) and exp(-k2 t); slopes by the complex step.
    """
    columns = []
    for name in values:
        at = {n: v * (1 + 1e-20j * (n == name)) for n, v in values.items()}
        a, b, shown = 5.0 + 0j, 0j, []
        for now in T:
            shown += [a, b, 5.0 - a - b]
            k1, k2 = (at["A" + n] * np.exp(-1e3 * at["E" + n] / (8.314 * now)) for n in "12")
            d1, d2 = np.exp(-k1 / 8), np.exp(-k2 / 8)
            a, b = a * d1, b * d2 + a * k1 / (k2 - k1) * (d1 - d2)
        columns.append(np.imag(shown) / 1e-20 / error)
    return np.array(columns) @ np.array(columns).T


def test_the_information_of_the_reactor_is_that_of_pyomo_doe_at_constant_temperature() -> None:
    """At 300 K: log10 of the trace 2.96, A1 and A2 1.84, A1 and E1 -70.238.

    Printed in pyomo/contrib/doe/tests/test_reactor_example.py; its slopes are differences.
    """
    found = reactor_information([300.0] * 9, 1.0, **PYOMO)
    assert np.log10(np.trace(found)) == pytest.approx(2.96, abs=0.005)
    assert found[0, 1] == pytest.approx(1.84, abs=0.005)
    assert found[0, 2] == pytest.approx(-70.238, abs=0.02)


@pytest.mark.slow
def test_the_reactor_of_pyomo_doe_is_designed_as_well_as_it_prints() -> None:
    """Printed: 5.0 mol/l, 494 K and then 300 K, log10 of the determinant 19.32.

    Its grid gives the first interval's end the next temperature: integrated exactly, those
    temperatures give 19.26.
    """
    values = {"A1": 84.79, "A2": 371.72, "E1": 7.78, "E2": 15.05}
    found = casid.design_experiment(
        reactor(0.01, **values),
        Aim.estimate(),
        {"T": (300, 700)},
        9 * 450.0,
        Ts=450.0,
        intervals=9,
        release={"A": (1, 5)},
        hold={"T": 300},
        seed=1,
    )
    assert found.initial["A"] == pytest.approx(5.0, abs=0.05)
    exact = reactor_information(found.record["T"].tolist(), 0.01, **values)
    assert np.linalg.slogdet(exact)[1] / np.log(10) > 19.32
    printed = reactor_information([494.0] + [300.0] * 8, 0.01, **values)
    assert np.linalg.slogdet(printed)[1] / np.log(10) == pytest.approx(19.26, abs=0.005)
    errors = np.sqrt(np.diag(np.linalg.inv(exact)))
    for p in found.parameters:
        assert p.std_error / p.value == pytest.approx(errors[list(values).index(p.name)], rel=2e-3)


def test_two_measurements_of_a_consecutive_reaction_are_taken_when_box_and_lucas_say() -> None:
    """A -> B -> C with rates 0.7 and 0.2: B is measured best at 1.23 and 6.86 (Biometrika 1959)."""
    m = casid.Model("consecutive reaction")
    A, B = m.state("A", "mol/l", initial=1.0), m.state("B", "mol/l", initial=0.0)
    k1, k2 = m.parameter("k1", "1/min", start=0.7), m.parameter("k2", "1/min", start=0.2)
    m.derivative(A, -k1 * A)
    m.derivative(B, k1 * A - k2 * B)
    m.output("B", B, "mol/l")
    Ts = 0.6  # a hundredth of a minute
    simulator = Simulator(m, Ts, ("k1", "k2"), substeps=1)
    run = simulator.sensitivities(np.zeros((1001, 0)), np.array([0.7, 0.2]) / 60, [1000.0, 0.0])
    slopes = run.dy[:, 0, :2]
    determinant = np.abs(slopes[:, :1] * slopes[:, 1] - slopes[:, 1:] * slopes[:, 0])
    first, second = np.unravel_index(np.argmax(np.triu(determinant)), determinant.shape)
    assert (first / 100, second / 100) == pytest.approx((1.23, 6.86), abs=0.011)
    pair = np.array([slopes[first], slopes[second]])
    score = scores(pair.T @ pair, Target("D", (0, 1)))
    assert score[0] == pytest.approx(np.log(determinant[first, second]))
