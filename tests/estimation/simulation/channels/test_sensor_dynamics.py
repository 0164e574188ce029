"""What a late sensor makes of an output that steps with a held input.

At the sample on which the input steps a late sensor still gives what was before: the output less
its steps is interpolated, the steps are held.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.estimation.simulation.known_simulation import KnownSimulation
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.channel_effects import sensor_lag
from casid.model.effects.channels.delays import time_delay

N, TS, RATE = 300, 0.1, 2.0
U = np.repeat(np.random.default_rng(4).uniform(-1, 1, N // 3), 3)


def washout(hold: str = "zoh") -> casid.Model:
    """x' = a (u - x), y = u - x: what is quick in u reaches the output directly."""
    m = casid.Model("washout")
    u, x = m.input("u", "1", hold=hold, known=True), m.state("x", "1")
    a = m.parameter("a", "1/s", start=RATE, lower=0.1, upper=10.0)
    m.derivative(x, a * (u - x))
    m.output("y", u - x, "1")
    return m


def criterion_of(effect: str, hold: str = "zoh") -> tuple[SimulationError, str]:
    m = washout(hold)
    made = sensor_lag(m, "y", 1.0) if effect == "lag" else time_delay(m, "y", 1.0)
    model, (name,) = made.extended(m)
    record = casid.Record({"u": U, "y": np.zeros(N)}, {"u": "1", "y": "1"}, Ts=TS)
    return SimulationError(model, [casid.Experiment(record, {}, "r")], substeps=4), name


def states() -> np.ndarray:
    """(N,) exact: x[k+1] = u[k] + (x[k] - u[k]) exp(-a Ts)."""
    x = np.zeros(N)
    for k in range(N - 1):
        x[k + 1] = U[k] + (x[k] - U[k]) * np.exp(-RATE * TS)
    return x


def behind_lag(tau: float) -> np.ndarray:
    """w' = (u - x - w) / tau beside x, exact for the held u by the matrix exponential."""
    A = np.array([[-RATE, 0.0, RATE], [-1 / tau, -1 / tau, 1 / tau], [0.0, 0.0, 0.0]])
    step, z, w = expm(A * TS), np.zeros(2), np.zeros(N)
    for k in range(N):
        w[k] = z[1]
        z = (step @ [*z, U[k]])[:2]
    return w


def behind_delay(samples: float) -> np.ndarray:
    """u - x at t_k - d: within the sample k - 1 - floor(d), u as it was held there."""
    whole = int(np.floor(samples))
    x, y = states(), np.zeros(N)
    for k in range(whole + 1, N):
        i = k - 1 - whole
        inside = (1 - (samples - whole)) * TS
        y[k] = U[i] - (U[i] + (x[i] - U[i]) * np.exp(-RATE * inside))
    return y


@pytest.mark.parametrize("samples", [0.12, 0.3, 0.7, 1.4, 3.6])
@pytest.mark.parametrize("effect", ["lag", "delay"])
def test_a_late_sensor_gives_what_was_before_the_step(effect, samples):
    """Up to the cubic between samples, which rounds a change of slope a by a Ts / 16 at either end.

    Taken as smooth itself the output would be wrong by up to the whole step.
    """
    criterion, name = criterion_of(effect)
    x = criterion.start.copy()
    x[criterion.names.index(name)] = samples * TS
    found = criterion.simulate(x, 0)[0][:, 0]
    exact = behind_lag(samples * TS) if effect == "lag" else behind_delay(samples)
    settled = slice(40, None)
    largest = np.max(np.abs(np.diff(U)))
    assert np.max(np.abs(found - exact)[settled]) < 2 * RATE * TS * largest / 16
    assert np.std(exact[settled]) > 0.2


@pytest.mark.parametrize("order", [("lag", "delay"), ("delay", "lag")])
@pytest.mark.parametrize("whole", [0, 2])
def test_a_lag_and_a_delay_commute_also_where_the_output_steps(order, whole):
    """Whichever is found first: behind the lag nothing steps, and a delay can be interpolated."""
    m = washout()
    for kind in order:
        effect = sensor_lag(m, "y", 1.0) if kind == "lag" else time_delay(m, "y", 1.0)
        m, _ = effect.extended(m)
    record = casid.Record({"u": U, "y": np.zeros(N)}, {"u": "1", "y": "1"}, Ts=TS)
    criterion = SimulationError(m, [casid.Experiment(record, {}, "r")], substeps=4)
    x = criterion.start.copy()
    x[criterion.names.index("lag_y")], x[criterion.names.index("delay_y")] = 0.25, whole * TS
    found = criterion.simulate(x, 0)[0][:, 0]
    exact = np.roll(behind_lag(0.25), whole)
    largest = np.max(np.abs(np.diff(U)))
    assert np.max(np.abs(found - exact)[40:]) < 2 * RATE * TS * largest / 16


@pytest.mark.parametrize("samples", [0.0, 0.05, 0.3, 1.4])
@pytest.mark.parametrize("effect", ["lag", "delay"])
def test_its_tangent_is_the_derivative_of_what_is_computed(effect, samples):
    criterion, name = criterion_of(effect)
    at = criterion.start.copy()
    at[criterion.names.index(name)] = samples * TS
    tangent = criterion.simulate(at, 0, tangent=True)[2][:, 0]
    for i in range(len(at)):
        ends = []
        s = 1e-6 * np.eye(len(at))[i]
        ways = (1, 2) if samples == 0.0 and criterion.names[i] == name else (-1, 1)
        ends = [criterion.simulate(at + way * s, 0)[0][:, 0] for way in ways]
        if ways == (1, 2):  # one-sided: a delay is not negative
            slope = (4 * ends[0] - ends[1] - 3 * criterion.simulate(at, 0)[0][:, 0]) / 2e-6
        else:
            slope = (ends[1] - ends[0]) / 2e-6
        scale = np.max(np.abs(slope)) + 1.0
        assert np.max(np.abs(slope - tangent[:, i])) < 1e-4 * scale


@pytest.mark.parametrize("effect", ["lag", "delay"])
def test_a_stage_at_nothing_changes_nothing_and_straight_inputs_have_no_steps(effect):
    criterion, name = criterion_of(effect)
    x = criterion.start.copy()
    x[criterion.names.index(name)] = 0.0
    plain = U - states()
    assert criterion.simulate(x, 0)[0][:, 0] == pytest.approx(plain, abs=1e-6)
    straight, _ = criterion_of(effect, hold="foh")
    assert straight._simulators[TS].stepping == ()


def test_simulated_by_itself_a_model_gives_what_the_criterion_does():
    criterion, name = criterion_of("lag")
    x = criterion.start.copy()
    x[criterion.names.index(name)] = 0.3 * TS
    own = KnownSimulation(criterion.model, TS, substeps=4)
    y, _ = own.run(U[:, None], {"a": RATE, name: 0.3 * TS}, np.zeros((1, 1)))
    assert y == pytest.approx(criterion.simulate(x, 0)[0], abs=1e-12)


@pytest.mark.parametrize(("longest", "left_out"), [(1.0, 51), (3.0, N // 4), (6.0, N // 4)])
def test_a_lag_however_long_leaves_samples_to_fit(longest: float, left_out: int):
    """Five times 6 s is the whole record of 30 s; a delay of unknown length counts to its end."""
    model, _ = sensor_lag(washout(), "y", longest).extended(washout())
    record = casid.Record({"u": U, "y": np.zeros(N)}, {"u": "1", "y": "1"}, Ts=TS)
    criterion = SimulationError(model, [casid.Experiment(record, {}, "r")])
    assert criterion.n_samples == N - left_out
