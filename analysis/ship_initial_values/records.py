"""Noise-free records of the linear ship (8.3) of Linder (2017), for section 8.6.

Sway, roll and yaw about a straight course at constant speed U, x = [phi; psi; v; p; r],

    diag(I_2, Mat) x' = F x + F_delta delta                                       (8.3)-(8.7)
    a_s = z_s p' + g phi - v' - U r                                               (8.13)-(8.16)

with the values of Table 8.2: Y_|u|v and N_|u|r with the minus signs that the table lost, without
which sway and yaw are unstable. What the thesis does not give is chosen here and can be: the
rudder's force C2 = -K_delta/z_r and its place (z_r, x_r), N_|u|v = 0, and the rudder's motion.

Nothing here is shared with the estimator: matrices are written down from (8.3), not derived from
`problems.ship`. Three integrators:

- ``trapezoidal``: the trapezoidal rule at T, x_t+1 - x_t = T/2 (x'_t + x'_t+1). This is the
  bilinear image of (8.3), so the samples obey (8.57) with the true coefficients, exactly.
- ``zoh``, ``foh``: Runge and Kutta's fourth order with the rudder held, or drawn as a straight
  line, between samples: a continuous ship, which (8.57) approximates.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from casid.arrays import Array
from casid.linear.sampled.lagged_columns import Column
from problems.ship import LOAD_CASES, TABLE_8_2

Integrator = Literal["trapezoidal", "zoh", "foh"]
TS = 0.02
"""Sample time [s]: 50 Hz."""

SUBSTEPS = 4
"""Runge-Kutta steps a sample: their own error is some 1e-9 of the signals."""

HULL = {
    "Y_vdot": -100.0,  # kg
    "Y_rdot": -1.0,  # kg m
    "Y_v": -35.0,  # kg/m, Y_|u|v
    "Y_ur": 0.0,  # kg
    "N_vdot": -1.0,  # kg m
    "N_v": 0.0,  # kg, N_|u|v, not given
    "N_r": -1.4,  # kg m, N_|u|r
    "A_z": 3.0 * TABLE_8_2["A_x"],  # kg m^2
    "z_r": 0.15,  # m, the rudder's height, not given
    "x_r": -0.7,  # m, the rudder's distance from midships, not given
}
"""The rest of Table 8.2, and what it leaves open; K_rdot = N_pdot = Y_phiuu = K_|u|v = 0."""


def of_case(case: str) -> dict[str, float]:
    """The weight aboard: true values of m [kg] and zbar_m [m]; the nominal ship has none."""
    return {n: LOAD_CASES[case].get(n, TABLE_8_2[n]) for n in ("m", "zbar_m")}


def matrices(load: dict[str, float]) -> tuple[Array, Array]:
    """A (5, 5) and B (5,) of x' = A x + B delta with this load aboard."""
    v = TABLE_8_2 | load
    h, U = HULL, v["U"]
    z_g, z_m = v["zbar_g"] + v["z_f"], v["zbar_m"] + v["z_f"]
    S = v["M"] * z_g + v["m"] * z_m
    A_1 = v["A_x"] + v["M"] * z_g**2 + v["m"] * z_m**2
    mass = v["M"] + v["m"]
    Y_pdot, K_ur = v["K_vdot"], v["K_vdot"] + v["K_r"] / U
    left = np.eye(5)
    left[2:, 2:] = [
        [mass - h["Y_vdot"], -S - Y_pdot, -h["Y_rdot"]],
        [-S - v["K_vdot"], A_1, 0.0],
        [-h["N_vdot"], 0.0, h["A_z"]],
    ]
    F = np.zeros((5, 5))
    F[0, 3] = F[1, 4] = 1.0
    F[2] = [0.0, 0.0, h["Y_v"] * U, 0.0, (h["Y_ur"] - mass) * U]
    F[3] = [-(v["k"] + S * v["g"]), 0.0, 0.0, -v["d"], (K_ur + S) * U]
    F[4] = [0.0, 0.0, h["N_v"] * U, 0.0, h["N_r"] * U]
    C2 = -v["K_delta"] / h["z_r"]
    B = np.array([0.0, 0.0, C2, -h["z_r"] * C2, h["x_r"] * C2])
    return np.linalg.solve(left, F), np.linalg.solve(left, B)


def rudder(N: int, seed: int, *, amplitude: float = 0.2, rate: float = 0.6) -> Array:
    """(N,) rudder angle [rad]: thrown from side to side at random instants, 1.5 s apart on average.

    `rate` [rad/s] is what its machine can do.
    """
    rng = np.random.default_rng(seed)
    flips = rng.random(N) < TS / 1.5
    wanted = amplitude * np.where(np.cumsum(flips) % 2, -1.0, 1.0)
    delta = np.zeros(N)
    for t in range(1, N):
        step = wanted[t] - delta[t - 1]
        delta[t] = delta[t - 1] + min(max(step, -rate * TS), rate * TS)
    return delta


def record(
    case: str,
    *,
    integrator: Integrator = "trapezoidal",
    duration: float = 60.0,
    seed: int = 1,
    finer: int = 1,
) -> dict[str, Array]:
    """gyro [rad/s], accel [m/s^2], r [rad/s] and delta [rad] of a load case, (N,) each, no noise.

    The rudder of a load case is the same whatever integrates the ship; at rest before.

    Parameters
    ----------
    finer : samples in each 0.02 s, of the same motion of the rudder.
    """
    number = list(LOAD_CASES).index(case)
    own = int(np.random.SeedSequence((seed, number)).generate_state(1)[0])
    delta = rudder(round(duration / TS), own)
    if finer > 1:  # the rudder's machine gets commands more often, too
        at = np.arange(delta.size * finer) / finer
        delta = np.asarray(np.interp(at, np.arange(delta.size), delta))
    T = TS / finer
    load = of_case(case)
    A, B = matrices(load)
    x = np.zeros((delta.size, 5))
    if integrator == "trapezoidal":
        implicit = np.eye(5) - T / 2 * A
        onward = np.linalg.solve(implicit, np.eye(5) + T / 2 * A)
        driven = np.linalg.solve(implicit, T / 2 * B)
        for t in range(delta.size - 1):
            x[t + 1] = onward @ x[t] + driven * (delta[t] + delta[t + 1])
    else:
        of_x, of_delta, of_slope = _runge_kutta(A, B, T)
        slope = (
            np.zeros(delta.size) if integrator == "zoh" else np.diff(delta, append=delta[-1]) / T
        )
        driven_by = np.outer(delta, of_delta) + np.outer(slope, of_slope)
        for t in range(delta.size - 1):
            x[t + 1] = of_x @ x[t] + driven_by[t]
    xdot = x @ A.T + np.outer(delta, B)
    v = TABLE_8_2
    z_s = v["zbar_s"] + v["z_f"]
    accel = z_s * xdot[:, 3] + v["g"] * x[:, 0] - xdot[:, 2] - v["U"] * x[:, 4]
    return {"gyro": x[:, 3].copy(), "accel": accel, "r": x[:, 4].copy(), "delta": delta}


def _runge_kutta(A: Array, B: Array, T: float) -> tuple[Array, Array, Array]:
    """What SUBSTEPS steps make in T of x (5, 5), of a rudder held (5,) and of its slope (5,).

    The steps are linear in all three, so each is found from its own unit.
    """
    h = T / SUBSTEPS
    x = np.hstack([np.eye(5), np.zeros((5, 2))])
    held, slope = np.eye(7)[5], np.eye(7)[6]
    for i in range(SUBSTEPS):
        inputs = [np.outer(B, held + h * (i + c) * slope) for c in (0.0, 0.5, 1.0)]
        k1 = A @ x + inputs[0]
        k2 = A @ (x + h / 2 * k1) + inputs[1]
        k3 = A @ (x + h / 2 * k2) + inputs[1]
        k4 = A @ (x + h * k3) + inputs[2]
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x[:, :5], x[:, 5], x[:, 6]


def instruments() -> tuple[Column, ...]:
    """(8.84) with the numbers of section 8.6: n_y = n_as = n_r = 16, n_delta = 2.

    Without noise the simulated signals are the recorded ones.
    """
    columns = [Column(f"gyro[t-{i}]", (("gyro", i, 1.0),)) for i in range(16)]
    for channel, lags in (("accel", 16), ("r", 16), ("delta", 2)):
        columns += [
            Column(f"mu {channel}[t-{i}]", ((channel, i, 1.0), (channel, i + 2, -1.0)))
            for i in range(lags)
        ]
    return tuple(columns)
