"""What a model says is exact: a diagnosis that finds a deficiency says what that is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import casid
from casid.diagnosis.verdict.taken_as_exact import taken_as_exact


def cooled(eta: float) -> casid.Record:
    """A store of 1 kJ/K that leaks 0.05 kW/K and is cooled by `eta` times a stepped power."""
    rng, T = np.random.default_rng(2), [0.0]
    P = np.repeat(rng.uniform(0, 1, 40), 20)
    for power in P[:-1]:
        # The step of a linear store under constant power is exact.
        rest = -eta * power / 0.05
        T.append(rest + (T[-1] - rest) * float(np.exp(-0.05)))
    noisy = np.array(T) + 0.01 * rng.standard_normal(len(T))
    return casid.Record({"P": 1e3 * P, "T": noisy}, {"P": "W", "T": "K"}, Ts=1.0)


def store(*, is_constant: bool) -> casid.Problem:
    m = casid.Model("store")
    T, P = m.state("T", "K"), m.input("P", "kW", hold="zoh")
    UA = m.parameter("UA", "kW/K", start=0.05, lower=1e-3)
    eta = m.constant("eta", 2.0, "1") if is_constant else m.parameter("eta", "1", value=2.0)
    C = m.parameter("C", "kJ/K", value=1.0)
    m.balance(T, "heat", inertia=C, terms=[-UA * T, -eta * P], unit="kW")
    m.output("T", T, "K")
    return casid.Problem("store", m)


def notes_on_eta(problem: casid.Problem, eta: float) -> list[str]:
    found = casid.diagnose(problem, cooled(eta), advise=False)
    return [n for n in found.notes if "never suspected: eta." in n]


@pytest.mark.slow
def test_a_deficient_model_names_the_constants_that_no_cause_stands_for():
    """The efficiency is 1.5 where the model has 2: a wrong one makes the model deficient."""
    assert len(notes_on_eta(store(is_constant=True), 1.5)) == 1


@pytest.mark.slow
def test_an_adequate_model_and_one_without_constants_have_no_such_note():
    assert notes_on_eta(store(is_constant=True), 2.0) == []
    assert notes_on_eta(store(is_constant=False), 1.5) == []


def converter(*, known: bool) -> casid.Problem:
    """A buck converter: the duty cycle is its only input, the source a constant."""
    m = casid.Model("buck converter")
    D = m.input("D", "%", hold="zoh", known=known)
    i, v = m.state("i", "A"), m.state("v", "V")
    V_in, R = m.constant("V_in", 12, "V"), m.constant("R", 2, "ohm")
    L = m.parameter("L", "uH", start=60, lower=1, upper=1000)
    C = m.parameter("C", "uF", start=150, lower=1, upper=5000)
    r = m.parameter("r", "mohm", start=50, lower=0, upper=2000)
    m.balance(i, "voltage", inertia=L, terms=[D * V_in, -v, -r * i])
    m.balance(v, "current", inertia=C, terms=[i, -v / R])
    m.output("i", i, "A")
    m.output("v", v, "V")
    return casid.Problem("buck", m)


def switched(gain: float, drop: float) -> casid.Record:
    """A converter of 47 uH and 220 uF whose switch passes `gain` of the source, less a voltage."""
    rng, Ts, N = np.random.default_rng(4), 5e-6, 2400
    D = np.repeat(rng.uniform(0.25, 0.6, N // 60), 60)
    A = np.array([[-0.05 / 47e-6, -1 / 47e-6], [1 / 220e-6, -1 / (2 * 220e-6)]])
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[0, 2] = A * Ts, Ts / 47e-6
    step = expm(whole)
    x = np.zeros((N, 2))
    for k in range(N - 1):
        x[k + 1] = step[:2, :2] @ x[k] + step[:2, 2] * (12 * gain * D[k] - drop)
    noisy = x + rng.normal(size=x.shape) * (0.01, 0.003)
    channels = {"D": D, "i": noisy[:, 0], "v": noisy[:, 1]}
    return casid.Record(channels, {"D": "1", "i": "A", "v": "V"}, Ts)


@pytest.mark.slow
def test_a_known_input_may_have_another_gain():
    """That it has no noise says nothing of what its actuator makes of it."""
    found = casid.diagnose(converter(known=True), switched(0.96, 0.4), advise=False)
    assert {(c.kind, c.where) for c in found.causes} == {
        ("offset", "voltage"),
        ("sensor_scale", "D"),
    }
    L = found.extended.parameter("L")
    assert abs(L.value - 47.0) < 4 * L.std_error
    (note,) = (n for n in found.notes if "`known=True`" in n)
    assert "a bias of D acts exactly as a constant of the voltage balance" in note


def test_the_notes_name_what_is_never_suspected_and_how_to_have_it_suspected():
    """A known value is tested for changes; only one that is estimated can come out different."""
    constants, commands = taken_as_exact(converter(known=True).model)
    assert "never suspected: V_in, R." in constants
    assert "have it estimated, `parameter(name, unit, start=)`" in constants
    assert "never suspected of any: D." in commands
    assert taken_as_exact(converter(known=False).model) == (constants,)


@pytest.mark.slow
def test_a_measured_input_s_bias_is_the_same_term_as_a_constant_in_its_one_balance():
    """What the switch loses might be a bias of the duty cycle: no record shows which."""
    found = casid.diagnose(converter(known=False), switched(1.0, 0.4), hold_out=0.0)
    (cause,) = found.causes
    assert {(cause.kind, cause.where)} | {(a.kind, a.where) for a in cause.alternatives} == {
        ("offset", "voltage"),
        ("sensor_bias", "D"),
    }
    assert cause.is_inseparable
    assert "no record of these channels can separate them" in found.sentence
    assert found.advice.startswith("No record of these channels can separate")
    assert found.proposals == ()
    assert "against the named one" not in str(found)
