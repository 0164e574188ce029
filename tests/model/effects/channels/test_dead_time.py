"""An input that acts late is delayed by any part of a sample, as what is declared of it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.estimation.simulation.channels.sample_lines import delayed_lines, lines_of
from casid.estimation.simulation.integration.band_limited import moved
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.catalogue import catalogue
from casid.model.effects.channels.actuator_effects import actuator_lag
from casid.model.effects.channels.channel_effects import hold, sensor_lag
from casid.model.effects.channels.delays import dead_time, time_delay
from casid.model.effects.effect import Sizes
from problems import pendulum
from tests.support.driven_oscillator import TS, D, K, M, at, moved_late

N = 600
STEPS = np.repeat(np.random.default_rng(4).standard_normal(N // 12), 12)
JAGGED = np.random.default_rng(5).standard_normal(N)
HOLDS = ("zoh", "foh", "bandlimited")
SIZES = Sizes({"x": 0.1, "v": 1.0}, {}, (0.0, N * TS), 0.1)


def oscillator(kind: str = "zoh", known: bool = True) -> casid.Model:
    m = casid.Model("oscillator")
    x, v = m.state("x", "m", initial=0.0), m.state("v", "m/s", initial=0.0)
    force = m.input("force", "N", hold=kind, known=known)
    k = m.parameter("k", "N/m", start=K)
    m.derivative(x, v)
    m.balance(v, "force balance", inertia=M, terms=[-k * x, -D * v, force])
    m.output("position", x, "m")
    m.output("speed", v, "m/s")
    return m


def criterion_of(model: casid.Model, force=STEPS, y=None, substeps: int = 1) -> SimulationError:
    y = np.zeros((len(force), 2)) if y is None else y
    columns = {"force": force, "position": y[:, 0], "speed": y[:, 1]}
    record = casid.Record(columns, {"force": "N", "position": "m", "speed": "m/s"}, Ts=TS)
    e = casid.Experiment(record, {}, "r")
    return SimulationError(model, [e], weights=np.ones(2), substeps=substeps)


def outputs(model: casid.Model, force=STEPS, substeps: int = 1, **values: float) -> np.ndarray:
    criterion = criterion_of(model, force, substeps=substeps)
    return criterion.simulate(at(criterion, **values), 0)[0]


def acting_late(force: np.ndarray, delay: float, kind: str) -> np.ndarray:
    """Position and speed, exact: the matrix exponential from corner to corner of the late input.

    At rest before the record, without force.
    """
    whole = int(np.floor(delay / TS))
    padded = np.concatenate([np.zeros(whole + 1), force, force[-1:]])
    return moved_late(padded[: len(force) + 2], delay / TS - whole, kind)


@pytest.mark.parametrize("kind", ["zoh", "foh"])
@pytest.mark.parametrize("samples", [0.05, 0.5, 1.0, 3.7, 42.4])
def test_a_late_input_moves_the_plant_as_its_exact_solution_does(samples, kind):
    """Mean and first moment in each sample are exact: what is left is of third order in Ts."""
    model = dead_time(oscillator(kind), "force", 2.0).extend(oscillator(kind))
    found = outputs(model, dead_time_force=samples * TS)
    exact = acting_late(STEPS, samples * TS, kind)
    size = np.abs(exact).max(axis=0)
    assert np.all(np.abs(found - exact).max(axis=0) < [1e-4, 4e-3] * size)
    # A delay of whole samples alone would miss by far more.
    rounded = acting_late(STEPS, np.round(samples) * TS, kind)
    if samples != np.round(samples):
        assert np.abs(rounded - exact)[:, 0].max() > 10 * np.abs(found - exact)[:, 0].max()


@pytest.mark.parametrize("samples", [0.3, 7.6])
def test_a_late_band_limited_input_is_a_late_sine(samples):
    w, t = 30.0, TS * np.arange(N)  # 0.19 of the sampling rate
    late = moved(np.sin(w * t), samples)[0]
    inner = slice(60, N - 60)
    assert late[inner] == pytest.approx(np.sin(w * (t - samples * TS))[inner], abs=2e-4)
    m = oscillator("bandlimited")

    def pulse(t: np.ndarray) -> np.ndarray:
        return np.sin(w * t) * np.exp(-(((t - 6.0) / 1.5) ** 2))

    model = dead_time(m, "force", 1.0).extend(m)
    found = outputs(model, pulse(t), dead_time_force=samples * TS)
    wanted = outputs(m, pulse(t - samples * TS))
    assert found == pytest.approx(wanted, abs=2e-4 * np.abs(wanted).max())


@pytest.mark.parametrize("kind", HOLDS)
@pytest.mark.parametrize("samples", [0.0, 0.3, 2.6])
def test_its_derivative_is_that_of_what_is_computed(samples, kind):
    m = oscillator(kind)
    model = dead_time(m, "force", 1.0).extend(m)
    force = np.convolve(JAGGED, np.ones(4) / 4, "same")
    if samples == 0.0:
        assert outputs(model, force) == pytest.approx(outputs(m, force), abs=1e-13)
    criterion = criterion_of(model, force)
    i = criterion.names.index("dead_time_force")
    jac = criterion.simulate(at(criterion, dead_time_force=samples * TS), 0, tangent=True)[2]
    y = [outputs(model, force, dead_time_force=samples * TS + k * 1e-6) for k in range(3)]
    slope = (-3 * y[0] + 4 * y[1] - y[2]) / 2e-6
    # Of a band-limited input the window cuts off what is not zero: its slope steps by 2e-4.
    assert jac[:, :, i] == pytest.approx(slope, abs=5e-4 * np.abs(slope).max())


def test_an_output_that_shows_the_command_at_once_shows_it_late():
    m = casid.Model("coil")
    flux = m.state("flux", "V s", initial=0.0)
    U = m.input("U", "V", hold="zoh", known=True)
    R = m.parameter("R", "ohm", start=1.2)
    m.derivative(flux, U)
    m.output("i", U / R, "A")
    model = dead_time(m, "U", 1.0).extend(m)
    record = casid.Record({"U": STEPS, "i": np.zeros(N)}, {"U": "V", "i": "A"}, Ts=TS)
    criterion = SimulationError(model, [casid.Experiment(record, {}, "r")])
    found = criterion.simulate(at(criterion, dead_time_U=2.5 * TS), 0)[0][:, 0]
    before = np.concatenate([np.zeros(3), STEPS])[:N]
    assert found == pytest.approx(before / 1.2, abs=1e-12)


@pytest.mark.parametrize("kind", HOLDS)
def test_a_dead_time_and_a_lag_of_one_command_act_one_after_the_other(kind):
    """In whatever order they were added; a delay of whole samples is a shift of the command."""
    m = oscillator(kind)
    one = actuator_lag(m, "force", 1.0).extend(dead_time(m, "force", 1.0).extend(m))
    lagging = actuator_lag(m, "force", 1.0).extend(m)
    other = dead_time(lagging, "force", 1.0).extend(lagging)
    values = {"tau_force": 0.07, "dead_time_force": 4 * TS}
    found = outputs(one, **values)
    assert outputs(other, **values) == pytest.approx(found, abs=1e-13)
    # What is band-limited moves before its first sample: no rest is known of it.
    before = STEPS[0] if kind == "bandlimited" else 0.0
    late = np.concatenate([np.full(4, before), STEPS])[:N]
    shifted = outputs(lagging, late, tau_force=0.07)
    # The last sample of a shifted record is followed by one that is not the record's.
    assert found[:-4] == pytest.approx(shifted[:-4], abs=2e-4 * np.abs(shifted).max())
    criterion = criterion_of(one)
    values["dead_time_force"] = 4.3 * TS
    x = at(criterion, **values)
    jac = criterion.simulate(x, 0, tangent=True)[2]
    for name in values:
        i = criterion.names.index(name)
        up, down = x.copy(), x.copy()
        up[i], down[i] = x[i] + 1e-6, x[i] - 1e-6
        slope = (criterion.simulate(up, 0)[0] - criterion.simulate(down, 0)[0]) / 2e-6
        assert jac[:, :, i] == pytest.approx(slope, abs=1e-4 * np.abs(slope).max())


def test_a_late_command_that_is_joined_by_lines_after_all_is_delayed_as_such():
    m = oscillator("zoh")
    model = dead_time(m, "force", 1.0).extend(m)
    joined = hold(model, "force").extend(model, starts={"ramp_force": 1.0})
    foh = dead_time(oscillator("foh"), "force", 1.0).extend(oscillator("foh"))
    wanted = outputs(foh, dead_time_force=2.3 * TS)
    assert outputs(joined, dead_time_force=2.3 * TS) == pytest.approx(wanted, abs=1e-12)


def test_a_refit_finds_the_dead_time_within_its_error():
    sd, true = 1e-4, 2.37 * TS
    rng = np.random.default_rng(1)
    y = acting_late(STEPS, true, "zoh") + sd * rng.standard_normal((N, 2))
    model = dead_time(oscillator(), "force", 0.2).extend(oscillator())
    fit = minimize_simulation_error(criterion_of(model, y=y))
    i = fit.criterion.names.index("dead_time_force")
    error = sd * np.sqrt(np.linalg.inv(fit.solution.hessian)[i, i])
    assert abs(fit.x[i] - true) < 3 * error
    assert true > 100 * error


def test_what_a_late_input_did_before_the_record_is_counted_in_no_output():
    """Ten samples of delay at most, and one: every output's first eleven samples are left out."""
    m = oscillator()
    moving = m.copy()
    moving.states["v"] = replace(m.states["v"], initial=None)
    used = criterion_of(dead_time(moving, "force", 10 * TS).extend(moving)).data[0].used
    assert not used[:11].any()
    assert used[11:].all()
    # What rested without force had none before, and all samples count.
    assert criterion_of(dead_time(m, "force", 10 * TS).extend(m)).data[0].used.all()


@pytest.mark.parametrize("effect", [dead_time, actuator_lag])
def test_a_late_sensor_is_a_late_input_of_what_rested(effect):
    """Both delay, or lag, what a linear system that was at rest answers with its one input.

    To a thousandth: a sensor's column is smooth between its samples, an input is held.
    """
    m = oscillator()
    sensors = m
    of_sensor = time_delay if effect is dead_time else sensor_lag
    for output in m.outputs:
        sensors = of_sensor(sensors, output, 1.0).extend(sensors)
    model = effect(m, "force", 1.0).extend(m)
    name = "dead_time_force" if effect is dead_time else "tau_force"
    prefix = "delay" if effect is dead_time else "lag"
    found = outputs(model, **{name: 2.4 * TS})
    shown = outputs(sensors, **{f"{prefix}_{y}": 2.4 * TS for y in m.outputs})
    assert found[:, 0] == pytest.approx(shown[:, 0], abs=1e-3 * np.ptp(found[:, 0]))
    assert not found[0].any()


def test_the_mean_and_the_first_moment_of_late_lines_are_exact():
    fine = 4000
    inside = (np.arange(fine) + 0.5) / fine
    for kind in ("zoh", "foh"):
        lines = delayed_lines(JAGGED, 3.3, kind)[0]
        for k in (10, 77, 300):
            place = k - 3.3 + inside
            low = np.floor(place).astype(int)
            rise = JAGGED[low + 1] - JAGGED[low] if kind == "foh" else 0.0
            exact = JAGGED[low] + (place - low) * rise
            line = lines[k, 1] + inside * (lines[k, 2] - lines[k, 1])
            assert line.mean() == pytest.approx(exact.mean(), abs=1e-3)
            assert (line * inside).mean() == pytest.approx((exact * inside).mean(), abs=1e-3)
        assert delayed_lines(JAGGED, 0.0, kind)[0] == pytest.approx(lines_of(JAGGED, kind))


def test_a_known_input_acts_late_and_a_measured_one_may_be_late_or_act_late():
    """A command that is recorded is recorded when it is given."""
    found = {
        (e.key, e.parameters[0].name)
        for known in (True, False)
        for e in catalogue(oscillator(known=known), SIZES, {})
        if e.kind == "time_delay" and e.where == "force"
    }
    assert found == {
        (("time_delay", "force"), "dead_time_force"),
        (("time_delay", "force"), "delay_force"),
        (("time_delay", "force: acts late"), "dead_time_force"),
    }
    m = oscillator()
    assert time_delay(m, "force", 0.1).parameters == dead_time(m, "force", 0.1).parameters


def test_only_recorded_commands_act_late_and_only_once():
    m = oscillator()
    extended = dead_time(m, "force", 0.5).extend(m)
    with pytest.raises(casid.ModelError, match="acts late already; extend the model before"):
        dead_time(extended, "force", 0.5)
    assert "time_delay" not in {
        e.kind for e in catalogue(extended, SIZES, {}) if e.where == "force"
    }
    with pytest.raises(casid.ModelError, match="request time_delay of such a channel"):
        dead_time(pendulum.problem.model, "accel", 0.5)


@pytest.mark.parametrize("first", [dead_time, time_delay])
def test_an_input_that_is_moved_in_time_is_not_moved_a_second_time(first) -> None:
    """u(t - d + e) has d - e alone: a late record of a late input would leave d any value."""

    def delays(model: casid.Model) -> list[str]:
        every = catalogue(model, SIZES, {})
        return [e.parameters[0].name for e in every if e.kind == "time_delay"]

    model = oscillator(known=False)
    assert {"dead_time_force", "delay_force", "delay_position"} <= set(delays(model))
    left = delays(first(model, "force", 0.1).extend(model))
    assert "delay_position" in left
    assert not {"dead_time_force", "delay_force"} & set(left)
