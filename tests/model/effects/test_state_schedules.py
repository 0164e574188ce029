"""A parameter of a flow that a sensor shows as well may go with a power of a state."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.model.effects.effect import Sizes
from casid.model.effects.state_schedules import state_schedules_of

TS, N = 2.0, 900


def loop() -> casid.Model:
    """A tank that a valve of position v fills, whose flow a meter shows."""
    m = casid.Model("tank")
    h, v = m.state("h", "m", start=0.8, lower=0.0), m.state("v", "%", start=40.0)
    u = m.input("u", "%", hold="zoh", known=True)
    k_v = m.parameter("k_v", "m^3/s", start=3e-3, lower=1e-4)
    k_o = m.parameter("k_o", "m^2/s", start=1e-3, lower=1e-5)
    m.derivative(v, (u - v) / m.parameter("tau", "s", start=5.0, lower=0.5))
    m.balance(h, "volume", inertia=m.constant("A", 0.35, "m^2"), terms=[k_v * v, -k_o * h])
    m.output("level", h, "m")
    m.output("flow", k_v * v, "m^3/s")
    return m


def record(seed: int) -> casid.Record:
    """The flow is 0.004 m^3/s v^1.5; steps of 0.2 s by Heun."""
    rng, h, v, between = np.random.default_rng(seed), 0.6, 0.4, 10
    u = np.repeat(rng.uniform(0.15, 0.9, N // 30), 30)
    level, flow, step = np.empty(N), np.empty(N), TS / between

    def slopes(h: float, v: float, u: float) -> tuple[float, float]:
        return (4e-3 * v**1.5 - 1.8e-3 * h) / 0.35, (u - v) / 6.0

    for k in range(N):
        level[k], flow[k] = h, 4e-3 * v**1.5
        for _ in range(between):
            a = slopes(h, v, u[k])
            b = slopes(h + step * a[0], v + step * a[1], u[k])
            h, v = h + 0.5 * step * (a[0] + b[0]), v + 0.5 * step * (a[1] + b[1])
    level += 0.004 * rng.standard_normal(N)
    flow += 1.2e-5 * rng.standard_normal(N)
    return casid.Record(
        {"u": u, "level": level, "flow": flow}, {"u": "1", "level": "m", "flow": "m^3/s"}, TS
    )


def test_a_coefficient_of_what_a_sensor_shows_as_well_goes_with_its_states():
    """k_v v stands in the balance and in the flow; k_o h in the balance alone, and is a force."""
    rng = np.random.default_rng(1)
    m = loop()
    motion = rng.uniform(0.1, 0.9, (2, 50))

    def course(expression: ca.SX) -> np.ndarray:
        symbols = ca.vertcat(m.symbol("h"), m.symbol("v"))
        return np.array(ca.Function("f", [symbols], [expression])(motion)).ravel()

    found = [*state_schedules_of(m, Sizes({}, {}, (0.0, 1.0), 1.0, course=course))]
    assert {e.where for e in found} == {"k_v~v"}
    assert [e.parameters[0].name for e in found] == [
        "slope_k_v_v",
        "curvature_k_v_v",
        "exponent_k_v_v",
    ]


@pytest.mark.slow
def test_the_law_of_a_valve_is_named_with_its_coefficient_and_not_as_a_law_of_the_actuator():
    """k_v v goes with v^1.5, k_v with v^0.5: what fills the tank and what the meter shows."""
    found = casid.diagnose(casid.Problem("tank", loop()), record(3), advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("scheduled_parameter", "k_v~v")
    (exponent,) = cause.parameters
    assert exponent.unit == "1"
    assert exponent.std_error is not None
    assert abs(exponent.value - 0.5) < 4 * exponent.std_error < 0.05


def reactor() -> casid.Model:
    """A stirred tank in which one reactant reacts, faster where it is warm, and heats the rest."""
    m = casid.Model("reactor")
    c, T = m.state("c", "mol/m^3", start=800.0, lower=0.0), m.state("T", "degC", start=25.0)
    q, feed = m.input("q", "m^3/s", hold="zoh", known=True), m.constant("feed", 1500.0, "mol/m^3")
    V, heat = m.constant("V", 0.5, "m^3"), m.constant("heat", 80e3, "J/mol")
    C, T_in = m.constant("C", 4e6, "J/(m^3 K)"), m.constant("T_in", 293.15, "K")
    E, T_0 = m.constant("E", 4000.0, "K"), m.constant("T_0", 300.0, "K")
    k = m.parameter("k", "1/s", start=1e-3, lower=1e-5)
    rate = k * ca.exp(-E * (1 / T - 1 / T_0)) * c
    m.balance(c, "reactant", inertia=V, terms=[q * (feed - c), -V * rate])
    m.balance(T, "heat", inertia=V * C, terms=[q * C * (T_in - T), V * heat * rate])
    m.output("c", c, "mol/m^3")
    m.output("T", T, "degC")
    return m


def reaction_of_order(n: float, seed: int) -> casid.Record:
    """At 300 K the rate is 1.5e-3 c (c / 700)^(n - 1); steps of 0.5 s by Heun."""
    rng, between = np.random.default_rng(seed), 20
    u = np.repeat(rng.uniform(2e-4, 2e-3, 25), 40)
    x, states = np.array([700.0, 297.0]), np.empty((u.size, 2))

    def slopes(x: np.ndarray, q: float) -> np.ndarray:
        k = 1.5e-3 * np.exp(-4000.0 * (1.0 / x[1] - 1.0 / 300.0))
        rate = k * x[0] * (x[0] / 700.0) ** (n - 1.0)
        return np.array(
            [q / 0.5 * (1500.0 - x[0]) - rate, q / 0.5 * (293.15 - x[1]) + 80e3 / 4e6 * rate]
        )

    step = 10.0 / between
    for i, q in enumerate(u):
        states[i] = x
        for _ in range(between):
            a = slopes(x, q)
            x = x + 0.5 * step * (a + slopes(x + step * a, q))
    c = states[:, 0] + 4.0 * rng.standard_normal(u.size)
    T = states[:, 1] + 0.05 * rng.standard_normal(u.size)
    return casid.Record({"q": u, "c": c, "T": T}, {"q": "m^3/s", "c": "mol/m^3", "T": "K"}, 10.0)


def test_the_rate_of_a_reaction_goes_with_a_power_of_what_reacts_and_of_no_temperature():
    rng = np.random.default_rng(1)
    m = reactor()
    motion = np.array([[300.0], [290.0]]) + rng.uniform(0.0, [[900.0], [20.0]], (2, 50))

    def course(expression: ca.SX) -> np.ndarray:
        symbols = ca.vertcat(m.symbol("c"), m.symbol("T"))
        return np.array(ca.Function("f", [symbols], [expression])(motion)).ravel()

    found = [*state_schedules_of(m, Sizes({}, {}, (0.0, 1.0), 1.0, course=course))]
    powers = [e.parameters[0].name for e in found if "reference" in e.constants]
    assert powers == ["exponent_k_c"]


@pytest.mark.slow
def test_a_reaction_of_another_order_is_named_once_with_its_order():
    """Order 1.5 in a model of order 1: along a line or a parabola k leaves a remainder."""
    problem = casid.Problem("reactor", reactor())
    found = casid.diagnose(problem, reaction_of_order(1.5, 3), starts=1, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("scheduled_parameter", "k~c")
    (exponent,) = cause.parameters
    assert exponent.unit == "1"
    assert exponent.std_error is not None
    assert abs(exponent.value - 0.5) < 4 * exponent.std_error < 0.1
