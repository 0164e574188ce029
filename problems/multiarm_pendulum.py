"""One arm of a pendulum on a bench, swinging freely: a full sine and viscous damping.

    theta'' = w_2 sin(theta) - d theta'                                                       (1)

with theta = pi hanging, w_2 = a_1 m_1 g / (m_1 a_1^2 + I_1) and d = k_1 / (m_1 a_1^2 + I_1).
Kaheman, Fasel, Bramburger, Strom, Kutz, Brunton (2022, arXiv 2205.06231) give a_1, m_1, I_1 and k_1
one by one, but a free oscillation determines these two combinations alone. The angle comes from an
encoder at 1 kHz, a period is 0.8 s: the example has 100 Hz, and a record of theirs can be decimated
by 10. Their three records for estimation are one of 27.5 s in three pieces with one clock.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

import casid


def swing_model() -> casid.Model:
    """(1), torques divided by the inertia about the pivot."""
    m = casid.Model("free swing of one arm")
    theta = m.state("theta", "rad", start=math.pi)
    rate = m.state("rate", "rad/s")
    # Over n swings a start that is wrong by 1/n of the frequency slips a swing.
    w_2 = m.parameter("w_2", "1/s^2", start=64.0, lower=1.0, upper=1e4)
    d = m.parameter("d", "1/s", start=0.05, lower=0.0, upper=10.0)
    m.derivative(theta, rate)
    terms = [w_2 * ca.sin(theta), -d * rate]
    m.balance(rate, "torque", inertia=1, terms=terms, unit="rad/s^2")
    m.output("theta", theta, "rad")
    return m


def simulate(
    *,
    theta_start: float = math.pi + 1.6,
    duration: float = 27.0,
    w_2: float = 64.1,
    d: float = 0.05,
    d_2: float = 0.005,
    F_c: float = 0.0,
    noise: float = 4e-5,
    seed: int = 6,
) -> casid.Record:
    """A swing from `theta_start` [rad] at rest, sampled at 100 Hz, with white noise [rad].

    `d_2` [1/rad] is damping by drag, `F_c` [rad/s^2] dry friction; swings this large do not stick.
    """
    Ts, substeps = 0.01, 4
    N, h = round(duration / Ts), Ts / substeps

    def acceleration(angle: float, rate: float) -> float:
        dry = math.copysign(F_c, rate) if rate else 0.0
        return w_2 * math.sin(angle) - (d + d_2 * abs(rate)) * rate - dry

    angle, rate, measured = theta_start, 0.0, np.empty(N)
    for i in range(N):
        measured[i] = angle
        for _ in range(substeps):
            a1 = acceleration(angle, rate)
            v2 = rate + h / 2 * a1
            a2 = acceleration(angle + h / 2 * rate, v2)
            v3 = rate + h / 2 * a2
            a3 = acceleration(angle + h / 2 * v2, v3)
            v4 = rate + h * a3
            a4 = acceleration(angle + h * v3, v4)
            angle += h / 6 * (rate + 2 * v2 + 2 * v3 + v4)
            rate += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    measured += noise * np.random.default_rng(seed).standard_normal(N)
    return casid.Record(
        {"theta": measured},
        {"theta": "rad"},
        Ts=Ts,
        name="example",
        provenance=(f"simulated by problems/multiarm_pendulum.py, seed {seed}",),
    )


def example() -> list[casid.Experiment]:
    """Half a minute of swinging from 92 degrees, with drag that (1) leaves out."""
    return [casid.Experiment(simulate(), {}, "example")]


def draw(seed: int) -> list[casid.Experiment]:
    """Half a minute of swinging as (1) has it, with noise from this seed."""
    return [casid.Experiment(simulate(d_2=0.0, seed=seed), {}, "drawn")]


problem = casid.Problem(
    name="multiarm_pendulum",
    model=swing_model(),
    channels={"theta": "theta_rad:rad"},
    time="t_s",
    example=example,
    simulate=draw,
    truth={"w_2": 64.1, "d": 0.05},
    description="One arm of a pendulum on a bench, swinging freely from a large angle.",
    references=(
        "K. Kaheman, U. Fasel, J. J. Bramburger, B. Strom, J. N. Kutz, S. L. Brunton, The "
        "Experimental Multi-Arm Pendulum on a Cart, arXiv 2205.06231, 2022",
    ),
)
