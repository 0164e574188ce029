"""Actuators lag as their equation says, whatever holds their commands between the samples."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.estimation.simulation.channels.first_order_lags import lag_lines
from casid.estimation.simulation.channels.sample_lines import lines_of
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.actuator_effects import actuator_effects_of, actuator_lag
from problems import pendulum
from tests.support.driven_oscillator import (
    COMMAND,
    SIZES,
    TS,
    D,
    K,
    M,
    N,
    T,
    at,
    criterion_of,
    oscillator,
    positions,
)


def held_through_a_lag(tau: float, command=COMMAND) -> np.ndarray:
    """The plant behind the actuator, its command held, by scipy sample by sample from rest."""

    def rate(_t, z, u):
        x, v, a = z
        return [v, (-K * x - D * v + a) / M, (u - a) / tau]

    z, out = np.zeros(3), np.empty(len(command))
    for i, u in enumerate(command):
        out[i] = z[0]
        z = solve_ivp(rate, (0, TS), z, args=(u,), rtol=1e-9, atol=1e-12).y[:, -1]
    return out


@pytest.mark.parametrize("tau", [0.004, 0.03])
def test_an_output_that_shows_the_command_at_once_shows_it_behind_the_lag(tau):
    """The current of a coil follows its voltage exactly as the recursion of a held one does."""
    m = casid.Model("coil")
    flux = m.state("flux", "V s", initial=0.0)
    U = m.input("U", "V", hold="zoh", known=True)
    R = m.parameter("R", "ohm", start=1.2)
    m.derivative(flux, U)
    m.output("i", U / R, "A")
    model = actuator_lag(m, "U", 2.0).extend(m)
    record = casid.Record({"U": COMMAND, "i": np.zeros(N)}, {"U": "V", "i": "A"}, Ts=TS)
    criterion = SimulationError(model, [casid.Experiment(record, {}, "r")])
    current, expected, E = 0.0, np.empty(N), np.exp(-TS / tau)
    for k in range(N):
        expected[k] = current / 1.2
        current = E * current + (1 - E) * COMMAND[k]
    found = criterion.simulate(at(criterion, tau_U=tau), 0)[0][:, 0]
    assert found == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("kind", ["zoh", "foh"])
@pytest.mark.parametrize("tau", [0.0, 0.004, 0.03, 0.5])
def test_the_lag_of_an_actuator_has_the_derivative_of_what_is_computed(tau, kind):
    m = oscillator(kind)
    model, (name,) = actuator_lag(m, "force", 2.0).extended(m)
    if tau == 0.0:
        assert positions(model) == pytest.approx(positions(m), abs=1e-15)
    criterion = criterion_of(model)
    jac = criterion.simulate(at(criterion, **{name: tau}), 0, tangent=True)[2][:, 0]
    jac = jac[:, criterion.names.index(name)]
    s = 1e-6
    if tau == 0.0:
        y = [positions(model, **{name: k * s}) for k in range(3)]
        slope = (-3 * y[0] + 4 * y[1] - y[2]) / (2 * s)
    else:
        slope = (positions(model, **{name: tau + s}) - positions(model, **{name: tau - s})) / 2 / s
    assert jac == pytest.approx(slope, abs=1e-5 * np.abs(jac).max())


def test_at_first_order_a_short_lag_is_a_delay_without_half_a_sample_of_error():
    """dy/dtau at tau = 0 is -dy/dt of a plant that was at rest before the record."""
    m = oscillator("zoh")
    model, (name,) = actuator_lag(m, "force", 1.0).extended(m)
    criterion = criterion_of(model, np.where(T < 14 * TS, 0.0, COMMAND))
    jac = criterion.simulate(at(criterion), 0, tangent=True)[2][:, 0, criterion.names.index(name)]
    _, states, _ = criterion.simulate(at(criterion), 0)
    v = states[:, 1]
    assert np.abs(jac + v).max() < 0.002 * np.abs(v).max()
    late = np.abs(jac[1:] + v[:-1]).max()
    assert late > 0.05 * np.abs(v).max()  # what a whole sample would be


@pytest.mark.parametrize("tau", [0.005, 0.02, 0.15])
def test_a_held_command_behind_a_lag_moves_the_plant_as_scipy_says(tau):
    """Mean and first moment of the actuator's motion are exact: what is left is Ts^3 w^2 / 60."""
    m = oscillator("zoh")
    y = positions(actuator_lag(m, "force", 2.0).extend(m), tau_force=tau)
    exact = held_through_a_lag(tau)
    assert np.abs(y - exact).max() < 3e-4 * np.abs(exact).max()


def test_a_refit_finds_the_lag_of_the_actuator():
    m = oscillator("zoh")
    sd, true = 1e-4, 0.04
    y = held_through_a_lag(true) + sd * np.random.default_rng(1).standard_normal(N)
    model = actuator_lag(m, "force", 0.5).extend(m)
    fit = minimize_simulation_error(criterion_of(model, y=y))
    i = fit.criterion.names.index("tau_force")
    error = sd * np.sqrt(np.linalg.inv(fit.solution.hessian)[i, i])
    assert abs(fit.x[i] - true) < 3 * error
    assert true > 20 * error


def test_only_recorded_commands_lag_and_only_once():
    m = oscillator()
    extended = actuator_lag(m, "force", 0.5).extend(m)
    with pytest.raises(casid.ModelError, match="through a lag already; extend the model before"):
        actuator_lag(extended, "force", 0.5)
    assert list(actuator_effects_of(extended, SIZES)) == []
    with pytest.raises(casid.ModelError, match="request sensor_lag of such a channel"):
        actuator_lag(pendulum.problem.model, "accel", 0.5)
    assert list(actuator_effects_of(pendulum.problem.model, SIZES)) == []


def test_an_actuator_without_a_lag_is_none_where_an_output_shows_its_steps() -> None:
    """A voltage that is held reaches the measured current of a motor at its own sample."""
    m = casid.Model("motor")
    voltage = m.input("voltage", "V", hold="zoh", known=True)
    w = m.state("w", "rad/s", initial=0.0)
    J, K = m.constant("J", 0.01, "kg m^2"), m.constant("K", 0.1, "N m/A")
    R = m.parameter("R", "Ohm", start=2.0)
    current = (voltage - K * w) / R
    m.balance(w, "torque", inertia=J, terms=[K * current])
    m.output("current", current, "A")
    steps = {"voltage": COMMAND, "current": np.zeros(N)}
    record = casid.Record(steps, {"voltage": "V", "current": "A"}, Ts=TS)
    plain, lagging = (
        SimulationError(model, [casid.Experiment(record, {}, "r")])
        for model in (m, actuator_lag(m, "voltage", 1.0).extend(m))
    )
    assert lagging.simulate(lagging.start, 0)[0] == pytest.approx(
        plain.simulate(plain.start, 0)[0], abs=1e-12
    )


@pytest.mark.parametrize("tau", [0.0, 1e-6, 0.03, 0.0999, 0.1001])
def test_a_short_lag_of_a_held_input_is_near_no_lag_and_has_its_derivative(tau: float) -> None:
    """Of the value at the sample on which the input steps, too, which an output may show."""
    steps = np.repeat([0.0, 1.0, -2.0], 5)
    step = 1e-7
    line, change = lag_lines(lines_of(steps, "zoh"), tau, steps=True)
    above = lag_lines(lines_of(steps, "zoh"), tau + step, steps=True)[0]
    assert (above - line) / step == pytest.approx(change, abs=1e-4)
    if tau == 0.0:
        assert line == pytest.approx(np.stack([steps] * 3, axis=1), abs=1e-12)


@pytest.mark.parametrize("still", [False, True])
def test_the_lag_of_a_command_that_moves_as_the_record_begins_is_found(still: bool) -> None:
    """What the actuator did before is not recorded: of a thruster under control in mid-course.

    A command that stands still at first was there before, and its first step counts.
    """
    tau, rng = 0.2, np.random.default_rng(8)
    before = 0 if still else 100
    command = 2.0 * rng.standard_normal(N + before)
    if still:
        command[:30], command[150:] = 0.0, 2.0  # its only moves are early ones
    v = acting = 0.0
    speed = np.empty(N + before)
    for k, u in enumerate(command):  # exact for a held command, but for the mean of what acts
        speed[k] = v
        decay, inside = np.exp(-TS / tau), 1 - tau / TS * (1 - np.exp(-TS / tau))
        mean = acting + (u - acting) * inside
        v = v * np.exp(-D / M * TS) + (1 - np.exp(-D / M * TS)) / D * mean
        acting += (u - acting) * (1 - decay)
    speed, command = speed[before:] + 1e-3 * rng.standard_normal(N), command[before:]
    m = casid.Model("hull")
    x = m.state("v", "m/s")
    force = m.input("force", "N", hold="zoh", known=True)
    m.balance(x, "surge", inertia=m.parameter("M", "kg", start=1.5), terms=[-D * x, force])
    m.output("position", x, "m/s")
    lagging = m.extend(actuator_lag(m, "force", longest=2.0)).with_unknown(tau_force=0.1)
    record = casid.Record(
        {"force": command, "position": speed}, {"force": "N", "position": "m/s"}, TS
    )
    fit = minimize_simulation_error(SimulationError(lagging, [casid.Experiment(record)]))
    assert fit.values["tau_force"] == pytest.approx(tau, abs=0.005)
    assert fit.values["M"] == pytest.approx(M, abs=0.04)
