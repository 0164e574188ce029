"""What the indirect pendulum cannot show, and what would mend it.

With S a_s as its input and the gyro as its output, k, d and I_x are found up to the sensors' scales
and nothing tells a constant torque from a constant angle (Linder 2017, section 7.3).
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.diagnosis.advice.recommendation import by_others, possible_causes
from casid.diagnosis.advice.undetectable import (
    Undetectable,
    absorbed_effects,
    practical_remedy,
    undetectable_effects,
)
from casid.diagnosis.evidence.scores.score_tests import score_test
from casid.diagnosis.thresholds import PLANNING
from casid.diagnosis.verdict.cause import Alternative, Cause
from casid.estimation.estimate import Estimated
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.declarations import Parameter
from casid.model.effects.balances.balance_effects import extra_input, offset, quadratic_damping
from casid.model.effects.channels.channel_effects import sensor_bias, sensor_scale
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.channels.sensor_effects import rectified
from casid.model.effects.effect import Effect
from casid.model.model import Model
from problems import pendulum
from tests.support import truth


def scale(model: Model, channel: str) -> Effect:
    """A sensor that shows 1 + s times its quantity."""
    p = Parameter(f"scale_{channel}", "1", 0.0)

    def apply(new, names):
        s = 1 + new.symbol(names[0])
        if channel in new.outputs:
            expression, unit = new.outputs[channel]
            new.replace_output(channel, expression * s, unit)
        else:
            new.substitute_symbol(channel, new.symbol(channel) / s)

    return Effect("sensor_scale", channel, (p,), apply)


@pytest.fixture(scope="module")
def experiments() -> list[casid.Experiment]:
    hidden = truth.cart_pendulum(seed=4, duration=20, Ts=0.02)
    columns = {n: np.asarray(c) for n, c in hidden.columns.items() if n != "t"}
    columns["speed"] = np.zeros(len(columns["gyro"]))  # stands still
    record = casid.Record(columns, {n: hidden.units[n] for n in columns}, Ts=0.02, name="record")
    return [casid.Experiment(record, {"m": 0.0})]


@pytest.fixture(scope="module")
def fitted(experiments):
    return fit_model(pendulum.problem.model, experiments, FitSettings(starts=1))


def asked(fit, effects, **options) -> dict[tuple[str, str], Undetectable]:
    model = fit.criterion.model
    table = score_test(fit, effects, input_sd={}, draws=50)
    found = undetectable_effects(table, model, fit.criterion.experiments, **options)
    return {(i.kind, i.where): i for i in found}


def test_a_constant_torque_and_a_bias_of_the_accelerometer_are_the_initial_angle(fitted):
    model = fitted.criterion.model
    found = asked(fitted, [offset(model, "torque"), sensor_bias(model, "accel")])
    assert len(found) == 2
    for i in found.values():
        assert i.reason == "structural"
        assert i.absorbed_by == ("phi(0)",)
        assert "Add a sensor of phi, make its initial value known" in i.remedy
    remedy = found["offset", "torque"].remedy
    assert remedy.endswith("or measure what acts in the torque balance itself.")


@pytest.mark.parametrize("channel", ["gyro", "accel"])
def test_the_scale_of_a_sensor_is_stiffness_damping_and_inertia_together(fitted, channel):
    i = asked(fitted, [scale(fitted.criterion.model, channel)])["sensor_scale", channel]
    assert i.is_structural
    assert i.visible < 1e-4
    assert {"k", "d", "I_x"} <= set(i.absorbed_by)
    assert "Give one of k, d, I_x a known value, or calibrate" in i.remedy


def test_a_gain_about_the_mean_that_shows_hides_no_gain_from_zero(fitted):
    """About a reading of 0.1 rad/s it is a bias of the gyro besides, which the record shows."""
    model = fitted.criterion.model
    about = sensor_scale(model, "gyro", 0.1)
    assert asked(fitted, [about]) == {}
    i = asked(fitted, [about, sensor_scale(model, "gyro")])["sensor_scale", "gyro"]
    imitators = "other values of k, d, I_x, p(0) and phi(0)"
    assert i.words == f"gain error of gyro (would look like {imitators})"


def test_the_gain_of_a_known_input_is_not_among_what_is_undetectable(experiments):
    """The user says what it is; the list and the advice are made of the same causes."""
    base = pendulum.problem.model
    model = base.copy()
    model.inputs["accel"] = replace(model.inputs["accel"], kind="known")
    for each, names in ((base, ["accel"]), (model, [])):
        fit = fit_model(each, experiments, FitSettings(starts=1))
        table = score_test(fit, [scale(each, "accel")], input_sd={}, draws=50)
        assert [e.where for _, e in absorbed_effects(table, each)] == names


def test_what_is_told_of_the_confounded_parameters_stands_with_them(fitted, monkeypatch):
    patient = replace(PLANNING, formula_limit=20.0)  # a slow machine's time
    monkeypatch.setattr("casid.diagnosis.advice.undetectable.PLANNING", patient)
    i = asked(fitted, [scale(fitted.criterion.model, "gyro")])["sensor_scale", "gyro"]
    assert "d/k" in i.identifiable
    assert "identifiable all the same" in i.why


def test_a_known_stiffness_makes_the_scale_of_the_gyro_visible(fitted, experiments):
    """The mend that was named works."""
    model = pendulum.problem.model.with_known(k=fitted.values["k"])
    fit = fit_model(model, experiments, FitSettings(starts=1))
    assert asked(fit, [scale(model, "gyro")]) == {}


def test_a_channel_that_rests_hides_what_depends_on_it_in_this_record_alone(fitted):
    model = fitted.criterion.model
    effect = extra_input(model, "torque", "speed", "m/s")
    i = asked(fitted, [effect])["extra_input", "speed"]
    assert i.reason == "practical"
    assert i.remedy == "Record speed while it moves: it is constant in record."


def test_a_channel_of_one_sign_shows_no_rectification_until_it_passes_through_zero(fitted):
    """A wider band of excitation would not help."""
    model = fitted.criterion.model
    remedy = practical_remedy(rectified(model, "gyro"), model, fitted.criterion.experiments)
    assert remedy == "Record gyro while it passes through zero, where it can."


def test_a_delay_is_not_asked_structurally(fitted):
    """It has no exact algebra; nearly all of it is absorbed here, and the threshold says so."""
    model = fitted.criterion.model
    i = asked(fitted, [time_delay(model, "gyro", 0.2)], threshold=0.5)["time_delay", "gyro"]
    assert i.reason == "practical (structure not checked)"
    assert "wider band" in i.remedy


def test_what_is_visible_is_not_listed_and_structural_causes_come_first(fitted):
    model = fitted.criterion.model
    effects = [
        quadratic_damping(model, "torque"),
        extra_input(model, "torque", "speed", "m/s"),
        offset(model, "torque"),
    ]
    found = asked(fitted, effects)
    assert list(found) == [("offset", "torque"), ("extra_input", "speed")]
    plain = json.loads(json.dumps([i.to_json() for i in found.values()]))
    assert plain[0]["reason"] == "structural"


def test_what_may_be_the_cause_is_seen():
    """A lag that explains as well as a jump was called undetectable in the same report."""
    rival = Alternative("sensor_lag", "T", 0.4, "explains the misfit as well")
    cause = Cause("parameter_jump", "T_a", 0.01, (), (rival,))
    assert possible_causes([cause]) == {("parameter_jump", "T_a"), ("sensor_lag", "T")}


def test_an_undetectable_cause_is_called_by_the_law_of_its_balance():
    law = "a constant voltage that opposes i, as a brush drop does"
    dead = Undetectable("coulomb_friction", "coil", "practical", 0.0, law=law)
    assert dead.words == "constant voltage that opposes i in the coil balance"
    assert str(dead).startswith(dead.words)


def test_a_cause_that_the_others_alone_make_identifiable_is_flagged():
    """A bias of 0.2 V stood beside a resting level that had moved by -0.2 V."""
    bent = Cause("scheduled_parameter", "tau~y", 0.01, ())
    bias = Cause("sensor_bias", "y", 0.01, ())
    absorbed = [
        Undetectable("sensor_bias", "y", "structural", 0.0, ("y_0",)),
        Undetectable("scheduled_parameter", "tau~y", "practical", 0.0),
    ]
    (note,) = by_others(absorbed, [bent, bias])
    assert note.startswith("bias of y is determined by the form of the other cause alone")
    assert "another value of y_0" in note
    assert by_others(absorbed, [bias]) == ()  # of several records, or a load case
    assert by_others(absorbed[1:], [bent, bias]) == ()
    step = replace(bias, parameters=(Estimated("bias_y", 0.1, "V"), Estimated("time", 2.0, "s")))
    assert by_others(absorbed, [bent, step]) == ()
