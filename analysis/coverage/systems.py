"""The systems of the study: models, and simulators of their own with what they are to give.

Linear systems move by matrix exponentials of SciPy, the pendulum by the Runge-Kutta of its problem;
neither shares code with the estimation. Inputs are straight lines between samples, and the same in
every draw: what is drawn is noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import expm
from scipy.signal import cont2discrete

import casid
from casid.arrays import Array
from problems import pendulum


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What happened: inputs and outputs free of noise, (N,) by name."""

    Ts: float
    inputs: Mapping[str, Array]
    outputs: Mapping[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """A model, its true values, and the noise of its sensors.

    Attributes
    ----------
    noise : output -> standard deviation of its noise.
    levels : input -> standard deviations of its noise, small, medium and large; empty where nothing
        is put in.
    pole : of coloured noise on the outputs, a complex pair or one on the real axis.
    push : a force of the first order that acts on the states in between; None where its model is
        not linear, or a measured input feels it.
    """

    name: str
    model: Callable[[], casid.Model]
    motion: Callable[[], Motion]
    truth: Mapping[str, float]
    noise: Mapping[str, float]
    levels: Mapping[str, tuple[float, float, float]]
    pole: complex
    push: Push | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """A force of the first order beside the inputs, in x' = a x + e f, y = c x; f' = -corner f.

    Attributes
    ----------
    place : the balance that it acts in.
    size, corner : standard deviation of f, and rad/s.
    """

    place: str
    a: Array  # (nx, nx)
    e: Array  # (nx,)
    c: Array  # (ny, nx)
    size: float
    corner: float

    def response(self, N: int, Ts: float, rng: np.random.Generator) -> Array:
        """(N, ny) what it does to the outputs, from rest; exact between samples (Van Loan 1978)."""
        n = len(self.a)
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n], whole[n, n] = self.a, self.e, -self.corner
        white = np.zeros((n + 1, n + 1))
        white[n, n] = 2 * self.corner * self.size**2
        both = expm(Ts * np.block([[-whole, white], [np.zeros((n + 1, n + 1)), whole.T]]))
        step = both[n + 1 :, n + 1 :].T
        values, vectors = np.linalg.eigh(step @ both[: n + 1, n + 1 :])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        x, out = np.zeros(n + 1), np.empty((N, len(self.c)))
        x[n] = self.size * rng.standard_normal()
        for k in range(N):
            out[k] = self.c @ x[:n]
            x = step @ x + root @ rng.standard_normal(n + 1)
        return out


def slow_steps(N: int, hold: int, seed: int, ramp: int) -> Array:
    """(N,) random levels in -1..1, held for about `hold` samples, with ramps; from rest."""
    rng = np.random.default_rng(seed)
    changes = rng.random(N) < 1 / hold
    level = rng.uniform(-1, 1, N)
    held = level[np.maximum.accumulate(np.where(changes, np.arange(N), 0))]
    ramped = np.convolve(held, np.ones(ramp) / ramp, "full")[:N]
    ramped[:ramp] = 0.0
    return ramped


def linear_motion(a: Array, b: Array, c: Array, u: Array, Ts: float, x0: Array) -> Array:
    """(N, ny) of x' = a x + b u, y = c x, with u (N, nu) in straight lines from u[0] = 0."""
    ad, bd, cd, dd, _ = cont2discrete((a, b, c, np.zeros((len(c), b.shape[1]))), Ts, method="foh")
    y = np.empty((len(u), len(c)))
    x = np.array(x0, dtype=float)  # that of a first-order hold is another one where u[0] is not 0
    for k, now in enumerate(u):
        y[k] = cd @ x + dd @ now
        x = ad @ x + bd @ now
    return y


# -- pendulum on a cart, indirect -----------------------------------------------------------------


@cache
def pendulum_motion() -> Motion:
    """Two minutes on the cart; the input is what an accelerometer without noise shows."""
    Ts, values = 0.01, pendulum.TABLE_7_2
    ref = pendulum.telegraph(12_000, Ts, amplitude=0.3, rng=np.random.default_rng(1))
    known = {name: values[name] for name in ("k", "d", "I_x")}
    phi, p, a_y, p_dot = pendulum.motion(ref, Ts, 5, **known, m=0.0, d_2=0.0)
    accel = values["z_s"] * p_dot + 9.81 * np.sin(phi) - a_y * np.cos(phi)
    return Motion(Ts, {"accel": accel}, {"gyro": p})


# -- roll decay -----------------------------------------------------------------------------------

ROLL = {"B": 0.06, "C": 6.06}


def roll_model() -> casid.Model:
    """phi'' = -B phi' - C phi, nothing put in."""
    m = casid.Model("roll decay")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    B = m.parameter("B", "1/s", start=0.1, lower=0.0)
    C = m.parameter("C", "1/s^2", start=5.9, lower=0.0)
    m.derivative(phi, p)
    m.balance(p, "torque", inertia=1, terms=[-B * p, -C * phi], unit="rad/s^2")
    m.output("phi", phi, "rad")
    return m


ROLL_A = np.array([[0.0, 1.0], [-ROLL["C"], -ROLL["B"]]])


@cache
def roll_motion() -> Motion:
    """A minute from 0.15 rad."""
    y = linear_motion(
        ROLL_A, np.zeros((2, 1)), np.eye(2)[:1], np.zeros((1200, 1)), 0.05, np.array([0.15, 0.0])
    )
    return Motion(0.05, {}, {"phi": y[:, 0]})


# -- motor ----------------------------------------------------------------------------------------

MOTOR = {"K": 0.8, "d": 0.02}
MOTOR_J = 0.004  # kg m^2
MOTOR_A = np.array([[-MOTOR["d"] / MOTOR_J]])


def motor_model() -> casid.Model:
    """J w' = K i - d w, with the current measured."""
    m = casid.Model("motor")
    w, i = m.state("w", "rad/s"), m.input("i", "A")
    K = m.parameter("K", "N m/A", start=0.6, lower=0.0)
    d = m.parameter("d", "N m s/rad", start=0.03, lower=0.0)
    J = m.constant("J", MOTOR_J, "kg m^2")
    m.balance(w, "torque", inertia=J, terms=[K * i, -d * w], unit="N m")
    m.output("w", w, "rad/s")
    return m


@cache
def motor_motion() -> Motion:
    """Forty seconds of steps of the current with ramps of 0.1 s."""
    i = slow_steps(4000, 80, 2, 10)
    b = np.array([[MOTOR["K"] / MOTOR_J]])
    w = linear_motion(MOTOR_A, b, np.eye(1), i[:, None], 0.01, np.zeros(1))[:, 0]
    return Motion(0.01, {"i": i}, {"w": w})


# -- two masses -----------------------------------------------------------------------------------

RIG = {"k": 400.0, "d": 1.5, "M": 2.0}
RIG_M = 1.0  # kg, the mass that the force acts on
GROUND = (150.0, 2.0)  # stiffness [N/m] and damping [N s/m] to ground


def rig_model() -> casid.Model:
    """A mass on a spring to ground, a second one on a spring to the first; both measured."""
    m = casid.Model("two masses")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    X, V = m.state("X", "m"), m.state("V", "m/s")
    F = m.input("F", "N")
    k = m.parameter("k", "N/m", start=370.0, lower=0.0)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    M = m.parameter("M", "kg", start=1.9, lower=0.1)
    between = [k * (X - x), d * (V - v)]
    m.derivative(x, v)
    m.derivative(X, V)
    k_g, d_g = m.constant("k_g", GROUND[0], "N/m"), m.constant("d_g", GROUND[1], "N s/m")
    ground = [-k_g * x, -d_g * v]
    first = m.constant("m", RIG_M, "kg")
    m.balance(v, "first", inertia=first, terms=[F, *between, *ground], unit="N")
    m.balance(V, "second", inertia=M, terms=[-term for term in between], unit="N")
    m.output("x", x, "m")
    m.output("X", X, "m")
    return m


def rig_matrix() -> Array:
    """(4, 4) of x, v, X and V."""
    k, d, M = RIG.values()
    return np.array(
        [
            [0, 1, 0, 0],
            [-(k + GROUND[0]) / RIG_M, -(d + GROUND[1]) / RIG_M, k / RIG_M, d / RIG_M],
            [0, 0, 0, 1],
            [k / M, d / M, -k / M, -d / M],
        ]
    )


@cache
def rig_motion() -> Motion:
    """Thirty seconds of steps of the force with ramps of 0.1 s."""
    F = slow_steps(3000, 60, 3, 10)
    b = np.array([[0], [1 / RIG_M], [0], [0]])
    y = linear_motion(rig_matrix(), b, np.eye(4)[[0, 2]], 10 * F[:, None], 0.01, np.zeros(4))
    return Motion(0.01, {"F": 10 * F}, {"x": y[:, 0], "X": y[:, 1]})


# -- room -----------------------------------------------------------------------------------------

ROOM = {"R": 0.01, "C": 4.0e6}
WALL = (0.002, 1.0e7)  # resistance to the wall [K/W] and its capacity [J/K]


def room_model() -> casid.Model:
    """Air and wall; heated, and losing through R to the measured air outside; as differences."""
    m = casid.Model("room")
    T, W = m.state("T", "K"), m.state("W", "K")
    T_o, P = m.input("T_o", "K"), m.input("P", "W", known=True)
    R = m.parameter("R", "K/W", start=0.013, lower=1e-3)
    C = m.parameter("C", "J/K", start=3.0e6, lower=1e5)
    R_w, C_w = m.constant("R_w", WALL[0], "K/W"), m.constant("C_w", WALL[1], "J/K")
    m.balance(T, "air", inertia=C, terms=[(T_o - T) / R, (W - T) / R_w, P], unit="W")
    m.balance(W, "wall", inertia=C_w, terms=[(T - W) / R_w], unit="W")
    m.output("T", T, "K")
    return m


def room_matrix() -> Array:
    """(2, 2) of air and wall."""
    R, C = ROOM.values()
    R_w, C_w = WALL
    return np.array([[-(1 / R + 1 / R_w) / C, 1 / R_w / C], [1 / R_w / C_w, -1 / R_w / C_w]])


@cache
def room_motion() -> Motion:
    """A fortnight by ten minutes, a week and days outside, the heater in steps."""
    N, Ts = 2016, 600.0
    t = Ts * np.arange(N) / 86_400
    outside = 4 * np.sin(2 * np.pi * t) + 3 * np.sin(2 * np.pi * t / 7.3)
    P = 1000 * slow_steps(N, 36, 4, 1)
    R, C = ROOM.values()
    b = np.array([[1 / R / C, 1 / C], [0, 0]])
    u = np.column_stack([outside, P])
    y = linear_motion(room_matrix(), b, np.eye(2)[:1], u, Ts, np.zeros(2))
    return Motion(Ts, {"T_o": outside, "P": P}, {"T": y[:, 0]})


SYSTEMS = (
    System(
        "pendulum, indirect",
        pendulum.indirect_model,
        pendulum_motion,
        {name: pendulum.TABLE_7_2[name] for name in ("k", "d", "I_x")},
        {"gyro": 0.01},
        {"accel": (0.003, 0.01, 0.03)},
        0.985 * np.exp(0.13j),
    ),
    System(
        "roll decay",
        roll_model,
        roll_motion,
        ROLL,
        {"phi": 0.005},
        {},
        0.98 * np.exp(0.125j),
        Push("torque", ROLL_A, np.array([0.0, 1.0]), np.eye(2)[:1], 0.05, 1.0),
    ),
    System(
        "motor",
        motor_model,
        motor_motion,
        MOTOR,
        {"w": 0.2},
        {"i": (0.02, 0.06, 0.2)},
        0.9,
        Push("torque", MOTOR_A, np.array([1 / MOTOR_J]), np.eye(1), 0.03, 3.0),
    ),
    System(
        "two-mass rig",
        rig_model,
        rig_motion,
        RIG,
        {"x": 0.002, "X": 0.002},
        {"F": (0.3, 1.0, 3.0)},
        0.98 * np.exp(0.24j),
        Push("first", rig_matrix(), np.eye(4)[1] / RIG_M, np.eye(4)[[0, 2]], 2.0, 3.0),
    ),
    System(
        "room",
        room_model,
        room_motion,
        ROOM,
        {"T": 0.05},
        {"T_o": (0.1, 0.3, 1.0)},
        0.9,
        Push("air", room_matrix(), np.eye(2)[0] / ROOM["C"], np.eye(2)[:1], 100.0, 1e-4),
    ),
)
