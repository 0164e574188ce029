"""Resistances that grow with the flow: dp = R q + R_2 |q| q, in the balance and at the meter.

The records come from a Runge-Kutta integration of V' = q written here, q the root of that law.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.model.effects.balances.resistances import growing_resistance, growing_resistances_of
from casid.model.rate_laws import with_balances

R, R_2, C = 10.0, 7.0, 0.045  # cmH2O s/L, cmH2O s^2/L^2, L/cmH2O
TS, N, NOISE = 0.02, 2500, 0.008  # s, 1, L/s


def lung(form: str = "resistance") -> casid.Model:
    """A compliance behind an airway, whose flow is measured."""
    m = casid.Model("lung")
    P, V = m.input("P", "cmH2O", known=True), m.state("V", "L")
    c = m.parameter("C", "L/cmH2O", start=0.05, lower=0.005)
    if form == "resistance":
        q = (P - V / c) / m.parameter("R", "cmH2O s/L", start=8.0, lower=1.0)
    else:
        q = m.parameter("G", "L/(cmH2O s)", start=0.1, lower=0.01) * (P - V / c)
    m.derivative(V, q)
    m.output("flow", q, "L/s")
    return m


def flow(dp: float) -> float:
    """The q of dp = R q + R_2 |q| q."""
    return float(np.sign(dp) * (np.sqrt(R**2 + 4 * R_2 * abs(dp)) - R) / (2 * R_2))


def record(seed: int = 2) -> casid.Record:
    """Breaths of several sizes and rates."""
    rng = np.random.default_rng(seed)
    t = TS * np.arange(N + 1)
    size, rate = (np.interp(t, t[::250], rng.uniform(*r, 11)) for r in ((6.0, 16.0), (0.2, 0.4)))
    pressure = size * (0.5 + 0.5 * np.sin(2 * np.pi * np.cumsum(rate) * TS))
    V, out = 0.0, np.empty(N)
    for n in range(N):
        p, last = pressure[n], pressure[n + 1]
        out[n] = flow(p - V / C)
        a = out[n]
        b = flow(0.5 * (p + last) - (V + TS / 2 * a) / C)
        c = flow(0.5 * (p + last) - (V + TS / 2 * b) / C)
        V += TS / 6 * (a + 2 * b + 2 * c + flow(last - (V + TS * c) / C))
    measured = out + NOISE * rng.standard_normal(N)
    units = {"P": "Pa", "flow": "m^3/s"}
    return casid.Record({"P": 98.0665 * pressure[:N], "flow": 1e-3 * measured}, units, TS)


@pytest.mark.parametrize("form", ["resistance", "conductance"])
def test_the_law_holds_in_the_balance_and_at_the_meter(form):
    model = with_balances(lung(form))
    (effect,) = growing_resistances_of(model)
    unit = effect.declared_units[effect.parameters[0].name]
    assert unit == "cmH2O s^2/L^2"
    extended, (name,) = effect.extended(model)
    e = extended.explicit()
    values = {"R": R * 98066.5, "G": 1 / (R * 98066.5), "C": C / 98066.5, name: R_2 * 98066.5e3}
    f = ca.Function("f", [e.x, e.u, e.p], [e.f, e.h])
    for dp in (-12.0, 3.0, 15.0):
        rate, shown = f([0.0], [dp * 98.0665], [values[n] for n in e.parameters])
        assert float(rate) == pytest.approx(1e-3 * flow(dp), rel=1e-9)
        assert float(shown) == pytest.approx(1e-3 * flow(dp), rel=1e-9)


def test_what_is_no_resistance_of_the_flow_that_is_shown_has_no_such_law():
    """A compliance, whose pressure is a part of the drop; a flow that no output shows."""
    model = with_balances(lung())
    assert growing_resistance(model, "C") is None
    model.replace_output("flow", model.symbol("V"), "L")
    assert growing_resistance(model, "R") is None


@pytest.mark.slow
def test_an_airway_whose_resistance_grows_with_the_flow_is_named_and_sized():
    problem = casid.Problem("lung", lung())
    (cause,) = casid.diagnose(problem, record(), starts=1, advise=False).causes
    assert (cause.kind, cause.where) == ("scheduled_parameter", "R~flow")
    (slope,) = cause.parameters
    assert slope.unit == "cmH2O s^2/L^2"
    assert abs(slope.value - R_2) < 4 * slope.std_error
