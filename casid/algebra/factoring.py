"""Factors of symbolic expressions, found in the same way every time."""

from __future__ import annotations

from typing import Any

SEED = 0
"""Of the points at which a polynomial of several symbols is evaluated."""


def factored(expression: Any) -> Any:
    """An expression of sympy, factored.

    Wang's algorithm evaluates a polynomial at random points, and an unlucky one makes its lifting
    take minutes instead of milliseconds: from one seed, what was quick once is quick always.
    """
    import sympy
    from sympy.core.random import rng

    before = rng.getstate()
    rng.seed(SEED)
    try:
        return sympy.factor(expression)
    finally:
        rng.setstate(before)
