"""Short sets beside linear theory: the lean at entry and exit, the heel that stays, the roll rate.

What a change of the rudder does is the difference from the same ship whose rudder stays. At the
entry the theory is the linear motion about the straight course, at the exit about the state of the
turn. Both get the rudder's own angle, of limited rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.ship_algorithm.records import SIDEWAYS, TS, load
from analysis.ship_basin_turns.records import Sailed, changes, sail, u_turn
from analysis.ship_basin_turns.steady_turn import NAMES, SteadyTurn, about
from casid.arrays import Array
from problems.ship_4dof import Ship, linearised, simulate


@dataclass(frozen=True, slots=True, eq=False)
class Lean:
    """Heel after a change of the rudder, from what it would be without [rad].

    Attributes
    ----------
    t : (n,) time after the change [s].
    phi, linear : (n,) of the simulator and of linear theory.
    inwards : +1 where a positive heel is one towards the inside of the turn, else -1.
    """

    t: Array
    phi: Array
    linear: Array
    inwards: float

    def first(self, phi: Array) -> tuple[float, float]:
        """The first extreme: time [s] and heel towards the inside of the turn [rad]."""
        slope = np.diff(phi)
        moving = np.flatnonzero(np.abs(phi) > 1e-9)
        k = int(moving[0]) if moving.size else 0
        turns = np.flatnonzero(slope[k:] * slope[k] <= 0.0)
        at = k + (int(turns[0]) if turns.size else len(slope) - k)
        return float(self.t[at]), float(phi[at] * self.inwards)


def lean_at(sailed: Sailed, which: int, *, seconds: float = 2.0) -> Lean:
    """After the `which`-th change of the rudder: 0, the entry; 1, the exit of one turn."""
    from scipy.signal import lsim

    m, k = sailed.motion, int(changes(sailed.command)[which])
    n = round(seconds / TS)
    state = {name: float(m[name][k]) for name in NAMES}
    motion: SteadyTurn = about(state, float(m["delta"][k]), ship=m.ship, load=m.load)
    t = TS * np.arange(n)
    stays = sailed.command[: k + n].copy()
    stays[k:] = stays[k - 1]
    without = simulate(stays, ship=m.ship, load=m.load, Ts=TS, substeps=4)["phi"][k:]
    rudder = m["delta"][k : k + n] - m["delta"][k]
    system = (motion.A, motion.B[:, None], np.eye(5)[:1], np.zeros((1, 1)))
    _, y, _ = lsim(system, rudder, t)
    side = float(np.sign(m["r"][int(changes(sailed.command)[0]) + round(2.0 / TS)]))
    return Lean(
        np.asarray(t, dtype=np.float64), m["phi"][k : k + n] - without, np.asarray(y).ravel(), side
    )


def critical_height(ship: Ship, case: str = "nominal") -> float:
    """z_r*: a rudder further down heels the ship inwards first [m]: `ship_signals.inward_heel`."""
    E = linearised(ship=ship, load=load(case)).E[2:, 2:]
    over = np.linalg.inv(E)[1]  # roll acceleration from forces in sway, roll and yaw
    return float((over[0] + ship.coefficients.x_r * over[2]) / over[1])


@dataclass(frozen=True, slots=True)
class Heel:
    """A ship in a turn with one rudder: heel [rad], a_s [m/s^2], largest roll rate [rad/s]."""

    phi: float
    accel: float
    rate: float


def linear_turn(delta: float, case: str, *, ship: Ship = SIDEWAYS) -> Heel:
    """By the linear model about a straight course, (8.3), at 1 m/s."""
    from scipy.signal import lsim

    found = linearised(1.0, ship=ship, load=load(case))
    keep = [0, 2, 3, 4]
    A, B = found.A[np.ix_(keep, keep)], found.B[keep]
    phi, _, _, r = -np.linalg.solve(A, B) * delta
    t = TS * np.arange(round(8.0 / TS))
    rudder = np.minimum(ship.rudder.rate * t, abs(delta)) * np.sign(delta)
    _, p, _ = lsim((A, B[:, None], np.eye(4)[2:3], np.zeros((1, 1))), rudder, t)
    return Heel(float(phi), float(ship.g * phi - r), float(np.max(np.abs(p))))


def simulated_turn(
    delta: float, case: str, *, ship: Ship = SIDEWAYS, command: Array | None = None
) -> tuple[Sailed, Heel]:
    """A short set, a U-turn of 8 s by default: its last second, and its largest roll rate."""
    s = sail(u_turn(delta) if command is None else command, case, ship=ship)
    last = slice(round(11.0 / TS), round(12.0 / TS))
    turn = slice(round(4.0 / TS), round(12.0 / TS))
    m = s.motion
    heel = Heel(
        float(np.mean(m["phi"][last])),
        float(np.mean(s.experiment.record["accel"][last])),
        float(np.max(np.abs(m["p"][turn]))),
    )
    return s, heel
