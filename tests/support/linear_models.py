"""Linear models that several tests share: the pendulum, a chain of masses, a ship in roll."""

from __future__ import annotations

import numpy as np

from casid.model.model import Model
from problems.pendulum import direct_model

NOMINAL = {"k": 10.39, "d": 0.1067, "I_x": 0.1385}  # Table 7.2
M, Z_G, Z_S, Z_M, G = 22.04, -0.018, -0.218, -0.274, 9.81


def indirect() -> Model:
    return direct_model().eliminate("a_y", using="accel")


def spring_chain(n: int) -> Model:
    """n masses in a row, each held to the one before (the first to a wall) by spring and damper."""
    m = Model(f"chain of {n}")
    F = m.input("F", "N")
    q = [m.state(f"q{i}", "m") for i in range(n)]
    v = [m.state(f"v{i}", "m/s") for i in range(n)]
    k = [m.parameter(f"k{i}", "N/m", start=4.0) for i in range(n)]
    d = [m.parameter(f"d{i}", "N s/m", start=0.3) for i in range(n)]
    mass = [m.parameter(f"m{i}", "kg", start=2.0) for i in range(n)]
    force = []
    for i in range(n):
        dq, dv = (q[i] - q[i - 1], v[i] - v[i - 1]) if i else (q[i], v[i])
        force.append(-k[i] * dq - d[i] * dv)
    for i in range(n):
        m.derivative(q[i], v[i])
        terms = [force[i]] + ([-force[i + 1]] if i + 1 < n else [F])
        m.balance(v[i], f"force {i}", inertia=mass[i], terms=terms)
    m.output("q", q[-1], "m")
    m.output("v", v[0], "m/s")
    return m


def chain_values(n: int, seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    return {
        f"{c}{i}": float(rng.uniform(low, high))
        for c, low, high in (("k", 1.0, 9.0), ("d", 0.05, 0.8), ("m", 0.5, 3.0))
        for i in range(n)
    }


def ship() -> Model:
    """The roll subsystem (8.10) with its IMU (8.13)-(8.16); vdot is unknown.

    Linder (2017), chapter 8: z_g = zbar_g + z_f, z_m = zbar_m + z_f, z_s = zbar_s + z_f (8.21).
    """
    m = Model("ship in roll")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    vdot = m.unknown_input("vdot", "m/s^2")
    r, rudder = m.input("r", "rad/s"), m.input("rudder", "rad", hold="zoh")
    k, d = m.parameter("k", "N m/rad"), m.parameter("d", "N m s/rad")
    A_x, z_f = m.parameter("A_x", "kg m^2"), m.parameter("z_f", "m")
    K_r, K_vdot = m.parameter("K_r", "N m s/rad"), m.parameter("K_vdot", "N s^2")
    K_delta = m.parameter("K_delta", "N m/rad")
    load, zbar_m = m.parameter("m", "kg", value=0.0), m.parameter("zbar_m", "m", value=0.0)
    mass, zbar_g = m.constant("M", 22.04, "kg"), m.constant("zbar_g", 0.0, "m")
    zbar_s, g, U = (
        m.constant("zbar_s", -0.2, "m"),
        m.constant("g", 9.82, "m/s^2"),
        m.constant("U", 1.0, "m/s"),
    )
    z_g, z_m, z_s = zbar_g + z_f, zbar_m + z_f, zbar_s + z_f
    S = mass * z_g + load * z_m
    K_ur = K_r / U + K_vdot  # K_r = (K_ur - K_vdot) U (8.20)
    m.derivative(phi, p)
    m.balance(
        p,
        "roll",
        inertia=A_x + mass * z_g**2 + load * z_m**2,  # (8.11)
        terms=[
            -(k + S * g) * phi,
            -d * p,
            (K_vdot + S) * vdot,
            (K_ur + S) * U * r,
            K_delta * rudder,
        ],
    )
    m.output("gyro", p, "rad/s")
    m.output("accel", z_s * m.der(p) + g * phi - vdot - U * r, "m/s^2")
    return m


SHIP = {  # Table 8.2
    "k": 10.38,
    "d": 0.2067,
    "A_x": 0.1385,
    "z_f": -0.028,
    "K_r": -0.5,
    "K_vdot": 0.1,
    "K_delta": -0.405,
}
