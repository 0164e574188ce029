"""Records for Algorithm 8.1: the ship's own sway and yaw answer the rudder, and close the loop.

Two kinds. `linear_experiments` steps (8.3) by the trapezoidal rule, the bilinear image, so that the
difference equation of the roll subsystem holds exactly and the truth is exact. `ship_experiments`
measures the nonlinear ship of problems/ship_4dof.py, whose surge speed drops in turns.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

import casid
from casid.arrays import Array
from problems.ship import LOAD_CASES, TABLE_8_2
from problems.ship_4dof import Coefficients, Load, Ship, linearised, simulate
from problems.ship_simulator.sensors import Channel, InertialUnit, for_roll, measure

TS = 0.02  # s
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


def load(case: str) -> Load:
    """The weight of a load case, that of Table 8.2 where it is to be found."""
    known: Mapping[str, float] = LOAD_CASES[case]
    own = known or {n: TABLE_8_2[n] for n in ("m", "zbar_m")}
    return Load(own["m"], own.get("zbar_m", 0.0))


def telegraph(N: int, *, angle: float, hold: float, rng: np.random.Generator) -> Array:
    """(N,) rudder [rad]: +-angle, reversed at random, `hold` s on average."""
    flips = rng.random(N) < TS / hold
    return np.asarray(angle * (1.0 - 2.0 * (np.cumsum(flips) % 2)))


@lru_cache(maxsize=16)
def _modes(ship: Ship, weight: Load) -> tuple[Any, ...]:
    """The trapezoidal image of (8.3): poles, and input and output maps of the modes."""
    found = linearised(TABLE_8_2["U"], ship=ship, load=weight)
    keep = [0, 2, 3, 4]  # the heading acts on nothing
    A = found.A[np.ix_(keep, keep)]
    B = np.column_stack([found.B, np.linalg.solve(found.E, found.T)])[keep]
    one = np.eye(4)
    left = np.linalg.inv(one - TS / 2 * A)
    Ad, Bd = left @ (one + TS / 2 * A), TS / 2 * left @ B
    # accel = z_s p' + g phi - v' - U r
    z_s = TABLE_8_2["zbar_s"] + TABLE_8_2["z_f"]
    rate = np.array([0.0, -1.0, z_s, 0.0])
    C = np.vstack([[0, 0, 1, 0], rate @ A + [TABLE_8_2["g"], 0, 0, -TABLE_8_2["U"]], [0, 0, 0, 1]])
    D = np.vstack([np.zeros(4), rate @ B, np.zeros(4)])
    poles, V = np.linalg.eig(Ad)
    return poles, np.linalg.solve(V, Bd), C @ V, D


def respond(ship: Ship, weight: Load, inputs: Array) -> Array:
    """(N, 3) p, a_s, r of the linear ship from rest.

    Parameters
    ----------
    inputs : (N, 4) rudder [rad], sway force [N], torques in roll and yaw [N m].
    """
    from scipy.signal import lfilter

    poles, Bd, C, D = _modes(ship, weight)
    drive = inputs @ Bd.T
    states = np.column_stack(
        [lfilter([1.0, 1.0], [1.0, -pole], drive[:, i]) for i, pole in enumerate(poles)]
    )
    # x_t - Ad x_(t-1) = Bd (u_t + u_(t-1))
    return np.asarray(np.real(states @ C.T) + inputs @ D.T)


def coloured(rms: float, corner: float, N: int, rng: np.random.Generator) -> Array:
    """(N,) a first-order disturbance."""
    from scipy.signal import lfilter

    pole = np.exp(-corner * TS)
    e = rng.standard_normal(N + 500)
    return np.asarray(rms * np.sqrt(1 - pole**2) * lfilter([1.0], [1.0, -pole], e)[500:])


Drive = tuple[np.random.Generator, Array, Array]


def drives(
    seed: int, cases: Sequence[str], N: int, *, angle: float, hold: float, disturbance: Disturbance
) -> Iterator[tuple[str, Drive]]:
    """For each load case: its generator, rudder (N,) [rad], forces (N, 3) in sway, roll and yaw."""
    for case in cases:
        rng = np.random.default_rng(np.random.SeedSequence((seed, list(LOAD_CASES).index(case))))
        rudder = telegraph(N, angle=angle, hold=hold, rng=rng)
        rms = (disturbance.sway, disturbance.torque, disturbance.yaw)
        forces = [coloured(s, disturbance.corner, N, rng) for s in rms]
        yield case, (rng, rudder, np.column_stack(forces))


BEFORE = 1000  # samples that are simulated before a record begins


def linear_experiments(
    seed: int,
    *,
    cases: tuple[str, ...] = THREE,
    duration: float = 600.0,
    angle: float = 0.2,
    hold: float = 0.7,
    disturbance: Disturbance | None = None,
    ship: Ship = SIDEWAYS,
) -> list[casid.Experiment]:
    """A record of each load case: channels gyro, accel, r, delta at 50 Hz.

    Parameters
    ----------
    seed : of rudder, disturbances and noise.
    duration : of each record [s].
    angle, hold : of the random telegraph of the rudder [rad], [s].
    """
    d = disturbance or Disturbance()
    made, N = [], round(duration / TS)
    driven = drives(seed, cases, N + BEFORE, angle=angle, hold=hold, disturbance=d)
    for case, (rng, delta, forces) in driven:
        y = respond(ship, load(case), np.column_stack([delta, forces]))[BEFORE:]
        y += np.array([d.gyro, d.accel, d.r]) * rng.standard_normal((N, 3))
        y += np.array([d.gyro_bias, d.accel_bias, 0.0])
        record = casid.Record(
            {"gyro": y[:, 0], "accel": y[:, 1], "r": y[:, 2], "delta": delta[BEFORE:]},
            {"gyro": "rad/s", "accel": "m/s^2", "r": "rad/s", "delta": "rad"},
            Ts=TS,
            name=case,
            provenance=(f"linear ship by the trapezoidal rule, seed {seed}",),
        )
        made.append(casid.Experiment(record, LOAD_CASES[case], case))
    return made


def ship_experiments(
    seed: int,
    *,
    cases: tuple[str, ...] = THREE,
    duration: float = 600.0,
    angle: float = 0.2,
    hold: float = 0.7,
    disturbance: Disturbance | None = None,
    ship: Ship = SIDEWAYS,
) -> list[casid.Experiment]:
    """The same of the nonlinear ship, through its inertial unit; r with the sign of the model."""
    d = disturbance or Disturbance()
    made, N = [], round(duration / TS) + BEFORE
    driven = drives(seed, cases, N, angle=angle, hold=hold, disturbance=d)
    for case, (rng, command, own) in driven:
        forces = np.column_stack([np.zeros(N), own])
        motion = simulate(command, ship=ship, load=load(case), forces=forces, Ts=TS, substeps=5)
        record = for_roll(measure(motion, unit(d), seed=int(rng.integers(2**31)), name=case))
        made.append(
            casid.Experiment(record.between(BEFORE * TS, record.t[-1]), LOAD_CASES[case], case)
        )
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
