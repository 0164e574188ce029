"""Friction that is other in each direction or falls with speed, against equations of motion."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.balances.balance_effects import cubic_damping, quadratic_stiffness
from casid.model.effects.balances.friction_effects import (
    asymmetric_coulomb,
    asymmetric_damping,
    hysteresis,
    stribeck_friction,
)
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import HYSTERESIS_SHAPE, Sizes
from casid.model.effects.search_ranges import HYSTERESIS

M, K, Ts, SPEED = 2.0, 50.0, 0.005, 0.02


def oscillator() -> casid.Model:
    m = casid.Model("oscillator")
    x, v = m.state("x", "m", initial=0.1), m.state("v", "m/s", initial=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[-m.constant("k", K, "N/m") * x])
    m.output("position", x, "m")
    return m


def missing(kind: str):
    """Effect, values of its parameters, and the force -R(x, v) as an equation writes it."""
    m = oscillator()
    return {
        "dry": (
            asymmetric_coulomb(m, "force", SPEED),
            (0.4,),
            lambda x, v: -0.4 * math.tanh(v / SPEED) ** 2,
        ),
        "viscous": (asymmetric_damping(m, "force"), (1.5,), lambda x, v: -1.5 * abs(v)),
        "stribeck": (
            stribeck_friction(m, "force", SPEED, 0.1, 0.35),
            (0.6, 0.15),
            lambda x, v: -0.6 * math.tanh(v / SPEED) * math.exp(-((v / 0.15) ** 2)),
        ),
        "cubic": (cubic_damping(m, "force"), (3.0,), lambda x, v: -3.0 * v**3),
        "one-sided": (quadratic_stiffness(m, "force"), (80.0,), lambda x, v: -80.0 * x * x),
        "about": (
            quadratic_stiffness(m, "force", about=0.03),
            (80.0,),
            lambda x, v: -80.0 * (x - 0.03) ** 2,
        ),
    }[kind]


@pytest.mark.parametrize("kind", ["dry", "viscous", "stribeck", "cubic", "one-sided", "about"])
def test_the_extended_model_moves_as_the_equation_of_motion_does(kind: str):
    """Against LSODA's adaptive steps; RK4's errors at Ts are below 1e-5 of 0.1 m."""
    effect, values, force = missing(kind)
    model, names = effect.extended(oscillator())
    N = 600
    record = casid.Record({"position": np.zeros(N)}, {"position": "m"}, Ts=Ts)
    known = model.with_known(**dict(zip(names, values, strict=True)))
    criterion = SimulationError(known, [casid.Experiment(record, {}, "r")], weights=np.ones(1))
    y = criterion.simulate(criterion.start, 0)[0][:, 0]

    def rates(t, s):
        return [s[1], (-K * s[0] + force(*s)) / M]

    t = np.arange(N) * Ts
    truth = solve_ivp(
        rates, (0, t[-1]), [0.1, 0.0], t_eval=t, rtol=1e-9, atol=1e-12, method="LSODA"
    )
    free = 0.1 * np.cos(5.0 * t)
    assert y == pytest.approx(truth.y[0], abs=1e-5)
    assert np.max(np.abs(truth.y[0] - free)) > 1e-3


def test_the_decay_speed_is_known_while_nothing_shows_it_and_estimated_after():
    effect = stribeck_friction(oscillator(), "force", SPEED, 0.1, 0.35)
    null, names = effect.extended(oscillator())
    assert null.parameters[names[1]].is_known
    begun, _ = effect.extended(oscillator(), starts={"F_s": 0.2})
    assert not begun.parameters[names[1]].is_known


@pytest.mark.parametrize(("b", "n"), [(1.0, 1.0), (0.5, 2.0)])
def test_a_force_with_a_memory_moves_the_body_as_bouc_and_wen_write_it(b: float, n: float):
    """Dahl's friction and a loop with sharper corners, against LSODA's adaptive steps."""
    F, travel, N = 1.0, 0.02, 600
    effect = hysteresis(oscillator(), "force", 0.05, (0.001, 0.2))
    start = {"F_h": F, "x_h": travel, "b_h": b, "n_h": n}
    model, names = effect.extended(oscillator(), starts=start)
    model.states["z_h"] = dataclasses.replace(model.states["z_h"], initial=0.0)
    record = casid.Record({"position": np.zeros(N)}, {"position": "m"}, Ts=Ts)
    known = model.with_known(**dict(zip(names, (F, travel, b, n), strict=True)))
    criterion = SimulationError(known, [casid.Experiment(record, {}, "r")], weights=np.ones(1))
    y = criterion.simulate(criterion.start, 0)[0][:, 0]

    def rates(_t, s):
        x, v, z = s
        loop = b * abs(v) * abs(z) ** (n - 1) * z + (1 - b) * v * abs(z) ** n
        return [v, (-K * x - F * z) / M, (v - loop) / travel]

    t = np.arange(N) * Ts
    solved = solve_ivp(
        rates, (0, t[-1]), [0.1, 0, 0], t_eval=t, rtol=1e-9, atol=1e-12, max_step=Ts, method="LSODA"
    )
    assert y == pytest.approx(solved.y[0], abs=2e-5)
    assert np.max(np.abs(solved.y[0] - 0.1 * np.cos(5.0 * t))) > 0.01


def test_a_memory_does_nothing_and_is_empty_without_its_force():
    model, names = hysteresis(oscillator(), "force", 0.05, (0.001, 0.2)).extended(oscillator())
    assert [model.parameters[n].is_known for n in names] == [False, True, True, True]
    assert model.states["z_h"].initial == 0.0
    there, _ = hysteresis(oscillator(), "force", 0.05, (0.001, 0.2)).extended(
        oscillator(), starts={"F_h": 1.0}
    )
    assert there.states["z_h"].initial is None


def test_a_travel_within_one_sample_is_dry_friction_and_no_hysteresis():
    """RK4 would need shorter steps for it than the fastest motion of the record has."""
    m = oscillator()
    sizes = Sizes({"x": 0.1, "v": 0.5}, {}, (0.0, 10.0), 0.1, Ts=0.005)
    coarse = dataclasses.replace(sizes, Ts=2.0)
    found = [
        [e for e in catalogue(m, s, {}) if e.shape == HYSTERESIS_SHAPE] for s in (sizes, coarse)
    ]
    assert [e.variant for e in found[0]] == sorted(e.variant for e in found[0])
    assert len(found[0]) == len(HYSTERESIS.starts)
    assert found[1] == []


def test_a_rate_without_a_position_has_no_hysteresis():
    m = casid.Model("shaft")
    w = m.state("w", "rad/s")
    m.balance(w, "torque", inertia=1.0, terms=[-m.parameter("d", "N m s/rad") * w])
    m.output("speed", w, "rad/s")
    assert hysteresis(m, "torque", 0.1, (0.01, 2.0)) is None
