"""Sensors that show an absolute value, sit elsewhere, or read right at their operating point."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

import casid
from casid.model.effects.catalogue import catalogue
from casid.model.effects.channels.channel_effects import sensor_scale
from casid.model.effects.channels.sensor_effects import (
    curved_reading,
    lever_arm,
    rectified,
    sensor_effects_of,
)
from casid.model.effects.effect import Effect, Sizes
from casid.model.effects.names import effect_words


def bar() -> casid.Model:
    """A hanging bar with an accelerometer and a camera on it."""
    m = casid.Model("bar")
    phi, w = m.state("phi", "rad"), m.state("w", "rad/s")
    u = m.input("u", "N m")
    m.derivative(phi, w)
    m.balance(w, "torque", inertia=2.0, terms=[u, -m.parameter("k", "N m/rad", start=8.0) * phi])
    m.output("accel", m.constant("l", 0.5, "m") * m.der(w), "m/s^2")
    m.output("speed", m.constant("a", 0.3, "m") * w, "m/s")
    return m


def shown(effect: Effect, value: float, channel: str) -> float:
    """An output of the extended bar at phi = 0.1, w = -0.2, u = 1: dw/dt = 0.1."""
    extended, (name, *_) = effect.extended(bar())
    e = extended.explicit()
    value_of = {"k": 8.0, "l": 0.5, "a": 0.3, name: value}
    p = [value_of[n] for n in e.parameters]
    h = ca.Function("h", [e.x, e.u, e.p], [e.h])([0.1, -0.2], [1.0], p)
    return float(h[e.outputs.index(channel)])


def test_a_rectifier_shows_the_absolute_value():
    effect = rectified(bar(), "speed")
    assert shown(effect, 1.0, "speed") == pytest.approx(0.06)
    assert shown(effect, 0.0, "speed") == pytest.approx(-0.06)
    on, (name,) = effect.extended(bar(), starts={"rectified_speed": 0.6})
    assert on.parameters[name].lower == 1.0  # it does it, or not


def test_a_lever_arm_adds_what_the_rotation_gives_to_a_point():
    assert shown(lever_arm(bar(), "accel", "w"), 0.2, "accel") == pytest.approx(0.7 * 0.1)
    assert shown(lever_arm(bar(), "speed", "w"), 0.2, "speed") == pytest.approx(0.5 * -0.2)


def test_a_curved_characteristic_errs_by_the_square_of_what_it_shows():
    assert shown(curved_reading(bar(), "speed"), 2.0, "speed") == pytest.approx(-0.06 + 2 * 0.0036)
    about = curved_reading(bar(), "speed", -0.05)
    assert shown(about, 2.0, "speed") == pytest.approx(-0.06 + 2 * 0.0001)
    assert shown(about, 0.0, "speed") == pytest.approx(-0.06)


def test_a_characteristic_curves_from_the_zero_of_its_scale_and_from_its_level():
    m = casid.Model("bath")
    T = m.state("T", "degC")
    m.balance(T, "heat", inertia=m.constant("C", 1e3, "J/K"), terms=[m.input("P", "W")])
    m.output("reading", T, "degC")
    at = dataclasses.replace(Sizes({}, {}, (0.0, 1.0), 1.0), levels={"reading": 350.0})
    curved = [e for e in sensor_effects_of(m, at) if e.shape == "reading^2"]
    assert [e.constants["about"] for e in curved] == [350.0, 273.15]
    assert {effect_words(*e.key) for e in curved} == {"unidentified term like reading^2 in reading"}


def test_an_absolute_value_is_suspected_where_no_reading_is_negative():
    sizes = Sizes({"phi": 0.1, "w": 0.5}, {}, (0.0, 10.0), 0.1, Ts=0.01)

    def kinds(low: float) -> set[str]:
        read = dataclasses.replace(sizes, readings={"speed": (low, 0.4)})
        return {e.where for e in catalogue(bar(), read, {}) if e.kind == "rectified"}

    assert kinds(0.0) == {"speed"}
    assert kinds(-0.3) == set()


def test_a_gain_about_the_operating_point_is_no_bias_there():
    """A thermometer near 300 K: about zero, one per cent would be 3 K everywhere."""
    m = casid.Model("room")
    T = m.state("T", "K")
    m.balance(T, "heat", inertia=m.parameter("C", "J/K"), terms=[m.input("P", "W")])
    m.output("thermometer", T, "K")
    extended, (name,) = sensor_scale(m, "thermometer", about=295.0).extended(m)
    reading = extended.outputs["thermometer"][0]
    f = ca.Function("f", [extended.symbol("T"), extended.symbol(name)], [reading])
    assert float(f(295.0, 0.01)) == pytest.approx(295.0)
    assert float(f(305.0, 0.01)) == pytest.approx(305.1)


def test_an_input_read_with_a_gain_about_its_operating_point_is_undone():
    m = casid.Model("room")
    T, outside = m.state("T", "K"), m.input("outside", "K")
    G = m.parameter("G", "W/K")
    m.balance(T, "heat", inertia=m.parameter("C", "J/K"), terms=[G * (outside - T)])
    m.output("thermometer", T, "K")
    extended, (name,) = sensor_scale(m, "outside", about=280.0).extended(m)
    term = extended.balances["heat"].terms[0]
    symbols = [extended.symbol(n) for n in ("G", "T", "outside", name)]
    f = ca.Function("f", symbols, [term])
    true = 270.0
    read = true + 0.02 * (true - 280.0)
    assert float(f(1.0, 0.0, read, 0.02)) == pytest.approx(true)
    assert np.isfinite(float(f(1.0, 0.0, read, 0.0)))


def filter_model(unit: str = "A") -> casid.Model:
    """A store that a recorded flow fills and that leaks, with its level measured."""
    m = casid.Model("store")
    of = {"A": ("V", "farad", "1/ohm"), "N": ("m/s", "kg", "N s/m")}[unit]
    v, i = m.state("v", of[0]), m.input("i", unit, hold="zoh", known=True)
    C = m.parameter("C", of[1], start=2.0, lower=0.1)
    G = m.parameter("G", of[2], start=0.5, lower=0.0)
    m.balance(v, "store", inertia=C, terms=[i, -G * v])
    m.output("level", v, of[0])
    return m


def of_store() -> Sizes:
    return Sizes({"v": 1.0}, {}, (0.0, 10.0), 0.1)


def test_an_output_may_show_what_flows_into_a_store_over_a_series_resistance():
    (effect,) = [e for e in sensor_effects_of(filter_model(), of_store()) if e.kind == "cross_axis"]
    (r,) = effect.parameters
    assert (effect.key, r.unit) == (("cross_axis", "level: store"), "ohm")
    assert effect_words(*effect.key, description=effect.description) == "series resistance of level"


def test_what_shows_a_speed_has_no_series_resistance():
    """What moves a mass is no flow into a store."""
    kinds = {e.kind for e in sensor_effects_of(filter_model("N"), of_store())}
    assert "cross_axis" not in kinds


@pytest.mark.slow
def test_the_series_resistance_of_a_capacitor_is_named():
    """0.05 ohm before 2 F: the terminals show v + r (i - G v), i in steps of half a second."""
    rng, Ts, r, G = np.random.default_rng(4), 0.05, 0.05, 0.5
    i = np.repeat(rng.uniform(-1.0, 1.0, 60), 10)
    shown, v, decay = np.empty(600), 0.2, np.exp(-G * Ts / 2.0)
    for k, flow in enumerate(i):
        shown[k] = v + r * (flow - G * v)
        v = flow / G + (v - flow / G) * decay
    shown += 2e-3 * rng.standard_normal(600)
    record = casid.Record({"i": i, "level": shown}, {"i": "A", "level": "V"}, Ts=Ts)
    problem = casid.Problem("store", filter_model(), starts=1)
    (cause,) = casid.diagnose(problem, record, advise=False, max_causes=1).causes
    (found,) = cause.parameters
    assert (cause.kind, cause.where) == ("cross_axis", "level")
    assert "over a series resistance" in cause.sentence
    assert abs(found.value - r) < 4 * found.std_error < 0.1 * r
