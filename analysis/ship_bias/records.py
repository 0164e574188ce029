"""Records of a linear ship with one imperfection at a time.

Sway, roll and yaw of (8.3) are stepped by the trapezoidal rule, the bilinear image, so the
difference equation (8.57) of the roll holds exactly: a perfect record returns the truth, and what
is found otherwise is the imperfection's. The ship is linear, so its answers to the rudder and to
forces add.

The ship is that of Table 8.2 with an added mass in sway of its own weight. With Table 8.2's 100 kg
the sway acceleration is so small beside g phi and U r that the five regressors of (8.57) are nearly
dependent (`ship_bias` prints how nearly), and a rudder alone does not determine the mass,
however good the sensors are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

import casid
from analysis.ship_algorithm.records import (
    BEFORE,
    THREE,
    TS,
    coloured,
    generator,
    load,
    respond,
    roll_record,
)
from casid.arrays import Array
from problems.ship import LOAD_CASES
from problems.ship_4dof import Coefficients, Ship

SECONDS = 300.0  # of each record

SHIP = Ship(coefficients=replace(Coefficients(), Y_vdot=-22.0))
"""Table 8.2, but for the added mass in sway."""


@dataclass(frozen=True, slots=True)
class Imperfection:
    """What a record has that its model has not; zeros: nothing.

    Attributes
    ----------
    gyro_bias, accel_bias, r_bias : of the channels [rad/s, m/s^2, rad/s].
    heel : constant torque in roll [N m].
    torque, sway, yaw : rms of a torque in roll [N m], a force [N] and a torque in yaw [N m], of the
        first order with a corner of 6 rad/s.
    gyro, accel, r : standard deviation of white noise [rad/s, m/s^2, rad/s].
    """

    gyro_bias: float = 0.0
    accel_bias: float = 0.0
    r_bias: float = 0.0
    heel: float = 0.0
    torque: float = 0.0
    sway: float = 0.0
    yaw: float = 0.0
    gyro: float = 0.0
    accel: float = 0.0
    r: float = 0.0


IMPERFECTIONS: Mapping[str, Imperfection] = {
    "none": Imperfection(),
    "gyro bias 0.01 rad/s": Imperfection(gyro_bias=0.01),
    "accelerometer bias 0.1 m/s^2": Imperfection(accel_bias=0.1),
    "constant heel of 2 deg": Imperfection(heel=0.15),
    "roll torque 0.01 N m rms": Imperfection(torque=0.01),
    "sway force 1 N rms": Imperfection(sway=1.0),
    "gyro noise 0.002 rad/s": Imperfection(gyro=0.002),
    "accelerometer noise 0.02 m/s^2": Imperfection(accel=0.02),
    "yaw-rate noise 0.002 rad/s": Imperfection(r=0.002),
    "all of these": Imperfection(0.01, 0.1, 0.0, 0.15, 0.01, 1.0, 0.0, 0.002, 0.02, 0.002),
}
"""One at a time, and all together."""


@dataclass(frozen=True, slots=True)
class Rudder:
    """A random telegraph: mean +- angle [rad], each held for `hold` s on average."""

    angle: float = 0.35
    mean: float = 0.0
    hold: float = 1.0

    def draw(self, N: int, rng: np.random.Generator) -> Array:
        """(N,) rudder angle [rad], of that very mean."""
        sign = 1.0 - 2.0 * (np.cumsum(rng.random(N) < TS / self.hold) % 2)
        return np.asarray(self.mean + self.angle * (sign - sign.mean()))


@dataclass(frozen=True, slots=True, eq=False)
class Answers:
    """One ship's answers to everything, (N, 3) each: p, a_s, r; imperfections add them up."""

    case: str
    delta: Array
    rudder: Array
    heel: Array  # to 1 N m
    sway: Array  # to forces of rms 1
    torque: Array
    yaw: Array
    noise: Array  # white, of variance 1

    def experiment(self, wrong: Imperfection) -> casid.Experiment:
        """The record with an imperfection."""
        y = (
            self.rudder
            + wrong.heel * self.heel
            + wrong.sway * self.sway
            + wrong.torque * self.torque
            + wrong.yaw * self.yaw
            + np.array([wrong.gyro, wrong.accel, wrong.r]) * self.noise
            + np.array([wrong.gyro_bias, wrong.accel_bias, wrong.r_bias])
        )
        record = roll_record(y, self.delta, self.case)
        return casid.Experiment(record, LOAD_CASES[self.case], self.case)


def answers(
    seed: int,
    rudder: Rudder | None = None,
    *,
    cases: tuple[str, ...] = THREE,
    seconds: float = SECONDS,
    ship: Ship = SHIP,
    U: float = 1.0,
) -> list[Answers]:
    """The ship in each load case, 20 s after it began to move.

    Parameters
    ----------
    seed : of rudder, forces and noise.
    seconds : of each record.
    """
    rudder, made = rudder or Rudder(), []
    for case in cases:
        rng = generator(seed, case)
        N = round(seconds / TS) + BEFORE
        delta, weight = rudder.draw(N, rng), load(case)
        forces = np.column_stack([coloured(1.0, 6.0, N, rng) for _ in range(3)])
        inputs = np.column_stack([delta, np.ones(N), forces])
        parts = {}
        for i, (what, enters) in enumerate(_ENTERS.items()):
            own = np.zeros((N, 4))
            own[:, enters] = inputs[:, i]
            parts[what] = respond(ship, weight, own, U=U)[BEFORE:]
        noise = rng.standard_normal((N - BEFORE, 3))
        made.append(Answers(case, delta[BEFORE:], noise=noise, **parts))
    return made


_ENTERS = {"rudder": 0, "heel": 2, "sway": 1, "torque": 2, "yaw": 3}  # columns of `respond`


def regressors(record: casid.Record) -> tuple[Array, Array]:
    """Phi (N - 2, 5) and Y (N - 2,) of (8.57)-(8.59)."""
    y = record["gyro"]
    mu = [record[n][2:] - record[n][:-2] for n in ("accel", "r", "delta")]
    return np.column_stack([-y[1:-1], -y[:-2], *mu]), np.asarray(y[2:])


def weakest(record: casid.Record) -> float:
    """Smallest singular value of Phi with columns of length 1: 0 where they are dependent."""
    Phi, _ = regressors(record)
    return float(np.linalg.svd(Phi / np.linalg.norm(Phi, axis=0), compute_uv=False)[-1])
