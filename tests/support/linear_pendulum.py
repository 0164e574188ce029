"""The linear pendulum (7.10) on a cart, simulated exactly with NumPy alone; Table 7.2.

Everything that drives it is constant over a sample, so one matrix exponential is the exact step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import expm

import casid

Array = np.ndarray[Any, Any]

TRUTH = {"k": 10.39, "d": 0.1067, "I_x": 0.1385}
M, Z_G, Z_S, G, Z_M = 22.04, -0.018, -0.218, 9.81, -0.274
LAG = 0.2  # a_y = reference / (LAG s + 1) [s]


def simulate(
    *,
    duration: float = 60.0,
    Ts: float = 0.01,
    seed: int = 0,
    noise: float = 0.01,
    amplitude: float = 1.0,
    torque_sd: float = 0.0,
    walk: float | None = None,
    load: float = 0.0,
    noise_a: float = 0.05,
    noise_v: float = 0.01,
) -> casid.Record:
    """A record of gyro, accel, a_y, v_y with white noise, and the noise-free a_y as `a_y_true`.

    The cart follows a random telegraph of this amplitude (mean hold 1 s), or its acceleration is a
    random walk with increments of sd walk * sqrt(Ts). `torque_sd` is white torque held over each
    sample. `noise` is that of gyro and accel, `noise_a` and `noise_v` that of the cart's channels.
    """
    rng = np.random.default_rng(seed)
    N = round(duration / Ts)
    S, I_1 = M * Z_G + load * Z_M, TRUTH["I_x"] + M * Z_G**2 + load * Z_M**2
    k, d = TRUTH["k"], TRUTH["d"]
    # States phi, p, a_y, v_y; inputs reference and torque.
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-(k + S * G) / I_1, -d / I_1, S / I_1, 0.0],
            [0.0, 0.0, -1 / LAG if walk is None else 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    B = np.array([[0.0, 0.0], [0.0, 1 / I_1], [1 / LAG if walk is None else 0.0, 0.0], [0.0, 0.0]])
    block = np.zeros((6, 6))
    block[:4, :4], block[:4, 4:] = A * Ts, B * Ts
    step = expm(block)
    flips = rng.random(N) < Ts / 1.0
    reference = amplitude * (-1.0) ** np.cumsum(flips)
    torque = torque_sd * rng.standard_normal(N)
    jolts = np.zeros((N, 4))
    if walk is not None:
        # The exact covariance of a random walk and what it moves, by a fine quadrature.
        s = (np.arange(400) + 0.5) * Ts / 400
        g = np.array([expm(A * v)[:, 2] for v in s])
        lower = np.linalg.cholesky(g.T @ g * walk**2 * Ts / 400 + 1e-18 * np.eye(4))
        jolts = rng.standard_normal((N, 4)) @ lower.T
    x = np.zeros((N, 4))
    for t in range(N - 1):
        x[t + 1] = step[:4, :4] @ x[t] + step[:4, 4:] @ [reference[t], torque[t]] + jolts[t]
    p_dot = x @ A[1] + torque / I_1
    clean = {
        "gyro": x[:, 1],
        "accel": Z_S * p_dot + G * x[:, 0] - x[:, 2],
        "a_y": x[:, 2],
        "v_y": x[:, 3],
    }
    sd = {"gyro": noise, "accel": noise, "a_y": noise_a, "v_y": noise_v}
    channels = {name: v + sd[name] * rng.standard_normal(N) for name, v in clean.items()}
    channels |= {"a_y_true": x[:, 2], "ref": reference}
    units = {"gyro": "rad/s", "accel": "m/s^2", "a_y": "m/s^2", "v_y": "m/s"}
    units |= {"a_y_true": "m/s^2", "ref": "m/s^2"}
    return casid.Record(channels, units, Ts=Ts, name=f"pendulum {seed}")
