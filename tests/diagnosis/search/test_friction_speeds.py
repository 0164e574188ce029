"""Dry friction reverses as sharply as the record shows, so that its size is not biased."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid

TS, FRICTION, SHARP = 0.005, 0.8, 0.015  # s, N, m/s


def slider() -> casid.Problem:
    m = casid.Model("slider")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=True)
    mass = m.parameter("m", "kg", start=1.5, lower=0.1)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    k = m.parameter("k", "N/m", start=15.0, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[F, -d * v, -k * x])
    m.output("position", x, "m")
    return casid.Problem("slider", m, noise={"position": 2e-4})


def record() -> casid.Record:
    """By SciPy: slow and fast motion, friction that reverses within 15 mm/s."""
    rng = np.random.default_rng(1)
    t = TS * np.arange(2400)
    F = 4.0 * np.sin(2 * np.pi * 0.41 * t) + 3.0 * np.sin(2 * np.pi * 0.13 * t)

    def slope(_: float, s: np.ndarray, force: float) -> list[float]:
        return [s[1], force - 0.6 * s[1] - 12.0 * s[0] - FRICTION * np.tanh(s[1] / SHARP)]

    state, x = np.zeros(2), np.empty(t.size)
    for i, force in enumerate(F):
        x[i] = state[0]
        found = solve_ivp(slope, (0.0, TS), state, "LSODA", args=(force,), rtol=1e-7, atol=1e-9)
        state = found.y[:, -1]
    x += 2e-4 * rng.standard_normal(t.size)
    return casid.Record({"position": x, "F": F}, {"position": "m", "F": "N"}, TS)


def test_the_size_of_dry_friction_is_within_its_error_and_nothing_is_invented():
    lines: list[str] = []
    found = casid.diagnose(slider(), record(), advise=False, progress=lines.append)
    assert [c.kind for c in found.causes] == ["coulomb_friction"]
    size = found.causes[0].parameters[0]
    assert size.std_error is not None
    assert size.value == pytest.approx(FRICTION, abs=4 * size.std_error)
    assert size.std_error < 0.02 * FRICTION
    assert any("reverses" in line for line in lines)
    assert found.model is not None
    assert found.model.causes[0].constants["speed"] == pytest.approx(SHARP, rel=0.1)
