"""Effects that are the same term of the equations, and those that only look alike."""

from __future__ import annotations

import pytest

import casid
from casid.model.effects.balances.balance_effects import offset
from casid.model.effects.channels.channel_effects import sensor_bias, sensor_scale
from casid.model.effects.clock_effects import bias_drift, bias_step, knock, offset_step
from casid.model.effects.same_terms import is_same_term
from casid.model.model import Model


def lift(gain: str = "none", second: bool = False) -> Model:
    """A pump feeds a cylinder; `gain` of its flow, which may also leave by a second way."""
    m = casid.Model("lift")
    Q, x, v = m.input("Q", "m^3/s"), m.state("x", "m"), m.state("v", "m/s")
    p = m.state("p", "Pa")
    A, M = m.constant("A", 2e-3, "m^2"), m.parameter("M", "kg", start=700.0)
    d, C = m.parameter("d", "N s/m", start=5000.0), m.parameter("C", "m^3/Pa", start=1e-11)
    k = {
        "none": 1,
        "estimated": m.parameter("k", "1", start=1.0),
        "known": m.parameter("given", "1", value=1.0),
        "by a signal": p * m.constant("per_pressure", 1e-5, "1/Pa"),
    }[gain]
    jet = [m.constant("rho_v", 30.0, "kg/(m^2 s)") * Q] if second else []
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[A * p, -d * v, *jet], unit="N")
    m.balance(p, "flow", inertia=C, terms=[k * Q, -A * v], unit="m^3/s")
    m.output("x", x, "m")
    m.output("p", p, "Pa")
    return m


@pytest.mark.parametrize("gain", ["none", "estimated"])
def test_a_bias_of_an_input_of_one_balance_is_a_constant_there(gain):
    m = lift(gain)
    assert is_same_term(m, offset(m, "flow"), sensor_bias(m, "Q"))
    # Each is searched for its own instant.
    assert is_same_term(m, offset_step(m, "flow", 70.0), bias_step(m, "Q", 70.02))


@pytest.mark.parametrize(
    "model",
    [lift("known"), lift("by a signal"), lift(second=True)],
    ids=["of a known gain, which another record may change", "by a signal", "in two balances"],
)
def test_a_bias_that_another_record_can_show_is_no_constant(model):
    assert not is_same_term(model, offset(model, "flow"), sensor_bias(model, "Q"))


def test_effects_of_other_places_and_courses_are_others():
    m = lift()
    assert not is_same_term(m, offset(m, "flow"), offset(m, "force"))
    assert not is_same_term(m, offset(m, "flow"), sensor_scale(m, "Q"))
    assert not is_same_term(m, offset(m, "flow"), offset_step(m, "flow", 70.0))
    assert not is_same_term(m, knock(m, "flow", 70.0, 0.02), offset_step(m, "flow", 70.0))
    assert not is_same_term(m, bias_drift(m, "Q", (0.0, 100.0)), offset_step(m, "flow", 70.0))
    # At rest, to a linear model, but not the same term: a state of its own stands for it.
    assert not is_same_term(m, sensor_bias(m, "p"), offset(m, "force"))
