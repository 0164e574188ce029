"""A two-mass drive, a motor, cars, a levitated body, a crane, a hull."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.support.park.signals import coloured, sines, steps
from tests.support.park.simulator import Disturbance, Input, Output, Place, System


def _two_mass(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    w1, w2, e = x[0], x[1], x[2]
    shaft = p["k"] * e + p["c"] * (w1 - w2)
    return (
        (u[0] - p["d1"] * w1 - shaft + f[0]) / p["J1"],
        (shaft - p["d2"] * w2 + f[1]) / p["J2"],
        w1 - w2,
    )


TWO_MASS = System(
    "two_mass",
    "rotating",
    Ts=0.005,
    N=2400,
    theta={"J1": 0.012, "J2": 0.02, "k": 30.0, "c": 0.03, "d1": 0.02, "d2": 0.015},
    start={"w1": (0.0, 0.5), "w2": (0.0, 0.5), "e": (0.0, 0.005)},
    inputs=(Input("torque", "N m", steps(-0.8, 0.8, (0.05, 0.4)), hold="zoh"),),
    outputs=(Output("speed", "rad/s", 0.05), Output("twist", "rad", 2e-4)),
    rate=_two_mass,
    sensors=lambda x, dx, u, p: (x[0], x[2]),
    places=(
        Place("motor", {0: 1.0}, {0: 1.0}),
        Place("load", {1: 1.0}, {1: 1.0}),
        Place(
            "shaft",
            {0: -1.0, 1: 1.0},
            {0: -1.0, 1: 1.0},
            {2: -1.0},
            spring="k",
            also=("e", "w1-w2", "w2-w1", "motor-load", "load-motor", "twist"),
        ),
    ),
    beside=(Input("bearing_temperature", "K", coloured(5.0, 2.0, 310.0), sd=0.1),),
)


def _motor(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    current = (u[0] - p["K"] * x[0]) / p["R"]
    return ((p["K"] * current - p["b"] * x[0] + f[0]) / p["J"], x[0])


MOTOR = System(
    "motor",
    "electrical",
    Ts=0.005,
    N=2400,
    theta={"J": 2e-4, "R": 1.2, "K": 0.05, "b": 1e-4},
    start={"w": (0.0, 5.0), "angle": (0.0, 0.1)},
    inputs=(Input("voltage", "V", steps(-8.0, 8.0, (0.1, 0.6)), hold="zoh"),),
    outputs=(Output("current", "A", 0.03), Output("angle", "rad", 0.02)),
    rate=_motor,
    sensors=lambda x, dx, u, p: ((u[0] - p["K"] * x[0]) / p["R"], x[1]),
    places=(Place("torque", {0: 1.0}, {0: 1.0}),),
    beside=(Input("temperature", "K", coloured(8.0, 2.0, 300.0), sd=0.1),),
)


def _quarter_car(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    z, v = x[0], x[1]  # suspension travel against the wheel, body velocity
    road = u[1]  # velocity of the wheel, unmeasured
    travel = v - road
    return (travel, (u[0] - p["k"] * z - p["d"] * travel + f[0]) / p["m"])


QUARTER_CAR = System(
    "quarter_car",
    "vehicle",
    Ts=0.01,
    N=3000,
    theta={"k": 2.0e4, "d": 1500.0},
    start={"z": (0.0, 0.005), "v": (0.0, 0.05)},
    inputs=(Input("actuator", "N", sines(600.0, 0.2, 6.0), hold="zoh"),),
    outputs=(Output("travel", "m", 2e-4), Output("acceleration", "m/s^2", 0.05)),
    rate=_quarter_car,
    sensors=lambda x, dx, u, p: (x[0], dx[1]),
    places=(Place("body", {0: 1.0}, {1: 1.0}, {0: 1.0}, spring="k", also=("z", "force")),),
    disturbances=(Disturbance(0.01, 0.05),),
    beside=(Input("speed", "m/s", coloured(4.0, 3.0, 20.0), sd=0.05),),
    more={"known": {"m": 320.0}},
)


def _levitation(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    y, v = x[0], x[1]
    command = -p["K_p"] * (y - u[0]) - p["K_d"] * v
    return (v, (p["k_y"] * y + p["k_i"] * command - p["d"] * v + f[0]) / p["m"])


LEVITATION = System(
    "levitation",
    "unstable, closed loop",
    Ts=0.002,
    N=3000,
    theta={"k_y": 400.0, "k_i": 20.0, "d": 0.4},
    start={"y": (0.0, 2e-4), "v": (0.0, 0.01)},
    inputs=(Input("reference", "m", steps(-2e-3, 2e-3, (0.04, 0.3)), hold="zoh"),),
    outputs=(Output("gap", "m", 2e-5), Output("current", "A", 0.01)),
    rate=_levitation,
    sensors=lambda x, dx, u, p: (x[0], -p["K_p"] * (x[0] - u[0]) - p["K_d"] * x[1]),
    places=(Place("force", {0: 1.0}, {1: 1.0}, {0: 1.0}),),
    more={"known": {"m": 0.1, "K_p": 60.0, "K_d": 0.6}, "spread": 0.08},
)


def _vehicle(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    v = x[0]
    drag = p["f_r"] * p["m"] * 9.81 + p["c_w"] * v * abs(v)
    return ((u[0] - drag - p["m"] * 9.81 * u[1] + f[0]) / p["m"],)


VEHICLE = System(
    "vehicle",
    "vehicle",
    Ts=0.1,
    N=4000,
    theta={"m": 1500.0, "c_w": 0.6, "f_r": 0.012},
    start={"v": (18.0, 1.0)},
    inputs=(
        Input("drive", "N", steps(-600.0, 1500.0, (2.0, 12.0)), hold="zoh"),
        Input("slope", "1", coloured(0.015, 4.0), sd=0.001),
    ),
    outputs=(Output("speed", "m/s", 0.05),),
    rate=_vehicle,
    sensors=lambda x, dx, u, p: (x[0],),
    places=(Place("force", {0: 1.0}, {0: 1.0}, operating=18.0, one_way=True),),
    beside=(Input("wind", "m/s", coloured(3.0, 5.0), sd=0.2),),
    more={"without": ("quadratic_damping",)},
)


def _crane(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    phi, w = x[0], x[1]
    swing = p["g"] / p["L"] * np.sin(phi) + u[0] / p["L"] * np.cos(phi)
    return (w, -swing - p["d"] * w + u[1] + f[0])


CRANE = System(
    "crane",
    "multibody",
    Ts=0.05,
    N=3000,
    theta={"L": 1.4, "d": 0.08},
    start={"phi": (0.0, 0.05), "w": (0.0, 0.1)},
    inputs=(Input("trolley", "m/s^2", sines(0.6, 0.05, 1.0), sd=0.02),),
    outputs=(Output("angle", "rad", 0.003),),
    rate=_crane,
    sensors=lambda x, dx, u, p: (x[0],),
    places=(Place("swing", {0: 1.0}, {1: 1.0}, {0: 1.0}),),
    disturbances=(Disturbance(0.06, 0.5),),
    beside=(Input("wind", "m/s", coloured(2.0, 3.0), sd=0.1),),
    more={"known": {"g": 9.81}},
)


def _hull(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
    phi, w = x[0], x[1]
    moment = -p["B"] * w - p["C"] * phi + p["K_f"] * u[0] + u[1] + f[0]
    return (w, moment)


HULL = System(
    "hull",
    "marine",
    Ts=0.1,
    N=4000,
    theta={"B": 0.06, "C": 0.8, "K_f": 0.25},
    start={"phi": (0.0, 0.05), "w": (0.0, 0.05)},
    inputs=(Input("fin", "rad", steps(-0.35, 0.35, (1.0, 6.0)), hold="zoh"),),
    outputs=(Output("roll", "rad", 0.002), Output("rate", "rad/s", 0.002)),
    rate=_hull,
    sensors=lambda x, dx, u, p: (x[0], x[1]),
    places=(Place("moment", {0: 1.0}, {1: 1.0}, {0: 1.0}, spring="C"),),
    disturbances=(Disturbance(0.01, 3.0, 1.1),),  # waves
    beside=(Input("speed", "m/s", coloured(1.0, 20.0, 7.0), sd=0.05),),
)

SYSTEMS = (TWO_MASS, MOTOR, QUARTER_CAR, LEVITATION, VEHICLE, CRANE, HULL)
