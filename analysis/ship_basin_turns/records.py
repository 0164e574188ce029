"""Turns of the nonlinear ship: short sets, long sets, and ships with terms switched off.

Linder (2017), sections 9.3-9.4: short sets of about 20 s hold one U or S turn, long sets
many turns with straight courses between. The rudder is moved by hand: its angle is an external
reference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import casid
from analysis.ship_algorithm.records import (
    NONE,
    SIDEWAYS,
    THREE,
    TS,
    Disturbance,
    generator,
    load,
    ship_record,
)
from casid.arrays import Array
from casid.errors import ModelError
from problems.ship import LOAD_CASES
from problems.ship_4dof import Actuator, Motion, PolynomialArm, Ship

Mask = NDArray[np.bool_]

BEFORE = 10.0  # s of straight course before a long set is recorded
QUIET = Disturbance(torque=0.002, sway=0.02, yaw=0.002, corner=6.0, gyro=2e-4, accel=2e-3, r=2e-4)
"""A tenth of the disturbances and of the noise of `ship_algorithm.records`."""

GROUPS: Mapping[str, tuple[str, ...]] = {
    "cross flow in roll": ("K_vv", "K_vr", "K_rv"),
    "cross flow in sway and yaw": ("Y_vv", "Y_vr", "Y_rv", "N_rr", "N_rv"),
    "quadratic roll damping": ("K_pp", "N_pp"),
    "heel-dependent terms": ("K_phiuv", "K_phiur", "Y_phiuv", "Y_phiur", "N_phiuv", "N_phiur"),
}
"""Coefficients of the simulator that the linear model has not, by what they are."""


def switched_off(ship: Ship, *groups: str) -> Ship:
    """The ship without some of what its roll model leaves out.

    `groups` : of `GROUPS`, or "bend of the arm", "rate limit", "speed drop" (resistance and
    propeller 500 times as strong hold the speed), "rudder drag".
    """
    for group in groups:
        c = ship.coefficients
        if group in GROUPS:
            ship = replace(ship, coefficients=replace(c, **dict.fromkeys(GROUPS[group], 0.0)))
        elif group == "bend of the arm":
            ship = replace(ship, arm=PolynomialArm((ship.arm.slope,)))
        elif group == "rate limit":
            a = ship.rudder
            ship = replace(ship, rudder=Actuator(a.lowest, a.highest, 1e3))
        elif group == "speed drop":
            held = replace(c, X_uu=500 * c.X_uu, C3=500 * c.C3)
            ship = replace(ship, coefficients=held)
        elif group == "rudder drag":
            ship = replace(ship, coefficients=replace(c, C1=0.0))
        else:
            known = ", ".join((*NONLINEAR, "rate limit"))
            raise ModelError(f"ship: nothing called {group!r} to switch off; choose from {known}")
    return ship


NONLINEAR = (*GROUPS, "bend of the arm", "speed drop", "rudder drag")
"""Everything but the rudder's rate: with these off the ship is linear, but for sin(phi)."""

SHIPS: Mapping[str, Ship] = {
    "all terms": SIDEWAYS,
    "no rate limit": switched_off(SIDEWAYS, "rate limit"),
    "speed held": switched_off(SIDEWAYS, "speed drop"),
    "no quadratic roll damping": switched_off(SIDEWAYS, "quadratic roll damping"),
    "no cross flow in roll": switched_off(SIDEWAYS, "cross flow in roll"),
    "no heel-dependent terms": switched_off(SIDEWAYS, "heel-dependent terms", "bend of the arm"),
    "none of them": switched_off(SIDEWAYS, *NONLINEAR),
}
"""One kind of term off at a time."""


def u_turn(angle: float, *, entry: float = 4.0, exit: float = 12.0, end: float = 20.0) -> Array:
    """(N,) rudder [rad] of a short set: one turn to port."""
    t = TS * np.arange(round(end / TS))
    return np.asarray(np.where((t >= entry - 1e-9) & (t < exit - 1e-9), angle, 0.0))


def s_turn(angle: float) -> Array:
    """(N,) rudder [rad] of a short set: a turn to port and one to starboard."""
    port = u_turn(angle, entry=4.0, exit=8.0)
    return np.asarray(port - u_turn(angle, entry=8.0, exit=12.0))


def long_set(
    duration: float,
    *,
    angle: float,
    seed: int,
    hold: tuple[float, float] = (1.5, 4.0),
    before: float = BEFORE,
) -> Array:
    """(N,) rudder [rad]: turns to random sides, a straight course after each.

    Turns and straight courses last between the two times `hold` [s], uniformly distributed.
    """
    rng, N = np.random.default_rng(seed), round((duration + before) / TS)
    delta, k, turning = np.zeros(N), round(before / TS), True
    while k < N:
        n = round(rng.uniform(*hold) / TS)
        if turning:
            delta[k : k + n] = angle * rng.choice([-1.0, 1.0])
        k, turning = k + n, not turning
    return delta


@dataclass(frozen=True, slots=True, eq=False)
class Sailed:
    """A record, what moved, and the command to the rudder.

    Attributes
    ----------
    experiment : gyro, accel, r, delta at 50 Hz.
    motion : as long as the command; the record begins `first` samples later.
    command : (N,) rudder [rad].
    """

    experiment: casid.Experiment
    motion: Motion
    command: Array
    first: int

    def cut(self, values: Array) -> Array:
        """What belongs to the record's samples."""
        return values[self.first : self.first + len(self.experiment.record.t)]

    def __getitem__(self, name: str) -> Array:
        """A true state at the record's samples."""
        return self.cut(self.motion[name])


def sail(
    command: Array,
    case: str = "nominal",
    *,
    ship: Ship = SIDEWAYS,
    disturbance: Disturbance = NONE,
    seed: int = 1,
    first: int = 0,
    name: str | None = None,
) -> Sailed:
    """Sail one record; `first` samples are left out of it."""
    name, rng = name or case, generator(seed, case)
    record, motion = ship_record(
        command, ship, load(case), disturbance, rng, name=name, first=first, substeps=4
    )
    return Sailed(casid.Experiment(record, LOAD_CASES[case], name), motion, command, first)


def long_sets(
    *,
    duration: float,
    angle: float = 0.3,
    seed: int = 1,
    ship: Ship = SIDEWAYS,
    disturbance: Disturbance = NONE,
    cases: Sequence[str] = THREE,
) -> list[Sailed]:
    """One long set of each load case, with rudders of their own."""
    return [
        sail(
            long_set(duration, angle=angle, seed=1000 * seed + i),
            case,
            ship=ship,
            disturbance=disturbance,
            seed=seed,
            first=round(BEFORE / TS),
        )
        for i, case in enumerate(cases)
    ]


def changes(command: Array) -> NDArray[np.intp]:
    """Samples at which the command to the rudder changes: entries and exits of turns."""
    return np.flatnonzero(np.diff(command)) + 1


def near_changes(command: Array, seconds: float, *, before: float = 0.0) -> Mask:
    """(N,) True from `before` seconds before each change to `seconds` after it."""
    near = np.zeros(len(command), dtype=bool)
    for k in changes(command):
        near[max(k - round(before / TS), 0) : k + round(seconds / TS)] = True
    return near
