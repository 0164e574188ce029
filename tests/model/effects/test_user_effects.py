"""Effects of a user's own: written in a few lines, refused where they cannot be judged, named."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.scores.divergence import diverging_size
from casid.errors import ModelError
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.integration.simulator import Simulator
from casid.model.declarations import Parameter
from casid.model.effects.balances.balance_effects import coulomb_friction
from casid.model.effects.effect import Effect
from casid.model.effects.user_effects import (
    balance_effect,
    channel_effect,
    parameter_effect,
    user_effects,
)
from casid.model.effects.validity import check_effects
from problems import pendulum

Ts = 0.01
MODEL = pendulum.problem.model


def stribeck(width: float = 0.2) -> Effect:
    """Friction that is largest at slow motion and gone at fast motion."""
    return balance_effect(
        "stribeck",
        "torque",
        lambda s: -s.c * s.p / width * ca.exp(-((s.p / width) ** 2)),
        parameter="c",
        unit="N m",
        sided="positive",
        description="friction that is largest at slow motion",
    )


def record(size: float, *, duration: float = 30.0, seed: int = 1) -> casid.Record:
    """The direct model (7.10) with Stribeck friction of `size` [N m], 0.01 of noise on both."""
    model = pendulum.linear_model().extend(stribeck())
    rng, N = np.random.default_rng(seed), round(duration / Ts)
    ref = pendulum.telegraph(N, Ts, amplitude=1.0, rng=rng)
    a_y = np.zeros(N)
    for i in range(1, N):
        a_y[i] = a_y[i - 1] + Ts / 0.2 * (ref[i - 1] - a_y[i - 1])
    true = {**pendulum.TABLE_7_2, "m": 0.0, "I_xm": 0.0, "g": 9.81, "c": size}
    p = np.array([true[n] for n in model.parameters])
    y = Simulator(model, Ts, substeps=2).simulate(a_y[:, None], p, np.zeros(2)).y
    y = y + 0.01 * rng.standard_normal(y.shape)
    return casid.Record(
        {"gyro": y[:, 0], "accel": y[:, 1], "ref": ref},
        {"gyro": "rad/s", "accel": "m/s^2", "ref": "m/s^2"},
        Ts=Ts,
        name="stribeck",
    )


def with_effects(*effects: object) -> casid.Problem:
    return dataclasses.replace(pendulum.problem, effects=effects)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_users_effect_is_named_where_it_acts():
    found = casid.diagnose(with_effects(stribeck()), record(0.03), advise=False)
    assert [(c.kind, c.where) for c in found.causes] == [("stribeck", "torque")]
    assert "riction that is largest at slow motion" in found.sentence
    (c,) = found.causes[0].parameters
    # Noise of the accelerometer, an input, biases the unweighted estimate by some per cent.
    assert c.value == pytest.approx(0.03, rel=0.15)
    assert (c.name, c.unit) == ("c", "N m")


def test_a_users_effect_is_not_named_where_it_does_not_act():
    quiet = record(0.0, duration=15.0)
    found = casid.diagnose(with_effects(stribeck()), quiet, starts=1, advise=False)
    assert found.verdict == "adequate"
    assert "stribeck" in {r.kind for r in found.ranking}


def test_a_function_of_the_model_may_give_one_effect_or_several():
    def each_balance(model: casid.Model) -> list[Effect]:
        return [dataclasses.replace(stribeck(), where=name) for name in model.balances]

    problem = with_effects(each_balance)
    assert [e.key for e in user_effects(MODEL, problem.effects)] == [("stribeck", "torque")]
    with pytest.raises(ModelError, match=r"5 is no casid.Effect.*casid.balance_effect"):
        with_effects(lambda model: 5)


def test_parameters_and_channels_are_changed_by_expressions_of_themselves():
    softer = parameter_effect(
        "soft_when_fast",
        "k",
        lambda s: s.k * (1 - s.c * s.p**2),
        parameter="c",
        unit="s^2/rad^2",
    )
    e = MODEL.extend(softer).explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    bent = channel_effect(
        "bent_gyro", "gyro", lambda s: s.gyro + s.b * s.gyro**3, parameter="b", unit="s^2/rad^2"
    )
    y = MODEL.extend(bent).explicit()
    h = ca.Function("h", [y.x, y.u, y.p], [y.h])
    squeezed = channel_effect(
        "weak_accel", "accel", lambda s: s.accel / s.gain, parameter="gain", unit="1", null=1.0
    )
    check_effects(MODEL, [softer, bent, squeezed])
    true = {**pendulum.TABLE_7_2, "m": 0.0, "I_xm": 0.0, "g": 9.81}
    x, p = [0.1, 2.0], [true[n] for n in MODEL.parameters]
    base = MODEL.explicit()
    before = ca.Function("f", [base.x, base.u, base.p], [base.f])
    # k (1 - c p^2) at c = 0.05 and p = 2 is 0.8 k.
    weaker = [0.8 * v if n == "k" else v for n, v in zip(MODEL.parameters, p, strict=True)]
    assert np.ravel(f(x, [0.3], [*p, 0.05])) == pytest.approx(np.ravel(before(x, [0.3], weaker)))
    assert float(h(x, [0.3], [*p, 0.1])) == pytest.approx(2.0 + 0.1 * 8.0)


def test_an_effect_may_use_a_recorded_channel_and_shapes_of_its_own():
    wind = balance_effect(
        "wind_load",
        "torque",
        lambda s: s.c * s.wind * ca.fabs(s.wind) / (1 + (s.p / s.knee) ** 2),
        parameter="c",
        unit="N m s^2/m^2",
        channels={"wind": "m/s"},
        further=[Parameter("knee", "rad/s", 1.0, lower=0.1, upper=10.0)],
    )
    check_effects(MODEL, [wind])
    extended, names = wind.extended(MODEL)
    assert extended.inputs["wind"].kind == "known"
    assert names == ("c", "knee")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: balance_effect("my_drag", "torque", lambda s: -1.0 * s.d * s.p, unit="1"),
            r"my_drag in torque: at c = 0 the extended model is not the model .*multiply what is",
        ),
        (
            lambda: balance_effect("my_drag", "torque", lambda s: -s.c * s.p, unit="N m"),
            r"my_drag in torque: .*term 4 of balance 'torque' is in .*correct the expression",
        ),
        (
            lambda: balance_effect(
                "my_drag", "torque", lambda s: -s.c * ca.tanh(s.p / 0.5), unit="N m"
            ),
            r"my_drag in torque: .*takes tanh of .*further=\[casid.Parameter\(name, unit, value=",
        ),
        (
            lambda: balance_effect("offset", "torque", lambda s: s.c * s.p, unit="N m s/rad"),
            r"'offset' in torque: the catalogue calls .* give it another, for example 'my_offset'",
        ),
        (
            lambda: balance_effect("My Drag", "torque", lambda s: s.c * s.p, unit="N m s/rad"),
            r"'My Drag' in torque: a kind is a name in lower case; call it 'my_drag'",
        ),
        (
            lambda: balance_effect("my_drag", "torqe", lambda s: s.c * s.p, unit="N m s/rad"),
            r"has no 'torqe'; did you mean 'torque'\?",
        ),
        (
            lambda: dataclasses.replace(stribeck(), parameters=()),
            r"stribeck in torque has no parameter.*multiply its term by one",
        ),
        (
            lambda: balance_effect("my_drag", "torque", lambda s: s.c * s.q, unit="N m s/rad"),
            r"my_drag in torque: .*has no 'q'",
        ),
        (
            lambda: balance_effect(
                "my_play", "torque", lambda s: s.c * ca.log(s.c) * s.phi, unit="1"
            ),
            r"my_play in torque: .*",
        ),
        (
            lambda: balance_effect("my_gain", "torque", lambda s: s.k * s.phi * s.c**2, unit="1"),
            r"my_gain in torque: its first parameter c changes nothing to first order",
        ),
    ],
)
def test_what_cannot_be_judged_is_refused_with_its_mend(make: Callable[[], Effect], message: str):
    with pytest.raises(ModelError, match=f"problem pendulum: effect.*{message}"):
        with_effects(make())


def test_the_same_effect_twice_is_refused():
    with pytest.raises(ModelError, match="stribeck in torque is there twice; give one another"):
        with_effects(stribeck(), stribeck(0.1))


def test_the_catalogues_own_effects_may_be_given_with_other_widths():
    problem = with_effects(lambda model: coulomb_friction(model, "torque", 0.5))
    assert [e.kind for e in user_effects(MODEL, problem.effects)] == ["coulomb_friction"]


def test_a_shape_with_a_unit_may_be_known():
    smooth = balance_effect(
        "dry",
        "torque",
        lambda s: -s.c * ca.tanh(s.p / s.width),
        unit="N m",
        further=[Parameter("width", "rad/s", value=0.5)],
    )
    with_effects(smooth)
    assert smooth.cost == 1
    extended, names = smooth.extended(MODEL)
    assert extended.parameters[names[1]].value == 0.5


def test_an_effect_that_runs_away_at_a_tiny_size_is_told_and_a_tame_one_is_not():
    """Negative damping of 1 % of the spring's force, c = 0.01 w m, on a mass of little damping.

    Its swing grows as exp(c t / 2 m), a factor exp(2.5) in 100 s at w = 5 rad/s; the same force
    against the motion lets it die out, and a bias of the sensor does nothing to it.
    """
    m = casid.Model("ringing mass")
    x, v = m.state("x", "m", start=0.1), m.state("v", "m/s")
    k, d = m.parameter("k", "N/m", start=50.0), m.parameter("d", "N s/m", start=0.01)
    m.derivative(x, v)
    m.balance(v, "force", inertia=2.0, terms=[-k * x, -d * v])
    m.output("position", x, "m")
    t = 0.02 * np.arange(5000)
    ringing = 0.1 * np.exp(-0.0025 * t) * np.cos(5.0 * t)
    ringing += 1e-4 * np.random.default_rng(1).standard_normal(t.size)
    data = casid.Record({"position": ringing}, {"position": "m"}, Ts=0.02)
    fit = fit_model(m, [casid.Experiment(data, {}, "r")], FitSettings(starts=1))

    def fed(sign: float) -> Effect:
        return balance_effect(
            "fed", "force", lambda s: sign * s.c * s.v, unit="N s/m", sided="positive"
        )

    expected = 0.01 * 5.0 * 2.0
    assert diverging_size(fit, fed(1.0)) == pytest.approx(expected, rel=0.02)
    assert diverging_size(fit, fed(-1.0)) is None
    bias = channel_effect("bias", "position", lambda s: s.position + s.c, unit="m")
    assert diverging_size(fit, bias) is None
