"""An accelerometer beyond the centre of percussion leaves an inertia of the other sign."""

from __future__ import annotations

import math

import numpy as np
import pytest

import casid
from casid.estimation.simulation.simulation_error import SimulationError
from casid.identification.inertia_sides import note_on_sides, other_side

M, L, Z, G = 42.0, 0.55, 0.8, 9.81
ZERO = M * L * Z
"""Inertia at which the sensor, Z below the pivot, sits at the centre of percussion [kg m^2]."""


def swing(inertia: float, N: int = 300, Ts: float = 0.02, seed: int = 2) -> casid.Record:
    """A boom under a vehicle whose acceleration nobody measures."""
    rng = np.random.default_rng(seed)
    fine, h = 10, Ts / 10
    t = h / 2 * np.arange(2 * N * fine + 1)
    push = sum(
        math.cos(phase) * np.sin(2 * math.pi * f * t + phase)
        for f, phase in zip(rng.uniform(0.2, 1.5, 8), rng.uniform(0, 6, 8), strict=True)
    )

    def rate(angle: float, w: float, a: float) -> float:
        return (-(M * G * L + 310.0) * angle - M * L * a - 9.0 * w) / inertia

    angle = w = 0.05
    rows = []
    for i in range(N * fine):
        a, b, c = push[2 * i : 2 * i + 3].tolist()
        k1 = rate(angle, w, a)
        if i % fine == 0:
            rows.append((angle, w, Z * k1 + G * angle + a))
        w2 = w + h / 2 * k1
        k2 = rate(angle + h / 2 * w, w2, b)
        w3 = w + h / 2 * k2
        k3 = rate(angle + h / 2 * w2, w3, b)
        w4 = w + h * k3
        k4 = rate(angle + h * w3, w4, c)
        angle += h / 6 * (w + 2 * w2 + 2 * w3 + w4)
        w += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    noise = np.array([1e-3, 4e-3, 0.02]) * rng.standard_normal((N, 3))
    angles, rates, accels = (np.array(rows) + noise).T
    units = {"angle": "rad", "gyro": "rad/s", "acc": "m/s^2"}
    return casid.Record({"angle": angles, "gyro": rates, "acc": accels}, units, Ts)


def boom(start: float) -> casid.Problem:
    m = casid.Model("boom under a vehicle")
    th, p = m.state("th", "rad"), m.state("p", "rad/s")
    a = m.unknown_input("a", "m/s^2")
    inertia = m.parameter("I", "kg m^2", start=start, lower=5.0, upper=80.0)
    d = m.parameter("d", "N m s/rad", start=5.0, lower=0.0, upper=200.0)
    k = m.parameter("k", "N m/rad", start=250.0, lower=0.0, upper=3000.0)
    m.derivative(th, p)
    m.balance(p, "torque", inertia=inertia, terms=[-(M * G * L + k) * th, -M * L * a, -d * p])
    m.output("angle", th, "rad")
    m.output("gyro", p, "rad/s")
    m.output("acc", Z * m.der(p) + G * th + a, "m/s^2")
    return casid.Problem("boom", m.eliminate(a, using="acc"), starts=1)


def test_the_other_side_begins_as_far_from_the_centre_of_percussion() -> None:
    record = [casid.Experiment(swing(16.5))]
    found = other_side(SimulationError(boom(20.0).model, record))
    assert found is not None
    assert found.parameter == "I"
    assert found.zero == pytest.approx(ZERO, rel=1e-9)
    assert found.start == pytest.approx(2 * ZERO - 20.0, rel=1e-9)
    (note,) = note_on_sides(boom(20.0), record)
    assert "at I = 18.48 kg m^2" in note
    assert "compare a fit with start=16.96, upper=18.48" in note
    (note,) = note_on_sides(boom(16.0), record)
    assert "I starts below it" in note
    assert "start=20.96, lower=18.48" in note


def test_no_inertia_vanishes_within_bounds_that_exclude_it() -> None:
    problem = casid.load_problem("problems/pendulum.py")
    assert note_on_sides(problem, problem.examples()) == ()
