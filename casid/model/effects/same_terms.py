"""Effects that are one and the same term of the equations: no record separates them.

A bias b of an input u that acts in one balance by a constant gain k, k (u - b), is a constant -k b
there. The equations of the model with the one effect of size s are those with the other of size
c s, at every state, input and value of the parameters; so are all outputs, whatever is recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.model.effects.clock_effects import at_instant
from casid.model.effects.effect import Effect
from casid.model.model import Model

_DRAWS, _POINTS = 3, 8  # values of what is estimated; of all else, for each of them


def is_same_term(model: Model, one: Effect, other: Effect) -> bool:
    """True where two effects of one size each are the same term, up to a constant factor.

    The factor may depend on what is estimated, and then stands in no record; it may not depend on a
    known value, which another record can change. Two that set in at an instant are compared at one
    instant, which is searched for either.

    Parameters
    ----------
    model : that both extend.
    """
    if any(e.test != "score" or len(e.parameters) != 1 for e in (one, other)):
        return False
    if one.sided != other.sided or one.sets_in != other.sets_in:
        return False
    try:
        if one.sets_in:
            if (one.end is None) != (other.end is None):
                return False
            other = at_instant(other, model, one.constants["time"], one.end)
        (first, (a,)), (second, (b,)) = (e.extended(model) for e in (one, other))
        slopes = [_slope(first, a), _slope(second, b)]
    except ModelError:
        return False
    if _frame(first, a) != _frame(second, b):
        return False  # of other states, inputs or stages
    rng = np.random.default_rng(7)
    return all(
        _are_proportional(slopes, *_points(first, a, rng), is_one_sided=one.sided == "positive")
        for _ in range(_DRAWS)
    )


def _slope(model: Model, own: str) -> Any:
    """How rates and outputs move with the parameter `own`, a function of x, u, p and its value."""
    e = model.explicit()
    size = ca.SX.sym("size")
    slope = ca.densify(ca.jacobian(ca.vertcat(e.f, e.h), model.symbol(own)))
    slope = ca.substitute(slope, model.symbol(own), size)
    others = ca.vertcat(ca.SX(0, 1), *(model.symbol(n) for n in e.parameters if n != own))
    return ca.Function("slope", [e.x, e.u, others, size], [slope])


def _frame(model: Model, own: str) -> tuple[object, ...]:
    """What a model has beside its equations, but for the parameter `own`."""
    parameters = {n: p for n, p in model.parameters.items() if n != own}
    return model.states, model.inputs, model.stages, parameters, list(model.outputs)


def _points(
    model: Model, own: str, rng: np.random.Generator
) -> tuple[list[tuple[Array, Array, Array]], Array]:
    """States, inputs and parameters but `own`, with one draw of what is estimated, and sizes.

    States, inputs and sizes have all signs and orders of magnitude: some laws differ in them alone.
    """
    parameters = [p for n, p in model.parameters.items() if n != own]
    estimated = rng.uniform(0.2, 1.7, len(parameters))

    def signals(n: int) -> Array:
        return np.asarray(rng.choice([-1.0, 1.0], n) * 10.0 ** rng.uniform(-3, 3, n))

    def values() -> Array:
        known = rng.uniform(0.2, 1.7, len(parameters))
        fixed = [
            (p.value if p.is_constant else known[i]) if p.is_known else estimated[i]
            for i, p in enumerate(parameters)
        ]
        return np.array(fixed, dtype=float)

    made = [
        (signals(len(model.states)), signals(len(model.inputs)), values()) for _ in range(_POINTS)
    ]
    return made, signals(_POINTS)


def _are_proportional(
    slopes: Sequence[Any],
    points: Sequence[tuple[Array, Array, Array]],
    sizes: Array,
    *,
    is_one_sided: bool,
) -> bool:
    """True if f'(s) = c g'(c s) at every point and size s with one factor c, as f(s) = g(c s)."""
    one, other = slopes
    start = [np.asarray(slope(*points[0], 0.0)).ravel() for slope in slopes]
    square = float(start[1] @ start[1])
    c = float(start[0] @ start[1]) / square if square > 0.0 else 0.0
    if not np.isfinite(c) or c == 0.0 or (is_one_sided and c < 0.0):
        return False
    for point, size in zip(points, np.abs(sizes) if is_one_sided else sizes, strict=True):
        f, g = (np.asarray(s(*point, x)).ravel() for s, x in ((one, size), (other, c * size)))
        if not np.allclose(f, c * g, rtol=1e-9, atol=0.0, equal_nan=True):
            return False
    return True
