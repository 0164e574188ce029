"""Records for Algorithm 8.1: the ship's own sway and yaw answer the rudder, and close the loop.

Two kinds. `linear_experiments` steps (8.3) by the trapezoidal rule, the bilinear image, so that the
difference equation of the roll subsystem holds exactly and the truth is exact. `ship_experiments`
measures the nonlinear ship of problems/ship_4dof.py, whose surge speed drops in turns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

import casid
from casid.arrays import Array
from problems.ship import LOAD_CASES, TABLE_8_2
from problems.ship_4dof import Coefficients, Load, Motion, Ship, linearised, simulate
from problems.ship_simulator.sensors import Channel, InertialUnit, for_roll, measure

TS = 0.02  # s
UNITS = {"gyro": "rad/s", "accel": "m/s^2", "r": "rad/s", "delta": "rad"}
THREE = ("nominal", "calibration", "loaded")
FOUR = ("nominal", "calibration", "second calibration", "loaded")
SIDEWAYS = Ship(coefficients=Coefficients(Y_vdot=-20.0, C2=12.0, z_r=0.405 / 12, x_r=-0.2))
"""A ship that its rudder moves sideways; the roll subsystem is that of Table 8.2.

The thesis gives no rudder force and no rudder position. With the added mass of its table, five
times the ship's, and C2 = 3.6 N/rad the rudder accelerates the ship by less than the
accelerometer's noise, a_s is a function of roll and yaw, and K_vdot is indistinguishable from K_r.
"""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What acts on the ship beside the rudder, and what the sensors add.

    Attributes
    ----------
    torque : rms of the roll torque [N m], of the first order with corner `corner` [rad/s].
    sway, yaw : rms of a force [N] and a torque [N m] of the same kind.
    gyro, accel, r : standard deviations of white noise [rad/s, m/s^2, rad/s].
    gyro_bias, accel_bias : [rad/s], [m/s^2].
    """

    torque: float = 0.02
    sway: float = 0.2
    yaw: float = 0.02
    corner: float = 6.0
    gyro: float = 0.002
    accel: float = 0.02
    r: float = 0.002
    gyro_bias: float = 0.0
    accel_bias: float = 0.0


NONE = Disturbance(0.0, 0.0, 0.0, 6.0, 0.0, 0.0, 0.0)


USUAL = Disturbance()


def load(case: str) -> Load:
    """The weight of a load case, that of Table 8.2 where it is to be found."""
    return load_of(LOAD_CASES[case] or {n: TABLE_8_2[n] for n in ("m", "zbar_m")})


def load_of(weight: Mapping[str, float]) -> Load:
    """The weight m [kg] at the height zbar_m [m], 0 where it has none."""
    return Load(weight["m"], weight.get("zbar_m", 0.0))


def telegraph(N: int, *, angle: float, hold: float, rng: np.random.Generator) -> Array:
    """(N,) rudder [rad]: +-angle, reversed at random, `hold` s on average."""
    flips = rng.random(N) < TS / hold
    return np.asarray(angle * (1.0 - 2.0 * (np.cumsum(flips) % 2)))


@lru_cache(maxsize=32)
def _modes(ship: Ship, weight: Load, U: float) -> tuple[Any, ...]:
    """The trapezoidal image of (8.3): poles, input and output maps of the modes, direct terms."""
    found = linearised(U, ship=ship, load=weight)
    keep = [0, 2, 3, 4]  # the heading acts on nothing
    A = found.A[np.ix_(keep, keep)]
    B = np.column_stack([found.B, np.linalg.solve(found.E, found.T)])[keep]
    one = np.eye(4)
    left = np.linalg.inv(one - TS / 2 * A)
    # accel = z_s p' + g phi - v' - U r
    rate = np.array([0.0, -1.0, TABLE_8_2["zbar_s"] + ship.z_f, 0.0])
    C = np.vstack([one[2], rate @ A + [ship.g, 0.0, 0.0, -U], one[3]])
    D = np.vstack([np.zeros(4), rate @ B, np.zeros(4)])
    poles, V = np.linalg.eig(left @ (one + TS / 2 * A))
    return poles, np.linalg.solve(V, TS / 2 * left @ B), C @ V, D


def respond(ship: Ship, weight: Load, inputs: Array, *, U: float = TABLE_8_2["U"]) -> Array:
    """(N, 3) p, a_s, r of the linear ship from rest.

    Parameters
    ----------
    inputs : (N, 4) rudder [rad], sway force [N], torques in roll and yaw [N m].
    """
    from scipy.signal import lfilter

    poles, B, C, D = _modes(ship, weight, U)
    drive = inputs @ B.T  # x_t - A x_(t-1) = B (u_t + u_(t-1))
    states = [lfilter([1.0, 1.0], [1.0, -pole], drive[:, i]) for i, pole in enumerate(poles)]
    return np.asarray(np.real(np.column_stack(states) @ C.T) + inputs @ D.T)


def coloured(rms: float, corner: float, N: int, rng: np.random.Generator) -> Array:
    """(N,) a first-order disturbance."""
    from scipy.signal import lfilter

    pole = np.exp(-corner * TS)
    e = rng.standard_normal(N + 500)
    return np.asarray(rms * np.sqrt(1 - pole**2) * lfilter([1.0], [1.0, -pole], e)[500:])


def _forces(d: Disturbance, N: int, rng: np.random.Generator) -> list[Array]:
    """In sway, roll and yaw, (N,) each [N, N m, N m]."""
    return [coloured(rms, d.corner, N, rng) for rms in (d.sway, d.torque, d.yaw)]


BEFORE = 1000  # samples that are simulated before a record begins


def linear_record(
    delta: Array, ship: Ship, weight: Load, d: Disturbance, rng: np.random.Generator, name: str
) -> casid.Record:
    """Channels gyro, accel, r, delta at 50 Hz of the linear ship, `BEFORE` samples left out."""
    y = respond(ship, weight, np.column_stack([delta, *_forces(d, len(delta), rng)]))[BEFORE:]
    y += np.array([d.gyro, d.accel, d.r]) * rng.standard_normal(y.shape)
    y += np.array([d.gyro_bias, d.accel_bias, 0.0])
    return roll_record(y, delta[BEFORE:], name)


def roll_record(y: Array, delta: Array, name: str) -> casid.Record:
    """A record of gyro, accel and r, the columns of y, and of the rudder."""
    return casid.Record(
        {"gyro": y[:, 0], "accel": y[:, 1], "r": y[:, 2], "delta": delta},
        UNITS,
        Ts=TS,
        name=name,
        provenance=("linear ship by the trapezoidal rule, analysis/ship_algorithm/records.py",),
    )


def ship_record(
    command: Array,
    ship: Ship,
    weight: Load,
    d: Disturbance,
    rng: np.random.Generator,
    *,
    name: str,
    first: int = BEFORE,
    substeps: int = 5,
) -> tuple[casid.Record, Motion]:
    """The same of the nonlinear ship, through its inertial unit, and how it moved.

    r has the sign of the model; `first` samples are left out of the record.
    """
    N = len(command)
    forces = np.column_stack([np.zeros(N), *_forces(d, N, rng)])
    motion = simulate(command, ship=ship, load=weight, forces=forces, Ts=TS, substeps=substeps)
    record = for_roll(measure(motion, unit(d), seed=int(rng.integers(2**31)), name=name))
    return record.between(first * TS, record.t[-1]), motion


def generator(seed: int, case: str) -> np.random.Generator:
    """Of rudder, disturbances and noise of a load case."""
    return np.random.default_rng(np.random.SeedSequence((seed, list(LOAD_CASES).index(case))))


def linear_experiments(
    seed: int,
    *,
    cases: tuple[str, ...] = THREE,
    duration: float = 600.0,
    angle: float = 0.2,
    hold: float = 0.7,
    disturbance: Disturbance = USUAL,
    ship: Ship = SIDEWAYS,
) -> list[casid.Experiment]:
    """A record of each load case.

    Parameters
    ----------
    seed : of rudder, disturbances and noise.
    duration : of each record [s].
    angle, hold : of the random telegraph of the rudder [rad], [s].
    """
    made = []
    for case in cases:
        rng = generator(seed, case)
        delta = telegraph(round(duration / TS) + BEFORE, angle=angle, hold=hold, rng=rng)
        record = linear_record(delta, ship, load(case), disturbance, rng, case)
        made.append(casid.Experiment(record, LOAD_CASES[case], case))
    return made


def ship_experiments(seed: int) -> list[casid.Experiment]:
    """The same three of the nonlinear ship."""
    made = []
    for case in THREE:
        rng = generator(seed, case)
        command = telegraph(round(600.0 / TS) + BEFORE, angle=0.2, hold=0.7, rng=rng)
        record, _ = ship_record(command, SIDEWAYS, load(case), USUAL, rng, name=case)
        made.append(casid.Experiment(record, LOAD_CASES[case], case))
    return made


def low_passed(experiments: list[casid.Experiment]) -> list[casid.Experiment]:
    """One and the same filter on all channels, 0.5 to 3 Hz, which keeps the regression."""
    return [
        casid.Experiment(casid.lowpass(e.record, 0.5, stop_hz=3.0), e.known, e.name)
        for e in experiments
    ]


def unit(d: Disturbance) -> InertialUnit:
    """The inertial unit with a disturbance's noise and biases."""
    return InertialUnit(
        zbar_s=TABLE_8_2["zbar_s"],
        gyro=Channel(noise=d.gyro, bias=d.gyro_bias),
        accel=Channel(noise=d.accel, bias=d.accel_bias),
        yaw_gyro=Channel(noise=d.r),
    )
