"""Rooms, tanks and circuits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.support.park.signals import coloured, daily, sines, steps, sunshine
from tests.support.park.simulator import Disturbance, Input, Output, Place, System


def _rooms(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    between = p["G"] * (x[0] - x[1])
    return (
        (u[0] - between - p["H1"] * (x[0] - u[1]) + f[0]) / p["C1"],
        (between - p["H2"] * (x[1] - u[1]) + f[1]) / p["C2"],
    )


ROOMS = System(
    "rooms",
    "thermal",
    Ts=600.0,
    N=2000,
    theta={"C1": 4e6, "C2": 9e6, "G": 120.0, "H1": 60.0, "H2": 90.0},
    start={"T1": (293.0, 1.0), "T2": (291.0, 1.0)},
    inputs=(
        Input("heater", "W", steps(0.0, 4000.0, (3600.0, 30000.0)), hold="zoh"),
        Input("outdoor", "K", daily(4.0, 276.0, 2.0, 20000.0), sd=0.1),
    ),
    outputs=(Output("room", "K", 0.05), Output("hall", "K", 0.05)),
    rate=_rooms,
    sensors=lambda x, dx, u, p: (x[0], x[1]),
    places=(
        Place("room_heat", {0: 1.0}, {0: 1.0}, operating=293.0, one_way=True),
        Place("hall_heat", {1: 1.0}, {1: 1.0}, operating=291.0, one_way=True),
        Place(
            "wall",
            {0: -1.0, 1: 1.0},
            {0: -1.0, 1: 1.0},
            also=("T1-T2", "T2-T1", "room_heat-hall_heat", "hall_heat-room_heat"),
        ),
    ),
    disturbances=(),
    beside=(Input("sun", "W/m^2", sunshine(600.0, 3000.0), sd=1.0),),
    more={"without": ("cubic_damping", "coulomb_friction")},
)


def _stirred(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    through = p["a"] * (x[0] - x[1])  # jacket to contents
    return (
        (p["P"] * u[0] - through - p["h"] * (x[0] - p["T_a"]) + f[0]) / p["C_j"],
        (through - p["q"] * (x[1] - p["T_in"] - u[1]) + f[1]) / p["C_t"],
    )


def _thermostat(k: int, y: Any, r: float, memory: dict[str, Any]) -> Any:
    error = r - y[1]
    total = memory.get("sum", 0.0)
    duty = np.clip(0.3 + 0.12 * error + 0.004 * total, 0.0, 1.0)
    memory["sum"] = total + np.where((duty > 0) & (duty < 1), error, 0.0)
    return duty


STIRRED = System(
    "stirred_tank",
    "process, closed loop",
    Ts=5.0,
    N=2400,
    theta={"a": 300.0, "C_j": 2.5e4, "C_t": 1.2e5, "q": 150.0},
    start={"T_j": (318.0, 1.0), "T_t": (308.0, 0.5)},
    inputs=(Input("duty", "1", steps(303.0, 318.0, (300.0, 1500.0)), hold="zoh"),),
    outputs=(Output("jacket", "K", 0.1), Output("tank", "K", 0.05)),
    rate=_stirred,
    sensors=lambda x, dx, u, p: (x[0], x[1]),
    places=(
        Place("jacket_heat", {0: 1.0}, {0: 1.0}, operating=318.0, one_way=True),
        Place("tank_heat", {1: 1.0}, {1: 1.0}, operating=308.0, one_way=True),
    ),
    disturbances=(Disturbance(0.5, 120.0),),
    law=_thermostat,
    beside=(Input("stirrer", "rad/s", coloured(2.0, 200.0, 20.0), sd=0.05),),
    more={
        "known": {"P": 9000.0, "h": 5.0, "T_a": 293.0, "T_in": 288.0},
        "without": ("cubic_damping", "coulomb_friction"),
    },
)


def _two_tanks(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    first = p["c1"] * np.sqrt(np.maximum(x[0], 1e-6))
    second = p["c2"] * np.sqrt(np.maximum(x[1], 1e-6))
    return ((u[0] - first + f[0]) / p["A1"], (first - second + f[1]) / p["A2"])


TWO_TANKS = System(
    "two_tanks",
    "fluid",
    Ts=2.0,
    N=2400,
    theta={"A1": 0.12, "A2": 0.10, "c1": 1.3e-3, "c2": 1.2e-3},
    start={"h1": (0.4, 0.03), "h2": (0.4, 0.03)},
    inputs=(Input("inflow", "m^3/s", steps(4e-4, 1.1e-3, (60.0, 400.0)), hold="zoh"),),
    outputs=(Output("upper", "m", 0.002), Output("lower", "m", 0.002)),
    rate=_two_tanks,
    sensors=lambda x, dx, u, p: (x[0], x[1]),
    places=(
        Place("upper_volume", {0: 1.0}, {0: 1.0}, operating=0.4, one_way=True),
        Place("lower_volume", {1: 1.0}, {1: 1.0}, operating=0.4, one_way=True),
    ),
    beside=(Input("water_temperature", "K", coloured(3.0, 500.0, 285.0), sd=0.05),),
    more={"without": ("cubic_damping", "coulomb_friction")},
)


def _circuit(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    v, i = x[0], x[1]
    diode = 1e-6 * (np.exp(np.clip(v / 0.12, -40.0, 40.0)) - 1.0)
    return ((i - v / p["R_p"] - diode + f[0]) / p["C"], (u[0] - p["R"] * i - v + f[1]) / p["L"])


CIRCUIT = System(
    "circuit",
    "electrical, fast",
    Ts=2e-5,
    N=3000,
    theta={"C": 2e-6, "R_p": 400.0, "R": 12.0, "L": 5e-3},
    start={"v": (0.0, 0.1), "i": (0.0, 0.005)},
    inputs=(Input("source", "V", sines(1.2, 100.0, 2500.0), sd=0.005),),
    outputs=(Output("capacitor", "V", 0.01), Output("current", "A", 3e-4)),
    rate=_circuit,
    sensors=lambda x, dx, u, p: (x[0], x[1]),
    places=(
        Place("charge", {0: 1.0}, {0: 1.0}),
        Place("coil", {1: 1.0}, {1: 1.0}),
    ),
    more={"substeps": 4, "without": ("coulomb_friction",)},
)

SYSTEMS = (ROOMS, STIRRED, TWO_TANKS, CIRCUIT)
