"""Parts that swing along, beside a line of the spectrum."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casid
from casid.diagnosis.search.refits.swinging_parts import (
    beside_lines,
    is_swinging_from_rest,
    may_move,
)
from casid.model.effects.balances.missing_parts import missing_mode


def rotor() -> casid.Model:
    m = casid.Model("rotor")
    w, u = m.state("w", "rad/s"), m.input("u", "N m")
    d = m.parameter("d", "N m s/rad", start=0.1, lower=0.0)
    m.balance(w, "torque", inertia=m.constant("J", 1.0, "kg m^2"), terms=[u, -d * w])
    m.output("w", w, "rad/s")
    return m


def test_a_part_found_without_a_mass_is_not_set_in_motion() -> None:
    """Its fit has neither a frequency nor a damping, as nothing shows them."""
    part = missing_mode(rotor(), "torque", 2.0)
    assert is_swinging_from_rest(part)
    names = tuple(p.name for p in part.parameters)
    massless: Any = SimpleNamespace(
        effect=part, names=names, fit=SimpleNamespace(values={"d": 0.1, names[0]: 0.0}), merit=1.0
    )
    assert not may_move(massless)  # nor, once it is adopted, by its refinement
    line: Any = SimpleNamespace(effect=SimpleNamespace(kind="periodic_disturbance"), merit=2.0)
    line.effect.cost = 5.0
    said: list[str] = []
    nothing: Any = None
    found = beside_lines(nothing, nothing, [line, massless], said.append)
    assert found == [line, massless]
    assert not said
