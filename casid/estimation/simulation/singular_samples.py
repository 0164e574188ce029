"""Samples at which the equations of a model have no finite value, or no finite slope."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.model.model import Model
from casid.model.singular_parts import singular_part

Expr = Any  # a CasADi SX expression

_REWRITE = (
    "rewrite the equations so that they have a value there (multiplied out, or with ca.fmax or "
    "ca.if_else)"
)


def singular_sample(
    model: Model, u: Array, p: Array, t: Array, x: Array, samples: Sequence[int] | None
) -> tuple[str, str] | None:
    """An operation of the equations that has no finite value at a sample, and the remedy.

    Parameters
    ----------
    u : (N, nu) the inputs, in the order of the model's.
    p : (np,) its parameters.
    t : (N,) [s].
    x : (nx,) a state, of which nothing is concluded: what it makes singular is left to others.
    samples : those in question; None for all.

    Returns
    -------
    tuple or None
        What the equations do at which instant, ``divide by F, which is 0 at t = 300 s``; None where
        no input and no parameter alone makes them so.
    """
    e = model.explicit()
    if e.u.numel() != u.shape[1]:
        return None
    values, symbols = ca.vertcat(e.f, e.h), ca.vertcat(e.x, e.u, e.p)
    slopes = ca.jacobian(values, ca.vertcat(e.x, e.p))
    points = np.column_stack([np.tile(x, (len(u), 1)), u, np.tile(p, (len(u), 1))])
    asked = np.arange(len(u)) if samples is None else np.array(samples)
    for expressions, of_what in ((values, ""), (slopes, "slopes of the ")):
        bad = asked[_has_no_value(expressions, symbols, points[asked])]
        found = singular_part(expressions, symbols, points[bad[0]]) if bad.size else None
        if found is None:
            continue
        inside = {s.name() for s in ca.symvar(found.part)}
        if inside & set(e.states):
            continue
        the = f"the {of_what}equations {found}"
        if not inside & set(e.inputs):
            return the, "change the values of its parameters"
        count = int(np.sum(_has_no_value(found.whole, symbols, points)))
        there = f"{the} at t = {t[bad[0]]:g} s, in {count} of {len(u)} samples"
        window = ", or take a window without these samples" if count < len(u) else ""
        return there, _REWRITE + window
    return None


def _has_no_value(expressions: Expr, symbols: Expr, points: Array) -> Array:
    """(N,) True where any entry of an (m, n) SX is not finite at a point of (N, k)."""
    function = ca.Function("parts", [symbols], [ca.vec(ca.densify(expressions))])
    return np.asarray(~np.isfinite(np.asarray(function(points.T), dtype=float)).all(axis=0))
