"""A bound that a fit ends at is said as it was declared."""

from __future__ import annotations

from types import SimpleNamespace

import casid
from casid.diagnosis.verdict.gain import bounds_met


def test_a_bound_without_a_unit_is_a_number_alone():
    m = casid.Model("bicycle")
    v = m.state("v", "m/s")
    rolling = m.parameter("c_r", "1", start=0.01, lower=0.0)
    damping = m.parameter("d", "kN s/m", start=0.1, lower=0.002)
    weight = m.constant("W", 900.0, "N")
    mass = m.constant("M", 90.0, "kg")
    m.balance(v, "force", inertia=mass, terms=[-rolling * weight, -damping * v])
    m.output("v", v, "m/s")
    variables = tuple(SimpleNamespace(name=n, source=n) for n in ("c_r", "d", "v(0)"))
    fit = SimpleNamespace(
        criterion=SimpleNamespace(variables=variables),
        solution=SimpleNamespace(at_lower=("c_r", "d"), at_upper=()),
    )
    assert bounds_met(casid.Problem("bicycle", m), fit) == {
        "c_r": "c_r at its lower bound (0)",
        "d": "d at its lower bound (0.002 kN s/m)",
    }
