"""What the advice tells a user to do, as it can be done."""

from __future__ import annotations

import shlex
from dataclasses import replace

import casid
from casid.diagnosis.advice.recommendation import advice, disturbance_advice
from casid.diagnosis.evidence.disturbances import Disturbance
from casid.diagnosis.verdict.cause import Alternative, Cause


def test_a_command_in_the_advice_can_be_copied_where_a_balance_has_a_space() -> None:
    """A shell takes what stands behind the option as one argument."""
    m = casid.Model("pool")
    h = m.state("h", "m")
    A, c = m.parameter("A", "m^2", start=10.0), m.parameter("c", "m^2/s", start=1.0)
    m.balance(h, "lower pool", inertia=A, terms=[-c * h])
    m.output("level", h, "m")
    text = disturbance_advice(m, Disturbance("lower pool", 0.05, "m^3/s", 0.9, 0.0))
    command = shlex.split(text[text.index("casid identify") :].rstrip("."))
    assert command == ["casid", "identify", "--disturbance", "lower pool:first"]


def test_no_experiment_is_advised_to_separate_two_names_of_one_term() -> None:
    """Where something else stands beside them, it can be told from both."""
    same = Alternative("sensor_bias", "Q", 0.5, "is the same term", is_same_term=True)
    cause = Cause("offset", "flow", 1e-9, (), (same,), description="a constant flow")
    text = advice("deficient", [cause], (), "")
    assert text.startswith("No record of these channels can separate constant flow in the flow")
    assert "from bias of Q: they are the same term" in text
    assert "calibrate Q independently" in text
    other = Alternative("sensor_scale", "hub", 0.2, "explains the misfit as well")
    both = advice("deficient", [replace(cause, alternatives=(same, other))], (), "")
    assert both.startswith("To separate constant flow in the flow balance from gain error of hub:")
