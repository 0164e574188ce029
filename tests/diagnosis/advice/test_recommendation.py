"""What the advice tells a user to do, as it can be done."""

from __future__ import annotations

import shlex

import casid
from casid.diagnosis.advice.recommendation import disturbance_advice
from casid.diagnosis.evidence.disturbances import Disturbance


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
