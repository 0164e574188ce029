"""Teeth are counted from the whitened residual of a model that leaves them out."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.records.signal_sizes import sizes_of
from casid.diagnosis.evidence.residual.cogging_periods import cogging_candidates, pitches_of
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.thresholds import COGGING
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.effect import Motion, Sizes
from casid.model.effects.places.place import balance_place

Ts, N, J, B = 0.004, 1500, 2e-4, 2e-4
TEETH = 9


def motor() -> casid.Model:
    m = casid.Model("motor")
    angle, w = m.state("angle", "rad", initial=0.0), m.state("w", "rad/s", start=10.0)
    torque = m.input("torque", "N m", known=True, hold="zoh")
    j, b = m.parameter("J", "kg m^2", start=1.5e-4), m.parameter("b", "N m s/rad", start=1e-4)
    m.derivative(angle, w)
    m.balance(w, "shaft", inertia=j, terms=[torque, -b * w])
    m.output("tacho", w, "rad/s")
    return m


def experiment(amplitude: float) -> casid.Experiment:
    """Five Runge-Kutta steps a sample of the equation of motion, 0.02 rad/s of noise."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(1e-3, 3e-3, N // 150), 150)
    s, out = np.array([0.0, 10.0]), []

    def rates(s: np.ndarray, torque: float) -> np.ndarray:
        teeth = amplitude * np.sin(TEETH * s[0] + 0.7)
        return np.array([s[1], (torque - B * s[1] - teeth) / J])

    h = Ts / 5
    for torque in u:
        out.append(s[1])
        for _ in range(5):
            k1 = rates(s, torque)
            k2 = rates(s + h / 2 * k1, torque)
            k3 = rates(s + h / 2 * k2, torque)
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(s + h * k3, torque))
    tacho = np.array(out) + 0.02 * rng.standard_normal(N)
    units = {"torque": "N m", "tacho": "rad/s"}
    record = casid.Record({"torque": u, "tacho": tacho}, units, Ts=Ts)
    return casid.Experiment(record, {}, "run")


def candidates(amplitude: float):
    data, model = [experiment(amplitude)], motor()
    fit = fit_model(model, data, FitSettings(starts=1))
    at = Weighing(data).weigh(model, fit, rounds=1)
    return cogging_candidates(at, sizes_of(at, {}))


def test_the_teeth_of_a_rotor_are_counted():
    found = candidates(1e-3)
    assert [c.effect.where for c in found] == ["shaft"]
    assert 2 * np.pi / found[0].effect.constants["pitch"] == pytest.approx(TEETH)
    assert found[0].p_value < 1e-6
    size = np.hypot(*found[0].starts.values()) / COGGING.start
    assert size == pytest.approx(1e-3, rel=0.3)  # linear in an amplitude that moves the rotor


def test_a_smooth_rotor_has_no_teeth():
    assert candidates(0.0) == []


def test_what_does_not_turn_round_is_not_searched_for_teeth():
    place = balance_place(motor(), "shaft")
    sizes = Sizes({"angle": 1.0, "w": 2.0}, {}, (0.0, 6.0), 0.1, Ts=Ts)
    assert len(pitches_of(place, Motion(1.0, -1.5, 1.5, 0.0), sizes)) == 0
    assert len(pitches_of(place, Motion(20.0, -40.0, 40.0, 0.0), sizes)) > 10
