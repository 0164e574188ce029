"""Fitted models without a fit: an extended model with given values, and a record to simulate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from casid.arrays import Array
from casid.data.problem import Problem
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.fitted.parts import AddedCause, Channels, FittedRecord, SimulationSettings
from casid.estimation.simulation.integration.simulator import Simulator
from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    cubic_stiffness,
    offset,
    quadratic_damping,
)
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.effect import Effect
from casid.model.model import Model
from problems.emps import problem as emps
from problems.pendulum import problem as pendulum
from problems.roll_decay import problem as roll_decay

MakeEffect = Callable[[Model], Effect | None]


@dataclass(frozen=True)
class Simulated:
    """A fitted model with what casid simulates: t (N,), inputs, y (N, ny), x (N + 1, nx)."""

    fitted: FittedModel
    t: Array
    inputs: Mapping[str, Array]
    y: Array
    x: Array

    @property
    def u(self) -> Array:
        """(N, nu) the inputs that are recorded."""
        return np.column_stack([*self.inputs.values(), np.zeros((len(self.t), 0))])


def fitted_model(
    problem: Problem,
    effects: Sequence[MakeEffect],
    values: Mapping[str, float],
    *,
    x0: Sequence[float],
    Ts: float,
    N: int,
    substeps: int = 1,
) -> FittedModel:
    """The model of a problem with effects in it, all parameters known."""
    model, causes = problem.model, []
    for make in effects:
        effect = make(model)
        assert effect is not None
        model, names = effect.extended(model)
        causes.append(AddedCause(effect.kind, effect.where, names))
    free = tuple(n for n, p in model.parameters.items() if not p.is_known)
    assert set(free) <= set(values)
    return FittedModel(
        name=problem.name,
        model=model.with_si_values(values),
        records=(FittedRecord("example", Ts, 0.0, N, {}, np.array([x0], dtype=float)),),
        covariance_names=free,
        covariance=1e-6 * np.eye(len(free)),
        causes=tuple(causes),
        settings=SimulationSettings(substeps, 1, np.ones(len(model.outputs))),
        channels=Channels(dict(problem.channels), dict(problem.recorded), {}, str(problem.time)),
    )


def driven_mass() -> Model:
    """A damped mass on a spring with a known force and a measured position."""
    m = Model("mass on a spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold="zoh", known=True)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0)
    k = m.parameter("k", "N/m", start=40.0, lower=0.0)
    mass = m.constant("m", 2.0, "kg")
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[-k * x, -d * v, force])
    m.output("position", x, "m")
    return m


def simulated(fitted: FittedModel, inputs: Mapping[str, Array] | None = None) -> Simulated:
    """Simulate a fitted model by casid's own simulator, inputs by default a random walk."""
    record, model = fitted.records[0], fitted.model
    t = record.t0 + record.Ts * np.arange(record.N)
    rng = np.random.default_rng(3)
    columns, recorded = [], {}
    for name, entry in model.inputs.items():
        if entry.signal is not None:
            columns.append(entry.signal(t))
            continue
        drawn = 0.1 * np.cumsum(rng.standard_normal(record.N))
        recorded[name] = inputs[name] if inputs else drawn
        columns.append(recorded[name])
    u = np.column_stack([*columns, np.zeros((record.N, 0))])
    simulator = Simulator(model, fitted.Ts, substeps=fitted.settings.substeps)
    p = np.array([fitted.values[name] for name in model.parameters])
    run = simulator.simulate(u, p, np.array(list(fitted.initial_states.values())))
    return Simulated(fitted, t, recorded, run.y, run.x)


@cache
def extended_pendulum() -> FittedModel:
    """The indirect pendulum with quadratic damping: an eliminated input."""
    return fitted_model(
        pendulum,
        [lambda m: quadratic_damping(m, "torque")],
        {"k": 10.37, "d": 0.105, "I_x": 0.1385, "d_2": 0.2},
        x0=(0.01, -0.02),
        Ts=0.01,
        N=400,
    )


@cache
def pendulum_alone() -> FittedModel:
    """The indirect pendulum without it."""
    values = {"k": 10.37, "d": 0.105, "I_x": 0.1385}
    return fitted_model(pendulum, [], values, x0=(0.01, -0.02), Ts=0.01, N=400)


@cache
def delayed_pendulum(samples: float) -> FittedModel:
    """The indirect pendulum whose gyro is late by some samples of 10 ms."""
    return fitted_model(
        pendulum,
        [lambda m: time_delay(m, "gyro", 0.1)],
        {"k": 10.37, "d": 0.105, "I_x": 0.1385, "delay_gyro": 0.01 * samples},
        x0=(0.01, -0.02),
        Ts=0.01,
        N=200,
    )


@cache
def extended_roll_decay() -> FittedModel:
    """The roll decay with quadratic damping and a hardening restoring moment: no input."""
    return fitted_model(
        roll_decay,
        [lambda m: quadratic_damping(m, "torque"), lambda m: cubic_stiffness(m, "torque")],
        {"B_1": 0.012, "C_1": 6.06, "phi_0": 0.001, "d_2": 0.07, "k_3": 4.0},
        x0=(0.16, 0.0),
        Ts=0.02,
        N=500,
    )


@cache
def extended_emps(N: int = 400) -> FittedModel:
    """The rail with dry friction and a constant force: fast near standstill, 4 steps a sample."""
    return fitted_model(
        emps,
        [lambda m: coulomb_friction(m, "force", 0.003), lambda m: offset(m, "force")],
        {"M": 95.1, "F_v": 203.5, "F_c": 20.4, "F_0": -3.2},
        x0=(0.0, 0.001),
        Ts=0.001,
        N=N,
        substeps=4,
    )


def with_steps(
    fitted: FittedModel, substeps: int, x0: Sequence[float] | None = None
) -> FittedModel:
    """The same model with other Runge-Kutta steps a sample, and another initial state."""
    record = fitted.records[0]
    if x0 is not None:
        record = replace(record, nodes=np.array([x0], dtype=float))
    settings = replace(fitted.settings, substeps=substeps)
    return replace(fitted, settings=settings, records=(record,))


def assert_same(found: Array, wanted: Array, eps: float = 1e-8) -> None:
    """Every column within eps of its largest value."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    assert found.shape == wanted.shape
    size = np.max(np.abs(wanted), axis=0)
    assert np.all(size > 0.0)
    assert np.all(np.abs(found - wanted) <= eps * size)
