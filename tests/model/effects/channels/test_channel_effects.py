"""Scales, lags, crossed axes and holds do what their physics says, with exact derivatives."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

import casid
from casid.estimation.simulation.channels.first_order_lags import lag_columns
from casid.estimation.simulation.channels.sensor_dynamics import delay_columns
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.channel_effects import (
    channel_effects_of,
    cross_axis,
    hold,
    sensor_lag,
    sensor_scale,
)
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.effect import Sizes
from problems import pendulum
from tests.support import truth

TS = 0.02
T = TS * np.arange(600)
FORCE = np.sin(1.3 * T) + 0.7 * np.sin(4.1 * T + 1.0) + 0.4 * np.sin(11.0 * T + 2.0)


def oscillator(kind: str = "foh") -> casid.Model:
    m = casid.Model("oscillator")
    x, v = m.state("x", "m", initial=0.1), m.state("v", "m/s", initial=0.0)
    force = m.input("force", "N", hold=kind)
    k = m.parameter("k", "N/m", start=50.0)
    m.derivative(x, v)
    m.balance(v, "force balance", inertia=2.0, terms=[-k * x, -1.5 * v, force])
    m.output("position", x, "m")
    m.output("speed", v, "m/s")
    return m


def criterion_of(model: casid.Model, force=FORCE, y=None, **columns) -> SimulationError:
    y = np.zeros((len(force), 2)) if y is None else y
    channels = {"force": force, "position": y[:, 0], "speed": y[:, 1], **columns}
    units = {n: "N" if n == "force" else "m" if n == "position" else "m/s" for n in channels}
    record = casid.Record(channels, units, Ts=TS)
    return SimulationError(model, [casid.Experiment(record, {}, "r")], weights=np.ones(2))


def at(criterion: SimulationError, **values: float) -> np.ndarray:
    return np.array([values.get(v.name, v.start) for v in criterion.variables])


def outputs(model: casid.Model, force=FORCE, **values: float) -> np.ndarray:
    criterion = criterion_of(model, force)
    return criterion.simulate(at(criterion, **values), 0)[0]


EFFECTS = [
    (lambda m: sensor_scale(m, "position"), 0.3),
    (lambda m: sensor_scale(m, "force"), 0.3),
    (lambda m: sensor_lag(m, "position", 1.0), 0.07),
    (lambda m: sensor_lag(m, "position", 1.0), 0.005),
    (lambda m: sensor_lag(m, "force", 1.0), 0.07),
    (lambda m: time_delay(m, "force", 1.0), 0.033),
    (lambda m: cross_axis(m, "speed", "wind", "m/s"), 0.2),
    (lambda m: hold(m, "force"), 0.4),
]


@pytest.mark.parametrize("kind", ["zoh", "foh"])
@pytest.mark.parametrize(("make", "far"), EFFECTS)
def test_at_null_it_is_the_model_and_the_derivative_is_that_of_what_is_computed(make, far, kind):
    m = oscillator(kind)
    effect = make(m)
    model, (name,) = effect.extended(m)
    wind = np.cos(2.0 * T)
    criterion = criterion_of(model, wind=wind)
    base = outputs(m)
    assert criterion.simulate(at(criterion), 0)[0] == pytest.approx(base, abs=1e-14)
    i = criterion.names.index(name)
    for value, step in ((0.0, 1e-5), (far, 1e-5)):
        x = at(criterion, **{name: value})
        jac = criterion.simulate(x, 0, tangent=True)[2][:, :, i]

        def moved(d: float, value: float = value) -> np.ndarray:
            return criterion.simulate(at(criterion, **{name: value + d}), 0)[0]

        if value == 0.0 and effect.sided == "positive":  # second-order from one side
            difference = (-3 * moved(0.0) + 4 * moved(step) - moved(2 * step)) / (2 * step)
        else:
            difference = (moved(step) - moved(-step)) / (2 * step)
        assert jac == pytest.approx(difference, abs=3e-5 * np.abs(jac).max())


@pytest.mark.parametrize("tau", [0.003, 0.02, 0.05, 0.3])
def test_a_lag_of_a_sine_is_the_analytic_one(tau):
    """Centred slopes err by (w Ts)^3 / 6 a sample, of which a short lag shows tau / Ts."""
    w = 5.0
    t = TS * np.arange(1000)
    exact = np.imag(np.exp(1j * w * t) / (1 + 1j * w * tau))
    late, _ = lag_columns(np.sin(w * t), tau / TS)
    inner = slice(600, 990)  # forty of the longest time constants after the start
    tolerance = (w * TS) ** 3 / 6 * min(tau / TS, 0.25)
    assert late[inner] == pytest.approx(exact[inner], abs=tolerance)


def test_without_a_lag_its_slope_is_that_of_a_delay_and_centred():
    y = np.random.default_rng(1).standard_normal(50)
    late, change = lag_columns(y, 0.0)
    assert late == pytest.approx(y, abs=1e-14)
    assert change == pytest.approx(-delay_columns(y, 0.0, derivative=True), abs=1e-13)


def test_the_lag_of_a_simulator_of_its_own_is_the_same_lag():
    """truth.py lags the rate on a grid five times as fine, starting three seconds ago."""
    size = 0.08
    hidden = truth.cart_pendulum("sensor_lag", seed=5, duration=20.0, noise=1e-9, size=size)
    late, _ = lag_columns(hidden.clean["phid"], size / hidden.Ts)
    gap = late - hidden.columns["gyro"]
    # A telegraph's jumps bend the rate within a sample: h^2 / 8 of its curvature, filtered.
    assert np.abs(gap[100:-2]).max() < 2e-3 * np.std(hidden.columns["gyro"])


def test_a_measured_input_that_lags_is_undone():
    """What acted is a sine; the record of it lags; the extended model finds the motion again.

    A centred slope is short by (w Ts)^2 / 6 of itself, which is w tau of the input.
    """
    w, tau = 3.0, 0.05
    acted, record = np.sin(w * T), np.imag(np.exp(1j * w * T) / (1 + 1j * w * tau))
    m = oscillator()
    found = outputs(sensor_lag(m, "force", 1.0).extend(m), record, lag_force=tau)
    y = outputs(m, acted)
    size = np.abs(y - outputs(m, record)).max()
    assert np.abs(found - y).max() < 0.02 * size


def test_a_scale_multiplies_an_output_and_divides_a_measured_input():
    m = oscillator()
    y = outputs(m)
    scaled = outputs(sensor_scale(m, "position").extend(m), scale_position=0.25)
    assert scaled[:, 0] == pytest.approx(1.25 * y[:, 0])
    back = outputs(sensor_scale(m, "force").extend(m), 1.25 * FORCE, scale_force=0.25)
    assert back == pytest.approx(y, abs=1e-14)


def test_a_scale_of_a_late_input_scales_the_slope_that_carries_its_delay():
    m = oscillator()
    model = time_delay(m, "force", 0.5).extend(m)
    model = sensor_scale(model, "force").extend(model)
    criterion = criterion_of(model)
    i = criterion.names.index("delay_force")
    x = at(criterion, delay_force=0.05, scale_force=0.5)
    up, down = x.copy(), x.copy()
    up[i], down[i] = x[i] + 1e-5, x[i] - 1e-5
    slope = (criterion.simulate(up, 0)[0] - criterion.simulate(down, 0)[0]) / 2e-5
    jac = criterion.simulate(x, 0, tangent=True)[2][:, :, i]
    assert jac == pytest.approx(slope, abs=1e-4 * np.abs(jac).max())


HOLDS = ("zoh", "foh", "bandlimited")
JAGGED = np.random.default_rng(5).normal(size=200)


@pytest.mark.parametrize(("declared", "other"), list(itertools.permutations(HOLDS, 2)))
def test_a_blend_of_one_is_the_other_hold(declared, other):
    m = oscillator(declared)
    effect = hold(m, "force", other)
    (p,) = effect.parameters
    true = outputs(oscillator(other), JAGGED)
    blended = outputs(effect.extend(m), JAGGED, **{p.name: 1.0})
    assert blended == pytest.approx(true, abs=1e-13)
    settled = effect.extend(m, starts={p.name: 1.0})
    assert settled.acting_hold("force") == other
    assert outputs(settled, JAGGED) == pytest.approx(true, abs=1e-13)
    assert np.abs(blended - outputs(m, JAGGED)).max() > 1e-4


def test_the_derivative_of_a_blend_is_what_it_changes():
    """A blend is linear in its parameter, and so are this oscillator's outputs."""
    m = oscillator("foh")
    for other in ("zoh", "bandlimited"):
        model = hold(m, "force", other).extend(m)
        criterion = criterion_of(model, JAGGED)
        name = next(n for n in criterion.names if n.endswith("_force"))
        whole = outputs(model, JAGGED, **{name: 1.0}) - outputs(model, JAGGED)
        i = criterion.names.index(name)
        jac = criterion.simulate(at(criterion), 0, tangent=True)[2][:, :, i]
        assert jac == pytest.approx(whole, abs=1e-13)


def test_an_input_has_one_blend_towards_each_hold():
    m = oscillator()
    extended = hold(m, "force").extend(m)
    with pytest.raises(casid.ModelError, match="blend ramp_force already; request the hold of a"):
        hold(extended, "force")
    with pytest.raises(casid.ModelError, match="declared hold='foh'; request 'zoh' or 'bandlim"):
        hold(m, "force", "foh")
    assert "hold" not in {e.kind for e in channel_effects_of(extended, SIZES, {})}
    found = {e.key for e in channel_effects_of(m, SIZES, {}) if e.kind == "hold"}
    assert found == {("hold", "force"), ("hold", "force: bandlimited")}


def test_an_actuator_behind_a_band_limited_command_lags_smoothly():
    """A lag of a time constant far below Ts leaves the band-limited command as it is."""
    for declared in HOLDS:
        m = oscillator(declared)
        lagging = casid.actuator_lag(m, "force", 0.5).extend(m)
        assert outputs(lagging, tau_force=0.0) == pytest.approx(outputs(m), abs=1e-10)
    t = TS * np.arange(600)
    w, tau = 11.0, 0.08
    m = oscillator("bandlimited")
    lagging = casid.actuator_lag(m, "force", 0.5).extend(m)
    behind = (np.exp(1j * (w * t - np.pi / 2)) / (1 + 1j * w * tau)).real
    y = outputs(lagging, np.sin(w * t), tau_force=tau)
    transient = int(5 * tau / TS) + 40
    # What the actuator holds at the start dies out with it and with the oscillator: compare forces.
    force = 2.0 * np.gradient(y[:, 1], TS) + 1.5 * y[:, 1] + 50.0 * y[:, 0]
    assert force[transient:-5] == pytest.approx(behind[transient:-5], abs=0.02)


SIZES = Sizes({"x": 0.1, "v": 1.0}, {}, (0.0, 12.0), 0.1)


def heated(unit: str) -> casid.Model:
    m = casid.Model("heated body")
    T = m.state("T", unit)
    m.balance(T, "heat", inertia=m.constant("C", 1e3, "J/K"), terms=[m.input("P", "W")])
    m.output("reading", T, unit)
    return m


@pytest.mark.parametrize(
    ("unit", "level", "points"),
    [
        ("degC", 400.0, {400.0, 273.15}),
        ("K", 400.0, {400.0, 273.15}),
        ("K", 8.0, {8.0}),  # a difference of temperatures
    ],
)
def test_the_gain_of_a_thermometer_errs_about_its_level_and_the_zero_of_its_scale(
    unit, level, points
):
    """One that is declared in K is adjusted in melting ice all the same."""
    sizes = dataclasses.replace(SIZES, levels={"reading": level})
    found = channel_effects_of(heated(unit), sizes, {})
    gains = [e for e in found if (e.kind, e.where) == ("sensor_scale", "reading")]
    assert {e.constants["about"] for e in gains} == points


def test_a_thermometer_is_drawn_towards_another_temperature_and_not_away_from_it():
    (felt,) = [
        e
        for e in channel_effects_of(heated("degC"), SIZES, {"hall": "degC"})
        if e.kind == "cross_axis"
    ]
    (share,) = felt.parameters
    assert (felt.sided, share.lower, share.upper) == ("positive", 0.0, 1.0)


def test_axes_are_crossed_between_channels_of_one_dimension_only():
    found = channel_effects_of(oscillator(), SIZES, {"wind": "m/s", "heat": "K", "knots": "kn"})
    crossed = {(e.where, e.parameters[0].name) for e in found if e.kind == "cross_axis"}
    assert crossed == {("speed", "cross_speed_wind"), ("speed", "cross_speed_knots")}


@pytest.mark.parametrize(
    ("make", "name", "true"),
    [
        (lambda m: sensor_scale(m, "speed"), "scale_speed", 0.15),
        (lambda m: sensor_lag(m, "position", 0.2), "lag_position", 0.06),
        (lambda m: cross_axis(m, "position", "speed", "m/s"), "cross_position_speed", 0.02),
        (lambda m: hold(m, "force"), "ramp_force", 0.7),
    ],
)
def test_a_refit_from_null_finds_the_true_value(make, name, true):
    m = oscillator("zoh")
    effect = make(m)
    clean = outputs(effect.extend(m), **{name: true})
    sd = 1e-3
    rng = np.random.default_rng(3)
    y = clean + sd * rng.standard_normal(clean.shape)
    model = effect.extend(m)
    fit = minimize_simulation_error(criterion_of(model, y=y))
    i = fit.criterion.names.index(name)
    error = sd * np.sqrt(np.linalg.inv(fit.solution.hessian)[i, i])
    assert abs(fit.x[i] - true) < 3 * error
    assert true > 10 * error  # else this test could not fail


def test_no_lag_is_found_where_there_is_none():
    m = oscillator()
    model = sensor_lag(m, "position", 0.2).extend(m, starts={"lag_position": 0.03})
    fit = minimize_simulation_error(criterion_of(model, y=outputs(m)))
    assert fit.values["lag_position"] < 1e-3 * TS


def test_effects_of_an_eliminated_channel_are_those_of_the_output_it_was():
    m = pendulum.problem.model
    for effect in (sensor_lag(m, "accel", 0.3), sensor_scale(m, "accel"), hold(m, "accel")):
        direct = effect.extend(m).direct()
        assert "accel" in direct.outputs
        assert not any("change of" in n or "end of" in n for n in direct.inputs)
        direct.explicit()
        if effect.kind == "sensor_lag":
            assert [(s.kind, s.channel) for s in direct.stages] == [("lag", "accel")]
        if effect.kind == "hold":
            assert direct.parameters["ramp_accel"].is_known


def test_units_follow_the_channel():
    m = pendulum.problem.model
    assert sensor_scale(m, "gyro").parameters[0].unit == "1"
    assert sensor_lag(m, "gyro", 0.1).parameters[0].unit == "s"
    assert m.inputs["accel"].blends == ()


def test_inputs_that_are_declared_alike_are_tried_together():
    """One parameter moves both; settled, both are what it says, and it is not free."""
    m = oscillator()
    push = m.input("push", "N", hold="foh", known=True)
    m.add_term("force balance", push)
    together = [e for e in channel_effects_of(m, SIZES, {}) if e.key == ("hold", "force, push")]
    assert [e.description for e in together] == ["held between its samples"]
    settled = together[0].extend(m, starts={"ramp_inputs": 1.0})
    assert {settled.acting_hold(n) for n in ("force", "push")} == {"zoh"}
    p = settled.parameters["ramp_inputs"]
    assert p.lower == p.upper == 1.0


def test_a_gain_errs_from_the_zero_of_its_sensor_and_from_where_its_channel_stays():
    """An accelerometer at rest shows gravity: a gain error is a bias and a gain at once."""
    m = casid.Model("hover")
    v, F = m.state("v", "m/s"), m.input("F", "N", known=True)
    m.balance(v, "vertical", inertia=m.constant("mass", 2.0, "kg"), terms=[F], unit="N")
    m.output("a", m.der(v) + m.constant("g", 9.81, "m/s^2"), "m/s^2")
    m.output("T", v * m.constant("c", 1.0, "K s/m") + m.constant("T_0", 300.0, "K"), "K")
    sizes = Sizes(
        rates={"v": 1.0},
        largest={"a": 12.0, "T": 310.0},
        window=(0.0, 10.0),
        longest_delay=0.1,
        levels={"a": 9.81, "T": 300.0},
    )
    scales = [e for e in channel_effects_of(m, sizes, {}) if e.kind == "sensor_scale"]
    points = [(e.where, e.constants.get("about", 0.0)) for e in scales]
    # Absolute zero means nothing to a thermometer; a command errs from its zero.
    assert points == [("a", 9.81), ("a", 0.0), ("T", 300.0), ("T", 273.15), ("F", 0.0)]


def test_a_command_has_a_zero_of_its_own_where_a_constant_term_does_not_stand_for_it():
    """Under a pressure p that changes, k (u - b) p is no flow k u p less a constant one."""

    sizes = Sizes(rates={"level": 1.0}, largest={}, window=(0.0, 10.0), longest_delay=0.1)

    def zeros(*flow: str) -> list[str]:
        m = casid.Model("vessel")
        level = m.state("level", "m")
        u, p = m.input("u", "1", known=True), m.input("p", "1", known=True)
        k = m.parameter("k", "m/s", start=1.0)
        terms = {"added": k * u, "times p": k * u * p, "times level": k * u * level}
        m.balance(level, "volume", inertia=1, terms=[terms[f] for f in flow], unit="m/s")
        m.output("level", level, "m")
        found = channel_effects_of(m, sizes, {})
        return [e.where for e in found if e.kind == "sensor_bias"]

    assert zeros("added") == []
    assert zeros("times p") == ["u", "p"]
    assert zeros("times level") == ["u"]


def test_a_command_of_a_rate_without_a_balance_has_a_zero_of_its_own():
    """No effect is a constant in such an equation: the bias of the command is the only name."""
    m = casid.Model("valve")
    s, u = m.state("s", "1"), m.input("u", "1", known=True)
    m.derivative(s, m.parameter("rate", "1/s", start=1.0) * (u - s))
    m.output("s", s, "1")
    sizes = Sizes(rates={"s": 1.0}, largest={}, window=(0.0, 10.0), longest_delay=0.1)
    found = channel_effects_of(m, sizes, {})
    assert [e.where for e in found if e.kind == "sensor_bias"] == ["u"]


def test_a_thermometer_that_feels_another_place_shows_a_temperature_between_both():
    """By a share of their difference, from whichever zero the two are counted."""
    m = casid.Model("two rooms")
    a, b = m.state("a", "degC", initial=20.0), m.state("b", "degC", initial=30.0)
    G = m.constant("G", 0.0, "W/K")
    C = m.constant("C", 1.0, "J/K")
    m.balance(a, "first", inertia=C, terms=[G * (b - a)])
    m.balance(b, "second", inertia=C, terms=[G * (a - b)])
    m.output("T_a", a, "degC")
    m.output("T_b", b, "degC")
    felt = m.extend(cross_axis(m, "T_a", "T_b", "K"))
    values = {"cross_T_a_T_b": 0.25}
    record = casid.Record(
        {"T_a": np.zeros(3), "T_b": np.zeros(3)}, {"T_a": "K", "T_b": "K"}, Ts=1.0
    )
    criterion = SimulationError(felt, [casid.Experiment(record, {}, "r")], weights=np.ones(2))
    y = criterion.simulate(at(criterion, **values), 0)[0]
    assert y[0] == pytest.approx([273.15 + 22.5, 273.15 + 30.0])
