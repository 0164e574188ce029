"""A part that swings between two bodies, and moves when the record begins: by SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid

TS, N = 0.01, 1500
J1, J2, STIFFNESS, DAMPER, LOSS = 0.01, 0.02, 30.0, 0.03, 0.02
J, OMEGA, ZETA = 0.004, 6.0, 0.05
SD = {"speed": 0.05, "twist": 2e-4}


def drive() -> casid.Problem:
    m = casid.Model("drive")
    torque = m.input("torque", "N m", hold="zoh", known=True)
    w1, w2, e = m.state("w1", "rad/s"), m.state("w2", "rad/s"), m.state("e", "rad")
    first = m.parameter("J1", "kg m^2", start=0.012, lower=1e-3, upper=0.1)
    second = m.parameter("J2", "kg m^2", start=0.02, lower=1e-3, upper=0.1)
    k = m.parameter("k", "N m/rad", start=28.0, lower=1.0, upper=300.0)
    c = m.parameter("c", "N m s/rad", start=0.02, lower=0.0, upper=1.0)
    d = m.parameter("d", "N m s/rad", start=0.02, lower=0.0, upper=1.0)
    shaft = k * e + c * (w1 - w2)
    m.derivative(e, w1 - w2)
    m.balance(w1, "motor", inertia=first, terms=[torque, -shaft, -d * w1])
    m.balance(w2, "load", inertia=second, terms=[shaft])
    m.output("speed", w1, "rad/s")
    m.output("twist", e, "rad")
    return casid.Problem("drive", m)


def record() -> casid.Record:
    """Two inertias, an elastic shaft, and a part on it that swings from two seconds before on."""
    rng, before = np.random.default_rng(5), 200
    torque = np.repeat(rng.uniform(-0.4, 0.4, (N + before) // 25 + 1), 25)[: N + before]

    def rate(_: float, z: np.ndarray, u: float) -> list[float]:
        w1, w2, e, q, v = z
        spring = OMEGA**2 * q + 2 * ZETA * OMEGA * v
        shaft = STIFFNESS * e + DAMPER * (w1 - w2) - J * spring
        first, second = (u - shaft - LOSS * w1) / J1, shaft / J2
        return [first, second, w1 - w2, v, -spring - (first - second)]

    z, rows = np.zeros(5), np.empty((N + before, 2))
    for k in range(N + before):
        rows[k] = z[0], z[2]
        z = solve_ivp(rate, (0.0, TS), z, args=(torque[k],), rtol=1e-8, atol=1e-12).y[:, -1]
    y = rows[before:] + rng.standard_normal((N, 2)) * list(SD.values())
    channels = {"torque": torque[before:], "speed": y[:, 0], "twist": y[:, 1]}
    return casid.Record(channels, {"torque": "N m", "speed": "rad/s", "twist": "rad"}, Ts=TS)


@pytest.mark.slow
def test_a_part_between_two_bodies_is_named_alone_and_sized_within_its_errors() -> None:
    found = casid.diagnose(drive(), record(), advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("missing_mode", "w1-w2")
    truth = {"J_m": J, "omega_m": OMEGA, "zeta_m": ZETA}
    sizes = {p.name: p for p in cause.parameters}
    for name, true in truth.items():
        size = sizes[name]
        assert size.std_error is not None
        assert size.value == pytest.approx(true, abs=4 * size.std_error)
        assert size.std_error < 0.25 * true
