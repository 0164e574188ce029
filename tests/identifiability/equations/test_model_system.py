"""A fitted model and the system whose identifiability is asked are the same equations."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest

import casid
from casid.errors import DataError, ModelError
from casid.identifiability.equations.model_system import left_out, system_of, translated
from casid.identifiability.equations.system import System
from casid.model.declarations import Input
from casid.model.effects.channels.actuator_effects import actuator_lag
from casid.model.effects.channels.channel_effects import hold, saturation, sensor_bias, sensor_lag
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.parameter_effects import parameter_jump
from problems import emps, pendulum, pendulum_rig, roll_decay

MODELS = {
    "pendulum": pendulum.problem.model,
    "pendulum at any angle": pendulum.nonlinear_model().eliminate("a_y", using="accel"),
    "pendulum rig": pendulum_rig.problem.model,
    "pendulum, load sought": pendulum.indirect_model().with_unknown(m=0.1, z_m=-0.3),
    "roll decay": roll_decay.problem.model,
    "EMPS": emps.problem.model,
}


def spring(**initial: float) -> casid.Model:
    """m v' = F - d v - k x + w, with the force F known and x measured; m known."""
    model = casid.Model("spring")
    x = model.state("x", "m", initial=initial.get("x"))
    v = model.state("v", "m/s", initial=initial.get("v"))
    F = model.input("F", "N")
    m, d = model.parameter("m", "kg", value=0.3), model.parameter("d", "N s/m", start=1.0)
    k = model.parameter("k", "N/m", start=4.0)
    model.parameter("unused", "1")
    load = model.parameter("load", "kg", value=0.0)
    model.derivative(x, v)
    model.balance(v, "force", inertia=m + load, terms=[F, -d * v, -k * x])
    model.output("position", x, "m")
    return model


def record(name: str = "run", **columns: Any) -> casid.Record:
    t = 0.1 * np.arange(50)
    channels = {"position": np.sin(t), "F": np.cos(t)} | columns
    return casid.Record(
        {n: np.broadcast_to(c, t.shape) for n, c in channels.items()},
        {"position": "m", "F": "N"},
        0.1,
        name=name,
    )


Array = np.ndarray[Any, Any]
Points = Mapping[str, Any]  # name -> number, or (N,) numbers


def evaluated(symbols: Mapping[str, Any], expression: Any, at: Points) -> Array:
    """(n,) values of n expressions at one point, (n, N) at N points."""
    columns = np.broadcast_arrays(*[np.asarray(at[n], dtype=float) for n in symbols])
    function = ca.Function("e", [ca.vertcat(*symbols.values())], [ca.densify(expression)])
    return np.squeeze(function(np.reshape(columns, (len(symbols), -1))).full())


def explicit_values(model: casid.Model, at: Points) -> Array:
    """f and h of the model as the estimators simulate it, known parameters at their values."""
    e = model.explicit()
    known = {p.name: p.value for p in model.parameters.values() if p.value is not None}
    symbols = {n: model.symbol(n) for n in (*e.states, *e.inputs, *e.parameters)}
    return evaluated(symbols, ca.vertcat(e.f, e.h), {**at, **known})


def system_values(system: System, at: Points) -> Array:
    held = {n: float(v) for n, v in system.at.items()}
    return evaluated(system.symbols, ca.vertcat(system.f, system.h), {**at, **held})


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("direct", [False, True], ids=["indirect", "direct"])
def test_the_system_is_the_model_that_is_fitted(name, direct):
    """f and h agree at random points, with known values put in and with them as constants."""
    model = MODELS[name].direct() if direct else MODELS[name]
    rng = np.random.default_rng(3)
    e = model.explicit()
    at = {n: rng.uniform(0.5, 1.5, 200) for n in (*e.states, *e.inputs, *e.parameters)}
    expected = explicit_values(model, at)
    assert np.isfinite(expected).all()
    system = system_of(MODELS[name], direct=direct)
    # The same operations in the same order, but for constants folded: a few roundings.
    np.testing.assert_allclose(system_values(system, at), expected, rtol=1e-11, atol=1e-11)
    known = {p.name: p.value for p in model.parameters.values() if p.value is not None}
    generic = system_of(MODELS[name], direct=direct, generic=True)
    got = system_values(generic, {**at, **known})
    np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("name", MODELS)
def test_unknown_parameters_are_asked_about_and_no_others(name):
    model = MODELS[name]
    system = system_of(model)
    unknown = [p.name for p in model.parameters.values() if not p.is_known]
    assert system.parameters == tuple(unknown)
    assert set(system.constants) == set(system.at)
    assert (system.states, system.outputs) == (tuple(model.states), tuple(model.outputs))
    assert set(system.units) >= {*system.declared, *system.outputs}


def test_an_eliminated_output_is_a_known_input_and_direct_undoes_it():
    model = pendulum.indirect_model()
    indirect, direct = system_of(model), system_of(model, direct=True)
    assert (indirect.inputs, indirect.unknown_inputs) == (("accel",), ())
    assert (direct.inputs, direct.unknown_inputs) == ((), ("a_y",))
    assert (indirect.outputs, direct.outputs) == (("gyro",), ("gyro", "accel"))


def test_generic_constants_leave_zeros_where_they_are():
    """An absent load is absent; 'some load' would be another experiment."""
    system = system_of(spring(), generic=True)
    assert system.constants == ("m",)
    assert "load" not in system.symbols
    loaded = system_of(spring(), generic=True, known={"load": 0.2})
    assert loaded.constants == ("m", "load")


def test_known_values_override_the_models():
    system = system_of(spring(), known={"d": 0.0, "m": 0.5})
    assert system.parameters == ("k", "unused")
    at = {"x": 1.0, "v": 2.0, "F": 3.0, "k": 4.0, "unused": 0.0}
    np.testing.assert_allclose(system_values(system, at), [2.0, -2.0, 1.0], rtol=1e-15)
    assert system_of(spring()).parameters == ("d", "k", "unused")  # the model is as it was


def test_a_parameter_in_no_equation_stays_a_question():
    assert "unused" in system_of(spring()).parameters


def test_known_initial_values_are_exact():
    assert dict(system_of(spring()).initial_values) == {}
    system = system_of(spring(x=0.1, v=0.0))
    assert dict(system.initial_values) == {"x": Fraction(1, 10), "v": Fraction(0)}


def test_known_values_that_divide_by_zero_are_named():
    with pytest.raises(ModelError, match="with m, load = 0: the equations divide by m.*; correct"):
        system_of(spring(), known={"m": 0.0})


def test_known_values_are_finite_and_of_parameters():
    with pytest.raises(ModelError, match="m = nan is known, but not finite; correct it"):
        system_of(spring(), known={"m": float("nan")})
    with pytest.raises(ModelError, match="has no parameter 'lod'.*did you mean 'load'"):
        system_of(spring(), known={"lod": 1.0})


# -- stages --------------------------------------------------------------------------------------


def test_delays_and_clipping_are_left_out_and_said_to_be():
    model = spring()
    late = time_delay(model, "position", 0.5).extend(model)
    clipped = saturation(late, "position", 0.9).extend(late)
    system = system_of(clipped)
    assert system.parameters == ("d", "k", "unused")
    assert not {"delay_position", "limit_position"} & set(system.symbols)
    assert left_out(clipped) == (
        "the delay of position is left out, and delay_position is not assessed",
        "the clipping of position is left out, and limit_position is not assessed",
    )
    assert left_out(model) == ()


def test_lags_and_blends_of_inputs_are_left_out_and_said_to_be():
    """What carries their tangents is no input, and their parameters are not called unidentifiable.

    A carrier that counted as an input of its own would seem to tell the lag's time constant.
    """
    model = casid.Model("driven spring")
    x, v = model.state("position", "m"), model.state("rate", "m/s")
    force = model.input("force", "N")
    k = model.parameter("k", "N/m", start=10.0)
    model.derivative(x, v)
    model.balance(v, "forces", inertia=1.0, terms=[-k * x, -v, force])
    model.output("position", x, "m")
    felt = sensor_lag(model, "position", 1.0).extend(model)
    late = sensor_lag(felt, "force", 1.0).extend(felt)
    slow = actuator_lag(late, "force", 1.0).extend(late)
    blended = hold(slow, "force").extend(slow)
    system = system_of(blended)
    assert system.parameters == ("k",)
    assert system.inputs == ("force",)
    assert left_out(blended) == (
        "the sensor's lag of position is left out, and lag_position is not assessed",
        "the sensor's lag of force is left out, and lag_force is not assessed",
        "the actuator's lag of force is left out, and tau_force is not assessed",
        "what force does between its samples is left out, and ramp_force is not assessed",
    )


def test_a_delayed_input_leaves_the_model_without_the_delay():
    model = spring()
    late = time_delay(model, "F", 0.5).extend(model)
    system, plain = system_of(late), system_of(model)
    assert (system.parameters, system.inputs) == (plain.parameters, plain.inputs)
    at = {"x": 0.1, "v": 0.2, "F": 0.3, "d": 0.4, "k": 0.5, "unused": 0.6}
    np.testing.assert_array_equal(system_values(system, at), system_values(plain, at))
    assert left_out(late) == ("the delay of F is left out, and delay_F is not assessed",)
    assert system_of(late, known={"delay_F": 0.1}).parameters == plain.parameters


def test_a_late_accelerometer_is_left_out_of_the_direct_model_too():
    model = pendulum.indirect_model()
    late = time_delay(model, "accel", 0.1).extend(model)
    assert system_of(late).inputs == ("accel",)
    assert system_of(late, direct=True).unknown_inputs == ("a_y",)
    assert system_of(late, direct=True).parameters == system_of(model, direct=True).parameters


def test_a_stage_parameter_that_an_equation_shares_is_asked_about():
    model = spring()
    biased = sensor_bias(model, "position").extend(model)
    clipped = saturation(biased, "position", 0.9).extend(biased)
    shared = clipped.copy()
    shared.stages = tuple(
        type(s)(kind=s.kind, channel=s.channel, parameter="bias_position") for s in clipped.stages
    )
    assert "bias_position" in system_of(shared).parameters
    assert left_out(shared) == ("the clipping of position is left out",)


# -- experiments ---------------------------------------------------------------------------------


@pytest.mark.parametrize("problem", [pendulum.problem, roll_decay.problem, emps.problem])
def test_the_problems_own_examples_translate_without_a_note(problem):
    examples = problem.examples()
    translation = translated(problem, examples)
    assert translation.notes == ()
    assert [s.name for s in translation.systems] == [e.name for e in examples]
    assert len(translated(problem.model, examples, direct=True).systems) == len(examples)


def test_each_experiment_knows_its_load_case():
    model = spring().with_unknown("load")
    cases = [("empty", {"load": 0.0}), ("loaded", {"load": 0.2}), ("unknown load", {})]
    experiments = [casid.Experiment(record(), known, name) for name, known in cases]
    systems = translated(model, experiments).systems
    assert [s.name for s in systems] == ["empty", "loaded", "unknown load"]
    assert ["load" in s.parameters for s in systems] == [False, False, True]
    at = {"x": 1.0, "v": 0.0, "F": 0.0, "d": 0.0, "k": 3.0, "unused": 0.0, "load": 0.3}
    accelerations = [system_values(s, at)[1] for s in systems]
    np.testing.assert_allclose(accelerations, [-10.0, -6.0, -5.0], rtol=1e-14)
    generic = translated(model, experiments, generic=True).systems
    assert [s.constants for s in generic] == [("m",), ("m", "load_loaded"), ("m",)]


def test_an_input_that_rests_is_taken_at_rest():
    experiments = [
        casid.Experiment(record(), name="moving"),
        casid.Experiment(record(F=0.0), name="free"),
        casid.Experiment(record(F=2.5), name="hanging"),
    ]
    translation = translated(spring(), experiments)
    moving, free, hanging = translation.systems
    assert (moving.inputs, moving.constants) == (("F",), tuple(moving.at))
    assert (free.inputs, "F" in free.constants) == ((), False)
    assert "F" not in free.symbols
    assert (hanging.inputs, hanging.constants[-1]) == ((), "F")
    assert hanging.at["F"] == 2.5
    assert translation.notes == (
        "free: input F is 0 in all samples, and assumed 0",
        "hanging: input F is the same in all samples, and assumed a known constant",
    )


def test_missing_samples_do_not_make_an_input_move():
    mask = np.arange(50) == 7
    run = record(F=np.where(mask, 1.0, 0.0)).mark_missing("F", mask)
    assert translated(spring(), [casid.Experiment(run)]).systems[0].inputs == ()


@pytest.mark.parametrize(("at", "inputs"), [(2.0, 2), (99.0, 1)])
def test_a_jump_after_the_record_is_no_jump(at, inputs):
    """Its input is zero on the record's clock: the size of the jump is in no equation."""
    model = spring()
    jump = parameter_jump(model, "k", at).extend(model)
    (system,) = translated(jump, [casid.Experiment(record())]).systems
    assert len(system.inputs) == inputs
    assert "jump_k" in system.parameters
    inside = {s.name() for s in ca.symvar(ca.vertcat(system.f, system.h))}
    assert ("jump_k" in inside) == (inputs == 2)


def test_a_generated_input_without_signal_stays_an_input():
    model = spring()
    extended = model.copy()
    u = extended.add_input(Input("made", "N", "generated"))
    extended.add_term("force", u)
    assert translated(extended, [casid.Experiment(record())]).systems[0].inputs == ("F", "made")


def test_a_zero_input_in_a_denominator_is_named():
    model = spring()
    model.output("ratio", model.symbol("x") / model.symbol("F"), "m/N")
    run = record(F=0.0).with_channel("ratio", np.zeros(50), "m/N")
    with pytest.raises(ModelError, match="free: .* with F = 0: the equations divide by F; correct"):
        translated(model, [casid.Experiment(run, name="free")])


def test_records_lacking_a_channel_and_no_records_are_refused():
    run = record().without("F")
    with pytest.raises(DataError, match=r"bare: no channel 'F' for spring.*Rename or map one"):
        translated(spring(), [casid.Experiment(run, name="bare")])
    with pytest.raises(DataError, match="give one or more, or use system_of"):
        translated(spring(), [])
