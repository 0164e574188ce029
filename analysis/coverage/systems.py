"""The systems of the study: models, and simulators of their own with what they are to give.

Linear systems move by matrix exponentials of SciPy, the pendulum by the Runge-Kutta of its problem;
neither shares code with the estimation. Inputs are straight lines between samples, and the same in
every draw: what is drawn is noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

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


class Matrices(NamedTuple):
    """x' = a x + b u + e f, y = c x, with a force f that nobody measures."""

    a: Array  # (nx, nx)
    b: Array  # (nx, nu)
    c: Array  # (ny, nx)
    e: Array  # (nx,)


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """A linear system with its inputs, in straight lines between samples, and where it begins.

    Attributes
    ----------
    matrices : of the parameters' values.
    u : (N, nu), u[0] = 0.
    """

    matrices: Callable[[Mapping[str, float]], Matrices]
    u: Array
    Ts: float
    x0: Array  # (nx,)

    def outputs(self, values: Mapping[str, float], x0: Array | None = None) -> Array:
        """(N, ny) without noise and force."""
        a, b, c, _ = self.matrices(values)
        nothing = np.zeros((len(c), self.u.shape[1]))
        ad, bd, cd, dd, _ = cont2discrete((a, b, c, nothing), self.Ts, method="foh")
        y = np.empty((len(self.u), len(c)))
        # The state of a first-order hold is another one where u[0] is not 0.
        x = np.array(self.x0 if x0 is None else x0, dtype=float)
        for k, now in enumerate(self.u):
            y[k] = cd @ x + dd @ now
            x = ad @ x + bd @ now
        return y


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """A force f of the first order that nobody measures, f' = -corner f + noise.

    Attributes
    ----------
    place : the balance that it acts in.
    size, corner : standard deviation of f, and rad/s.
    """

    place: str
    size: float
    corner: float

    def steps(self, of: Matrices, Ts: float) -> tuple[Array, Array]:
        """Transition and noise (nx + 1, nx + 1) of x and f in a sample (Van Loan 1978)."""
        n = len(of.a)
        whole, white = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n], whole[n, n] = of.a, of.e, -self.corner
        white[n, n] = 2 * self.corner * self.size**2
        both = expm(Ts * np.block([[-whole, white], [np.zeros((n + 1, n + 1)), whole.T]]))
        step = both[n + 1 :, n + 1 :].T
        return step, step @ both[: n + 1, n + 1 :]

    def response(self, of: Matrices, N: int, Ts: float, rng: np.random.Generator) -> Array:
        """(N, ny) what it does to the outputs, from rest; exact between samples."""
        step, noise = self.steps(of, Ts)
        values, vectors = np.linalg.eigh(noise)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        n = len(of.a)
        x, out = np.zeros(n + 1), np.empty((N, len(of.c)))
        x[n] = self.size * rng.standard_normal()
        for k in range(N):
            out[k] = of.c @ x[:n]
            x = step @ x + root @ rng.standard_normal(n + 1)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """A model, its true values, and the noise of its sensors.

    Attributes
    ----------
    noise : output -> standard deviation of its noise.
    levels : input -> standard deviations of its noise, small, medium and large; empty where nothing
        is put in.
    pole : of coloured noise on the outputs, a complex pair or one on the real axis.
    plant : what the simulator is made of; None where that is not linear.
    push : a force of the first order that acts on the states in between; None where the plant is
        not linear, or a measured input feels it.
    """

    name: str
    model: Callable[[], casid.Model]
    motion: Callable[[], Motion]
    truth: Mapping[str, float]
    noise: Mapping[str, float]
    levels: Mapping[str, tuple[float, float, float]]
    pole: complex
    plant: Plant | None = None
    push: Push | None = None


def slow_steps(N: int, hold: int, seed: int, ramp: int) -> Array:
    """(N,) random levels in -1..1, held for about `hold` samples, with ramps; from rest."""
    rng = np.random.default_rng(seed)
    changes = rng.random(N) < 1 / hold
    level = rng.uniform(-1, 1, N)
    held = level[np.maximum.accumulate(np.where(changes, np.arange(N), 0))]
    ramped = np.convolve(held, np.ones(ramp) / ramp, "full")[:N]
    ramped[:ramp] = 0.0
    return ramped


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


def roll_matrices(values: Mapping[str, float]) -> Matrices:
    """Of phi and p."""
    a = np.array([[0.0, 1.0], [-values["C"], -values["B"]]])
    return Matrices(a, np.zeros((2, 1)), np.eye(2)[:1], np.array([0.0, 1.0]))


ROLL_PLANT = Plant(roll_matrices, np.zeros((1200, 1)), 0.05, np.array([0.15, 0.0]))


@cache
def roll_motion() -> Motion:
    """A minute from 0.15 rad."""
    return Motion(ROLL_PLANT.Ts, {}, {"phi": ROLL_PLANT.outputs(ROLL)[:, 0]})


# -- motor ----------------------------------------------------------------------------------------

MOTOR = {"K": 0.8, "d": 0.02}
MOTOR_J = 0.004  # kg m^2


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


def motor_matrices(values: Mapping[str, float]) -> Matrices:
    """Of w."""
    a, b = np.array([[-values["d"] / MOTOR_J]]), np.array([[values["K"] / MOTOR_J]])
    return Matrices(a, b, np.eye(1), np.array([1 / MOTOR_J]))


MOTOR_PLANT = Plant(motor_matrices, slow_steps(4000, 80, 2, 10)[:, None], 0.01, np.zeros(1))


@cache
def motor_motion() -> Motion:
    """Forty seconds of steps of the current with ramps of 0.1 s."""
    w = MOTOR_PLANT.outputs(MOTOR)[:, 0]
    return Motion(MOTOR_PLANT.Ts, {"i": MOTOR_PLANT.u[:, 0]}, {"w": w})


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


def rig_matrices(values: Mapping[str, float]) -> Matrices:
    """Of x, v, X and V."""
    k, d, M = (values[name] for name in RIG)
    a = np.array(
        [
            [0, 1, 0, 0],
            [-(k + GROUND[0]) / RIG_M, -(d + GROUND[1]) / RIG_M, k / RIG_M, d / RIG_M],
            [0, 0, 0, 1],
            [k / M, d / M, -k / M, -d / M],
        ]
    )
    force = np.eye(4)[1] / RIG_M
    return Matrices(a, force[:, None], np.eye(4)[[0, 2]], force)


RIG_PLANT = Plant(rig_matrices, 10 * slow_steps(3000, 60, 3, 10)[:, None], 0.01, np.zeros(4))


@cache
def rig_motion() -> Motion:
    """Thirty seconds of steps of the force with ramps of 0.1 s."""
    y = RIG_PLANT.outputs(RIG)
    return Motion(RIG_PLANT.Ts, {"F": RIG_PLANT.u[:, 0]}, {"x": y[:, 0], "X": y[:, 1]})


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


def room_matrices(values: Mapping[str, float]) -> Matrices:
    """Of air and wall, for the temperature outside and the heater."""
    R, C = (values[name] for name in ROOM)
    R_w, C_w = WALL
    a = np.array([[-(1 / R + 1 / R_w) / C, 1 / R_w / C], [1 / R_w / C_w, -1 / R_w / C_w]])
    b = np.array([[1 / R / C, 1 / C], [0, 0]])
    return Matrices(a, b, np.eye(2)[:1], np.eye(2)[0] / C)


def room_inputs() -> Array:
    """(2016, 2) a fortnight by ten minutes: a week and days outside, the heater in steps."""
    t = 600.0 * np.arange(2016) / 86_400
    outside = 4 * np.sin(2 * np.pi * t) + 3 * np.sin(2 * np.pi * t / 7.3)
    return np.column_stack([outside, 1000 * slow_steps(len(t), 36, 4, 1)])


ROOM_PLANT = Plant(room_matrices, room_inputs(), 600.0, np.zeros(2))


@cache
def room_motion() -> Motion:
    """A fortnight by ten minutes."""
    T_o, P = ROOM_PLANT.u.T
    return Motion(ROOM_PLANT.Ts, {"T_o": T_o, "P": P}, {"T": ROOM_PLANT.outputs(ROOM)[:, 0]})


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
        ROLL_PLANT,
        Push("torque", 0.05, 1.0),
    ),
    System(
        "motor",
        motor_model,
        motor_motion,
        MOTOR,
        {"w": 0.2},
        {"i": (0.02, 0.06, 0.2)},
        0.9,
        MOTOR_PLANT,
        Push("torque", 0.03, 3.0),
    ),
    System(
        "two-mass rig",
        rig_model,
        rig_motion,
        RIG,
        {"x": 0.002, "X": 0.002},
        {"F": (0.3, 1.0, 3.0)},
        0.98 * np.exp(0.24j),
        RIG_PLANT,
        Push("first", 2.0, 3.0),
    ),
    System(
        "room",
        room_model,
        room_motion,
        ROOM,
        {"T": 0.05},
        {"T_o": (0.1, 0.3, 1.0)},
        0.9,
        ROOM_PLANT,
        Push("air", 100.0, 1e-4),
    ),
)
