"""Stabilised inverted pendulum on a cart whose acceleration nobody measures.

Linder (2017), Indirect System Identification for Unknown Input Problems, chapter 7: the direct
model (7.10), an accelerometer and a gyro on the pendulum (7.13)-(7.15), constants of Table 7.2.
The cart's acceleration a_y is eliminated with the accelerometer, which leaves the indirect model

    I_2 phi'' = -k phi - d phi' - S a_s,   S = M z_g + m z_m,   I_2 = I_1 - z_s S          (7.24)

It is exact for the nonlinear pendulum as well: sin(phi) and cos(phi) a_y enter the torque balance
(7.9) and the accelerometer alike, and leave together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import casid


def direct_model() -> casid.Model:
    """The pendulum with the unknown input still in it: (7.10) and (7.13)-(7.15)."""
    m = casid.Model("stabilised pendulum on a cart")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    a_y = m.unknown_input("a_y", "m/s^2")
    k = m.parameter("k", "N m/rad", start=8.0, lower=0.0, upper=200.0)
    d = m.parameter("d", "N m s/rad", start=0.1, lower=0.0, upper=20.0)
    # Below 0.0794 kg m^2 the inertia I_2 of the indirect model would be negative.
    I_x = m.parameter("I_x", "kg m^2", start=0.15, lower=0.081, upper=2.0)
    # A load is known to be absent unless a load case says otherwise; it may still appear.
    load = m.parameter("m", "kg", value=0.0, lower=0.0)
    M, z_g = m.constant("M", 22.04, "kg"), m.constant("z_g", -0.018, "m")
    z_m, I_xm = m.constant("z_m", -0.274, "m"), m.constant("I_xm", 0.0, "kg m^2")
    z_s, g = m.constant("z_s", -0.218, "m"), m.constant("g", 9.81, "m/s^2")
    S = M * z_g + load * z_m
    I_1 = I_x + M * z_g**2 + I_xm + load * z_m**2  # about the pivot (7.8)
    m.derivative(phi, p)
    m.balance(p, "torque", inertia=I_1, terms=[-(k + S * g) * phi, -d * p, S * a_y])
    m.output("gyro", p, "rad/s")
    m.output("accel", z_s * m.der(p) + g * phi - a_y, "m/s^2")
    return m


def simulate(
    *,
    duration: float = 60.0,
    k: float = 10.39,
    d: float = 0.1067,
    I_x: float = 0.1385,
    m: float = 0.0,
    d_2: float = 0.0,
    noise: float = 0.01,
    seed: int = 1,
) -> casid.Record:
    """The nonlinear pendulum (7.9) on a cart that follows a random reference, sampled at 100 Hz.

    The cart's acceleration follows `ref`, random steps held for 1 s on average, through
    1/(0.2 s + 1); `d_2` [N m s^2/rad^2] is drag, `noise` the standard deviation on both sensors.
    """
    M, z_g, z_s, z_m, g = 22.04, -0.018, -0.218, -0.274, 9.81
    S, I_1 = M * z_g + m * z_m, I_x + M * z_g**2 + m * z_m**2
    rng = np.random.default_rng(seed)
    Ts, substeps = 0.01, 5
    N = round(duration / Ts)
    steps = rng.random(N) < Ts / 1.0
    level = rng.uniform(-1.0, 1.0, N)
    ref = level[np.maximum.accumulate(np.where(steps, np.arange(N), 0))]

    def rates(x: NDArray[np.float64], r: float) -> NDArray[np.float64]:
        phi, p, a_y = x
        torque = -k * phi - S * g * np.sin(phi) - d * p - d_2 * abs(p) * p + S * np.cos(phi) * a_y
        return np.array([p, torque / I_1, (r - a_y) / 0.2])

    x: NDArray[np.float64] = np.zeros(3)
    h = Ts / substeps
    phi, p, a_y, p_dot = np.empty((4, N))
    for i in range(N):
        phi[i], p[i], a_y[i] = x
        p_dot[i] = rates(x, ref[i])[1]
        for _ in range(substeps):
            k1 = rates(x, ref[i])
            k2 = rates(x + h / 2 * k1, ref[i])
            k3 = rates(x + h / 2 * k2, ref[i])
            k4 = rates(x + h * k3, ref[i])
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    accel = z_s * p_dot + g * np.sin(phi) - a_y * np.cos(phi)
    t = Ts * np.arange(N)
    phase = rng.uniform(0, 2 * np.pi, 4)
    yaw_rate = 0.2 * np.sin(0.31 * t + phase[0]) + 0.1 * np.sin(1.7 * t + phase[1])
    speed = 1.5 + 0.3 * np.sin(0.13 * t + phase[2]) + 0.1 * np.sin(0.71 * t + phase[3])
    return casid.Record(
        {
            "gyro": p + noise * rng.standard_normal(N),
            "accel": accel + noise * rng.standard_normal(N),
            "ref": ref,
            "yaw_rate": yaw_rate,
            "speed": speed,
        },
        {"gyro": "rad/s", "accel": "m/s^2", "ref": "m/s^2", "yaw_rate": "rad/s", "speed": "m/s"},
        Ts=Ts,
        name="example",
        provenance=(f"simulated by problems/pendulum.py, seed {seed}",),
    )


def example() -> list[casid.Experiment]:
    """One minute of the nominal pendulum with something that the model above leaves out."""
    return [casid.Experiment(simulate(d_2=0.2), {}, "example")]  # drag: for the diagnosis to find


problem = casid.Problem(
    name="pendulum",
    model=direct_model().eliminate("a_y", using="accel"),
    channels={"gyro": "gyro:rad/s", "accel": "accel:m/s^2"},
    recorded={"ref": "m/s^2", "yaw_rate": "rad/s", "speed": "m/s"},
    time="t",
    load_cases={"nominal": {"m": 0.0}, "loaded": {"m": 0.2}},
    example=example,
    description="Inverted pendulum on a cart, held by springs; the cart's acceleration is unknown.",
    references=(
        "J. Linder, Indirect System Identification for Unknown Input Problems, 2017, ch. 7",
    ),
)
