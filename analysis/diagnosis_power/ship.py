"""Records of the roll of a ship with one hidden effect, integrated here, and their problem.

The roll subsystem of Linder (2017), (8.10) and (8.13)-(8.16), on a given course at the speed u(t),
with what may be hidden in it,

    A_1 p' = -(k + S g) phi - d p - d_2 |p| p + (K_vdot + S) (v' + u r) + K_r r + K_delta delta
    a_s = z_s p' + g phi - v' - u r,   K_r = K_r0 + s (u - U),   m = m_0 + (a jump),

by the Runge-Kutta method. A weight of unknown mass at a known height is aboard; A_x and K_vdot of
the hull are known: one record does not determine them beside the rest. The speed is recorded and
the model does not use it.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

import casid
from casid.arrays import Array
from problems import ship
from problems.ship import TABLE_8_2, waves

SOUGHT = ("k", "d", "K_r", "K_delta", "m")
"""Of Table 8.2: five parameters for the five coefficients that one record shows."""

PLACES = {
    "none": "torque",
    "quadratic_damping": "torque",
    "sensor_bias": "gyro",
    "time_delay": "gyro",
    "parameter_jump": "m",
    "scheduled_parameter": "K_r~speed",
}

PILOT = {
    "quadratic_damping": 0.003,  # N m s^2/rad^2
    "sensor_bias": 0.0003,  # rad/s
    "time_delay": 0.002,  # s
    "parameter_jump": 0.02,  # kg
    "scheduled_parameter": 0.03,  # N s^2/rad
}
"""Sizes that a search for an energy starts from."""

LARGEST = {"time_delay": 0.2, "parameter_jump": 1.0, "scheduled_parameter": 3.0}

R_NOISE = 2e-4  # rad/s, of the yaw gyro
SUBSTEPS = 2
BEFORE = 20.0  # s, until the start is forgotten


@dataclass(frozen=True, slots=True, eq=False)
class ShipRecord:
    """What was simulated: channels measured and without noise, and the truth."""

    columns: dict[str, Array]  # name -> (N,)
    quiet: dict[str, Array]
    where: str
    size: float
    t_jump: float
    start: dict[str, float]  # what is sought, as it is without the effect


UNITS = {
    "t": "s",
    "gyro": "rad/s",
    "accel": "m/s^2",
    "r": "rad/s",
    "delta": "rad",
    "speed": "m/s",
}


@functools.cache
def problem() -> casid.Problem:
    """The roll of a ship with an unknown weight aboard and a speed log beside it."""
    model = ship.indirect_model().with_known(
        z_f=TABLE_8_2["z_f"],
        A_x=TABLE_8_2["A_x"],
        K_vdot=TABLE_8_2["K_vdot"],
        zbar_m=TABLE_8_2["zbar_m"],
    )
    return dataclasses.replace(
        ship.problem,
        name="ship with a weight",
        model=model,
        recorded={"speed": "m/s"},
        load_cases={},
        example=None,
        simulate=None,
        truth={},
    )


def simulate(
    kind: str, size: float, seed: int, *, duration: float, Ts: float, noise: float
) -> ShipRecord:
    """One record; the seed draws hull, course and noise, the same for every kind.

    Parameters
    ----------
    size : d_2 [N m s^2/rad^2], bias [rad/s], delay [s], mass that comes aboard [kg] or
        s [N s^2/rad], whichever the kind is; the sign of bias and s is drawn
    noise : sd of gyro [rad/s] and accelerometer [m/s^2]
    """
    rng = np.random.default_rng(seed)
    v = dict(TABLE_8_2)
    for name in SOUGHT:
        v[name] *= rng.uniform(0.8, 1.2)
    signals = (
        waves(0.1, (0.3, 8.0), rng),
        waves(0.1, (0.1, 6.0), rng),
        waves(0.25, (0.1, 6.0), rng),
        waves(0.1, (0.02, 0.3), rng, n=12),
    )
    t_jump = duration * rng.uniform(0.12, 0.58)
    white = rng.standard_normal((3, round(duration / Ts)))
    sign = rng.choice([-1.0, 1.0])
    if kind not in ("sensor_bias", "scheduled_parameter"):
        sign = 1.0
    size = float(sign) * size

    h = Ts / SUBSTEPS
    steps = round((BEFORE + duration) / h)
    half = np.linspace(-BEFORE, steps * h - BEFORE, 2 * steps + 1, dtype=np.float64)
    vdot, r, delta, speed = (signal.at(half) for signal in signals)
    speed = v["U"] + speed

    def acting(name: str) -> float:
        return size if kind == name else 0.0

    m = v["m"] + acting("parameter_jump") * (half > t_jump)
    S = v["M"] * v["z_f"] + m * (v["zbar_m"] + v["z_f"])
    A_1 = v["A_x"] + v["M"] * v["z_f"] ** 2 + m * (v["zbar_m"] + v["z_f"]) ** 2
    K_r = v["K_r"] + acting("scheduled_parameter") * (speed - v["U"])
    push = (v["K_vdot"] + S) * (vdot + speed * r) + K_r * r + v["K_delta"] * delta
    phi, p, a = _integrated(
        (push / A_1).tolist(),
        ((v["k"] + S * v["g"]) / A_1).tolist(),
        (v["d"] / A_1).tolist(),
        (acting("quadratic_damping") / A_1).tolist(),
        h,
    )
    at = round(BEFORE / h) + SUBSTEPS * np.arange(white.shape[1])
    t = Ts * np.arange(white.shape[1], dtype=np.float64)
    gyro = p[at] + acting("sensor_bias")
    if kind == "time_delay":
        gyro = CubicSpline(half[::2], p)(t - size)
    z_s = v["zbar_s"] + v["z_f"]
    accel = z_s * a[at] + v["g"] * phi[at] - (vdot + speed * r)[::2][at]
    quiet: dict[str, Array] = {
        "t": t,
        "gyro": gyro,
        "accel": accel,
        "r": r[::2][at],
        "delta": delta[::2][at],
        "speed": speed[::2][at],
    }
    columns: dict[str, Array] = {
        **quiet,
        "gyro": gyro + noise * white[0],
        "accel": accel + noise * white[1],
        "r": quiet["r"] + R_NOISE * white[2],
    }
    start = {name: v[name] for name in SOUGHT}
    return ShipRecord(columns, quiet, PLACES[kind], size, t_jump, start)


def _integrated(
    push: list[float], k: list[float], d: list[float], d_2: list[float], h: float
) -> tuple[Array, Array, Array]:
    """phi, p and p' on the grid of the steps; coefficients are given at half steps."""

    def rate(i: int, x: float, p: float) -> float:
        return push[i] - k[i] * x - (d[i] + d_2[i] * abs(p)) * p

    x = p = 0.0
    path = []
    for i in range(0, len(push) - 1, 2):
        a1 = rate(i, x, p)
        path.append((x, p, a1))
        p2 = p + 0.5 * h * a1
        a2 = rate(i + 1, x + 0.5 * h * p, p2)
        p3 = p + 0.5 * h * a2
        a3 = rate(i + 1, x + 0.5 * h * p2, p3)
        p4 = p + h * a3
        a4 = rate(i + 2, x + h * p3, p4)
        x += h / 6.0 * (p + 2.0 * (p2 + p3) + p4)
        p += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
    path.append((x, p, rate(len(push) - 1, x, p)))
    phi, speed, change = np.array(path).T
    return phi, speed, change


def next_size(kind: str, size: float, energy: float, wanted: float) -> float:
    """A size nearer to the energy wanted: it grows with the square of a small effect."""
    step = math.sqrt(wanted / max(energy, 1e-12))
    return min(abs(size) * min(max(step, 0.05), 20.0), LARGEST.get(kind, math.inf))
