"""Cogging acts as its equation says, and its period is known where teeth are counted in a turn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.balances.cogging_effects import cogging

Ts, N, J, B = 0.005, 400, 2e-4, 2e-4
TEETH, A, PHASE = 12, 2e-3, 0.4


def motor() -> casid.Model:
    m = casid.Model("motor")
    angle, w = m.state("angle", "rad", initial=0.0), m.state("w", "rad/s", initial=8.0)
    m.derivative(angle, w)
    b = m.constant("b", B, "N m s/rad")
    m.balance(w, "torque", inertia=m.constant("J", J, "kg m^2"), terms=[-b * w])
    m.output("angle_measured", angle, "rad")
    return m


def test_a_rotor_coasts_over_its_teeth_as_the_equation_of_motion_says():
    pitch = 2 * np.pi / TEETH
    effect = cogging(motor(), "torque", pitch, 20.0)
    assert effect is not None
    extended, names = effect.extended(motor())
    amplitudes = {names[0]: A * np.cos(PHASE), names[1]: -A * np.sin(PHASE)}
    record = casid.Record({"angle_measured": np.zeros(N)}, {"angle_measured": "rad"}, Ts=Ts)
    c = SimulationError(
        extended.with_known(**amplitudes), [casid.Experiment(record, {}, "r")], weights=np.ones(1)
    )
    y = c.simulate(c.start, 0)[0][:, 0]

    def rates(t, s):
        return [s[1], (-B * s[1] + A * np.cos(TEETH * s[0] + PHASE)) / J]

    t = np.arange(N) * Ts
    truth = solve_ivp(rates, (0, t[-1]), [0.0, 8.0], t_eval=t, rtol=1e-9, atol=1e-11).y[0]
    smooth = 8.0 * J / B * -np.expm1(-B / J * t)
    assert y == pytest.approx(truth, abs=1e-3)
    assert np.max(np.abs(truth - smooth)) > 0.05


def test_teeth_in_a_turn_have_a_known_pitch_and_others_are_estimated_near_theirs():
    known = cogging(motor(), "torque", 2 * np.pi / TEETH, 20.0)
    free = cogging(motor(), "torque", 0.5, 20.0)
    assert known is not None
    assert free is not None
    assert known.parameters[2].value == pytest.approx(2 * np.pi / TEETH)
    p = free.parameters[2]
    assert p.value is None
    assert (p.lower, p.upper) == pytest.approx((0.5 - 0.25 / 40, 0.5 + 0.25 / 40))
