"""A first cause that is seen beside a disturbance: a dead zone of a fin, without casid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

import casid
from casid.diagnosis.thresholds import SHORTLIST

TS, N = 0.1, 1500
B, C, K = 0.3, 0.8, 0.25
GAP, SD = 0.1, 0.002  # rad
LOOK = "look for effects beside a random disturbance"


def hull() -> casid.Problem:
    m = casid.Model("hull")
    fin = m.input("fin", "rad", hold="zoh", known=True)
    phi, w = m.state("phi", "rad"), m.state("w", "rad/s")
    b = m.parameter("B", "1/s", start=0.2, lower=0.0, upper=2.0)
    c = m.parameter("C", "1/s^2", start=1.0, lower=0.05, upper=10.0)
    k = m.parameter("K", "1/s^2", start=0.2, lower=0.0, upper=10.0)
    m.derivative(phi, w)
    m.balance(w, "moment", inertia=1, terms=[-b * w, -c * phi, k * fin], unit="rad/s^2")
    m.output("roll", phi, "rad")
    return casid.Problem("hull", m)


def record(waves: float = 0.0, *, gap: float = GAP, fade: float = 0.0) -> casid.Record:
    """Rolling under a slow random fin beyond its dead zone, and a moment of white waves (rad/s^2).

    The fin loses the share `fade` of its force after a minute. All of it is held over each sample:
    the linear hull then moves by its matrix exponential.
    """
    rng = np.random.default_rng(5)
    fin = 0.2 * np.sqrt(1 - 0.95**2) * lfilter([1.0], [1.0, -0.95], rng.standard_normal(N))
    acting = K * np.sign(fin) * np.maximum(np.abs(fin) - gap, 0.0)
    acting *= np.where(TS * np.arange(N) < 60.0, 1.0, 1.0 - fade)
    acting += waves * rng.standard_normal(N)
    step = expm(TS * np.array([[0.0, 1.0, 0.0], [-C, -B, 1.0], [0.0, 0.0, 0.0]]))
    x, roll = np.zeros(2), np.empty(N)
    for k in range(N):
        roll[k] = x[0]
        x = step[:2] @ [*x, acting[k]]
    roll += SD * rng.standard_normal(N)
    return casid.Record({"fin": fin, "roll": roll}, {"fin": "rad", "roll": "rad"}, Ts=TS)


def diagnosed(of: casid.Record) -> tuple[casid.Diagnosis, list[str]]:
    """The diagnosis, and what it said up to the second round of the search, if there was one."""
    said: list[str] = []
    found = casid.diagnose(hull(), of, advise=False, progress=said.append)
    second = "test every effect (round 2)"
    return found, said[: said.index(second)] if second in said else said


def refits(said: list[str]) -> list[str]:
    return [s.partition(": ")[2] for s in said if s.startswith("refit ")]


def test_what_leaves_no_disturbance_is_the_first_cause_and_nothing_else_is_refitted_for_it():
    found, said = diagnosed(record())
    assert [(c.kind, c.where) for c in found.causes] == [("deadzone", "fin")]
    gap = found.causes[0].parameters[0]
    assert abs(gap.value - GAP) < 3 * gap.std_error
    assert set(refits(said)) == {"dead zone in fin"}


@pytest.mark.slow
def test_where_waves_are_all_that_it_leaves_nothing_is_sought_under_the_noise_of_the_sensors():
    found, said = diagnosed(record(waves=0.03, gap=0.0, fade=0.8))
    assert [(c.kind, c.where) for c in found.causes] == [("parameter_jump", "K")]
    jump, time = found.causes[0].parameters
    assert jump.value == pytest.approx(-0.8 * K, abs=3 * jump.std_error)
    assert time.value == pytest.approx(60.0, abs=TS / (1 - 0.95))  # the fin's correlation time
    assert [d.where for d in found.disturbances] == ["moment"]
    assert said.count("test every effect (round 1)") == 1
    assert len(refits(said)) <= 6


@pytest.mark.slow
def test_where_many_are_seen_beside_waves_they_are_sought_under_the_noise_of_the_sensors_as_well():
    found, said = diagnosed(record(waves=0.05))
    assert len(refits(said[said.index("test every effect (round 1)") :])) > 6
    assert found.causes[0].kind == "deadzone"
    # It leaves the waves and nothing to name: no two causes are sought beside them in its place.
    beside = said.index(
        "treat the remainder as a disturbance, and test every effect in its presence"
    )
    assert "test every effect (round 1)" in said[beside:]
    assert "test every effect (round 2)" not in said[beside:]


def spindle() -> casid.Problem:
    m = casid.Model("spindle")
    u = m.input("u", "N m", hold="zoh", known=True)
    w = m.state("w", "rad/s")
    J = m.parameter("J", "kg m^2", start=1.5, lower=0.1, upper=10.0)
    b = m.parameter("b", "N m s/rad", start=1.0, lower=0.0, upper=20.0)
    m.balance(w, "torque", inertia=J, terms=[u, -b * w], unit="N m")
    m.output("speed", w, "rad/s")
    return casid.Problem("spindle", m)


def with_dry_friction(friction: float, mean: float = 0.0, fine: int = 50) -> casid.Record:
    """A spindle whose bearing sticks below its friction, in small steps; its torque is slow."""
    rng = np.random.default_rng(7)
    torque = lfilter([1.0], [1.0, -0.97], rng.standard_normal(N)) * 1.5 * np.sqrt(1 - 0.97**2)
    torque += mean
    w, speed = 0.0, np.empty(N)
    for k in range(N):
        speed[k] = w
        for _ in range(fine):
            drive = torque[k] - 0.5 * w
            if w == 0.0 and abs(drive) <= friction:
                continue
            side = np.sign(w) if w else np.sign(drive)
            after = w + TS / fine * (drive - friction * side)
            w = 0.0 if w * after < 0.0 else after
    speed += 5e-3 * rng.standard_normal(N)
    return casid.Record({"u": torque, "speed": speed}, {"u": "N m", "speed": "rad/s"}, Ts=TS)


@pytest.mark.slow
def test_what_leaves_noise_once_it_is_refined_is_the_first_cause_as_well():
    """The width over which dry friction is smoothed is found after it is named."""
    said: list[str] = []
    found = casid.diagnose(spindle(), with_dry_friction(0.2), advise=False, progress=said.append)
    assert [(c.kind, c.where) for c in found.causes] == [("coulomb_friction", "torque")]
    size = found.causes[0].parameters[0]
    assert abs(size.value - 0.2) < 3 * size.std_error
    assert said.count("test every effect (round 1)") == 2  # beside a disturbance, and without one
    assert len(refits(said)) <= SHORTLIST.few


@pytest.mark.slow
def test_what_acts_as_the_first_cause_does_is_refitted_and_named_with_it():
    """Of what turns one way no motion tells dry friction from a constant term, or from a bias."""
    found = casid.diagnose(spindle(), with_dry_friction(0.2, mean=6.0), advise=False)
    (cause,) = found.causes
    assert {cause.kind, *(a.kind for a in cause.alternatives)} == {
        "offset",
        "coulomb_friction",
        "sensor_bias",
    }


def shaker() -> casid.Problem:
    m = casid.Model("shaker")
    u = m.input("u", "V", hold="zoh", known=True)
    i, x, v = m.state("i", "A"), m.state("x", "m"), m.state("v", "m/s")
    R = m.parameter("R", "ohm", start=6.0, lower=1.0, upper=30.0)
    L = m.parameter("L", "H", start=5e-4, lower=2e-5, upper=5e-3)
    Bl = m.parameter("Bl", "N/A", start=5.0, lower=0.5, upper=30.0)
    M = m.parameter("M", "kg", start=0.015, lower=2e-3, upper=0.1)
    K = m.parameter("K", "N/m", start=1500.0, lower=100.0, upper=2e4)
    D = m.parameter("D", "N s/m", start=1.0, lower=0.05, upper=20.0)
    m.derivative(x, v)
    m.balance(i, "voltage", inertia=L, terms=[u, -R * i, -Bl * v])
    m.balance(v, "force", inertia=M, terms=[Bl * i, -K * x, -D * v])
    m.output("current", i, "A")
    m.output("laser", x, "m")
    return casid.Problem("shaker", m)


def with_a_short_coil(drop: float, fine: int = 8) -> casid.Record:
    """A coil that leaves its field: its force factor is 6.2 (1 - drop x^2); Runge-Kutta steps."""
    rng = np.random.default_rng(11)
    Ts, count = 2e-4, 3000
    tones, phases = np.arange(15, 400, 7.5), rng.uniform(0, 2 * np.pi, 52)
    t = Ts * np.arange(count)
    size = 1 / np.maximum(tones / 60, 1)
    u = np.cos(2 * np.pi * np.outer(t, tones) + phases[: tones.size]) @ size
    u *= 7 / u.std()

    def rates(z: np.ndarray, volts: float) -> np.ndarray:
        i, x, v = z
        factor = 6.2 * (1 - drop * x**2)
        acceleration = (factor * i - 1900.0 * x - 1.3 * v) / 0.0135
        return np.array([(volts - 6.8 * i - factor * v) / 6e-4, v, acceleration])

    z, y, h = np.zeros(3), np.empty((count, 2)), Ts / fine
    for k in range(count):
        y[k] = z[:2]
        for _ in range(fine):
            a = rates(z, u[k])
            b = rates(z + h / 2 * a, u[k])
            c = rates(z + h / 2 * b, u[k])
            z = z + h / 6 * (a + 2 * b + 2 * c + rates(z + h * c, u[k]))
    y += rng.standard_normal((count, 2)) * [6e-3, 1e-5]
    columns = {"u": u, "current": y[:, 0], "laser": y[:, 1]}
    return casid.Record(columns, {"u": "V", "current": "A", "laser": "m"}, Ts=Ts)


@pytest.mark.slow
def test_a_change_with_a_state_is_the_first_cause_by_the_law_that_leaves_noise():
    """By another law it leaves misfit, which looks like a disturbance and is not."""
    said: list[str] = []
    found = casid.diagnose(
        shaker(), with_a_short_coil(2.2e4), starts=1, advise=False, progress=said.append
    )
    assert [(c.kind, c.where) for c in found.causes] == [("scheduled_parameter", "Bl~x")]
    curvature = found.causes[0].parameters[0]
    assert curvature.value == pytest.approx(-6.2 * 2.2e4, abs=4 * curvature.std_error)
    assert said.count("test every effect (round 1)") == 1  # and none beside a disturbance


def exchanger() -> casid.Problem:
    m = casid.Model("heat exchanger")
    hot, cold = m.state("hot", "degC", start=50.0), m.state("cold", "degC", start=30.0)
    flow = m.input("flow", "kg/s", hold="zoh", known=True)
    inlet = m.input("inlet", "degC", hold="zoh", known=True)
    cp, water = m.constant("cp", 4180.0, "J/(kg K)"), m.constant("water", 0.3, "kg/s")
    C_h = m.parameter("C_h", "kJ/K", start=40.0, lower=5.0, upper=500.0)
    C_c = m.parameter("C_c", "kJ/K", start=60.0, lower=5.0, upper=500.0)
    UA = m.parameter("UA", "W/K", start=1000.0, lower=50.0, upper=20000.0)
    entry = m.constant("entry", 287.15, "K")
    passed = UA * (hot - cold)
    m.balance(hot, "hot side", inertia=C_h, terms=[flow * cp * (inlet - hot), -passed])
    m.balance(cold, "cold side", inertia=C_c, terms=[water * cp * (entry - cold), passed])
    m.output("hot_out", hot, "degC")
    m.output("cold_out", cold, "degC")
    return casid.Problem("heat exchanger", m)


def with_a_film(power: float) -> casid.Record:
    """Heat passes as a power of the flow; exact between samples, where both inputs are held."""
    rng = np.random.default_rng(1)
    Ts, count = 2.0, 2000
    flow = np.repeat(rng.uniform(0.15, 0.45, count // 50), 50)
    inlet = np.repeat(rng.uniform(58.0, 78.0, count // 125), 125)
    z, y = np.array([55.0, 25.0]), np.empty((count, 2))
    for k in range(count):
        y[k] = z
        a, b, film = flow[k] * 4180.0, 0.3 * 4180.0, 1450.0 * (flow[k] / 0.3) ** power
        A = np.zeros((3, 3))
        A[0] = np.array([-a - film, film, a * inlet[k]]) / 5.2e4
        A[1] = np.array([film, -b - film, b * 14.0]) / 7.5e4
        z = (expm(A * Ts) @ [*z, 1.0])[:2]
    y += 0.08 * rng.standard_normal((count, 2))
    columns = {"flow": flow, "inlet": inlet, "hot_out": y[:, 0], "cold_out": y[:, 1]}
    units = {"flow": "kg/s", "inlet": "degC", "hot_out": "degC", "cold_out": "degC"}
    return casid.Record.from_signals(
        {n: (Ts * np.arange(count), v) for n, v in columns.items()}, units
    )


@pytest.mark.slow
def test_a_change_with_an_input_is_the_first_cause_by_the_power_that_leaves_noise():
    """The line that is tested leaves what looks like a disturbance: the bend of the power."""
    said: list[str] = []
    found = casid.diagnose(
        exchanger(), with_a_film(0.7), starts=1, advise=False, progress=said.append
    )
    assert [(c.kind, c.where) for c in found.causes] == [("scheduled_parameter", "UA~flow")]
    exponent = found.causes[0].parameters[0]
    assert exponent.value == pytest.approx(0.7, abs=4 * exponent.std_error)
    assert exponent.name == "exponent_UA_flow"
    assert said.count("test every effect (round 1)") == 1  # and none beside a disturbance
