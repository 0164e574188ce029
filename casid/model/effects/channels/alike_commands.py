"""Commands that a model takes as alike: a drone's rotors, two thrusters, two valves of one pipe.

They enter the same equations by the same law, each with its own sign or lever arm. Their actuators
are then of one make: what one does to its command, all of them do. One at a time, such an effect
would unbalance what the commands do together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.model.model import Model


def alike_commands(model: Model, channels: Sequence[str]) -> list[tuple[str, ...]]:
    """Groups of two or more of `channels`, inputs of a model, that act by one law.

    The slopes of all equations in one, and in another in its place, are in a proportion that
    depends on nothing that moves or is estimated.
    """
    groups: list[list[str]] = []
    for channel in channels:
        for group in groups:
            if _is_alike(model, group[0], channel):
                group.append(channel)
                break
        else:
            groups.append([channel])
    return [tuple(group) for group in groups if len(group) > 1]


def _is_alike(model: Model, one: str, other: str) -> bool:
    a, b = model.inputs[one], model.inputs[other]
    if (a.unit, a.kind, a.hold) != (b.unit, b.kind, b.hold):
        return False
    sides = [ca.SX(b.total) for b in model.balances.values()]
    sides += [ca.SX(rate) for rate in model._rates.values()]
    sides += [ca.SX(e) for e, _ in model.outputs.values()]
    u = ca.SX.sym("u")
    slopes = [
        ca.substitute(ca.jacobian(ca.vertcat(*sides), model.symbol(n)), model.symbol(n), u)
        for n in (one, other)
    ]
    return _in_proportion(model, *(ca.densify(s) for s in slopes))


def _in_proportion(model: Model, a: Any, b: Any) -> bool:
    """True if two columns of slopes have one ratio in each row, whatever moves or is estimated."""
    names = {s.name(): s for s in ca.symvar(ca.vertcat(a, b))}
    fixed = {n for n in names if n in model.parameters and model.parameters[n].is_known}
    function = ca.Function("slopes", [ca.vertcat(ca.SX(0, 1), *names.values())], [a, b])
    rng = np.random.default_rng(7)
    known = rng.uniform(0.3, 1.7, len(names))
    is_fixed = np.array([n in fixed for n in names], dtype=bool)
    ratios = []
    for _ in range(3):
        at = np.where(is_fixed, known, rng.uniform(0.3, 1.7, len(names)))
        first, second = (np.asarray(v.full()).ravel() for v in function(at))
        felt = first != 0.0
        if not np.all(np.isfinite([*first, *second])) or np.any(felt != (second != 0.0)):
            return False
        ratios.append(second[felt] / first[felt])
    return bool(len(ratios[0])) and np.allclose(ratios, ratios[0], rtol=1e-9, atol=0.0)
