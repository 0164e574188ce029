"""Linear constraints B theta = b: their scale, and their text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError


def relation(row: Array, value: float, coefficients: Sequence[str]) -> str:
    """A linear constraint as text: ``a1 + a2 + 0.02 b0 = -1``."""
    text = ""
    for weight, name in zip(np.asarray(row).tolist(), coefficients, strict=True):
        if weight == 0:
            continue
        size = f"{abs(weight):.6g}"
        factor = "" if size == "1" else f"{size} "
        sign = (" - " if weight < 0 else " + ") if text else ("-" if weight < 0 else "")
        text += f"{sign}{factor}{name}"
    return f"{text or '0'} = {value + 0.0:.6g}"


def largest_one(rows: Any, n: int) -> Array:
    """Rows (m, n + 1) divided by the largest of their first n entries, with its sign."""
    out = np.asarray(rows, dtype=float).reshape(-1, n + 1)
    if not len(out):
        return out
    # The first of equals, so that rounding in the last digit does not choose the sign.
    size = np.abs(out[:, :n])
    first = np.argmax(size > 0.999999 * size.max(axis=1, keepdims=True), axis=1)
    return np.asarray(out / out[np.arange(len(out)), first][:, None] + 0.0)


def coefficient_names(names: Sequence[str], n: int) -> tuple[str, ...]:
    """The names given, or theta1 .. theta<n>; refuses another number of names than n."""
    if names and len(names) != n:
        raise ModelError(f"{len(names)} names were given for {n} coefficients; give {n}")
    return tuple(names) or tuple(f"theta{i + 1}" for i in range(n))
