"""The rudder heels the ship inwards first: a zero in the right half-plane (A.5.1).

A rudder below the origin (z_r > 0) pushes the ship over towards the side to which it will turn;
the turn leans it outwards later. What decides on the first moment is the acceleration in roll at
the step, which changes its sign at

    z_r* = (S + K_vdot) (A_z + x_r Y_rdot)/((M_t - Y_vdot) A_z - Y_rdot N_vdot),   K_rdot = 0

Above z_r* the zero is to the left. z_r* has the sign of S + K_vdot: positive with the K_vdot that
chapter 9 estimates, so that z_r = 0 lies above it; with that of Table 8.2 it is 8.5 mm above the
origin, so that at z_r = 0 something of the lean is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.ship_signals.model import NEGLECTED, symbolic_matrices
from casid.arrays import Array
from casid.linear.laplace import solve
from problems.ship_4dof import Actuator, Coefficients, Ship, Start, linearised, simulate

HULLS = {"Table 8.2": 0.1, "chapter 9": 0.96}
"""K_vdot (and Y_pdot, which is its mirror) [kg m]: of Table 8.2, and about Tables 9.5-9.9."""


def critical_height() -> Any:
    """z_r at which the roll acceleration of a rudder step vanishes, in symbols of the model."""
    import sympy

    E, _, B = (m.subs(dict.fromkeys(NEGLECTED, 0)) for m in symbolic_matrices())
    onset = solve(E[2:, 2:], B[2:, 0])[1]
    (height,) = sympy.solve(sympy.numer(sympy.together(onset)), sympy.Symbol("z_r"))
    return sympy.factor(height)


@dataclass(frozen=True, slots=True, eq=False)
class Lean:
    """A small step of the rudder to port.

    Attributes
    ----------
    z_r : height of the rudder's force, down from the origin [m].
    onset : roll acceleration at the step [rad/s^2]; negative is inwards, to port.
    zeros : finite zeros from rudder to roll angle [1/s].
    t, linear, phi : (N,) time [s], heel of the linear model and of the simulator [rad].
    turn : -1 if the ship turned to port.
    """

    z_r: float
    onset: float
    zeros: NDArray[np.complex128]
    t: Array
    linear: Array
    phi: Array
    turn: float

    @property
    def right(self) -> tuple[float, ...]:
        """Real parts of the zeros in the right half-plane [1/s]."""
        return tuple(sorted(float(z.real) for z in self.zeros if z.real > 0.0))

    @property
    def inward(self) -> float:
        """Deepest heel of the simulator towards the turn before the outward one [rad]."""
        towards = self.phi * self.turn
        return float(max(0.0, np.max(towards[: int(np.argmin(towards)) + 1])))

    @property
    def outward(self) -> float:
        """Greatest heel of the simulator away from the turn [rad]."""
        return float(max(0.0, np.max(-self.phi * self.turn)))


def lean(z_r: float | None = None, *, hull: str = "Table 8.2", step: float = 0.02) -> Lean:
    """Step of the rudder [rad] on the linear model and on the simulator, 12 s.

    Parameters
    ----------
    z_r : height of the rudder [m]; the ship's own by default.
    hull : one of `HULLS`.
    """
    from scipy.linalg import expm

    own = Coefficients()
    height = own.z_r if z_r is None else z_r
    K_vdot = HULLS[hull]
    c = replace(own, z_r=height, K_vdot=K_vdot, Y_pdot=K_vdot)
    body = replace(Ship(), coefficients=c, rudder=Actuator(-1.0, 1.0, 1e3))
    linear = linearised(ship=body)
    motion = simulate(np.full(1200, step), ship=body, start=Start(delta=step), Ts=0.01, substeps=2)
    both = np.zeros((6, 6))
    both[:5, :5], both[:5, 5] = linear.A, linear.B * step
    over, x = expm(both * motion.Ts), np.append(np.zeros(5), 1.0)
    phi = np.empty(motion.t.size)
    for i in range(phi.size):
        phi[i] = x[0]
        x = over @ x
    return Lean(
        z_r=height,
        onset=float(linear.B[3] * step),
        zeros=linear.zeros(0),
        t=motion.t,
        linear=phi,
        phi=motion["phi"],
        turn=float(np.sign(motion["r"][-1])),
    )
