"""Rational functions over one common denominator, coefficients expressions of the parameters.

They are evaluated at parameter values, and pickled: an SX expression cannot be pickled, a Function
of SX expressions can, and zeros stay structural.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import ModelError, nearest
from casid.model.declarations import Parameter

Expr = Any  # a CasADi SX expression


@dataclass(frozen=True, eq=False, kw_only=True)
class CommonDenominator:
    """Transfer functions of the parameters over one denominator, continuous or discrete."""

    name: str
    denominator: Expr
    numerators: tuple[tuple[Expr, ...], ...]
    p: Expr
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    description: tuple[Parameter, ...] = ()

    @property
    def order(self) -> int:
        """The degree of the denominator: of a discrete one the largest lag."""
        return int(self.denominator.numel()) - 1

    @cached_property
    def function(self) -> ca.Function:
        """p (np,) -> denominator, then the numerators, output by output."""
        flat = [ca.densify(e) for e in self._expressions()]
        return ca.Function("coefficients", [self.p], flat, {"cse": True})

    def evaluate(
        self, values: Mapping[str, float] | None = None
    ) -> tuple[Array, list[list[Array]]]:
        """Denominator (n+1,) and numerators [output][input] -> (n+1,) as numbers."""
        vector = parameter_vector(self.name, self.description, values or {})
        flat: list[Array] = [np.array(b).ravel() for b in self.function.call([vector])]
        nu = len(self.inputs)
        return flat[0], [flat[1 + i * nu : 1 + (i + 1) * nu] for i in range(len(self.outputs))]

    def nominal(self) -> Array:
        """(np,) The parameters' values, starts of those that are not known."""
        return np.array([q.start if q.value is None else q.value for q in self.description])

    def _expressions(self) -> list[Expr]:
        return [self.denominator, *(b for row in self.numerators for b in row)]

    def __reduce__(self) -> tuple[Any, ...]:
        derived = {"p", "denominator", "numerators"}
        own: Any = self
        kept = {f.name: getattr(self, f.name) for f in fields(own) if f.name not in derived}
        return _restored, (type(self), packed(self.p, self._expressions()), kept)


def _restored(kind: Any, function: ca.Function, kept: Mapping[str, Any]) -> Any:
    p, (denominator, *flat) = unpacked(function, kept["parameters"])
    nu = len(kept["inputs"])
    rows = tuple(tuple(flat[i * nu : (i + 1) * nu]) for i in range(len(kept["outputs"])))
    return kind(p=p, denominator=denominator, numerators=rows, **kept)


def packed(p: Expr, expressions: Sequence[Expr]) -> ca.Function:
    """Expressions of p as one function, which can be pickled."""
    return ca.Function("packed", [p], [ca.SX(e) for e in expressions])


def unpacked(function: ca.Function, names: Sequence[str]) -> tuple[Expr, list[Expr]]:
    """New symbols with these names, and what `packed` got as expressions of them."""
    p = ca.vertcat(ca.SX(0, 1), *[ca.SX.sym(n) for n in names])
    return p, list(function.call([p]))


def parameter_vector(
    name: str, description: Sequence[Parameter], values: Mapping[str, float]
) -> Array:
    """The parameters (np,) in order, from `values` and else from what is known.

    Raises
    ------
    ModelError
        If an unknown parameter has no value, or a name is not a parameter.
    """
    names = [q.name for q in description]
    for given in values:
        if given not in names:
            raise ModelError(f"{name} has no parameter {given!r}{nearest(given, names)}")
    lacking = [q.name for q in description if q.name not in values and q.value is None]
    if lacking:
        raise ModelError(
            f"{name}: no value for {', '.join(lacking)}; give one for each, "
            f"as in {{{lacking[0]!r}: 1.0}}"
        )
    return np.array([values.get(q.name, q.value) for q in description], dtype=float)
