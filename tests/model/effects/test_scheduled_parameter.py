"""A parameter that depends on a recorded channel is named with it, sized, and not imagined.

The records come from a Runge-Kutta integration of 2 v' = -k x - d(s) v + F written here.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.model.effects.effect import Motion, Sizes, Spread
from casid.model.effects.parameter_effects import (
    input_schedules_of,
    is_constant_term,
    power_scheduled_parameter,
    scheduled_parameter,
)
from casid.model.effects.state_schedules import (
    inhibited_parameter,
    is_inhibited,
    state_scheduled_parameter,
    state_schedules_of,
)

MASS, STIFFNESS, DAMPING = 2.0, 50.0, 1.5  # kg, N/m, N s/m
TS, SUBSTEPS, NOISE = 0.02, 5, 2e-3  # s, 1, m


def speed(t: np.ndarray) -> np.ndarray:
    """A channel that wanders: 1.5 m/s and two sines that fit no whole number of times."""
    return 1.5 + 0.5 * np.sin(0.37 * t) + 0.3 * np.sin(0.91 * t + 1.0)


def record(slope: float, seed: int, *, of: str = "d", seconds: float = 60.0) -> casid.Record:
    """The parameter `of` is p (1 + slope (speed - mean)), under steps of force held for 1 s."""
    rng = np.random.default_rng(seed)
    t = TS * np.arange(round(seconds / TS))
    force = np.repeat(rng.uniform(-5.0, 5.0, math.ceil(seconds)), round(1.0 / TS))[: len(t)]
    h = TS / SUBSTEPS
    half = 0.5 * h * np.arange(2 * SUBSTEPS * len(t) + 1)  # starts, middles and ends of the steps
    change = 1.0 + slope * (speed(half) - speed(t).mean())
    k = (STIFFNESS * (change if of == "k" else np.ones_like(half))).tolist()
    d = (DAMPING * (change if of == "d" else np.ones_like(half))).tolist()
    x, v, path = 0.0, 0.0, np.empty(len(t))
    for n, F in enumerate(force.tolist()):
        path[n] = x
        for i in range(2 * SUBSTEPS * n, 2 * SUBSTEPS * (n + 1), 2):
            a1 = (F - k[i] * x - d[i] * v) / MASS
            x2, v2 = x + h / 2 * v, v + h / 2 * a1
            a2 = (F - k[i + 1] * x2 - d[i + 1] * v2) / MASS
            x3, v3 = x + h / 2 * v2, v + h / 2 * a2
            a3 = (F - k[i + 1] * x3 - d[i + 1] * v3) / MASS
            x4, v4 = x + h * v3, v + h * a3
            a4 = (F - k[i + 2] * x4 - d[i + 2] * v4) / MASS
            x += h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    position = path + NOISE * rng.standard_normal(len(t))
    return casid.Record(
        {"position": position, "force": force, "speed": speed(t)},
        {"position": "m", "force": "N", "speed": "m/s"},
        Ts=TS,
    )


def problem() -> casid.Problem:
    """The same oscillator without any influence of the speed."""
    m = casid.Model("oscillator")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold="zoh", known=True)
    mass = m.parameter("m", "kg", start=1.8, lower=0.1, upper=20.0)
    d = m.parameter("d", "N s/m", start=1.2, lower=0.0, upper=50.0)
    k = m.parameter("k", "N/m", start=45.0, lower=0.0, upper=1e3)
    m.derivative(x, v)
    m.balance(v, "force balance", inertia=mass, terms=[-k * x, -d * v, force])
    m.output("position", x, "m")
    return casid.Problem(name="oscillator", model=m, recorded={"speed": "m/s"}, starts=1)


@functools.cache
def diagnosed(slope: float, seed: int, of: str = "d") -> casid.Diagnosis:
    return casid.diagnose(problem(), record(slope, seed, of=of), advise=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("of", "slope", "value"), [("d", 0.5, DAMPING), ("k", -0.1, STIFFNESS)], ids="dk"
)
def test_a_parameter_that_follows_a_channel_is_named_with_it_and_sized(of, slope, value):
    """The slope is the same about any mean of the channel: p's own value takes that up."""
    d = diagnosed(slope, 1, of)
    assert [(c.kind, c.where) for c in d.causes] == [("scheduled_parameter", f"{of}~speed")]
    (s,) = d.causes[0].parameters
    assert s.value == pytest.approx(slope * value, abs=3 * s.std_error)
    assert s.std_error < 0.1 * abs(slope * value)
    assert s.unit == ("N s^2/m^2" if of == "d" else "N s/m^2")
    # A model of the right form leaves the noise: its rms over 900 samples is known to 2.4 %.
    assert d.held_out["extended_rmse"]["position"] == pytest.approx(NOISE, rel=0.08)
    assert d.held_out["baseline_rmse"]["position"] > 1.3 * NOISE
    assert f"The parameter {of} changes with speed" in d.sentence


@pytest.mark.slow
def test_of_parameters_that_act_alike_the_estimated_one_is_named_and_the_other_beside_it():
    """The damping is d + e with e known: nothing in any record tells d~speed from e~speed."""
    given = problem()
    m = given.model.copy("oscillator with a known damper")
    e = m.parameter("e", "N s/m", value=0.5)
    m.add_term("force balance", -e * m.symbol("v"))
    d = casid.diagnose(dataclasses.replace(given, model=m), record(0.5, 1), advise=False)
    assert [(c.kind, c.where) for c in d.causes] == [("scheduled_parameter", "d~speed")]
    assert ("scheduled_parameter", "e~speed") in {
        (a.kind, a.where) for a in d.causes[0].alternatives
    }
    assert len({(a.kind, a.where) for a in d.causes[0].alternatives}) == len(
        d.causes[0].alternatives
    )


@pytest.mark.parametrize("seed", [11, *(pytest.param(s, marks=pytest.mark.slow) for s in (12, 13))])
def test_a_channel_that_moves_nothing_raises_no_alarm(seed):
    assert diagnosed(0.0, seed).verdict == "adequate"


@pytest.mark.slow
def test_a_model_that_knows_how_its_parameter_follows_the_channel_is_adequate():
    """The estimated slope is 0.5 times the damping at the channel's mean over the whole record."""
    given, r = problem(), record(0.5, 1)
    m = given.model.copy("oscillator with its speed")
    speed = m.input("speed", "m/s", known=True)
    slope = m.parameter("slope", "N s^2/m^2", start=0.5, lower=0.0, upper=5.0)
    m.add_term("force balance", -slope * speed * m.symbol("v"))
    # At no speed there would be less damping than at the mean, by 0.5 of it for each m/s.
    m.parameters["d"] = dataclasses.replace(m.parameters["d"], lower=-50.0)
    d = casid.diagnose(casid.Problem(name="known", model=m, starts=1), r, advise=False)
    assert d.verdict == "adequate"
    found = d.baseline.parameter("slope")
    assert found.value == pytest.approx(0.5 * DAMPING, abs=3 * found.std_error)


def battery() -> casid.Problem:
    """A charge that is counted, and a voltage that falls with it and by R i."""
    m = casid.Model("battery")
    current, charge = m.input("i", "A", hold="zoh", known=True), m.state("z", "1", initial=0.9)
    m.derivative(charge, -current / m.constant("Q", 9000.0, "A s"))
    R = m.parameter("R", "Ohm", start=0.02, lower=1e-3, upper=1.0)
    k = m.parameter("k", "V", start=0.5, lower=0.05, upper=3.0)
    m.output(
        "v",
        m.parameter("v_0", "V", start=3.0, lower=1.0, upper=5.0) + k * charge - R * current,
        "V",
    )
    return casid.Problem("battery", m)


@pytest.mark.slow
def test_a_resistance_in_what_a_sensor_shows_is_named_with_the_charge_that_it_depends_on():
    """v = v_0 + k z - R (1 - 0.4 (z - 1/2)) i at a charge z counted exactly: R~z, -0.4 R."""
    rng, N = np.random.default_rng(2), 1800
    i = np.repeat(rng.uniform(-2.0, 5.0, N // 30), 30)
    z = 0.9 - np.concatenate([[0.0], np.cumsum(i)[:-1]]) / 9000.0
    v = 3.4 + 0.7 * z - 0.03 * (1 - 0.4 * (z - 0.5)) * i + 5e-4 * rng.standard_normal(N)
    record = casid.Record({"i": i, "v": v}, {"i": "A", "v": "V"}, Ts=1.0)
    first = casid.diagnose(battery(), record, advise=False).causes[0]
    assert (first.kind, first.where) == ("scheduled_parameter", "R~z")
    slope = first.parameters[0]
    assert abs(slope.value + 0.4 * 0.03) < 4 * slope.std_error


@pytest.mark.slow
def test_a_resistance_in_what_a_sensor_shows_may_fall_with_the_recorded_current():
    """v = v_0 + k z - R (1 - 0.06 |i|) i: R~i, -0.06 R."""
    rng, N = np.random.default_rng(3), 900
    i = np.repeat(rng.uniform(-5.0, 5.0, N // 30), 30)
    z = 0.9 - np.concatenate([[0.0], np.cumsum(i)[:-1]]) / 9000.0
    v = 3.4 + 0.7 * z - 0.03 * (1 - 0.06 * np.abs(i)) * i + 5e-4 * rng.standard_normal(N)
    record = casid.Record({"i": i, "v": v}, {"i": "A", "v": "V"}, Ts=1.0)
    first = casid.diagnose(battery(), record, advise=False).causes[0]
    assert (first.kind, first.where) == ("scheduled_parameter", "R~i")
    slope = first.parameters[0]
    assert abs(slope.value + 0.06 * 0.03) < 4 * slope.std_error


def coil(seed: int) -> tuple[casid.Problem, casid.Record]:
    """L di/dt = u - R i - v, C dv/dt = i - v / R_p, both stated as rates; L = L_0 / (1 + i^2 / 18).

    The simulation is a Runge-Kutta integration written here: ten steps a sample.
    """
    rng, Ts, N = np.random.default_rng(seed), 1e-4, 3000
    u = np.repeat(rng.uniform(-10.0, 10.0, N // 60), 60)

    def rate(x: np.ndarray, u: float) -> np.ndarray:
        i, v = x
        return np.array([(u - 2.0 * i - v) * (1 + i**2 / 18) / 8e-3, (i - v / 60.0) / 4e-4])

    x, path, h = np.zeros(2), np.empty((N, 2)), Ts / 10
    for n in range(N):
        path[n] = x
        for _ in range(10):
            a = rate(x, u[n])
            b = rate(x + h / 2 * a, u[n])
            c = rate(x + h / 2 * b, u[n])
            x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, u[n]))
    y = path + [0.01, 0.02] * rng.standard_normal((N, 2))
    m = casid.Model("coil")
    drive = m.input("u", "V", hold="zoh", known=True)
    i, v = m.state("i", "A"), m.state("v", "V")
    R = m.parameter("R", "Ohm", start=1.0, lower=0.1, upper=50.0)
    L = m.parameter("L", "H", start=5e-3, lower=1e-4, upper=1.0)
    C = m.parameter("C", "A s/V", start=2e-4, lower=1e-5, upper=1e-2)
    m.derivative(i, (drive - R * i - v) / L)
    m.derivative(v, (i - v / m.constant("R_p", 60.0, "Ohm")) / C)
    m.output("current", i, "A")
    m.output("voltage", v, "V")
    channels = {"u": u, "current": y[:, 0], "voltage": y[:, 1]}
    return casid.Problem("coil", m), casid.Record(
        channels, {"u": "V", "current": "A", "voltage": "V"}, Ts=Ts
    )


@pytest.mark.slow
def test_iron_that_saturates_is_an_inductance_that_falls_with_the_current():
    """The law searched, L (L - s m) / (L - s i^2), is the true one: s = -L / 18 at no current."""
    problem, record = coil(2)
    found = casid.diagnose(problem, record, advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("scheduled_parameter", "L~i")]
    left = found.held_out["extended_rmse"]
    assert left["current"] == pytest.approx(0.01, rel=0.1)
    assert left["voltage"] == pytest.approx(0.02, rel=0.1)


def test_a_factor_of_force_and_voltage_may_fall_with_the_position():
    """A voice coil: B stands in two balances out of proportion; its position moves it."""
    m = casid.Model("voice_coil")
    u = m.input("u", "V", known=True)
    i, x, v = m.state("i", "A"), m.state("x", "m"), m.state("v", "m/s")
    L, B = m.parameter("L", "H", start=1e-3), m.parameter("B", "N/A", start=5.0)
    m.balance(i, "voltage", inertia=L, terms=[u, -6.0 * i, -B * v], unit="V")
    m.derivative(x, v)
    m.balance(v, "force", inertia=0.01, terms=[B * i, -v, -1000.0 * x])
    m.output("i", i, "A")
    motion = np.random.default_rng(0).standard_normal((3, 50))

    def course(expression: ca.SX) -> np.ndarray:
        return np.array(ca.Function("f", [ca.vertcat(i, x, v)], [expression])(motion)).ravel()

    sizes = Sizes(dict.fromkeys(m.states, 1.0), {}, (0.0, 1.0), 0.1, course=course)
    places = {e.key[1] for e in state_schedules_of(m, sizes)}
    assert {"B~x", "B~i", "B~v", "L~i"} <= places


def driven() -> casid.Model:
    """A body behind an actuator of gain K, with a constant force F_0 on it."""
    m = casid.Model("driven")
    v, u = m.state("v", "m/s"), m.input("u", "V", hold="zoh", known=True)
    K, F_0 = m.parameter("K", "N/V", start=1.0), m.parameter("F_0", "N", start=0.0)
    m.balance(v, "force", inertia=2.0, terms=[K * u, F_0, -0.5 * v])
    m.output("speed", v, "m/s")
    return m


@pytest.mark.parametrize("power", [1, 2])
def test_a_parameter_that_is_zero_stays_zero_and_slopes_are_numbers(power: int) -> None:
    """A load of zero in one of several load cases."""
    model = driven()
    effect = state_scheduled_parameter(model, "K", "v", Motion(1.0, -2.0, 2.0, 0.8), power)
    e = effect.extended(model)[0].explicit()
    of = ca.Function("f", [e.x, e.u, e.p], [e.f, ca.jacobian(e.f, ca.vertcat(e.x, e.p))])
    value, slopes = (part.full() for part in of(1.5, 3.0, 0.0))
    assert value == pytest.approx(-0.375)
    assert np.all(np.isfinite(slopes))


def test_a_constant_term_has_no_schedule_beside_the_input_that_it_would_be() -> None:
    assert is_constant_term(driven(), "F_0")
    assert not is_constant_term(driven(), "K")


def test_an_inertia_that_falls_straight_keeps_a_share_however_far_it_falls():
    """Beyond the current at which it would vanish an inductance keeps a twentieth of itself."""
    m = casid.Model("coil")
    i = m.state("i", "A")
    u = m.input("u", "V", known=True)
    m.balance(i, "voltage", inertia=m.parameter("L", "H", start=0.1, lower=1e-3), terms=[u])
    m.output("i", i, "A")
    effect = state_scheduled_parameter(m, "L", "i", Motion(1.0, 0.0, 4.0, 1.0))
    extended, names = effect.extended(m)
    e = extended.explicit()
    (slope,) = names
    order = {n: k for k, n in enumerate(e.parameters)}
    p = np.zeros(len(order))
    p[order["L"]], p[order[slope]] = 0.1, -0.05  # zero at 3 A
    rate = ca.Function("f", [e.x, e.u, e.p], [e.f])
    for current, inductance in ((1.0, 0.1), (2.0, 0.05), (3.5, 0.005), (-3.5, 0.005)):
        assert float(rate(current, 1.0, p)) == pytest.approx(1.0 / inductance)


@pytest.mark.parametrize("power", [1, 2])
def test_what_a_coil_stores_is_the_flux_that_its_motor_shows_however_it_bends(power):
    """The inertia of a current is the slope of the flux p(i) i that another axis induces from."""
    m = casid.Model("two axes")
    d, q = m.state("d", "A"), m.state("q", "A")
    w, u = m.input("w", "rad/s", known=True), m.input("u", "V", known=True)
    L = m.parameter("L", "H", start=0.1, lower=1e-3)
    m.balance(d, "d axis", inertia=m.constant("L_d", 1.0, "H"), terms=[w * L * q])
    m.balance(q, "q axis", inertia=L, terms=[u])
    m.output("d", d, "A")
    m.output("q", q, "A")
    effect = state_scheduled_parameter(m, "L", "q", Motion(1.0, -2.0, 2.0, 1.0), power)
    extended, (size,) = effect.extended(m)
    e = extended.explicit()
    rates = ca.Function("f", [e.x, e.u, e.p], [e.f])
    p = [{"L": 0.1, size: -0.02, "L_d": 1.0}[n] for n in e.parameters]

    def of(current: float) -> tuple[float, float]:
        """The flux, which speed 1 induces in the other axis, and the inertia at 1 V."""
        flux, rate = np.ravel(rates([0.0, current], [1.0, 1.0], p))
        return flux, 1.0 / rate

    for current in (-1.5, 0.4, 1.2):
        (high, _), (low, _) = of(current + 1e-6), of(current - 1e-6)
        assert of(current)[1] == pytest.approx((high - low) / 2e-6, rel=1e-6)
    assert of(1.5)[1] < 0.9 * of(1.5)[0] / 1.5  # less than the flux per current: it bends


def heat_pump() -> casid.Problem:
    """A tank of 40 kJ/K that a heat pump of constant efficiency heats."""
    m = casid.Model("heat pump")
    T = m.state("T", "degC", start=40.0)
    outside = m.input("outside", "degC", known=True)
    power = m.input("power", "W", hold="zoh", known=True)
    C = m.constant("C", 4.0e4, "J/K")
    loss = m.parameter("loss", "W/K", start=10.0, lower=0.0)
    efficiency = m.parameter("efficiency", "1", start=2.0, lower=0.5)
    m.balance(T, "tank", inertia=C, terms=[efficiency * power, loss * (outside - T)])
    m.output("tank", T, "degC")
    return casid.Problem("heat pump", m)


def test_the_gain_of_an_input_is_tested_with_every_other_input():
    """The loss, which multiplies the temperature outside itself, with the power alone."""
    sizes = Sizes(
        {}, {}, (0.0, 1.0), 1.0, readings={"outside": (270.0, 285.0), "power": (0.0, 200.0)}
    )
    found = [e.where for e in input_schedules_of(heat_pump().model, sizes)]
    assert found == ["efficiency~outside", "loss~power"]


@pytest.mark.slow
def test_what_a_heat_pump_makes_of_its_power_depends_on_the_temperature_outside():
    """C T' = 3 (1 + 0.03 (outside - mean)) power - 12 (T - outside), by exact steps of 60 s."""
    rng, n, h, slope = np.random.default_rng(4), 1500, 60.0, 0.09
    outside = 5.0 + 6.0 * np.sin(2 * np.pi * np.arange(n + 1) / 700)
    power = np.repeat(rng.choice([20.0, 80.0, 140.0], n // 15), 15)
    T, decay = np.empty(n + 1), math.exp(-12.0 * h / 4.0e4)
    T[0] = 20.0
    for k in range(n):
        between = 0.5 * (outside[k] + outside[k + 1])
        gain = 3.0 + slope * (between - 5.0)
        final = between + gain * power[k] / 12.0
        T[k + 1] = final + (T[k] - final) * decay
    tank = T[:n] + 0.05 * rng.standard_normal(n)
    data = {"tank": tank + 273.15, "outside": outside[:n] + 273.15, "power": power}
    record = casid.Record(data, {"tank": "K", "outside": "K", "power": "W"}, Ts=h)
    found = casid.diagnose(heat_pump(), record, advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [
        ("scheduled_parameter", "efficiency~outside")
    ]
    (size,) = found.causes[0].parameters
    assert size.std_error is not None
    assert abs(size.value - slope) < 3 * size.std_error
    assert size.std_error < 0.1 * slope


def seat() -> casid.Problem:
    """A seat on a spring, whose damper's current pulls at it."""
    m = casid.Model("seat")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold="zoh", known=True)
    current = m.input("current", "A", hold="zoh", known=True)
    d = m.parameter("d", "N s/m", start=20.0, lower=0.0, upper=1e3)
    k = m.parameter("k", "N/m", start=1800.0, lower=0.0, upper=1e5)
    c = m.parameter("c", "N/A", start=3.0, lower=0.0, upper=100.0)
    mass = m.parameter("m", "kg", start=7.0, lower=0.1, upper=100.0)
    m.derivative(x, v)
    m.balance(v, "force balance", inertia=mass, terms=[force, c * current, -d * v, -k * x])
    m.output("position", x, "mm")
    return casid.Problem("seat", m)


def test_what_multiplies_a_state_is_tested_with_the_inputs_that_keep_their_sign():
    """The damping of a damper goes with its current; the force on the seat is no level."""
    m = seat().model
    sizes = Sizes({}, {}, (0.0, 1.0), 1.0, readings={"force": (-9.0, 9.0), "current": (0.0, 2.0)})
    found = [e.where for e in input_schedules_of(m, sizes)]
    assert found == ["c~force", "d~current", "k~current"]
    # With a parameter of its own, d_1 current v, nothing is left for d to change by.
    d_1 = m.parameter("d_1", "N s/(m A)", start=1.0)
    m.add_term("force balance", -d_1 * m.symbol("current") * m.symbol("v"))
    found = [e.where for e in input_schedules_of(m, sizes)]
    assert found == ["c~force", "k~current"]


@pytest.mark.slow
def test_a_damping_that_goes_with_a_current_is_named_where_the_current_acts_otherwise_too():
    """8 v' = force + 4 i - 30 (1 + 0.5 (i - 1)) v - 2000 x, by exact steps of 10 ms."""
    rng, n, h = np.random.default_rng(1), 2500, 0.01
    current = np.repeat(rng.uniform(0.1, 2.0, n // 125), 125)
    force = 20.0 * np.convolve(rng.standard_normal(n), np.ones(15) / 4, "same")
    state, x = np.zeros(2), np.empty(n)
    for j in range(n):
        x[j] = state[0]
        A = np.array([[0.0, 1.0], [-250.0, -30.0 * (1 + 0.5 * (current[j] - 1.0)) / 8]])
        step = expm(A * h)
        rest = np.array([(force[j] + 4.0 * current[j]) / 2000.0, 0.0])
        state = rest + step @ (state - rest)
    position = x + 1e-4 * rng.standard_normal(n)
    record = casid.Record(
        {"force": force, "current": current, "position": position},
        {"force": "N", "current": "A", "position": "m"},
        Ts=h,
    )
    found = casid.diagnose(seat(), record, advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("scheduled_parameter", "d~current")]
    (slope,) = found.causes[0].parameters
    assert slope.std_error is not None
    assert abs(slope.value - 15.0) < 4 * slope.std_error
    assert slope.std_error < 0.15
    assert found.held_out["extended_rmse"]["position"] == pytest.approx(0.1, rel=0.1)  # mm


def test_a_power_of_a_channel_leaves_a_parameter_what_it_is_at_the_mean():
    """UA (flow / 0.1)^n, and next to nothing without a flow."""
    m = casid.Model("tank")
    T = m.state("T", "K")
    m.input("flow", "L/min", known=True)
    UA = m.parameter("UA", "W/K", start=200.0, lower=0.0)
    m.balance(T, "tank", inertia=m.constant("C", 1.0, "J/K"), terms=[-UA * T])
    m.output("T", T, "K")
    spread = Spread(2e-4, 0.0, 4e-4)
    effect = power_scheduled_parameter(m, "UA", "flow", "m^3/s", spread)
    assert effect.key == ("scheduled_parameter", "UA~flow")
    assert "(flow/12 L/min)^exponent_UA_flow" in effect.description
    new, (n,) = effect.extended(m)
    e = new.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f, ca.jacobian(e.f, e.p)])
    for exponent in (0.0, 0.8, 1.0):
        values = {"UA": 200.0, "C": 1.0, n: exponent}
        p = [values[name] for name in e.parameters]
        for ratio in (0.5, 1.0, 2.0):
            rate, slopes = f(1.0, ratio * spread.mean, p)
            assert float(rate) == pytest.approx(-200.0 * ratio**exponent, rel=1e-5)
        rate, slopes = f(1.0, 0.0, p)
        assert np.all(np.isfinite(slopes.full()))
        assert float(rate) == pytest.approx(-200.0 * 1e-3**exponent, rel=1e-5)


def test_a_channel_named_with_brackets_has_a_size_and_an_error_as_any_other():
    """Variables of multiple shooting have brackets in their names; names of channels may, too."""
    channel, of = "speed of air [m/s]", problem()
    entries = record(0.5, 1)
    named = casid.Record(
        {"position": entries["position"], "force": entries["force"], channel: entries["speed"]},
        {"position": "m", "force": "N", channel: "m/s"},
        Ts=TS,
    )
    effect = scheduled_parameter(of.model, "d", channel, "m/s", Spread(1.5, 0.7, 2.3))
    assert [p.name for p in effect.parameters] == ["slope_d_speed_of_air_m_s"]
    found = casid.identify(
        dataclasses.replace(of, model=of.model.extend(effect), recorded={channel: "m/s"}), named
    )
    slope = found.parameter("slope_d_speed_of_air_m_s")
    assert slope.value == pytest.approx(0.5 * DAMPING, abs=4 * slope.std_error)


def test_parameters_with_brackets_in_their_own_names_are_no_inner_nodes():
    m = casid.Model("tank")
    h, q = m.state("h", "m"), m.input("q", "m/s", known=True, hold="zoh")
    m.derivative(h, q - m.parameter("leak [1/s]", "1/s", start=0.05) * h)
    m.output("level", h, "m")
    rng = np.random.default_rng(1)
    flow, level = np.repeat(rng.uniform(0.0, 0.1, 20), 20), np.zeros(400)
    for k in range(399):
        level[k + 1] = level[k] * math.exp(-0.01) + flow[k] * (1 - math.exp(-0.01)) / 0.1
    level += 1e-3 * rng.standard_normal(400)
    data = casid.Record({"q": flow, "level": level}, {"q": "m/s", "level": "m"}, Ts=0.1)
    found = casid.identify(casid.Problem("tank", m), data, settings=casid.FitSettings(segments=3))
    leak = found.parameter("leak [1/s]")
    assert leak.value == pytest.approx(0.1, abs=4 * leak.std_error)
    assert [p.name for p in found.initial_states] == ["h(0)"]  # of three parts, the first alone


def test_a_reaction_is_inhibited_by_what_it_makes_and_not_by_what_it_is_stated_with():
    """k A in the balances of A and B becomes k A (1 + r m) / (1 + r B), the same where B is m."""
    m = casid.Model("reaction")
    A, B = m.state("A", "mmol/L", start=5.0), m.state("B", "mmol/L", start=2.0)
    k = m.parameter("k", "1/s", start=0.1, lower=0.0)
    m.balance(A, "a", inertia=1, terms=[-k * A])
    m.balance(B, "b", inertia=1, terms=[k * A])
    m.output("y", B, "mmol/L")
    sizes = Sizes(
        {"A": 5.0, "B": 2.0}, {"y": 4.0}, (0.0, 9.0), 1.0, ranges={"A": (1.0, 5.0), "B": (1.0, 3.0)}
    )
    (effect,) = state_schedules_of(m, sizes)
    assert effect.key == ("scheduled_parameter", "k~B")
    extended, (r,) = effect.extended(m)
    e = extended.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    values = {"k": 0.1, r: 0.5}
    for amount in (2.0, 6.0):
        found = np.ravel(f([4.0, amount], [], [values[n] for n in e.parameters]))
        rate = 0.1 * 4.0 * (1 + 0.5 * 2.0) / (1 + 0.5 * amount)
        assert found == pytest.approx([-rate, rate], rel=1e-12)


@pytest.mark.parametrize(("lowest", "levels_off"), [(0.0, True), (-100.0, False)])
def test_the_gain_of_an_input_that_is_never_negative_may_saturate_with_it(lowest, levels_off):
    """What leaves take up of the light, of which 300 W/m^2 halve the gain."""
    m = casid.Model("leaves")
    c, light = m.state("c", "kg/m^3", start=0.7), m.input("light", "W/m^2", known=True)
    p, g = m.parameter("p", "kg/(m J)", start=0.002), m.parameter("g", "1/s", start=0.1)
    m.balance(c, "CO2", inertia=1, terms=[-p * light, -g * c])
    m.output("y", c, "kg/m^3")
    ranges = {"c": (0.3, 1.0), "light": (lowest, 600.0)}
    sizes = Sizes({"c": 0.7, "light": 300.0}, {"y": 0.7}, (0.0, 9.0), 1.0, ranges=ranges)
    gains = [e for e in state_schedules_of(m, sizes) if e.where == "p~light"]
    found = [e for e in gains if is_inhibited(e)]
    assert len(found) == levels_off
    assert gains == found  # a gain that changes otherwise is a law of the input's own
    for effect in found:
        extended, (r,) = effect.extended(m)
        e = extended.explicit()
        f = ca.Function("f", [e.x, e.u, e.p], [e.f])
        values = {"p": 0.002, "g": 0.0, r: 1 / 300.0}
        for u in (0.0, 150.0, 600.0):
            rate = float(f([0.7], [u], [values[n] for n in e.parameters]))
            true = -0.002 * u * (1 + 300.0 / 300.0) / (1 + u / 300.0)  # 300 W/m^2 is the mean
            assert rate == pytest.approx(true, rel=1e-12)


def test_the_gain_of_an_input_is_what_multiplies_it_whatever_else_the_force_depends_on():
    """C (i/(z + z_0))^2: iron that saturates lowers C with i; z_0 is a length, and no gain."""
    m = casid.Model("magnet")
    z, v = m.state("z", "m", start=0.01), m.state("v", "m/s")
    i = m.input("i", "A", known=True)
    C, z_0 = m.parameter("C", "N m^2/A^2", start=7e-5), m.parameter("z_0", "m", start=1e-3)
    m.derivative(z, v)
    m.balance(v, "force", inertia=m.constant("M", 0.1, "kg"), terms=[-C * (i / (z + z_0)) ** 2])
    m.output("y", z, "m")
    ranges = {"z": (0.008, 0.012), "v": (-0.1, 0.1), "i": (1.0, 4.0)}
    sizes = Sizes({"z": 1e-3, "v": 0.1, "i": 2.0}, {"y": 0.01}, (0.0, 9.0), 1.0, ranges=ranges)
    with_current = [e.where for e in state_schedules_of(m, sizes) if e.where.endswith("~i")]
    assert set(with_current) == {"C~i"}


def test_an_amount_that_helps_a_reaction_keeps_its_rate_finite():
    """r is above -1/(2 x) for the largest x that was met."""
    m = casid.Model("reaction")
    A, B = m.state("A", "kg/m^3", start=5.0), m.state("B", "kg/m^3", start=2.0)
    k = m.parameter("k", "1/s", start=0.1, lower=0.0)
    m.balance(A, "a", inertia=1, terms=[-k * A])
    m.balance(B, "b", inertia=1, terms=[k * A])
    m.output("y", B, "kg/m^3")
    effect = inhibited_parameter(m, "k", "B", Motion(2.0, 1.0, 4.0, 2.0))
    assert effect.parameters[0].lower == pytest.approx(-0.5 / 4.0)
    assert effect.parameters[0].unit == "m^3/kg"


def test_a_slope_is_shown_in_the_units_that_its_two_quantities_have():
    """An inductance in uH falls by uH/A; breath in L/h with a flow in m^3/h is L/m^3, not 1."""
    m = casid.Model("choke")
    i, u = m.state("i", "A"), m.input("u", "V", known=True)
    L, R = m.parameter("L", "uH", start=200.0, lower=1.0), m.parameter("R", "mohm", start=50.0)
    m.balance(i, "choke", inertia=L, terms=[u, -R * i])
    m.output("i", i, "A")
    sizes = Motion(2.0, -1.0, 3.0, 1.5)
    for power, unit in ((1, "uH/A"), (2, "uH/A^2")):
        new, (name,) = state_scheduled_parameter(m, "L", "i", sizes, power).extended(m)
        assert (new.unit_of(name), new.in_declared_units({name: 2e-6})) == (unit, {name: 2.0})

    room = casid.Model("room")
    C, flow = room.state("C", "ppm"), room.input("flow", "m^3/h", known=True)
    g, V = room.parameter("g", "L/h", start=20.0), room.constant("V", 50.0, "m^3")
    room.balance(C, "CO2", inertia=V, terms=[g, -flow * C])
    spread = Spread(0.1, 0.05, 0.2)
    new, (name,) = scheduled_parameter(room, "g", "flow", "m^3/s", spread).extended(room)
    assert (new.unit_of(name), new.in_declared_units({name: 0.5})) == ("L/m^3", {name: 500.0})
    assert new.parameters[name].unit == "1"
