"""Free roll decay of a ship model: a linear oscillator about its mean heel.

    phi'' = -B_1 phi' - C_1 (phi - phi_0)                                                     (1)

per unit of inertia: the linear terms of the usual roll decay equation, with B_1 = B_1A and
C_1 = C_1A of Alexandersson (2020, doi 10.17632/2stvkyngj9.1). The undamped roll frequency is
sqrt(C_1). The starts suit that author's measurements: the tanker KVLCC2 at 1:68 (SSPA), roll angle
at 100 Hz, released from a held heel. The window of a record starts after the release.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import casid


def decay_model() -> casid.Model:
    """(1), torques divided by the inertia."""
    m = casid.Model("free roll decay")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    B_1 = m.parameter("B_1", "1/s", start=0.02, lower=0.0, upper=5.0)
    C_1 = m.parameter("C_1", "1/s^2", start=6.1, lower=0.01, upper=400.0)
    phi_0 = m.parameter("phi_0", "rad", start=0.0, lower=-0.5, upper=0.5)
    m.derivative(phi, p)
    m.balance(p, "torque", inertia=1, terms=[-B_1 * p, -C_1 * phi, C_1 * phi_0], unit="rad/s^2")
    m.output("phi", phi, "rad")
    return m


def simulate(
    *,
    phi_start: float = 0.16,
    duration: float = 60.0,
    B_1: float = 0.012,
    B_2: float = 0.07,
    C_1: float = 6.06,
    C_3: float = 4.0,
    noise: float = 2e-4,
    seed: int = 2,
) -> casid.Record:
    """A decay from `phi_start` [rad] at rest, sampled at 50 Hz, with white noise [rad].

    `B_2` [1/rad] is damping by drag, `C_3` [1/(s^2 rad^2)] hardening of the restoring moment.
    """
    Ts, substeps = 0.02, 4
    N, h = round(duration / Ts), Ts / substeps

    def rates(x: NDArray[np.float64]) -> NDArray[np.float64]:
        phi, p = x
        return np.array([p, -(B_1 + B_2 * abs(p)) * p - (C_1 + C_3 * phi**2) * phi])

    x, phi = np.array([phi_start, 0.0]), np.empty(N)
    for i in range(N):
        phi[i] = x[0]
        for _ in range(substeps):
            k1 = rates(x)
            k2 = rates(x + h / 2 * k1)
            k3 = rates(x + h / 2 * k2)
            k4 = rates(x + h * k3)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    phi += noise * np.random.default_rng(seed).standard_normal(N)
    return casid.Record(
        {"phi": phi},
        {"phi": "rad"},
        Ts=Ts,
        name="example",
        provenance=(f"simulated by problems/roll_decay.py, seed {seed}",),
    )


def example() -> list[casid.Experiment]:
    """One minute of decay from 9 degrees, with what ships have and (1) leaves out."""
    return [casid.Experiment(simulate(), {}, "example")]


def draw(seed: int) -> list[casid.Experiment]:
    """One minute of decay as (1) has it, with noise from this seed."""
    return [casid.Experiment(simulate(B_2=0.0, C_3=0.0, seed=seed), {}, "drawn")]


problem = casid.Problem(
    name="roll_decay",
    model=decay_model(),
    channels={"phi": "phi_rad:rad"},
    time="t_s",
    example=example,
    simulate=draw,
    truth={"B_1": 0.012, "C_1": 6.06, "phi_0": 0.0},
    description="Free roll decay of a ship model at rest, released from a held heel.",
    references=(
        "M. Alexandersson, roll decay tests of KVLCC2 at SSPA, doi 10.17632/2stvkyngj9.1, 2020",
    ),
)
