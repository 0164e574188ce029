"""Electro-mechanical positioning system (EMPS): a motor drives a cart along a rail.

    M q'' = force - F_v q'                                                                    (1)

Janot, Gautier, Brunot, Workshop on Nonlinear System Identification Benchmarks, Eindhoven 2019,
the model of its section 3 with viscous friction alone. Position loop closed around the drive,
vir = k_v (k_p (q_ref - q) - q'), force = g_tau vir with the drive's gain; 1 kHz. Between samples
the force is taken as straight lines (`foh`): on the benchmark's record, with dry friction and a
constant force in the model, they leave 2.387 mm rms and held samples (`zoh`) 2.390 mm.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

import casid


def rail_model(hold: Literal["zoh", "foh"] = "foh") -> casid.Model:
    """(1), with what the measured force does between its samples."""
    m = casid.Model("electro-mechanical positioning system")
    q, v = m.state("q", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold=hold)
    M = m.parameter("M", "kg", start=100.0, lower=1.0, upper=1e4)
    F_v = m.parameter("F_v", "N s/m", start=200.0, lower=0.0, upper=1e5)
    m.derivative(q, v)
    m.balance(v, "force", inertia=M, terms=[force, -F_v * v])
    m.output("q", q, "m")
    return m


def simulate(
    *,
    duration: float = 12.0,
    M: float = 95.0,
    F_v: float = 200.0,
    F_c: float = 20.0,
    F_0: float = -3.0,
    noise: float = 2e-6,
    seed: int = 3,
) -> casid.Record:
    """The closed loop on a reference of two sines, recorded at 500 Hz.

    `F_c` [N] is dry friction (sticking included), `F_0` [N] a constant force beside the drive's,
    `noise` the standard deviation of the encoder [m].
    """
    k_p, k_v, g_tau = 160.18, 243.45, 35.15065188248547
    Ts, substeps = 0.002, 10
    N, h = round(duration / Ts), Ts / substeps
    rng = np.random.default_rng(seed)
    t = h * np.arange(N * substeps)
    q_ref = 0.06 * (1 - np.cos(2 * np.pi * 0.25 * t)) + 0.01 * (1 - np.cos(2 * np.pi * 1.1 * t))

    def acceleration(v: float, free: float, side: float) -> float:
        return (free - F_v * v - F_c * side) / M

    q = v = 0.0
    measured, force = np.empty(N), np.empty(N)
    for i in range(N):
        measured[i] = q + noise * rng.standard_normal()
        for j in range(substeps):
            drive = g_tau * np.clip(k_v * (k_p * (q_ref[i * substeps + j] - q) - v), -10.0, 10.0)
            if j == 0:
                force[i] = drive
            free = drive + F_0
            if v == 0.0 and abs(free) <= F_c:
                continue  # it sticks
            side = np.sign(v) if v != 0.0 else np.sign(free)
            middle = v + h / 2 * acceleration(v, free, side)
            after = v + h * acceleration(middle, free, side)
            if v * after < 0.0:
                after = 0.0  # it stops; the next step decides whether it sticks
            q += h / 2 * (v + after)
            v = after
    return casid.Record(
        {"q": measured, "force": force},
        {"q": "m", "force": "N"},
        Ts=Ts,
        name="example",
        provenance=(f"simulated by problems/emps.py, seed {seed}",),
    )


def example() -> list[casid.Experiment]:
    """Twelve seconds of the closed loop, with friction that (1) leaves out."""
    return [casid.Experiment(simulate(), {}, "example")]


def draw(seed: int) -> list[casid.Experiment]:
    """Twelve seconds of the closed loop with the friction of (1) alone, noise from this seed."""
    return [casid.Experiment(simulate(F_c=0.0, F_0=0.0, seed=seed), {}, "drawn")]


problem = casid.Problem(
    name="emps",
    model=rail_model(),
    channels={"q": "q_meas_m:m", "force": "force_N:N"},
    time="t_s",
    example=example,
    simulate=draw,
    truth={"M": 95.0, "F_v": 200.0},
    description="Motor-driven cart on a rail; position and drive force, in closed loop.",
    references=(
        "A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS, Workshop on "
        "Nonlinear System Identification Benchmarks, Eindhoven 2019",
    ),
)
