"""An effect that leads every window of an unstable model astray is refitted from a part of each."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.diagnosis.evidence.records.unstable_records import records_in_windows
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.balances.balance_effects import coulomb_friction

TS, N, FRICTION = 0.02, 1500, 1.5  # s, samples, N m
L1, G = 0.5, 9.81
I1, I2, S1, S2, M2 = 0.5056, 0.1996, 1.44, 0.72, 4.0


def moved(_: float, x: np.ndarray, torque: np.ndarray) -> list[float]:
    """The arm, whose elbow has dry friction."""
    q1, q2, w1, w2 = x
    a, h = I1 + M2 * L1**2 + I2, S2 * L1
    fore = S2 * G * np.cos(q1 + q2)
    mass = np.array([[a + 2 * h * np.cos(q2), I2 + h * np.cos(q2)], [I2 + h * np.cos(q2), I2]])
    turn = h * np.sin(q2)
    weight = (S1 + M2 * L1) * G * np.cos(q1) + fore
    right = [
        torque[0] + turn * (2 * w1 * w2 + w2**2) - weight - 1.2 * w1,
        torque[1] - turn * w1**2 - fore - 0.6 * w2 - FRICTION * np.tanh(w2 / 0.01),
    ]
    return [w1, w2, *np.linalg.solve(mass, right)]


def record(seed: int = 13) -> casid.Record:
    """A controller moves both joints to and fro, the arm falling out of its path without it."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 6.28, 6)

    def wanted(t: float) -> np.ndarray:
        first = 0.7 * np.sin(0.9 * t + phase[0]) + 0.3 * np.sin(2.3 * t + phase[1])
        return np.array(
            [first, 0.8 * np.sin(1.3 * t + phase[2]) + 0.35 * np.sin(3.1 * t + phase[3])]
        )

    x, before, rows = np.array([*wanted(0.0), 0.0, 0.0]), None, []
    for k in range(N):
        angles = x[:2] + np.radians(0.02) * rng.standard_normal(2)
        error = wanted(k * TS) - angles
        rate = np.zeros(2) if before is None else (error - before) / TS
        torque, before = np.array([160.0, 70.0]) * error + np.array([14.0, 5.0]) * rate, error
        rows.append((*torque, *angles))
        step = solve_ivp(moved, (0, TS), x, "DOP853", rtol=1e-8, atol=1e-10, args=(torque,))
        x = step.y[:, -1]
    units = {"tau1": "N m", "tau2": "N m", "q1": "rad", "q2": "rad"}
    return casid.Record(dict(zip(units, np.array(rows).T, strict=True)), units, Ts=TS)


def arm() -> casid.Problem:
    m = casid.Model("two-link arm")
    t1, t2 = (m.input(n, "N m", hold="zoh", known=True) for n in ("tau1", "tau2"))
    q1, q2 = m.state("q1", "rad"), m.state("q2", "rad")
    w1, w2 = m.state("w1", "rad/s"), m.state("w2", "rad/s")
    first, second = (
        m.parameter(n, "kg m^2", start=s, lower=0.01) for n, s in (("I1", 0.4), ("I2", 0.3))
    )
    s1, s2 = (m.parameter(n, "kg m", start=s, lower=0.0) for n, s in (("S1", 1.2), ("S2", 0.9)))
    d1, d2 = (m.parameter(n, "N m s/rad", start=1.0, lower=0.0) for n in ("d1", "d2"))
    l1, g, m2 = m.constant("l1", L1, "m"), m.constant("g", G, "m/s^2"), m.constant("m2", M2, "kg")
    h, a = s2 * l1, first + m2 * l1**2
    both, turn, fore = second + h * ca.cos(q2), h * ca.sin(q2), s2 * g * ca.cos(q1 + q2)
    weight = (s1 + m2 * l1) * g * ca.cos(q1) + fore
    m.derivative(q1, w1)
    m.derivative(q2, w2)
    m.balance(
        w1,
        "shoulder",
        inertia=a + second + 2 * h * ca.cos(q2),
        terms=[t1, -both * m.der(w2), turn * (2 * w1 * w2 + w2**2), -weight, -d1 * w1],
    )
    m.balance(
        w2,
        "elbow",
        inertia=second,
        terms=[t2, -both * m.der(w1), -turn * w1**2, -fore, -d2 * w2],
    )
    m.output("q1", q1, "rad")
    m.output("q2", q2, "rad")
    return casid.Problem("arm", m)


@pytest.mark.slow
def test_dry_friction_that_leads_every_window_astray_is_fitted_to_the_noise() -> None:
    """The model without it errs by 6 degrees over a window, three hundred times the noise.

    From there a refit of the right law ended at 0.8 N m.
    """
    problem = arm()
    split, settings = (
        split_records([casid.Experiment(record(), {}, "r")], 0.3),
        FitSettings(starts=1),
    )
    cut = records_in_windows(problem.model, split, settings, lambda _: None)
    fit = fit_model(problem.model, cut.split.fitted, settings, start=cut.start)
    weighing = Weighing(cut.split.fitted)
    at = weighing.weigh(problem.model, fit)
    effect = coulomb_friction(at.model, "elbow", speed=0.05)
    found = Refitting(weighing).refit(at, effect, 1.0)
    assert found is not None
    assert found.fit.values[found.names[0]] == pytest.approx(FRICTION, rel=0.03)
    assert found.fit.solution.value < 1e-2 * at.fit.solution.value
