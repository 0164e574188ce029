"""Roll damping inside a turn and after it, from the decay of rolls that were kicked.

One record: a long turn, then a straight course, and a torque of 0.1 s every 4 s that heels the ship
to one side and the other. Windows of 3 s behind the kicks are sorted by rudder and yaw rate; in
each the ship is left alone with a rudder that rests, and rolls about a mean heel that relaxes,

    phi'' = -alpha_1 phi' - alpha_2 (phi - h),   h' = -lambda h,   gyro = phi'.                (1)

All windows of a kind share alpha_1 and alpha_2, and have initial states of their own. The roll dies
out at alpha_1/2, to be compared with the pole of the simulator about the same state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

import casid
from analysis.ship_algorithm.records import TS, load
from analysis.ship_basin_turns.steady_turn import NAMES, about, steady_turn
from casid.arrays import Array
from problems.ship_4dof import Motion, Ship, Start, simulate

Where = Literal["in the turn", "after it"]

TORQUE, KICK, EVERY, WINDOW = 0.3, 0.1, 4.0, 3.0  # N m, s, s, s
RELAXES = 2.0
"""lambda [1/s], chosen: sway and yaw of these ships have real parts from 1.5 to 7. The gyro hardly
sees h, and leaves it open."""

SETTLED = 0.1
"""Yaw rate, as a share of its largest, under which the ship is on a straight course."""


def decay_model() -> casid.Model:
    """(1)."""
    m = casid.Model("roll about a heel that relaxes")
    q, p, h = m.state("q", "rad"), m.state("p", "rad/s"), m.state("h", "rad")
    alpha_1 = m.parameter("alpha_1", "1/s", start=1.0, lower=0.0, upper=10.0)
    alpha_2 = m.parameter("alpha_2", "1/s^2", start=25.0, lower=1.0, upper=200.0)
    relaxes = m.constant("lambda", RELAXES, "1/s")
    m.derivative(q, p)
    m.derivative(p, -alpha_1 * p - alpha_2 * (q - h))
    m.derivative(h, -relaxes * h)
    m.output("gyro", p, "rad/s")
    return m


@dataclass(frozen=True, slots=True, eq=False)
class Kicked:
    """A turn and the course after it, with kicks.

    Attributes
    ----------
    motion : simulated.
    windows : first samples of the windows, by where they are.
    """

    motion: Motion
    windows: Mapping[Where, tuple[int, ...]]

    def window(self, name: str, k: int) -> Array:
        """(n,) a state within a window."""
        return self.motion[name][k : k + round(WINDOW / TS)]

    def decay(self, where: Where) -> float:
        """Mean of the simulator's own decay about the mean states of the windows [1/s]."""
        m = self.motion
        found = []
        for k in self.windows[where]:
            state = {n: float(np.mean(self.window(n, k))) for n in NAMES} | {"p": 0.0}
            turn = about(state, float(np.mean(self.window("delta", k))), ship=m.ship, load=m.load)
            found.append(turn.decay)
        return float(np.mean(found))

    def amplitude(self, where: Where) -> float:
        """P [rad/s] of the roll rate with which K_p|p| p acts as 8/(3 pi) K_p|p| P p.

        The mean of |p| weighted with the work p^2 of the damping, in those terms.
        """
        p = np.concatenate([self.window("p", k) for k in self.windows[where]])
        weighted = np.sum(np.abs(p) ** 3) / np.sum(p**2)
        return float(weighted * 3 * math.pi / 8)

    def quadratic(self, where: Where) -> float:
        """What K_p|p| adds to the decay at that amplitude [1/s]; the tangent does not see it.

        The decay per torque is that of the linear coefficient, by a small change of K_p.
        """
        m, step = self.motion, 1e-4
        c = m.ship.coefficients
        stiffer = replace(m.ship, coefficients=replace(c, K_p=c.K_p - step))
        per = (
            replace(self, motion=replace(m, ship=stiffer)).decay(where) - self.decay(where)
        ) / step
        return -c.K_pp * 8 / (3 * math.pi) * self.amplitude(where) * per


def kicked(
    ship: Ship, *, delta: float = 0.2, case: str = "nominal", turning: float = 60.0
) -> Kicked:
    """From the steady turn: `turning` s of it, and as much of the course after it."""
    N = 2 * round(turning / TS)
    command = np.where(np.arange(N) < N // 2, delta, 0.0)
    starts = np.arange(round(1.0 / TS), N - round(EVERY / TS), round(EVERY / TS))
    forces = np.zeros((N, 4))
    for i, kick in enumerate(starts.tolist()):
        forces[kick : kick + round(KICK / TS), 2] = TORQUE * (-1) ** i
    s = steady_turn(delta, ship=ship, load=load(case)).state
    start = Start(u=s["u"], v=s["v"], r=s["r"], phi=s["phi"], delta=delta)
    motion = simulate(
        command, ship=ship, load=load(case), forces=forces, start=start, Ts=TS, substeps=4
    )
    windows: dict[Where, list[int]] = {"in the turn": [], "after it": []}
    most = float(np.max(np.abs(motion["r"])))
    for kick in starts.tolist():
        k = kick + round(KICK / TS) + 1
        at = slice(k, k + round(WINDOW / TS))
        rudder, turn = np.abs(motion["delta"][at]), np.abs(motion["r"][at])
        if rudder.min() > 0.99 * abs(delta) and turn.min() > 0.5 * most:
            windows["in the turn"].append(k)
        elif rudder.max() == 0.0 and turn.max() < SETTLED * most:
            windows["after it"].append(k)
    return Kicked(motion, {where: tuple(found) for where, found in windows.items()})


@dataclass(frozen=True, slots=True)
class Decay:
    """Roll decay found in windows of one kind, beside the simulator's; all in 1/s.

    Attributes
    ----------
    found, std_error : by casid from the gyro.
    tangent : of the simulator's linear motion.
    quadratic : what K_p|p| p adds at the amplitude of these rolls.
    """

    where: Where
    windows: int
    found: float
    std_error: float
    tangent: float
    quadratic: float

    @property
    def expected(self) -> float:
        """What the simulator's terms say [1/s]."""
        return self.tangent + self.quadratic


def identified(record: Kicked, where: Where, *, noise: float, seed: int) -> Decay:
    """The decay in the windows of one kind, from a gyro with white noise [rad/s], at 25 Hz."""
    rng = np.random.default_rng(seed)
    experiments = []
    for k in record.windows[where]:
        p = record.window("p", k)[::2]
        gyro = p + noise * rng.standard_normal(p.size)
        name = f"window at {k * TS:.1f} s"
        own = casid.Record({"gyro": gyro}, {"gyro": "rad/s"}, Ts=2 * TS, name=name)
        experiments.append(casid.Experiment(own, {}, name))
    found = casid.identify(decay_model(), experiments)
    error = found.parameter("alpha_1").std_error
    return Decay(
        where,
        len(experiments),
        found["alpha_1"] / 2,
        float("nan") if error is None else error / 2,
        record.decay(where),
        record.quadratic(where),
    )
