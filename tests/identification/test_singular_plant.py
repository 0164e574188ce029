"""A levitated ball, whose magnet pulls without bound at no distance, in segments and windows.

m z'' = m g - K (i / z)^2 is unstable; the simulation of a wrong parameter or state falls into z = 0
within a few e-folding times. A controller holds the ball, and the current is measured.
"""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.errors import SolveError
from casid.estimation.local_rank import LocalRank, describe_null
from casid.estimation.simulation import fit
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.instability import segments_for, window_for
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.records.measured_states import measured_states, output_equations
from casid.estimation.simulation.simulation_error import SimulationError

MASS, K, G, TS, NOISE = 0.05, 2.5e-5, 9.81, 0.002, 5e-6
VOLTS = 1000.0, 1.0  # per metre, and at no gap


@cache
def held(N: int = 1200) -> tuple[casid.Record, np.ndarray]:
    """The gap goes to and fro about 5 mm; midpoint rule in 20 steps a sample. Also its rate."""
    rng = np.random.default_rng(1)
    goals = 5e-3 + 1e-3 * np.repeat(rng.uniform(-1, 1, N // 100), 100)
    z, v, seen, rate, total = 5e-3, 0.0, 5e-3, 0.0, 0.0
    rows = []

    def pull(z: float, i: float) -> float:
        return G - K / MASS * (i / z) ** 2

    for goal in goals:
        y = z + NOISE * rng.standard_normal()
        rate, seen = 0.6 * rate + 0.4 * (y - seen) / TS, y
        total += TS * (y - goal)
        i = goal * np.sqrt(MASS * G / K) + 700.0 * (y - goal) + 12.0 * rate + 1500.0 * total
        i = float(np.clip(i, 0.05, 3.0))
        rows.append((i, y, v))
        for _ in range(20):
            h = TS / 20
            a = pull(z, i)
            z, v = z + h * (v + h / 2 * a), v + h * pull(z + h / 2 * v, i)
    current, gap, rates = np.array(rows).T
    channels = {"i": current, "gap": gap, "sensor": VOLTS[1] + VOLTS[0] * gap}
    return casid.Record(channels, {"i": "A", "gap": "m", "sensor": "V"}, TS, name="held"), rates


def ball(start: float = 3e-5, *, in_volts: bool = False) -> casid.Problem:
    m = casid.Model("levitated ball")
    z, v = m.state("z", "m"), m.state("v", "m/s")
    i = m.input("i", "A", hold="zoh", known=True)
    pull = m.parameter("K", "N m^2/A^2", start=start, lower=1e-7)
    mass, g = m.constant("m", MASS, "kg"), m.constant("g", G, "m/s^2")
    m.derivative(z, v)
    m.balance(v, "force", inertia=mass, terms=[mass * g, -pull * (i / z) ** 2])
    if in_volts:
        gain, zero = m.constant("gain", VOLTS[0], "V/m"), m.constant("zero", VOLTS[1], "V")
        m.output("sensor", zero + gain * z, "V")
    else:
        m.output("gap", z, "m")
    return casid.Problem("levitated ball", m, starts=1)


def criterion(problem: casid.Problem, window: int = 0) -> SimulationError:
    return SimulationError(problem.model, [casid.Experiment(held()[0], window=window)])


def test_states_are_solved_for_from_outputs_and_their_derivatives():
    """The gap from volts, its rate from a parabola through eleven samples.

    Its slope has a standard deviation of s / (T sqrt(110)) = 0.24 mm/s; the controller shakes the
    ball by its own noise as much again several times, within a twentieth of the largest rate.
    """
    c = criterion(ball(in_volts=True))
    d, at = c.data[0], np.arange(80, 1200, 100)
    equations = output_equations(c.model, c.free)
    p = np.array([c.model.parameters[n].nominal for n in c.model.explicit().parameters])
    found = measured_states(equations, d, p, at, np.zeros(2))
    assert found[:, 0] == pytest.approx(held()[0]["gap"][at], abs=4 * NOISE)
    assert found[:, 1] == pytest.approx(held()[1][at], abs=0.05 * abs(held()[1]).max())


def test_a_state_that_no_output_determines_stays_undetermined():
    """Where a cart rolls, its rate says nothing of where it is."""
    m = casid.Model("cart")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    m.derivative(x, v)
    m.derivative(v, -m.parameter("c", "1/s", start=1.0) * v)
    m.output("rate", v, "m/s")
    record = casid.Record({"rate": np.exp(-TS * np.arange(100.0))}, {"rate": "m/s"}, TS, name="r")
    c = SimulationError(m, [casid.Experiment(record)])
    equations = output_equations(m, ["c"])
    found = measured_states(equations, c.data[0], np.ones(1), np.array([50]), np.zeros(2))[0]
    assert np.isnan(found[0])
    assert found[1] == pytest.approx(np.exp(-50 * TS), rel=1e-4)


def test_a_record_begins_where_the_model_is_finite():
    """At the declared z = 0 the force is infinite: the sensor's curve gives the gap instead."""
    c = criterion(ball(in_volts=True))
    assert c.start[c.names.index("z(0)")] == pytest.approx(5e-3, abs=4 * NOISE)
    assert segments_for(c) > 1  # the instability is seen from there


@pytest.mark.parametrize(
    "start", [1.5e-5, *(pytest.param(z, marks=pytest.mark.slow) for z in (3e-5, 6e-5))]
)
def test_segments_and_windows_are_fitted_from_short_horizons(start: float):
    """A few iterations, whichever side K begins on; K within 3.5 standard errors."""
    problem = ball(start)
    c = criterion(problem)
    windowed = casid.Experiment(held()[0], window=window_for(c))
    for experiment, segments in ((windowed, 1), (casid.Experiment(held()[0]), segments_for(c))):
        found = fit_model(problem.model, [experiment], FitSettings(starts=1, segments=segments))
        assert found.solution.is_converged
        error = NOISE * found.criterion.weights[0] / np.sqrt(found.solution.hessian[0, 0])
        assert abs(found.values["K"] - K) < 3.5 * max(error, 2e-9)
        assert np.sqrt(2 * found.solution.value / 1200) == pytest.approx(
            NOISE * found.criterion.weights[0], rel=0.15
        )


@pytest.mark.slow
def test_short_horizons_that_lead_astray_do_not_take_a_fit_from_parameters_that_are_given(
    monkeypatch: pytest.MonkeyPatch,
):
    """Parameters that a longer fit has found are where the windows begin, if they end lower there.

    What acts alike for an e-folding time, as motor gain and inertia of a robot that balances, the
    sensors' noise moves over short horizons as far as into the basin of another optimum.
    """
    problem, record = ball(), held()[0]
    windowed = casid.Experiment(record, window=window_for(criterion(problem)))
    astray = SimpleNamespace(values={"K": 9e-5}, starts_tried=1, starts_agreeing=1)
    monkeypatch.setattr(fit, "fit_of_short_horizons", lambda *_, **__: astray)
    found = fit_model(problem.model, [windowed], FitSettings(starts=1), start={"K": 1.1 * K})
    assert found.solution.is_converged
    assert found.values["K"] == pytest.approx(K, rel=1e-3)


def test_windows_that_leave_what_was_measured_are_refused_with_a_remedy():
    """From a start far off without short horizons; their rank would say nothing of the record."""
    c = criterion(ball(9e-5), window=36)
    with pytest.raises(SolveError, match="windows leave the range of what was measured") as caught:
        minimize_simulation_error(c)
    assert "start the parameters nearer" in str(caught.value)
    assert len(str(caught.value)) < 500


def test_many_undetermined_directions_are_named_in_a_few_sentences():
    """A hundred unknowns make a message that can be read."""
    names = [f"z[{i}]" for i in range(100)]
    rank = LocalRank(0, 100, 0.0, tuple(dict.fromkeys(names, 1.0) for _ in range(100)))
    said = describe_null(rank)
    assert len(said) < 400
    assert "94 more directions" in said


def test_every_window_behind_a_sensor_that_lags_has_samples_that_count():
    """None of the first windows is left out for the past: nothing would determine their states."""
    window, model = 36, ball().model
    slow = model.extend(casid.sensor_lag(model, "gap", longest=60 * TS))
    c = SimulationError(slow, [casid.Experiment(held()[0], window=window)])
    used = c.data[0].used[:, 0]
    assert not used[0]
    assert all(np.mean(used[i : i + window]) >= 0.75 for i in range(0, used.size, window))
    whole = SimulationError(slow, [casid.Experiment(held()[0])])
    assert np.mean(whole.data[0].used) == 0.75


@pytest.mark.slow
def test_a_singular_plant_is_diagnosed_in_windows():
    found = casid.diagnose(ball(), held(3000)[0], advise=False)
    assert found.verdict == "adequate"
    assert found.gain.held_out["baseline_rmse"]["gap"] == pytest.approx(NOISE, rel=0.15)
