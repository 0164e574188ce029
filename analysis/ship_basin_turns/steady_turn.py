"""Steady turns of the simulator: where they are, and the linear motion about them.

Roll damping inside a turn and after it are two numbers of one nonlinear ship. The terms |u| p,
v|v|, r|v|, v|r| and phi|uv| have another slope in a turn than on a straight course; K_p|p| p has
none at p = 0, and acts as 8/(3 pi) K_p|p| P on a roll of amplitude P.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casid.arrays import Array
from problems.ship_4dof import LOAD_CASES, Load, Ship, Start, dynamics, simulate

ROWS = (2, 4, 5, 6, 7)
"""phi, u, v, p, r of the simulator's state: positions and heading act on nothing."""

NAMES = ("phi", "u", "v", "p", "r")


@dataclass(frozen=True, slots=True, eq=False)
class SteadyTurn:
    """A state that does not change, and the linear motion about it.

    Attributes
    ----------
    delta : rudder [rad].
    state : phi [rad], u, v [m/s], p, r [rad/s].
    A : (5, 5) x' = A x of small deviations of phi, u, v, p, r.
    B : (5,) of the rudder.
    """

    delta: float
    state: Mapping[str, float]
    A: Array
    B: Array

    @property
    def poles(self) -> NDArray[np.complex128]:
        """(5,) eigenvalues [1/s]."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    @property
    def roll(self) -> complex:
        """The pole of the roll: the fastest to swing, in the upper half-plane [1/s]."""
        return complex(max(self.poles, key=lambda z: z.imag))

    @property
    def decay(self) -> float:
        """At which a roll dies out, -Re of its pole [1/s]."""
        return -self.roll.real

    def accel(self, g: float) -> float:
        """a_s = g sin(phi) - u r of the steady turn [m/s^2]."""
        s = self.state
        return g * math.sin(s["phi"]) - s["u"] * s["r"]


def steady_turn(
    delta: float, *, ship: Ship, load: Load = LOAD_CASES["nominal"], w_p: float = 100.0
) -> SteadyTurn:
    """The steady turn with a constant rudder [rad]: simulated for 80 s, then Newton's method."""
    command = np.full(4000, delta)
    motion = simulate(
        command, ship=ship, load=load, w_p=w_p, start=Start(delta=delta), Ts=0.02, substeps=2
    )
    x, keep = motion.states[-1, list(ROWS)], np.ix_(ROWS, ROWS)
    f = dynamics(ship, load)
    slopes = f.factory("J", f.name_in(), ["jac:rates:x", "jac:rates:actuators"])
    outside = ([delta, w_p], np.zeros(4), np.zeros(2))
    A: Array = np.zeros((5, 5))
    B: Array = np.zeros(5)
    for _ in range(12):
        full = np.zeros(8)
        full[list(ROWS)] = x
        rates = np.asarray(f(full, *outside)).ravel()[list(ROWS)]
        in_x, in_u = (np.asarray(j) for j in slopes(full, *outside))
        A, B = in_x[keep], in_u[list(ROWS), 0]
        if np.max(np.abs(rates)) < 1e-13:
            break
        x = x - np.linalg.solve(A, rates)
    return SteadyTurn(delta, dict(zip(NAMES, x.tolist(), strict=True)), A, B)


def about(
    state: Mapping[str, float], delta: float, *, ship: Ship, load: Load, w_p: float = 100.0
) -> SteadyTurn:
    """Small motion about any state, as if the ship stayed in it.

    For what is not steady: the straight course after a turn, on which the speed comes back.
    """
    f = dynamics(ship, load)
    slopes = f.factory("J", f.name_in(), ["jac:rates:x", "jac:rates:actuators"])
    full = np.zeros(8)
    full[list(ROWS)] = [state[n] for n in NAMES]
    in_x, in_u = (np.asarray(j) for j in slopes(full, [delta, w_p], np.zeros(4), np.zeros(2)))
    return SteadyTurn(delta, dict(state), in_x[np.ix_(ROWS, ROWS)], in_u[list(ROWS), 0])
