"""Accelerometer outputs written as the sum of the modelled forces over the mass.

An accelerometer responds to every force. An output written as `m.der(v)` follows a force that is
added to the balance; one written as a sum of forces over the mass does not, and the misfit is then
attributed to the sensor. With J dv/dt = sum of terms, an output

    y = s (sum of terms) / J + r,    s = 1 or -1                                              (1)

whose rest r holds no parameter that is estimated is s dv/dt + r.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.model.declarations import Balance
from casid.model.model import Model
from casid.model.units import same_dimension

_MOST_TERMS = 10  # of a balance, whose subsets are tried to write the rest of (1)


def with_written_accelerations(model: Model) -> tuple[Model, dict[str, str]]:
    """A copy whose outputs (1) hold the derivative, and output -> balance of those.

    Returns
    -------
    the model itself where it has none. The outputs have the values that they had.
    """
    balances = [b for b in model.balances.values() if same_dimension(_unit(model, b), "m/s")]
    new, found = model, {}
    for name, (expression, unit) in model.outputs.items():
        if not same_dimension(unit, "m/s^2") or _depends(expression, model._derivatives.values()):
            continue
        for b in balances:
            written = _written(model, ca.SX(expression), b)
            if written is not None:
                new = model.copy() if new is model else new
                new.replace_output(name, written, unit)
                found[name] = b.name
                break
    return new, found


def _unit(model: Model, balance: Balance) -> str:
    return model.states[balance.rate].unit


def _depends(expression: Any, symbols: Sequence[Any] | Any) -> bool:
    return bool(np.any(ca.which_depends(ca.SX(expression), ca.vertcat(*symbols))))


def _written(model: Model, y: Any, b: Balance) -> Any | None:
    """An output by (1), or None where it is no such acceleration."""
    free = [model.symbol(n) for n, p in model.parameters.items() if not p.is_known]
    rate = model.der(model.symbol(b.rate))
    if not free or len(b.terms) > _MOST_TERMS or _depends(b.total, model._derivatives.values()):
        return None
    total = b.total / b.inertia
    if not _depends(total, free):
        return None
    shares = _values([t / b.inertia for t in b.terms], y, free)
    if shares is None:
        return None
    terms, output, slopes = shares
    for s in (1.0, -1.0):
        if not _is_nothing(slopes[:, 0] - s * slopes[:, 1], slopes):
            continue
        rest = output - s * terms.sum(axis=1)
        for size in range(len(b.terms)):
            for kept in combinations(range(len(b.terms)), size):
                if _is_nothing(rest + s * terms[:, list(kept)].sum(axis=1), terms):
                    return s * rate - s * sum((b.terms[i] / b.inertia for i in kept), ca.SX(0))
        return s * rate + (y - s * total)
    return None


def _values(terms: list[Any], y: Any, free: list[Any]) -> tuple[Array, Array, Array] | None:
    """Terms (P, n), output (P,) and both slopes by the unknown parameters (Q, 2), at random points.

    None where they are not finite.
    """
    total, unknown = sum(terms, ca.SX(0)), ca.vertcat(*free)
    both = [ca.densify(ca.jacobian(e, unknown)) for e in (y, total)]
    symbols = ca.symvar(ca.veccat(*terms, y))
    function = ca.Function("f", [ca.vertcat(*symbols)], [ca.vertcat(*terms), y, *both])
    rng = np.random.default_rng(5)
    points = [function(rng.uniform(0.3, 1.7, len(symbols))) for _ in range(6)]
    values = [[np.asarray(v, dtype=float).ravel() for v in point] for point in points]
    if not all(np.all(np.isfinite(v)) for point in values for v in point):
        return None
    slopes = np.vstack([np.column_stack(point[2:]) for point in values])
    return np.array([v[0] for v in values]), np.array([v[1][0] for v in values]), slopes


def _is_nothing(difference: Array, beside: Array) -> bool:
    return bool(np.max(np.abs(difference)) <= 1e-9 * np.max(np.abs(beside)))
