"""Records of the basin, made again: four load cases of the lengths of Table 9.3 of Linder (2017).

The ship is that of Table 8.2, made to sway by her rudder (`ship_algorithm.records.SIDEWAYS`), for
chapter 9 states no hydrodynamics. The weights stand at the heights of Table 9.2. Records obey the
difference equation of the roll exactly (`basin`), or come from the nonlinear ship and her inertial
unit (`nonlinear_basin`). The thesis does not publish its rudder: here it is a random telegraph.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

import casid
from analysis.ship_algorithm.records import (
    BEFORE,
    SIDEWAYS,
    TS,
    Disturbance,
    linear_record,
    load_of,
    low_passed,
    ship_record,
    telegraph,
)
from casid.arrays import Array
from problems.ship_4dof import Load, Ship

LIGHT = {"m": 0.2, "zbar_m": -0.256}
HEAVY = {"m": 0.4, "zbar_m": -0.268}
"""Weights and heights of Table 9.2 [kg], [m]."""

NOMINAL = {"m": 0.0}

WEIGHTS: tuple[Mapping[str, float], ...] = (NOMINAL, LIGHT, LIGHT, HEAVY)
SECONDS = (63.2, 36.1, 51.1, 65.5)
"""Of the four records of Table 9.3 [s]."""

CASES: dict[int, tuple[int, int, int]] = {1: (0, 1, 2), 2: (0, 2, 3), 3: (0, 1, 3)}
"""Table 9.4: which records are nominal, calibration and loaded, counted from 0."""

ROLES = ("nominal", "calibration", "loaded")

BASIN = Disturbance(
    torque=0.01,
    sway=0.1,
    yaw=0.01,
    gyro=0.002,
    accel=0.02,
    r=0.002,
    gyro_bias=0.01,
    accel_bias=0.01,
)
"""Noise and bias of the sensors, and what acts on the hull beside the rudder: a roll torque of
0.01 N m, a sway force of 0.1 N and a yaw torque of 0.01 N m rms, of the first order, 6 rad/s."""


@dataclass(frozen=True, slots=True)
class Basin:
    """How the records of a draw are made.

    Attributes
    ----------
    weights, seconds : of each record [kg, m], [s].
    angle, hold : of the random telegraph of the rudder [rad], [s].
    disturbance : what acts beside it, and what the sensors add.
    """

    weights: tuple[Mapping[str, float], ...] = WEIGHTS
    seconds: tuple[float, ...] = SECONDS
    angle: float = 0.2
    hold: float = 0.7
    disturbance: Disturbance = field(default=BASIN)
    ship: Ship = SIDEWAYS


def truth_of(case: int, how: Basin | None = None) -> dict[str, float]:
    """m [kg] and zbar_m [m] of the loaded record of a case."""
    return dict((how or Basin()).weights[CASES[case][2]])


def basin(seed: int, how: Basin | None = None) -> list[casid.Record]:
    """Records 1 to 4 of Table 9.3 of the linear ship, before any filter, 50 Hz.

    Channels gyro [rad/s], accel [m/s^2], r [rad/s], delta [rad]; the ship has moved for 20 s.
    """
    how = how or Basin()
    return [
        linear_record(delta, how.ship, weight, how.disturbance, rng, name)
        for name, rng, weight, delta in _driven(seed, how)
    ]


def nonlinear_basin(seed: int, how: Basin | None = None) -> list[casid.Record]:
    """The same of the manoeuvring ship, whose speed drops in turns and whose rudder has a rate."""
    how = how or Basin()
    return [
        ship_record(command, how.ship, weight, how.disturbance, rng, name=name)[0]
        for name, rng, weight, command in _driven(seed, how)
    ]


def _driven(seed: int, how: Basin) -> Iterator[tuple[str, np.random.Generator, Load, Array]]:
    """Name, generator, weight and rudder of each record."""
    for i, (weight, seconds) in enumerate(zip(how.weights, how.seconds, strict=True)):
        rng = np.random.default_rng(np.random.SeedSequence((seed, i)))
        N = round(seconds / TS) + BEFORE
        yield (
            f"record {i + 1}",
            rng,
            load_of(weight),
            telegraph(N, angle=how.angle, hold=how.hold, rng=rng),
        )


def experiments_of(
    records: Sequence[casid.Record], case: int, how: Basin | None = None
) -> list[casid.Experiment]:
    """The nominal, the calibrated and the loaded ship of a case, low-passed as in section 9.4."""
    how = how or Basin()
    made = []
    for role, i in zip(ROLES, CASES[case], strict=True):
        known = {} if role == "loaded" else how.weights[i]
        made.append(casid.Experiment(records[i], known, role))
    return low_passed(made)


def halves(
    experiments: Sequence[casid.Experiment],
) -> tuple[list[casid.Experiment], list[casid.Experiment]]:
    """First and second halves of every record, as Table 9.7."""
    first, second = [], []
    for e in experiments:
        t = e.record.t
        middle = float(t[len(t) // 2])
        first.append(casid.Experiment(e.record.between(t[0], middle), e.known, e.name))
        second.append(casid.Experiment(e.record.between(middle, t[-1]), e.known, e.name))
    return first, second
