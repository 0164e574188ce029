"""A load's mass and height: by which rudder, and after which calibration, are they known best?

The ship of `problems/ship_4dof.py` with the inertial unit and log of its example. `rudder` designs
the rudder angle of the record with the unknown load, within 10 degrees of roll, against zigzags.
`calibration` chooses the weight and height of a known load, and how the time is shared among the
records without load, with the known and with the unknown one (thesis, section 8.5): what an error
of the common parameters adds is in it, since they are estimated from all three.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import minimize

import casid
from analysis.common.case_file import Row
from casid.arrays import Array
from casid.estimation.simulation.integration.simulator import Simulator
from problems import ship_4dof
from problems.ship_simulator.manoeuvring import manoeuvring_model

Ts, DURATION, INTERVAL = 0.05, 20.0, 0.2
ROLL = 10.0  # degrees, at most
LARGEST, RATE = math.radians(35.0), 0.4  # of the rudder [rad], [rad/s]
PROPELLER, SPEED = 100.0, 1.0  # [rad/s], [m/s]
NOISE = {"gyro": 0.002, "accel": 0.02, "yaw_gyro": 0.002, "speed": ship_4dof.LOG_NOISE}
LOAD = {"m": 0.4, "zbar_m": -0.182}
NUISANCE = ("K_p", "C2")  # of the ship, estimated beside the load
ZIGZAGS = (10.0, 20.0)  # degrees of rudder, and of heading at which it is reversed
SEARCHED = tuple(product((10.0, 15.0, 20.0, 25.0, 35.0), (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)))

COMMON = ("k", "A_x", "K_p", "K_ur", "K_vdot", "C2", "z_f")
"""What the three records of a calibration have in common; (8.62) by the names of the ship."""
TOTAL = 180.0  # seconds of all three records
THESIS = {"m": 0.2, "zbar_m": -0.172}
WEIGHTS, HEIGHTS = (0.1, 0.2, 0.4, 0.8), (-0.3, -0.24, -0.172, -0.1, 0.0)


def ship(unknown: Sequence[str], load: Mapping[str, float]) -> casid.Problem:
    """The ship with a load, some of its parameters unknown, begun at their true values."""
    values = ship_4dof.true_values() | dict(load)
    sought = {name: (values[name], -math.inf, math.inf) for name in unknown}
    return casid.Problem("ship", manoeuvring_model(values, sought), noise=NOISE)


def information(problem: casid.Problem, rudder: Array, free: Sequence[str]) -> Array:
    """(n, n) information on parameters from one record, its initial state estimated beside."""
    model = problem.model
    simulator = Simulator(model, Ts, tuple(free), substeps=4)
    p = np.array([e.start if e.value is None else e.value for e in model.parameters.values()])
    u = np.column_stack([rudder, np.full(len(rudder), PROPELLER)])
    run = simulator.sensitivities(u, p, np.array([SPEED, *[0.0] * (len(model.states) - 1)]))
    assert run.dy is not None
    noise = np.array([NOISE[name] for name in model.outputs])
    columns = (run.dy / noise[None, :, None]).reshape(-1, run.dy.shape[2])
    wanted, start = columns[:, : len(free)], columns[:, len(free) :]
    left = wanted - start @ np.linalg.lstsq(start, wanted, rcond=None)[0]
    return np.asarray(left.T @ left)


def roll_of(rudder: Array) -> float:
    """Largest roll angle of the loaded ship [deg], by the simulator."""
    motion = ship_4dof.simulate(
        rudder, load=ship_4dof.Load(**LOAD), start=ship_4dof.Start(u=SPEED), w_p=PROPELLER, Ts=Ts
    )
    return float(np.degrees(np.max(np.abs(motion["phi"]))))


def followed(command: Array) -> Array:
    """(N,) rudder angle that follows a command at its largest rate, from rest."""
    out = np.zeros(len(command))
    for k in range(1, len(out)):
        out[k] = out[k - 1] + np.clip(command[k] - out[k - 1], -RATE * Ts, RATE * Ts)
    return out


def zigzag(angle: float) -> Array:
    """(N,) rudder angle of a zigzag: reversed where the heading has turned by the same angle."""
    command = np.full(round(DURATION / Ts), math.radians(angle))
    side, begun = 1.0, 0
    while True:
        motion = ship_4dof.simulate(
            command,
            load=ship_4dof.Load(**LOAD),
            start=ship_4dof.Start(u=SPEED),
            w_p=PROPELLER,
            Ts=Ts,
        )
        # A positive rudder turns to port, where the heading falls.
        turned = np.flatnonzero(-side * motion["psi"][begun:] >= math.radians(angle))
        if not len(turned):
            return followed(command)
        begun, side = begun + int(turned[0]) + 1, -side
        command[begun:] = side * math.radians(angle)


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """A rudder sequence with the standard errors of the load that it gives."""

    name: str
    mass: float
    height: float
    roll: float

    def row(self) -> Row:
        """Plain numbers."""
        return {
            "rudder": self.name,
            "std_error_m": self.mass,
            "std_error_zbar_m": self.height,
            "roll_deg": self.roll,
        }


def judged(name: str, rudder: Array) -> Manoeuvre:
    """What a rudder sequence says of the load."""
    free = (*LOAD, *NUISANCE)
    found = np.linalg.inv(information(ship(free, LOAD), rudder, free))
    mass, height = np.sqrt(np.diag(found))[:2].tolist()
    return Manoeuvre(name, mass, height, roll_of(rudder))


def rudder(*, seconds: float = 60.0, starts: int = 3) -> list[Manoeuvre]:
    """The designed rudder, the zigzags, and the best periodic one of `SEARCHED` by the mass."""
    found = casid.design_experiment(
        ship((*LOAD, *NUISANCE), LOAD),
        casid.Aim.estimate(*LOAD, optimality="A"),
        {"delta": (-LARGEST, LARGEST), "phi": (-ROLL, ROLL, "deg")},
        DURATION,
        Ts=Ts,
        interval=INTERVAL,
        slew={"delta": RATE},
        hold={"w_p": PROPELLER},
        x0={"u": SPEED},
        starts=starts,
        seconds=seconds,
    )
    designed = judged("designed", found.record["delta"])
    zigzags = [judged(f"zigzag {a:.0f}/{a:.0f}", zigzag(a)) for a in ZIGZAGS]
    periodic = [
        judged(
            f"{angle:g} deg, reversed every {every:g} s",
            followed(ship_4dof.zigzag(DURATION, angle=math.radians(angle), every=every, Ts=Ts)),
        )
        for angle, every in SEARCHED
    ]
    kept = [m for m in periodic if m.roll <= ROLL]
    return [designed, *zigzags, min(kept, key=lambda m: m.mass)]


@dataclass(frozen=True, slots=True)
class Plan:
    """A calibration load, seconds of the three records, and the errors of the unknown load."""

    m: float
    zbar_m: float
    seconds: tuple[float, float, float]  # without load, with the known, with the unknown one
    mass: float
    height: float

    def row(self) -> Row:
        """Plain numbers."""
        return {
            "calibration_m": self.m,
            "calibration_zbar_m": self.zbar_m,
            "seconds": [round(s, 1) for s in self.seconds],
            "std_error_m": self.mass,
            "std_error_zbar_m": self.height,
        }


def calibration() -> tuple[Plan, Plan]:
    """The thesis's load with equal times, and the best of the loads with the best times."""
    command = ship_4dof.random_steps(60.0, angle=math.radians(20.0), hold=1.5, seed=3, Ts=Ts)
    angle = followed(command)
    free = (*COMMON, *LOAD)

    def per_second(load: Mapping[str, float], unknown: Sequence[str]) -> Array:
        out = np.zeros((len(free), len(free)))
        n = len(unknown)
        out[:n, :n] = information(ship(unknown, load), angle, unknown) / 60.0
        return out

    nominal, loaded = per_second({"m": 0.0, "zbar_m": 0.0}, COMMON), per_second(LOAD, free)
    known = {
        (m, z): per_second({"m": m, "zbar_m": z}, COMMON)
        for m, z in {(THESIS["m"], THESIS["zbar_m"]), *product(WEIGHTS, HEIGHTS)}
    }

    def plan(place: tuple[float, float], seconds: Array) -> Plan:
        total = sum(s * f for s, f in zip(seconds, (nominal, known[place], loaded), strict=True))
        errors = np.sqrt(np.diag(_inverse(np.asarray(total))))[-2:]
        first, second, third = (float(s) for s in seconds)
        return Plan(*place, (first, second, third), float(errors[0]), float(errors[1]))

    def shared(place: tuple[float, float]) -> Plan:
        def seconds(v: Array) -> Array:
            share = np.exp([0.0, *v])
            return np.asarray(TOTAL * share / share.sum())

        def worth(v: Array) -> float:
            p = plan(place, seconds(v))
            return float(np.log((p.mass / LOAD["m"]) ** 2 + (p.height / LOAD["zbar_m"]) ** 2))

        return plan(place, seconds(minimize(worth, np.zeros(2), method="Nelder-Mead").x))

    thesis = plan((THESIS["m"], THESIS["zbar_m"]), np.full(3, TOTAL / 3))
    best = min(
        (shared(place) for place in known),
        key=lambda p: (p.mass / LOAD["m"]) ** 2 + (p.height / LOAD["zbar_m"]) ** 2,
    )
    return thesis, best


def _inverse(a: Array) -> Array:
    """Inverse of an information matrix, its columns scaled."""
    scale = 1 / np.sqrt(np.diag(a))
    return np.asarray(np.linalg.inv(a * np.outer(scale, scale)) * np.outer(scale, scale))
