"""Stops, overflows and play between two bodies, against equations of motion of their own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.balances.contact_effects import backlash, end_stop
from casid.model.effects.effect import Effect
from casid.model.effects.names import effect_words

Ts, N = 0.002, 1000


def two_bodies() -> casid.Model:
    m = casid.Model("two bodies")
    x, v = m.state("x", "m", initial=0.1), m.state("v", "m/s", initial=0.0)
    y, w = m.state("y", "m", initial=0.0), m.state("w", "m/s", initial=0.0)
    k, c = m.constant("k", 200.0, "N/m"), m.constant("c", 3.0, "N s/m")
    link = k * (x - y) + c * (v - w)
    m.derivative(x, v)
    m.derivative(y, w)
    m.balance(v, "first", inertia=m.constant("m1", 1.0, "kg"), terms=[-link])
    m.balance(w, "second", inertia=m.constant("m2", 2.0, "kg"), terms=[link])
    m.output("position", x, "m")
    return m


def simulated(model: casid.Model, effect: Effect, values: dict[str, float], **inputs) -> np.ndarray:
    extended, names = effect.extended(model)
    known = dict(zip(names, values.values(), strict=True))
    output, (_, unit) = next(iter(model.outputs.items()))
    channels = {output: np.zeros(N), **inputs}
    units = {output: unit, **{n: model.inputs[n].unit for n in inputs}}
    record = casid.Record(channels, units, Ts=Ts)
    criterion = SimulationError(
        extended.with_known(**known), [casid.Experiment(record, {}, "r")], weights=np.ones(1)
    )
    return criterion.simulate(criterion.start, 0)[0][:, 0]


def solved(rates, start) -> np.ndarray:
    t = np.arange(N) * Ts
    path = solve_ivp(rates, (0.0, t[-1]), start, t_eval=t, max_step=Ts, rtol=1e-8, atol=1e-10)
    return path.y[0]


def test_bodies_with_play_between_them_move_freely_in_it():
    """Spring and damper act together, on what the gap leaves of the relative position."""
    gap = 0.02

    def rates(t, s):
        q, u = s[0] - s[2], s[1] - s[3]
        link = 0.0 if abs(q) < gap else 200.0 * (q - np.sign(q) * gap) + 3.0 * u
        return [s[1], -link, s[3], link / 2.0]

    truth = solved(rates, [0.1, 0.0, 0.0, 0.0])
    effect = backlash(two_bodies(), "v-w", 1e-4, 0.1)
    assert effect is not None
    y = simulated(two_bodies(), effect, {"gap": gap})
    rigid = simulated(two_bodies(), effect, {"gap": 0.0})
    assert y == pytest.approx(truth, abs=2e-4)
    assert np.max(np.abs(rigid - truth)) > 0.01


@pytest.mark.parametrize(
    ("side", "sides"),
    [("both", (1, -1)), ("symmetric", (1, -1)), ("upper", (1,)), ("lower", (-1,))],
)
def test_a_stop_acts_beyond_its_limit_alone(side, sides):
    m = casid.Model("mass")
    x, v = m.state("x", "m", initial=0.1), m.state("v", "m/s", initial=0.0)
    m.derivative(x, v)
    k = m.constant("k", 90.0, "N/m")
    m.balance(v, "force", inertia=m.constant("m", 1.0, "kg"), terms=[-k * x])
    m.output("position", x, "m")

    def rates(t, s):
        stop = -sum(a * 600.0 * max(a * s[0] - 0.08, 0.0) for a in sides)
        return [s[1], -90.0 * s[0] + stop]

    truth = solved(rates, [0.1, 0.0])
    effect = end_stop(m, "force", side, 0.0, 0.1, 1e-4)
    assert effect is not None
    ends = sides if side != "both" else (-1, 1)
    ends = ends[:1] if side == "symmetric" else ends
    positions = {("limit" if len(ends) == 1 else f"limit_{a}"): 0.08 * a for a in ends}
    y = simulated(m, effect, {"k_stop": 600.0, **positions})
    assert y == pytest.approx(truth, abs=5e-4)
    assert np.max(np.abs(truth - 0.1 * np.cos(np.sqrt(90.0) * np.arange(N) * Ts))) > 0.01


def test_stops_that_are_symmetric_about_zero_are_none_of_a_motion_about_elsewhere():
    m = casid.Model("mass")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    m.derivative(x, v)
    m.balance(v, "force", inertia=m.constant("m", 1.0, "kg"), terms=[-x], unit="N")
    m.output("position", x, "m")
    assert end_stop(m, "force", "symmetric", 0.02, 0.1, 1e-4) is not None
    assert end_stop(m, "force", "symmetric", 0.2, 0.1, 1e-4) is None


def test_a_full_tank_overflows():
    """A store without a position has a content: it runs over above its rim."""
    m = casid.Model("tank")
    h = m.state("h", "m", initial=0.2)
    u = m.input("u", "m^3/s", known=True)
    area, k = m.constant("A", 0.01, "m^2"), m.constant("k", 0.005, "m^2/s")
    m.balance(h, "tank", inertia=area, terms=[u, -k * h], unit="m^3/s")
    m.output("level", h, "m")
    inflow = 0.001 + 0.0008 * np.sin(2 * np.pi * np.arange(N) * Ts)

    def rates(t, s):
        flow = np.interp(t, np.arange(N) * Ts, inflow)
        return [(flow - 0.005 * s[0] - 0.05 * max(s[0] - 0.21, 0.0)) / 0.01]

    truth = solved(rates, [0.2])
    effect = end_stop(m, "tank", "upper", 0.2, 0.02, 1e-5)
    assert effect is not None
    y = simulated(m, effect, {"k_stop": 0.05, "limit": 0.21}, u=inflow)
    assert y == pytest.approx(truth, abs=2e-5)
    dry = simulated(m, effect, {"k_stop": 0.0, "limit": 0.21}, u=inflow)
    assert dry.max() - truth.max() > 5e-3


def test_a_coupling_without_a_damper_has_play_in_its_spring_alone():
    m = casid.Model("sprung")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    y, w = m.state("y", "m"), m.state("w", "m/s")
    spring = m.parameter("k", "N/m") * (x - y)
    m.derivative(x, v)
    m.derivative(y, w)
    m.balance(v, "first", inertia=m.constant("m1", 1.0, "kg"), terms=[-spring])
    m.balance(w, "second", inertia=m.constant("m2", 2.0, "kg"), terms=[spring])
    m.output("position", x, "m")
    assert backlash(m, "v-w", 1e-4) is None


def test_the_level_of_an_overflow_is_shown_on_the_scale_of_its_channel():
    """A level in degC is one of that scale; a stiffness counts differences, in kelvin."""
    m = casid.Model("room")
    T = m.state("T", "degC", start=20.0)
    heating = m.input("heating", "W", known=True)
    m.balance(T, "heat", inertia=m.parameter("C", "J/K", start=1e5, lower=1e3), terms=[heating])
    m.output("room", T, "degC")
    effect = end_stop(m, "heat", "upper", 293.15, 5.0, 0.1)
    assert effect is not None
    assert effect.description == "an overflow, where T is above limit"
    new, names = effect.extended(m)
    assert names == ("k_stop", "limit")
    assert new.declared_units["limit"] == "degC"
    assert "k_stop" not in new.declared_units
    words = effect_words(*effect.key, description=effect.description)
    assert words == "overflow in the heat balance"
