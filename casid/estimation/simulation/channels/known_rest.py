"""The rest that a record begins in, where every state is declared to be known at its start.

Where x(0) is known and f(x(0), u, theta) = 0 has one solution u for all theta, the system rested at
that u before the record: an infusion that is on at the first sample was off until then. Not so
where a state is known but does not rest, as the level of a tank that empties through its outlet.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.model.model import Model

_ROUNDING = 1e-9
"""Relative size of what counts as zero: rounding errors, many times over."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownRest:
    """What is known of a system before its record.

    Attributes
    ----------
    inputs : recorded input -> its value there, SI, of those that the rest determines.
    outputs : those that no input moves at once, which are at rest at the first sample.
    """

    inputs: dict[str, float] = field(default_factory=dict)
    outputs: frozenset[str] = frozenset()


def rest_before(model: Model) -> KnownRest:
    """What was before each record of a model; empty for a model without stages."""
    return known_rest(model) if model.stages else KnownRest()


def known_rest(model: Model) -> KnownRest:
    """The rest that the records of a model begin in; empty where none is known.

    Inputs that enter otherwise than linearly there may have several, and none is known. A
    band-limited input moves before its first sample, and is none of those that are determined.
    """
    e, states = model.explicit(), list(model.states.values())
    # A state that an effect has added begins in its nominal value, and need not rest.
    own = [i for i, s in enumerate(states) if not s.is_added]
    recorded = [n for n, entry in model.inputs.items() if entry.kind in ("measured", "known")]
    if not own or any(states[i].initial is None for i in own):
        return KnownRest()
    u = ca.SX.sym("u", len(recorded))
    inputs = ca.SX.zeros(len(e.inputs))
    inputs[[e.inputs.index(n) for n in recorded]] = u
    x0 = ca.SX(ca.DM([s.nominal for s in states]))
    f, h = ca.substitute([e.f[own], e.h], [e.x, e.u], [x0, inputs])
    slopes = ca.jacobian(f, u)
    if recorded and any(ca.which_depends(ca.vec(slopes), u, 1, True)):
        return KnownRest()
    parts = [ca.densify(ca.substitute(f, u, 0 * u)), ca.densify(slopes)]
    at_zero = ca.Function("at_zero", [e.p], parts)
    p = np.array([entry.nominal for entry in model.parameters.values()])
    # A parameter of an effect that is zero, so that nothing changes, stays zero.
    other = p * np.random.default_rng(0).uniform(0.5, 1.5, len(p))
    rest, elsewhere = (_rest(*(np.array(v) for v in at_zero(q))) for q in (p, other))
    if rest is None or elsewhere is None:
        return KnownRest()
    if not np.allclose(rest, elsewhere, rtol=_ROUNDING, atol=0.0, equal_nan=True):
        return KnownRest()
    moved = ca.which_depends(h, u, 1, True) if recorded else [False] * len(e.outputs)
    return KnownRest(
        {
            name: value
            for name, value in zip(recorded, rest.tolist(), strict=True)
            if np.isfinite(value) and model.acting_hold(name) != "bandlimited"
        },
        frozenset(n for n, moves in zip(e.outputs, moved, strict=True) if not moves),
    )


def _rest(rates: Array, slopes: Array) -> Array | None:
    """The inputs (nu,) with rates (nx, 1) + slopes (nx, nu) u = 0, or None where there are none.

    NaN where any value, or one that goes with another input's, would do.
    """
    system = np.hstack([slopes, rates])
    if not np.all(np.isfinite(system)):
        return None
    system = system / np.maximum(np.abs(system).max(axis=1, keepdims=True), 1e-300)
    sizes = np.maximum(np.abs(system[:, :-1]).max(axis=0, initial=0.0), 1e-300)
    scaled, wanted = system[:, :-1] / sizes, -system[:, -1]
    u, _, rank, _ = np.linalg.lstsq(scaled, wanted, rcond=_ROUNDING)
    if np.any(np.abs(scaled @ u - wanted) > _ROUNDING):
        return None
    _, _, directions = np.linalg.svd(scaled)
    free = np.abs(directions[rank:]).max(axis=0, initial=0.0) > _ROUNDING
    u = np.where(np.abs(u) > _ROUNDING**2, u, 0.0)
    return np.where(free, np.nan, u / sizes)
