"""Where expressions have no finite value: what they divide by, or take the root or logarithm of."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.model.formula_text import shown_text

Expr = Any  # a CasADi SX expression

_OPERATIONS = {
    ca.OP_DIV: ("divide by", 1),
    ca.OP_INV: ("divide by", 0),
    ca.OP_SQRT: ("take the root of", 0),
    ca.OP_LOG: ("take the logarithm of", 0),
    ca.OP_LOG1P: ("take the logarithm of 1 plus", 0),
    ca.OP_POW: ("take a power of", 0),
    ca.OP_CONSTPOW: ("take a power of", 0),
    ca.OP_ASIN: ("take the arcsine of", 0),
    ca.OP_ACOS: ("take the arccosine of", 0),
}
"""Operation that may have no finite value -> what it does to which of its operands."""


class SingularPart(NamedTuple):
    """A part of an expression that has a finite value where an operation on it has none.

    Attributes
    ----------
    verb : what the expression does with it: `divide by`.
    part : an SX expression.
    value : of it.
    whole : the operation on it, which has none.
    """

    verb: str
    part: Expr
    value: float
    whole: Expr

    def __str__(self) -> str:
        return f"{self.verb} {shown_text(self.part)}, which is {self.value:.4g}"


def singular_part(expressions: Expr, symbols: Expr, point: Array) -> SingularPart | None:
    """What makes expressions infinite or undefined at a point; None where nothing does.

    From the first entry that has no finite value the way is down to the operation whose operands
    are all finite: a branch that is not taken, or a factor that is zero, is not on it. A value that
    overflows has no such operation.

    Parameters
    ----------
    expressions : (m, n) SX.
    symbols : (k, 1) SX, all that occur in them.
    point : (k,) their values.
    """
    entries = ca.vec(ca.densify(ca.SX(expressions)))
    place = _first_not_finite(entries, symbols, point)
    if place is None:
        return None
    node = entries[place]
    while node.n_dep():
        operands = ca.vertcat(*[node.dep(i) for i in range(node.n_dep())])
        place = _first_not_finite(operands, symbols, point)
        if place is None:
            break
        node = operands[place]
    if node.n_dep() == 0 or node.op() not in _OPERATIONS:
        return None
    verb, which = _OPERATIONS[node.op()]
    part = node.dep(which)
    return SingularPart(verb, part, float(_values(part, symbols, point)[0]), node)


def _first_not_finite(entries: Expr, symbols: Expr, point: Array) -> int | None:
    bad = ~np.isfinite(_values(entries, symbols, point))
    return int(np.argmax(bad)) if bad.any() else None


def _values(entries: Expr, symbols: Expr, point: Array) -> Array:
    return np.asarray(ca.Function("parts", [symbols], [entries])(point), dtype=float).ravel()
