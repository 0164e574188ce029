"""One system for every template, simulated by SciPy and written as strangers write their files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

Array = np.ndarray


class System(NamedTuple):
    """A file, the options that its owner gives, and the truth in the units of the template."""

    template: str
    header: str
    columns: Callable[[], tuple[Array, ...]]
    known: Mapping[str, float]
    truth: Mapping[str, float]

    def write(self, path: Path) -> Path:
        """Write the file."""
        rows = np.column_stack(self.columns())
        np.savetxt(path, rows, fmt="%.7g", delimiter=",", header=self.header, comments="")
        return path


def steps(N: int, every: int, low: float, high: float, seed: int) -> Array:
    """(N,) levels that change every so many samples."""
    levels = np.random.default_rng(seed).uniform(low, high, -(-N // every))
    return np.repeat(levels, every)[:N]


def held(rates: Callable[..., list[float]], x0: list[float], Ts: float, *inputs: Array) -> Array:
    """(nx, N) states at the samples; the inputs are held between them."""
    x, path = np.array(x0, dtype=float), []
    for u in zip(*inputs, strict=True):
        path.append(x)
        found = solve_ivp(lambda t, x, u=u: rates(x, *u), (0, Ts), x, rtol=1e-9, atol=1e-9)
        x = found.y[:, -1]
    return np.array(path).T


def noise(N: int, size: float, seed: int) -> Array:
    """White noise."""
    return size * np.random.default_rng(seed).standard_normal(N)


def mass_spring_damper() -> tuple[Array, ...]:
    N, Ts = 800, 0.02
    F = steps(N, 40, -20, 20, 1)
    x, _ = held(lambda x, F: [x[1], (F - 4 * x[1] - 300 * (x[0] - 0.05)) / 2], [0.05, 0], Ts, F)
    return Ts * np.arange(N), F, 1e3 * (x + noise(N, 5e-4, 2))


def swing() -> tuple[Array, ...]:
    N, Ts = 600, 0.05
    x, _ = held(lambda x, _: [x[1], -0.2 * x[1] - 6 * (x[0] - 0.02)], [0.2, 0], Ts, np.zeros(N))
    return Ts * np.arange(N), np.rad2deg(x + noise(N, 1e-3, 3))


def dc_motor() -> tuple[Array, ...]:
    N, Ts = 800, 0.005
    U = steps(N, 40, -12, 12, 4)
    R, K, J, b, gear = 2.0, 0.04, 5e-5, 2e-5, 5.0
    w, th = held(lambda x, U: [(K * (U - K * x[0]) / R - b * x[0]) / J, x[0] / gear], [0, 0], Ts, U)
    i = (U - K * w) / R + noise(N, 0.02, 5)
    return 1e3 * Ts * np.arange(N), U, 1e3 * i, np.rad2deg(th + noise(N, 1e-3, 6))


def motor_speed() -> tuple[Array, ...]:
    t, U, _, _ = dc_motor()
    R, K, J, b = 2.0, 0.04, 5e-5, 2e-5
    (w,) = held(lambda x, U: [(K * (U - K * x[0]) / R - b * x[0]) / J], [0], 0.005, U)
    return t / 1e3, U, (w + noise(t.size, 1.0, 7)) * 30 / np.pi


def room() -> tuple[Array, ...]:
    N, Ts = 700, 300.0
    P = steps(N, 35, 0, 2, 8)  # kW
    outside = 5 * np.sin(2 * np.pi * np.arange(N) * Ts / 86400)
    (T,) = held(lambda x, P, T_a: [(1e3 * P - 80 * (x[0] - T_a)) / 4e6], [18.0], Ts, P, outside)
    return Ts * np.arange(N), T + noise(N, 0.05, 9), outside, P


def tank() -> tuple[Array, ...]:
    N, Ts = 600, 2.0
    q = steps(N, 60, 12, 60, 10)  # L/min
    (h,) = held(lambda x, q: [(q / 6e4 - 1.2e-3 * np.sqrt(x[0])) / 0.1], [0.3], Ts, q)
    return Ts * np.arange(N), q, 1e2 * (h + noise(N, 1e-3, 11))


def vehicle() -> tuple[Array, ...]:
    N, Ts = 600, 0.5
    F = steps(N, 60, 0, 4000, 12)
    (v,) = held(lambda x, F: [(F - 150 - 0.45 * x[0] ** 2) / 1400], [15.0], Ts, F)
    return Ts * np.arange(N), F, 3.6 * (v + noise(N, 0.05, 13))


def lag() -> tuple[Array, ...]:
    N, Ts = 500, 0.1
    u = steps(N, 25, 0, 5, 14)
    (y,) = held(lambda x, u: [(3.0 + 2.0 * u - x[0]) / 1.5], [3.0], Ts, u)
    return Ts * np.arange(N), u, y + noise(N, 0.02, 15)


SYSTEMS = {
    "mass-spring-damper": System(
        "mass-spring-damper",
        "time [s],Kraft [N],Weg [mm]",
        mass_spring_damper,
        {},
        {"M": 2.0, "k": 300.0, "d": 4.0, "x_0": 50.0},
    ),
    "swing without a torque": System(
        "mass-spring-damper",
        "t_s,roll_deg",
        swing,
        {"J": 3.0},
        {"k": 18.0, "d": 0.6, "x_0": np.rad2deg(0.02)},
    ),
    "motor": System(
        "dc-motor",
        "t [ms],U_Mot (V),I_Mot [mA],Winkel [deg]",
        dc_motor,
        {"N": 5.0},
        {"R": 2.0, "K": 0.04, "J": 5e-5, "b": 2e-5},
    ),
    "motor without a current": System(
        "dc-motor",
        "t,voltage (V),motor speed [rpm]",
        motor_speed,
        {"R": 2.0, "K": 0.04},
        {"J": 5e-5, "b": 2e-5},
    ),
    "thermal": System(
        "thermal",
        "time [s],T_room [degC],outside temp (degC),P_heat [kW]",
        room,
        {},
        {"C": 4e6, "H": 80.0},
    ),
    "tank": System(
        "tank",
        "time [s],Zufluss [L/min],Level [cm]",
        tank,
        {},
        {"A": 0.1, "c": 1.2e-3},
    ),
    "vehicle": System(
        "vehicle",
        "t,traction [N],speed [km/h]",
        vehicle,
        {},
        {"M": 1400.0, "F_r": 150.0, "c": 0.45},
    ),
    "free": System(
        "free",
        "t [s],valve cmd [V],pressure [bar]",
        lag,
        {},
        {"tau_pressure": 1.5, "g_pressure_valve_cmd": 2.0, "pressure_0": 3.0},
    ),
}
