"""What slides in a plane is braked along its path, not along each axis by itself."""

from __future__ import annotations

import numpy as np
import pytest

import casid

TS, N, MASS, STIFFNESS, DAMPING, FRICTION, NOISE = 0.02, 1000, 2.0, 9.0, 0.8, 1.5, 2e-3  # SI


def table() -> casid.Problem:
    """A body on springs that two forces push about on a table."""
    m = casid.Model("table")
    F, G = m.input("F", "N", known=True), m.input("G", "N", known=True)
    x, y, v, w = m.state("x", "m"), m.state("y", "m"), m.state("v", "m/s"), m.state("w", "m/s")
    mass = m.parameter("m", "kg", start=1.5, lower=0.1, upper=20.0)
    d = m.parameter("d", "N s/m", start=0.5, lower=0.0, upper=20.0)
    k = m.parameter("k", "N/m", start=8.0, lower=0.0, upper=100.0)
    m.derivative(x, v)
    m.derivative(y, w)
    m.balance(v, "along", inertia=mass, terms=[F, -d * v, -k * x])
    m.balance(w, "across", inertia=mass, terms=[G, -d * w, -k * y])
    m.output("px", x, "m")
    m.output("py", y, "m")
    return casid.Problem("table", m)


def record() -> casid.Record:
    """The friction opposes the velocity, with the same size in every direction."""
    rng, h = np.random.default_rng(3), TS / 20
    t = np.arange(N) * TS
    frequencies = np.linspace(0.5, 6.0, 20)
    forces = np.array(
        [
            1.2 * np.cos(np.outer(t, frequencies) + rng.uniform(0, 2 * np.pi, 20)).sum(axis=1)
            for _ in range(2)
        ]
    )
    s, path = np.zeros(4), np.empty((N, 2))
    for k in range(N):
        path[k] = s[:2]
        for j in range(20):
            f = forces[:, k] + (forces[:, min(k + 1, N - 1)] - forces[:, k]) * (j + 0.5) / 20
            q, v = s[:2], s[2:]
            brake = FRICTION * v / np.sqrt(v @ v + 1e-6)
            v = v + h * (f - DAMPING * v - STIFFNESS * q - brake) / MASS
            s = np.r_[q + h * v, v]
    path = path + NOISE * rng.standard_normal((N, 2))
    channels = {"F": forces[0], "G": forces[1], "px": path[:, 0], "py": path[:, 1]}
    return casid.Record(channels, {"F": "N", "G": "N", "px": "m", "py": "m"}, Ts=TS)


@pytest.mark.slow
def test_friction_in_a_plane_is_one_force_along_the_path():
    """Within four standard errors, and 2 %: the record is made with steps of first order."""
    found = casid.diagnose(table(), record(), starts=1, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("coulomb_friction", "v and w")
    (size,) = cause.parameters
    assert abs(size.value - FRICTION) < 4 * size.std_error + 0.02 * FRICTION
