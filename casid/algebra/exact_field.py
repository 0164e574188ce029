"""Rational functions of symbols as numbers of a field, so that formulas stay cancelled.

Matrices are numpy arrays of field elements (or of floats), so that one code serves both.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from casid.algebra import elimination
from casid.algebra.factoring import factored
from casid.arrays import Array
from casid.errors import IdentifiabilityError

RANK = 1e-10  # smallest singular value of scaled moments that is not zero


class ExactField:
    """The field of rational functions in the symbols of some expressions."""

    def __init__(self, expressions: Iterable[Any]) -> None:
        from sympy.polys.constructor import construct_domain

        self.domain, _ = construct_domain([_rational(e) for e in expressions], field=True)

    def of(self, values: Array) -> Array:
        """Expressions (any shape) as elements."""
        elements = [self.domain.from_sympy(_rational(v)) for v in values.ravel()]
        return _objects(elements).reshape(values.shape)

    def expressions(self, values: Array) -> Array:
        """Elements as sympy expressions, factored."""

        domain = self.domain
        made = [factored(domain.to_sympy(domain.convert(v))) for v in values.ravel()]
        return _objects(made).reshape(values.shape)


def _rational(value: Any) -> Any:
    import sympy

    return sympy.nsimplify(sympy.sympify(value), rational=True)


def solve(matrix: Array, right: Array, labels: list[str], what: str, remedy: str) -> Array:
    """Solve matrix @ x = right, (n, n) and (n, m), of floats or of field elements.

    Parameters
    ----------
    labels : what the n columns are called.
    what, remedy : begin and end the message when the columns depend on each other.

    Raises
    ------
    IdentifiabilityError
        If the matrix is singular; the message names the combination of columns that vanishes.
    """
    combination = null_vector(matrix)
    if combination is not None:
        text = " + ".join(
            f"{_shown(c)}{name}" for c, name in zip(combination, labels, strict=True) if c != 0
        )
        raise IdentifiabilityError(f"{what}: {text.replace('+ -', '- ')} = 0. {remedy}")
    if matrix.dtype != object:
        scale = _scale(matrix, axis=0)
        return np.asarray(np.linalg.solve(matrix / scale, right) / scale[:, None])
    found = elimination.solve(matrix.tolist(), right.tolist())
    return _objects([v for row in found or () for v in row]).reshape(right.shape)


def null_vector(matrix: Array) -> Array | None:
    """A vector x with matrix @ x = 0, its first entry that is not zero 1; None if there is none."""
    if matrix.dtype != object:
        scale = _scale(matrix, axis=0)
        rows = matrix / scale
        rows = rows / _scale(rows, axis=1)[:, None]
        _, s, vt = np.linalg.svd(rows)
        if len(s) == 0 or s[-1] > RANK:
            return None
        vector = vt[-1] / scale
        vector[np.abs(vt[-1]) < 1e-6] = 0.0
        return np.asarray(vector / vector[np.flatnonzero(vector)[0]])
    for vector in elimination.null_space(matrix.tolist(), 1)[:1]:
        first = next(v for v in vector if v != 0)
        return _objects([v / first for v in vector])
    return None


def _objects(values: list[Any]) -> Array:
    """(n,) elements, one by one: numpy may not look into them."""
    made = np.empty(len(values), dtype=object)
    made[:] = values
    return made


def _scale(matrix: Array, axis: int) -> Array:
    size = np.sqrt(np.sum(matrix**2, axis=axis))
    return np.where(size > 0, size, 1.0)


def _shown(value: Any) -> str:
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    if text in ("1", "-1"):
        return text[:-1]
    return f"({text})*" if "+" in text[1:] or " " in text else f"{text}*"
