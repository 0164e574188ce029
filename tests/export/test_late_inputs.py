"""Exports of a model whose command acts late: the very samples of casid's simulation.

After the last sample of a record the command is held, and what a step does there is not the
record's: the last sample is left out.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import casid
from casid.arrays import Array
from casid.errors import ModelError
from casid.estimation.fitted.fitted_model import FittedModel
from casid.model.effects.channels.actuator_effects import actuator_lag
from casid.model.effects.channels.delays import dead_time, time_delay
from tests.export.test_c_code import compiled, needs_compiler
from tests.export.test_delayed_outputs import stepped_in_c
from tests.export.test_fmu import unit
from tests.support.fitted_models import assert_same, driven_mass, fitted_model

LATE = (0.3, 1.0, 2.3, 17.75)  # samples
TS = 0.01
START = {False: (0.1, -0.2), True: (0.0, 0.0)}
COMMAND = 5 + np.cumsum(np.random.default_rng(3).standard_normal(200))


@cache
def late_mass(
    samples: float, hold: str = "zoh", late_sensor: float = 0.0, *, rests: bool = False
) -> FittedModel:
    """A mass that shows its position and, at once, the force on it; or is known to rest at 0."""
    m = driven_mass()
    force = m.symbol("force")
    if hold != "zoh" or rests:
        m, start = casid.Model("joined"), 0.0 if rests else None
        x, v = m.state("x", "m", initial=start), m.state("v", "m/s", initial=start)
        force = m.input("force", "N", hold=hold)
        d, k = m.parameter("d", "N s/m", start=1.0), m.parameter("k", "N/m", start=40.0)
        m.derivative(x, v)
        m.balance(v, "force", inertia=m.constant("m", 2.0, "kg"), terms=[-k * x, -d * v, force])
        m.output("position", x, "m")
    m.output("load", force, "N")
    effects = [lambda m: dead_time(m, "force", 0.5)]
    values = {"d": 1.2, "k": 55.0, "dead_time_force": TS * samples}
    if late_sensor:
        effects.append(lambda m: time_delay(m, "position", 0.1))
        values["delay_position"] = TS * late_sensor
    problem = casid.Problem("mass", m, channels={n: n for n in ("force", "position", "load")})
    return fitted_model(problem, effects, values, x0=START[rests], Ts=TS, N=len(COMMAND))


def simulated(fitted: FittedModel) -> Array:
    record = fitted.simulate({"force": COMMAND})
    return np.column_stack([record["position"], record["load"]])


def stepped(fitted: FittedModel, *, rests: bool = False) -> Array:
    """By the exported CasADi function, sample by sample."""
    function = fitted.to_casadi()
    x, past, y = list(START[rests]), np.zeros(function.numel_in("past")), []
    for u, u_next in zip(COMMAND, [*COMMAND[1:], COMMAND[-1]], strict=True):
        step = function(x=x, u=u, u_next=u_next, past=past)
        x, past = step["x_next"], step["past_next"]
        y.append(np.array(step["y"]).ravel())
    return np.array(y)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("samples", LATE)
def test_the_casadi_function_remembers_commands(samples: float, hold: str) -> None:
    fitted = late_mass(samples, hold)
    assert_same(stepped(fitted)[:-1], simulated(fitted)[:-1])


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_before_its_first_sample_a_resting_mass_had_no_force(hold: str) -> None:
    """Nor was its position another than at rest; the force is seen at once, late."""
    fitted = late_mass(2.3, hold, 1.6, rests=True)
    y = stepped(fitted, rests=True)
    assert_same(y[:-1], simulated(fitted)[:-1])
    assert not y[:2].any()
    assert np.abs(y[4, 1]) > 4.0  # of about 5 N


def test_a_lagging_actuator_of_a_resting_mass_begins_without_force() -> None:
    m = casid.Model("mass")
    x, v = m.state("x", "m", initial=0.0), m.state("v", "m/s", initial=0.0)
    force, k = m.input("force", "N", hold="zoh"), m.parameter("k", "N/m", start=40.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=m.constant("m", 2.0, "kg"), terms=[-k * x, force])
    m.output("position", x, "m")
    problem = casid.Problem("mass", m, channels={n: n for n in ("force", "position")})
    lag = [lambda m: actuator_lag(m, "force", 0.5)]
    fitted = fitted_model(
        problem, lag, {"k": 55.0, "tau_force": 0.05}, x0=(0.0, 0.0), Ts=TS, N=len(COMMAND)
    )
    function, state, y = fitted.to_casadi(), np.zeros(3), []
    for u, u_next in zip(COMMAND, [*COMMAND[1:], COMMAND[-1]], strict=True):
        step = function(x=state, u=u, u_next=u_next)
        state = step["x_next"]
        y.append(float(step["y"]))
    exact = fitted.simulate({"force": COMMAND})["position"]
    # The line in each sample that stands for the actuator's motion is exact to third order.
    assert np.array(y) == pytest.approx(exact, abs=1e-5 * np.ptp(exact))


def test_a_late_command_and_a_late_sensor_share_the_memory() -> None:
    fitted = late_mass(2.3, late_sensor=1.6)
    assert fitted.to_casadi().numel_in("past") == 3 + 3 + 1
    assert_same(stepped(fitted)[:-1], simulated(fitted)[:-1])


def test_without_delays_the_command_acts_at_once() -> None:
    function = late_mass(2.3).to_casadi(without_delays=True)
    assert function.name_in() == ["x", "u", "u_next", "t", "p"]


@needs_compiler
@pytest.mark.parametrize("samples", [0.3, 2.3])
def test_the_c_step_remembers_commands(samples: float, tmp_path: Path) -> None:
    fitted = late_mass(samples)
    library = compiled(fitted.to_c(tmp_path / "model"))
    text = (tmp_path / "model.h").read_text()
    kept = int(samples) + 2  # past samples, and whether there was one
    assert f"#define MODEL_NPAST {kept}\n" in text
    assert f"Inputs act late (force by {TS * samples:.6g} s)" in text
    assert_same(stepped_in_c(library, text, kept, COMMAND, 2), simulated(fitted)[:-1])


@needs_compiler
@pytest.mark.parametrize("samples", [0.3, 2.3])
def test_co_simulation_remembers_commands(samples: float, tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    fitted = late_mass(samples)
    path = fitted.to_fmu(tmp_path / "model.fmu")
    assert fmpy.read_model_description(str(path)).modelExchange is None
    y = []
    with unit(path, "CoSimulation") as (fmu, places):
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        for k, u in enumerate(COMMAND):
            fmu.setReal([places["force"]], [u])
            y.append(fmu.getReal([places["position"], places["load"]]))
            fmu.doStep(currentCommunicationPoint=k * TS, communicationStepSize=TS)
    assert_same(np.array(y)[:-1], simulated(fitted)[:-1])


def test_the_state_space_has_a_pade_approximation_of_the_dead_time() -> None:
    """Of order n its relative error is (s T)^(2n+1) n!^2 / ((2n)! (2n+1)!)."""
    fitted, T = late_mass(2.3), 0.023
    with pytest.raises(ModelError, match=r"inputs are delayed \(force by 0.023 s\).*pade=3"):
        fitted.to_control()
    prompt, late = fitted.to_control(without_delays=True), fitted.to_control(pade=3)
    assert late.nstates == prompt.nstates + 3
    for wT in (0.1, 0.5, 1.0):
        s = 1j * wT / T
        left_out = wT**7 * 36 / (720 * 5040)
        assert_allclose(late(s), prompt(s) * np.exp(-s * T), rtol=1.1 * left_out + 1e-12)


def test_modelica_and_the_problem_file_say_the_delay(tmp_path: Path) -> None:
    fitted = late_mass(2.3)
    text = fitted.to_modelica(tmp_path / "Mass.mo").read_text()
    assert "delay(force, 0.023)" in text
    resting = late_mass(2.3, rests=True).to_modelica(tmp_path / "Resting.mo").read_text()
    assert "Before it acts late, force was 0" in resting
    assert "Before it acts late" not in text
    lines = fitted.to_problem_file(tmp_path / "mass.py").read_text()
    assert 'm.extend(casid.dead_time(m, "force", longest=0.5))' in lines.replace("model", "m")
    problem = casid.load_problem(tmp_path / "mass.py")
    again = problem.model
    stages = [(s.kind, s.channel) for s in again.stages]
    assert stages == [("late_input", "force")]
    assert again.parameters["dead_time_force"].start == pytest.approx(0.023)
