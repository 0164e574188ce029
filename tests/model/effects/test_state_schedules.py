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
