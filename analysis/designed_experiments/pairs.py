"""The pairs of causes, on six systems, with the limits under which they are to be separated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casid
from problems.pendulum import indirect_model


@dataclass(frozen=True, slots=True)
class Pair:
    """Two causes in one system, and what may be done to tell them apart.

    Attributes
    ----------
    sizes : cause -> value of its first parameter, SI; the other is taken as visible as that.
    limits : as `casid.design_experiment` takes them.
    duration : shortest and longest designed record [s].
    interval, Ts : of the input and of the record [s].
    """

    name: str
    system: str
    problem: Callable[[], casid.Problem]
    causes: tuple[str, str]
    sizes: Mapping[str, float]
    limits: Mapping[str, tuple[Any, ...]]
    duration: tuple[float, float]
    interval: float
    Ts: float
    is_closed_loop: bool = False


def pendulum() -> casid.Problem:
    """The pendulum on a cart whose acceleration nobody measures."""
    return casid.Problem("pendulum", indirect_model(), noise={"gyro": 0.02})


def roll() -> casid.Problem:
    """A ship model in roll, a moment acting on it."""
    m = casid.Model("roll")
    phi, p, M = m.state("phi", "deg"), m.state("p", "deg/s"), m.input("M", "N m")
    B = m.parameter("B", "N m s/rad", start=0.3, lower=0.0)
    C = m.parameter("C", "N m/rad", start=6.0, lower=0.1)
    A = m.parameter("A", "kg m^2", start=1.0, lower=0.1)
    m.derivative(phi, p)
    m.balance(p, "torque", inertia=A, terms=[M, -B * p, -C * phi])
    m.output("phi", phi, "deg")
    return casid.Problem("roll", m, noise={"phi": 0.5})


def motor() -> casid.Problem:
    """A motor with a gearbox of 20:1, its current and the angle of its output shaft measured."""
    m = casid.Model("motor")
    w, angle, U = m.state("w", "rad/s"), m.state("angle", "deg"), m.input("U", "V", hold="zoh")
    J = m.parameter("J", "kg m^2", start=2e-4, lower=1e-6)
    R = m.parameter("R", "ohm", start=1.2, lower=0.01)
    K = m.parameter("K", "V s/rad", start=0.05, lower=1e-3)
    b = m.parameter("b", "N m s/rad", start=1e-4, lower=0.0)
    gear = m.constant("gear", 20.0, "1")
    current = (U - K * w) / R
    m.derivative(angle, w / gear)
    m.balance(w, "torque", inertia=J, terms=[K * current, -b * w])
    m.output("current", current, "mA")
    m.output("angle", angle, "deg")
    return casid.Problem("motor", m, noise={"current": 60.0, "angle": 0.2})


def rig() -> casid.Problem:
    """Two inertias on a shaft, the first one driven."""
    m = casid.Model("two-mass rig")
    w1, w2, e = m.state("w1", "rad/s"), m.state("w2", "rad/s"), m.state("e", "rad")
    M = m.input("M", "N m")
    J1 = m.parameter("J1", "kg m^2", start=0.01, lower=1e-4)
    J2 = m.parameter("J2", "kg m^2", start=0.02, lower=1e-4)
    k = m.parameter("k", "N m/rad", start=30.0, lower=0.0)
    c = m.parameter("c", "N m s/rad", start=0.02, lower=0.0)
    d = m.parameter("d", "N m s/rad", start=0.02, lower=0.0)
    m.derivative(e, w1 - w2)
    m.balance(w1, "motor side", inertia=J1, terms=[M, -k * e, -c * (w1 - w2), -d * w1])
    m.balance(w2, "load side", inertia=J2, terms=[k * e, c * (w1 - w2)])
    m.output("n", w1, "rpm")
    m.output("twist", e, "deg")
    return casid.Problem("rig", m, noise={"n": 3.0, "twist": 0.1})


def tank() -> casid.Problem:
    """Two tanks, the lower one's level measured, outflows in proportion to the levels."""
    m = casid.Model("tanks")
    x1, x2 = m.state("x1", "m", start=0.5, lower=0.0), m.state("x2", "m", start=0.5, lower=0.0)
    q = m.input("q", "l/s", hold="zoh")
    A, c = m.constant("A", 0.1, "m^2"), m.parameter("c", "m^2/s", start=1e-3, lower=1e-5)
    gain = m.parameter("gain", "1", start=1.0, lower=0.1)
    m.balance(x1, "upper", inertia=A, terms=[gain * q, -c * x1])
    m.balance(x2, "lower", inertia=A, terms=[c * x1, -c * x2])
    m.output("level", x2, "m")
    return casid.Problem("tanks", m, noise={"level": 0.01})


def cart() -> casid.Problem:
    """A cart under a position controller: its reference is what can be chosen."""
    m = casid.Model("positioned cart")
    x, v, ref = m.state("x", "mm"), m.state("v", "mm/s"), m.input("ref", "mm")
    M = m.parameter("M", "kg", start=2.0, lower=0.1)
    d = m.parameter("d", "N s/m", start=5.0, lower=0.0)
    k_p, k_d = m.constant("k_p", 400.0, "N/m"), m.constant("k_d", 30.0, "N s/m")
    F = k_p * (ref - x) - k_d * v
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[F, -d * v])
    m.output("x", x, "mm")
    return casid.Problem("cart", m, noise={"x": 0.5})


PENDULUM = {"a_y": (-1, 1), "phi": (-10, 10, "deg")}
ROLL = {"M": (-1, 1), "phi": (-15, 15)}
CART = {"ref": (-100, 100), "x": (-100, 100)}


def _pair(
    name: str,
    problem: Callable[[], casid.Problem],
    causes: tuple[str, str],
    size: float,
    limits: Mapping[str, tuple[Any, ...]],
    duration: tuple[float, float],
    sampling: tuple[float, float],
) -> Pair:
    """A pair, the first parameter of the first cause of this size, its interval and sample time."""
    interval, Ts = sampling
    system = SYSTEMS[problem]
    closed = problem is cart
    sizes = {causes[0]: size}
    return Pair(name, system, problem, causes, sizes, limits, duration, interval, Ts, closed)


SYSTEMS = {
    pendulum: "pendulum",
    roll: "roll",
    motor: "motor",
    rig: "two-mass rig",
    tank: "tanks",
    cart: "positioned cart",
}

FRICTION = ("quadratic_damping", "coulomb_friction")
DRY = ("coulomb_friction", "quadratic_damping")
DRAG = ("quadratic_damping", "cubic_damping")
COUPLING = ("cubic_stiffness@w1-w2", "quadratic_damping@w1-w2")
OUTLET = ("quadratic_damping@upper", "cubic_damping@upper")
RIG = {"M": (-3, 3), "twist": (-3, 3)}
MOTOR = {"U": (-12, 12), "current": (-5000, 5000)}
TANK = {"q": (0, 1), "x1": (0.1, 1), "x2": (0.1, 1)}

# Faint causes: the records that decide are long against the time constants, see `study`.
PAIRS = (
    _pair("pendulum drag", pendulum, DRAG, 0.085, PENDULUM, (2.0, 20.0), (0.2, 0.05)),
    _pair("pendulum friction", pendulum, FRICTION, 0.06, PENDULUM, (2.0, 20.0), (0.2, 0.05)),
    _pair("roll drag", roll, DRAG, 0.25, ROLL, (10.0, 60.0), (0.5, 0.1)),
    _pair("roll friction", roll, FRICTION, 0.06, ROLL, (6.0, 60.0), (0.4, 0.1)),
    _pair("motor friction", motor, DRY, 1.5e-4, MOTOR, (0.5, 5.0), (0.04, 0.01)),
    _pair("motor drag", motor, DRAG, 1e-7, MOTOR, (0.5, 5.0), (0.05, 0.01)),
    _pair("rig coupling", rig, COUPLING, 80.0, RIG, (0.5, 4.0), (0.03, 0.01)),
    _pair("tank outlet", tank, OUTLET, 1.5e-4, TANK, (1000.0, 6000.0), (100.0, 10.0)),
    _pair("cart friction", cart, DRY, 0.1, CART, (0.5, 5.0), (0.08, 0.02)),
    _pair("cart drag", cart, DRAG, 2.0, CART, (1.0, 8.0), (0.1, 0.02)),
)
