"""A jump that shows as a ringing alone is sought at instants nearer each other than its period."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.instants.jump_times import placed_by_refits
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.parameter_effects import parameter_jump

TS, N, SNAP = 0.02, 6000, 60.0
WHEEL, MOTOR, DAMPING, STIFFNESS, CRACKED = 2.0, 0.5, 4.0, 600.0, 420.0
"""The shaft swings at 6.2 Hz and rings for 0.3 s; its torque turns it by 0.7 rad on average."""


def turned() -> casid.Record:
    """120 s of two speeds, exact for held torques; from 60 s on the shaft is softer."""
    rng = np.random.default_rng(3)
    motor = 400.0 + 4.0 * np.repeat(rng.standard_normal(N // 20), 20)
    load, noise = 400.0 * np.ones(N), rng.standard_normal((N, 2))
    steps = []
    for k in (STIFFNESS, CRACKED):
        A = [
            [0.0, 1.0, -1.0],
            [-k / MOTOR, -DAMPING / MOTOR, DAMPING / MOTOR],
            [k / WHEEL, DAMPING / WHEEL, -DAMPING / WHEEL - 2.0 / WHEEL],
        ]
        B = [[0.0, 0.0], [1 / MOTOR, 0.0], [0.0, -1 / WHEEL]]
        steps.append(expm(TS * np.block([[np.array(A), np.array(B)], [np.zeros((2, 5))]])))
    x, rows = np.array([400.0 / STIFFNESS, 0.0, 0.0]), np.empty((N, 4))
    for i in range(N):
        rows[i] = motor[i], load[i], *(x[1:] + 2.0 * noise[i])
        x = (steps[i * TS >= SNAP] @ np.array([*x, motor[i], load[i]]))[:3]
    units = {"motor": "N m", "load": "N m", "fast": "rad/s", "slow": "rad/s"}
    return casid.Record(dict(zip(units, rows.T, strict=True)), units, Ts=TS)


def shaft() -> casid.Model:
    m = casid.Model("shaft")
    twist = m.state("twist", "rad", start=400.0 / STIFFNESS)
    fast, slow = m.state("w", "rad/s"), m.state("v", "rad/s")
    motor, load = (m.input(n, "N m", hold="zoh", known=True) for n in ("motor", "load"))
    k = m.parameter("k", "N m/rad", start=500.0, lower=1.0, upper=1e4)
    d = m.parameter("d", "N m s/rad", start=3.0, lower=0.0, upper=100.0)
    drag = m.parameter("drag", "N m s/rad", start=1.0, lower=0.0, upper=100.0)
    m.derivative(twist, fast - slow)
    m.balance(fast, "motor", inertia=MOTOR, terms=[motor, -k * twist, -d * (fast - slow)])
    terms = [k * twist, d * (fast - slow), -drag * slow, -load]
    m.balance(slow, "wheel", inertia=WHEEL, terms=terms)
    m.output("fast", fast, "rad/s")
    m.output("slow", slow, "rad/s")
    return m


@pytest.mark.parametrize("near", [49.0, 55.7, 68.0])
def test_the_snap_of_a_shaft_is_placed_though_its_ringing_is_over_between_two_instants(near):
    """The first scan has one every 0.28 s, almost two periods; coarse scores are 4 to 11 s off."""
    experiments = [casid.Experiment(turned())]
    fit = fit_model(shaft(), experiments, FitSettings(starts=1), throw=False)
    weighing = Weighing(experiments)
    at = weighing.weigh(fit.criterion.model, fit)
    refitting = Refitting(weighing)
    found = refitting.refit(at, parameter_jump(at.model, "k", near), CRACKED - STIFFNESS)
    assert found is not None
    placed = placed_by_refits(refitting, at, found, [])
    assert placed.effect.constants["time"] == pytest.approx(SNAP, abs=TS)
