"""Refits find large effects although they have carried the model as it is far away.

The roll axis of a quadrotor under its controller. The command is all that is simulated from, and
what the model misses adds up twice: its error is a hundred times the noise.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.search.rounds import Search, shortlist
from casid.diagnosis.solvers import NEAR
from casid.diagnosis.thresholds import REFITS
from casid.estimation.nlp.solution import Evaluation
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.actuator_effects import actuator_lag
from tests.support.hidden_forces import RECORDED, fitted

TS, INERTIA, GAIN, DAMPING, LAG = 0.01, 0.012, 0.9, 0.02, 0.03  # s, kg m^2, N m, N m s/rad, s
NOISE = {"angle": math.radians(0.1), "rate": 0.01}  # rad, rad/s


def flight(*, drag: float = 0.0, torque: float = 0.0, seed: int = 0) -> casid.Record:
    """24 s by Runge-Kutta: random steps of the angle; a missing torque -drag |p| p + torque."""
    rng = np.random.default_rng(seed)
    N, h = 2400, TS / 10
    wanted = np.repeat(np.radians(rng.uniform(-25, 25, 24)), 100)

    def slope(x: np.ndarray, command: float) -> np.ndarray:
        moment = GAIN * x[2] - DAMPING * x[1] - drag * abs(x[1]) * x[1] + torque
        return np.array([x[1], moment / INERTIA, (command - x[2]) / LAG])

    x, columns = np.zeros(3), np.empty((N, 3))
    for k in range(N):
        angle = x[0] + NOISE["angle"] * rng.standard_normal()
        rate = x[1] + NOISE["rate"] * rng.standard_normal()
        command = float(np.clip(0.4 * (wanted[k] - angle) - 0.08 * rate, -0.35, 0.35))
        columns[k] = command, angle, rate
        for _ in range(10):
            k1 = slope(x, command)
            k2 = slope(x + 0.5 * h * k1, command)
            k3 = slope(x + 0.5 * h * k2, command)
            k4 = slope(x + h * k3, command)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    units = {"command": "1", "angle": "rad", "rate": "rad/s"}
    return casid.Record(dict(zip(units, columns.T, strict=True)), units, Ts=TS)


def roll_axis() -> casid.Problem:
    m = casid.Model("roll axis")
    u = m.input("command", "1", hold="zoh", known=True)
    phi, p, motor = m.state("phi", "rad"), m.state("p", "rad/s"), m.state("motor", "1")
    J = m.parameter("J", "kg m^2", value=INERTIA)
    k = m.parameter("k_t", "N m", start=0.5, lower=0.01, upper=20.0)
    d = m.parameter("d", "N m s/rad", start=0.05, lower=0.0, upper=1.0)
    tau = m.parameter("tau", "s", start=0.05, lower=0.002, upper=0.2)  # J / d is as good
    m.derivative(phi, p)
    m.balance(p, "roll", inertia=J, terms=[k * motor, -d * p])
    m.derivative(motor, (u - motor) / tau)
    m.output("angle", phi, "rad")
    m.output("rate", p, "rad/s")
    return casid.Problem("roll axis", m)


def test_a_start_that_leads_to_a_minimum_found_before_is_not_followed_to_its_end() -> None:
    """Drag from twice its linearised size: the same minimum, to what a refit leaves of a step."""
    at, experiments = fitted("quadratic damping", 3)
    weighing = Weighing(experiments, known_noise={"F": 0.02})
    refitting = Refitting(weighing)
    scores = shortlist(at, Search(weighing, RECORDED).table(at, []))
    (score,) = (s for s in scores if s.effect.key == ("quadratic_damping", "force"))
    effect = score.effect
    found = refitting.refit(at, effect, score.step)
    assert found is not None
    starts = {effect.parameters[0].name: 2 * score.step}
    passes: list[int] = []
    evaluated = SimulationError._evaluate

    def counted(self: SimulationError, x: np.ndarray) -> Evaluation:
        passes[-1] += 1
        return evaluated(self, x)

    for best in (None, found):
        passes.append(0)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(SimulationError, "_evaluate", counted)
            other = refitting._from(at, effect, starts, None, at.fit.values, best=best)
        assert (other is found) == (best is found)
        assert other.gain == pytest.approx(found.gain, rel=1e-3)
    assert passes[1] < passes[0]


def test_a_step_that_leads_away_is_shortened() -> None:
    """Drag from 10 000 times its linearised size: the simulation diverges within a second."""
    at, experiments = fitted("quadratic damping", 3)
    weighing = Weighing(experiments, known_noise={"F": 0.02})
    scores = shortlist(at, Search(weighing, RECORDED).table(at, []))
    (score,) = (s for s in scores if s.effect.key == ("quadratic_damping", "force"))
    refitting = Refitting(weighing)
    near, far = (refitting.refit(at, score.effect, k * score.step) for k in (1, 1e4))
    assert near is not None
    assert far is not None
    assert far.gain == pytest.approx(near.gain, rel=1e-3)
    assert not refitting.attempts.failed


@pytest.mark.slow
def test_a_large_drag_is_named_and_sized_from_where_the_user_would_start() -> None:
    found = casid.diagnose(roll_axis(), flight(drag=0.02, seed=1), advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("quadratic_damping", "roll")]
    size = found.causes[0].parameters[0]
    assert size.std_error is not None
    assert size.value == pytest.approx(0.02, abs=4 * size.std_error)


@pytest.mark.slow
def test_a_constant_torque_is_named_although_no_parameter_is_determined_without_it() -> None:
    found = casid.diagnose(roll_axis(), flight(torque=0.02), advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("offset", "roll")]
    size = found.causes[0].parameters[0]
    assert size.std_error is not None
    assert size.value == pytest.approx(0.02, abs=4 * size.std_error)


@pytest.mark.slow
def test_nothing_is_found_in_the_flight_of_the_model_itself() -> None:
    assert casid.diagnose(roll_axis(), flight(), advise=False).verdict == "adequate"


LAG_OF_PUSH = 0.6  # s


def pushed_sledge(**settings: object) -> tuple[Refitting, Weighted]:
    """A push that reaches a sledge through a lag, and the model without the lag at its noise."""
    Ts, N, mass, drag, noise = 0.1, 600, 5.0, 2.0, 0.01
    rng = np.random.default_rng(4)
    push = np.repeat(rng.uniform(-10, 10, N // 20), 20)
    A = np.array([[-drag / mass, 1 / mass], [0.0, -1 / LAG_OF_PUSH]])
    step = expm(np.block([[A, np.array([[0.0], [1 / LAG_OF_PUSH]])], [np.zeros((1, 3))]]) * Ts)
    x, v = np.array([0.0, push[0]]), np.empty(N)
    for k in range(N):
        v[k] = x[0] + noise * rng.standard_normal()
        x = step[:2, :2] @ x + step[:2, 2] * push[k]
    m = casid.Model("sledge")
    F, speed = m.input("F", "N", hold="zoh", known=True), m.state("v", "m/s")
    d = m.parameter("d", "N s/m", start=1.5, lower=0.0, upper=100.0)
    inertia = m.parameter("M", "kg", start=4.0, lower=0.1, upper=100.0)
    m.balance(speed, "force", inertia=inertia, terms=[F, -d * speed])
    m.output("v", speed, "m/s")
    record = casid.Record({"F": push, "v": v}, {"F": "N", "v": "m/s"}, Ts=Ts)
    experiments = [casid.Experiment(record, {}, "push")]
    weighing = Weighing(experiments)
    at = weighing.weigh(m, fit_model(m, experiments, FitSettings(starts=1)))
    return Refitting(replace(weighing, **settings)), at


def test_a_lag_that_is_longer_than_its_start_leaves_room_for_is_found_all_the_same() -> None:
    """A lag of 0.6 s, searched from a twentieth of that."""
    refitting, at = pushed_sledge()
    found = refitting.refit(at, actuator_lag(at.model, "F", longest=3.0), 0.03, near=True)
    assert found is not None
    assert found.fit.values["tau_F"] == pytest.approx(LAG_OF_PUSH, rel=0.05)
    assert found.fit.solution.at_upper == ()


def test_the_model_of_a_lag_has_room_for_twice_what_was_found_up_to_the_longest() -> None:
    """A thermometer of 0.6 s was held at the 0.53 s that its refit had ended below."""
    refitting, at = pushed_sledge()
    for longest, upper in ((3.0, 2 * LAG_OF_PUSH), (0.7, 0.7)):
        effect = actuator_lag(at.model, "F", longest=longest)
        found = refitting.refit(at, effect, 0.3, near=True)
        assert found is not None
        assert 0.95 * upper <= found.model.parameters["tau_F"].upper <= longest


def test_candidates_are_refitted_to_where_nothing_is_left_to_decide() -> None:
    """Each of the two fits within 1e-5 of the criterion of one to the end, or twice that."""
    gains = []
    for solver in (NEAR, None):
        refitting, at = pushed_sledge(solver=solver)
        found = refitting.refit(at, actuator_lag(at.model, "F", longest=3.0), 0.3)
        assert found is not None
        gains.append(found.gain)
    room = 2 * 2 * REFITS.enough * at.fit.solution.value
    assert gains[1] == pytest.approx(gains[0], abs=room)


def test_a_refit_that_ends_above_the_model_without_its_effect_is_none() -> None:
    """The push counts as noisy: less what noise leaves of a diverging simulation, it would gain."""
    refitting, at = pushed_sledge(solver=replace(NEAR, max_iterations=1))
    at = replace(at, input_sd={"F": 20.0})
    slip = casid.balance_effect(
        "slip", "force", lambda s: s.c * s.v**2, parameter="c", unit="N s^2/m^2"
    )
    near = refitting._from(at, slip, {"c": 0.0}, None, at.fit.values)
    assert near.fit.solution.value <= at.fit.solution.value
    with np.errstate(all="ignore"), pytest.raises(casid.SolveError, match="farther from the rec"):
        refitting._from(at, slip, {"c": 0.2}, None, at.fit.values)
