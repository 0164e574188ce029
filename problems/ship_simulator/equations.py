"""How a ship moves, (A.30)-(A.40), and one sample of it as a compiled function."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .hull import Coefficients, Load, Ship, coriolis_rows
from .rudder import HeadingAutopilot

Array = NDArray[np.float64]


def rotation(phi: float, theta: float, psi: float) -> Array:
    """(3, 3) R = Rz(psi) Ry(theta) Rx(phi), from the ship's axes to north, east, down (A.8).

    Entry (2, 3) is -cos(psi) sin(phi) + sin(theta) sin(psi) cos(phi); as printed, with
    sin(theta) first, the matrix is not orthogonal.
    """
    (cf, sf), (ct, st), (cp, sp) = ((math.cos(a), math.sin(a)) for a in (phi, theta, psi))
    return np.array(
        [
            [cp * ct, -sp * cf + cp * st * sf, sp * sf + cp * cf * st],
            [sp * ct, cp * cf + sf * st * sp, -cp * sf + st * sp * cf],
            [-st, ct * sf, ct * cf],
        ]
    )


def hydrodynamics(c: Coefficients, phi: Any, nu: Sequence[Any]) -> list[Any]:
    """The four rows of f (A.36) [N, N m]: numbers or CasADi expressions."""
    u, v, p, r = nu
    U, V, P, R = (ca.fabs(a) for a in nu)
    UV, ur = U * V, u * r
    UR = ca.fabs(ur)
    uu = u * u
    return [
        c.X_uu * U * u,
        (c.Y_uv * U + c.Y_vv * V + c.Y_vr * R) * v
        + (c.Y_ur * u + c.Y_rv * V) * r
        + (c.Y_phiuv * UV + c.Y_phiur * UR + c.Y_phiuu * uu) * phi,
        (c.K_uv * U + c.K_vv * V + c.K_vr * R) * v
        + (c.K_ur * u + c.K_rv * V) * r
        + (c.K_phiuv * UV + c.K_phiur * UR + c.K_phiuu * uu + c.K_phiphiphi * (phi * phi)) * phi
        + (c.K_up * U + c.K_pp * P + c.K_p) * p,
        (c.N_uv * U) * v
        + (c.N_ur * U + c.N_rr * R + c.N_rv * V) * r
        + (c.N_phiuv * UV + c.N_phiur * (u * R) + c.N_phiuu * (u * U)) * phi
        + (c.N_p + c.N_pp * P + c.N_up * U) * p,
    ]


def _product(matrix: Array, vector: list[Any]) -> list[Any]:
    """Matrix times vector, zeros left out, so that they cost nothing."""
    made: list[Any] = []
    for row in matrix:
        terms = [a * b for a, b in zip(row.tolist(), vector, strict=True) if a != 0.0]
        made.append(sum(terms[1:], terms[0]) if terms else 0.0)
    return made


@lru_cache(maxsize=64)
def dynamics(ship: Ship, load: Load) -> Any:
    """CasADi function of x = [x y phi psi u v p r], inputs [delta w_p], tau (4) and current (2).

    Its value is x' (8): velocities over ground, rates of the angles, accelerations.
    """
    c, moments = ship.coefficients, ship.moments(load)
    x, actuators = ca.SX.sym("x", 8), ca.SX.sym("actuators", 2)
    tau, current = ca.SX.sym("tau", 4), ca.SX.sym("current", 2)
    _, _, phi, psi, u, v, p, r = ca.vertsplit(x)
    nu, (delta, w_p) = [u, v, p, r], ca.vertsplit(actuators)
    cos_phi, cos_psi, sin_psi = ca.cos(phi), ca.cos(psi), ca.sin(psi)
    side = v * cos_phi
    steer = c.C2 * delta
    actuation = [c.C3 * w_p - c.C1 * ca.fabs(delta), steer, -c.z_r * steer, c.x_r * steer]
    restoring = [0.0, 0.0, ship.restoring(phi, load), 0.0]
    force = [
        f - sum(a * b for a, b in zip(row, nu, strict=True)) - g + actuation[i] + tau[i]
        for i, (f, row, g) in enumerate(
            zip(hydrodynamics(c, phi, nu), coriolis_rows(moments, nu), restoring, strict=True)
        )
    ]
    mass = ship.mass_matrix(load)
    inverse = np.asarray(np.linalg.inv(mass), dtype=np.float64)
    if mass[0, 3] == 0.0:  # surge stands alone: no rounding in place of zeros
        inverse[0, 1:] = inverse[1:, 0] = 0.0
    rates = [
        cos_psi * u - sin_psi * side + current[0],
        sin_psi * u + cos_psi * side + current[1],
        p,
        cos_phi * r,
        *_product(inverse, force),
    ]
    return ca.Function(
        "dynamics",
        [x, actuators, tau, current],
        [ca.vertcat(*rates)],
        ["x", "actuators", "tau", "current"],
        ["rates"],
    )


def turned(harmonics: Any, psi: Any) -> list[Any]:
    """Forces at heading psi from their Fourier series, four numbers a term (see `by_heading`)."""
    four = [harmonics[i] for i in range(4)]
    for h in range(1, (harmonics.numel() // 4 + 1) // 2):
        cos, sin = ca.cos(h * psi), ca.sin(h * psi)
        first = 8 * h - 4
        four = [
            f + cos * harmonics[first + i] + sin * harmonics[first + 4 + i]
            for i, f in enumerate(four)
        ]
    return four


@lru_cache(maxsize=64)
def sample_step(
    ship: Ship,
    load: Load,
    Ts: float,
    substeps: int,
    autopilot: HeadingAutopilot | None = None,
    terms: int = 1,
) -> Any:
    """CasADi function of one sample: Runge-Kutta 4 in `substeps` steps.

    Its inputs are the state (10: x of `dynamics`, then rudder and propeller), the commands (3:
    rudder, propeller, course), and forces and current, 4 `terms` + 2 numbers, at the sample and at
    the next. Its values are the next state and x' (8) at the sample. An autopilot's angle is
    computed at the sample and added to the rudder's command.
    """
    f = dynamics(ship, load)
    state, command = ca.SX.sym("state", 10), ca.SX.sym("command", 3)
    here, there = ca.SX.sym("here", 4 * terms + 2), ca.SX.sym("there", 4 * terms + 2)
    x, actuators = state[:8], state[8:]
    asked = [command[0], command[1]]
    if autopilot is not None:
        asked[0] = asked[0] + autopilot(x[3] - command[2], x[7])
    moved = []
    for i, a in enumerate((ship.rudder, ship.propeller)):
        wanted = ca.fmin(ca.fmax(asked[i], a.lowest), a.highest)
        reach = a.rate * Ts
        moved.append(ca.fmin(ca.fmax(wanted - actuators[i], -reach), reach))
    inputs = ca.vertcat(actuators, here)
    change = (ca.vertcat(ca.vertcat(*moved), there - here)) / (2 * substeps)
    h = Ts / substeps

    def rates(at: Any, z: Any) -> Any:
        return f(at, z[:2], ca.vertcat(*turned(z[2:-2], at[3])), z[-2:])

    first: Any = None
    for i in range(substeps):
        left, middle, right = (inputs + k * change for k in (2 * i, 2 * i + 1, 2 * i + 2))
        k1 = rates(x, left)
        k2 = rates(x + h / 2 * k1, middle)
        k3 = rates(x + h / 2 * k2, middle)
        k4 = rates(x + h * k3, right)
        x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
        first = k1 if first is None else first
    return ca.Function(
        "sample_step",
        [state, command, here, there],
        [ca.vertcat(x, actuators + ca.vertcat(*moved)), first],
        ["state", "command", "here", "there"],
        ["next", "rates"],
    )
