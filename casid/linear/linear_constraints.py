"""Linear constraints B theta = b: whether any theta satisfies them, and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import ModelError


def check_consistent(
    B: Array,
    b: Array,
    *,
    labels: Sequence[str] = (),
    coefficients: Sequence[str] = (),
    tolerance: float = 1e-9,
) -> tuple[int, ...]:
    """Refuse linear constraints that no theta satisfies; return which rows are independent.

    Parameters
    ----------
    B : (m, n); b : (m,) constraints B theta = b, rows of any scale.
    labels : what each row is called, such as where it comes from; default "row 1", ...
    coefficients : names of theta's n entries, for texts.
    tolerance : of b, relative to the entries of a row; known values that were estimated before do
        not agree to the last digit.

    Returns
    -------
    Indices of independent rows; the others follow from them.

    Raises
    ------
    ModelError
        If rows contradict each other (the fewest that do are named), hold non-finite numbers, or
        the shapes do not fit.

    Notes
    -----
    B theta = b has no solution if and only if some y has y'B = 0 and y'b != 0.
    """
    B, b, names = _checked(B, b, labels)
    m, n = B.shape
    theta = coefficient_names(coefficients, n)
    size = np.maximum(np.max(np.abs(B), axis=1, initial=0.0), TINY)
    empty = [i for i in range(m) if not B[i].any()]
    rows, right = B / size[:, None], b / size
    columns = np.maximum(np.max(np.abs(rows), axis=0, initial=0.0), TINY)
    rows = rows / columns
    kept: list[int] = []
    for i in range(m):
        if i in empty:
            continue
        trial = rows[[*kept, i]]
        singular = np.linalg.svd(trial, compute_uv=False)
        if len(trial) <= n and singular[-1] > 1e-10 * singular[0]:
            kept.append(i)
            continue
        implied, weights = _implied(rows, right, kept, i, tolerance)
        if implied is not None:
            guilty = [names[k] for k, weight in zip(kept, weights, strict=True) if weight != 0]
            raise ModelError(
                f"linear constraints contradict each other: {' and '.join(guilty)} imply "
                f"{relation(B[i], implied * size[i], theta)}, but {names[i]} has {b[i]:.6g} on "
                f"the right; drop one of {', '.join([*guilty, names[i]])}, or correct the known "
                "values they are made of"
            )
    return tuple(kept)


def _checked(B: Array, b: Array, labels: Sequence[str]) -> tuple[Array, Array, tuple[str, ...]]:
    """Arrays of the right shapes with finite entries, and a name for each row."""
    B, b = np.atleast_2d(np.asarray(B, dtype=float)), np.atleast_1d(np.asarray(b, dtype=float))
    if B.shape[0] != len(b):
        raise ModelError(
            f"linear constraints: B has {B.shape[0]} rows and b {len(b)} entries; give one entry "
            "of b for each row of B"
        )
    m = len(B)
    names = tuple(labels) or tuple(f"row {i + 1}" for i in range(m))
    if len(names) != m:
        raise ModelError(f"linear constraints: {len(names)} labels for {m} rows; give {m}")
    broken = np.flatnonzero(~np.isfinite(B).all(axis=1) | ~np.isfinite(b)).tolist()
    if broken:
        raise ModelError(
            f"linear constraints: {names[broken[0]]} holds a number that is not finite; look for a "
            "known parameter that is zero or missing and occurs in a denominator"
        )
    for i in np.flatnonzero(~B.any(axis=1) & (b != 0)).tolist():
        raise ModelError(
            f"linear constraints: {names[i]} reads 0 = {b[i]:g}, which no theta satisfies; "
            "take it out"
        )
    return B, b, names


def _implied(
    rows: Array, right: Array, kept: list[int], i: int, tolerance: float
) -> tuple[float | None, Array]:
    """What the kept rows imply on the right of row i where that contradicts it, else None.

    Row i is a combination y of kept rows: y'rows[kept] = rows[i]. The same must hold for b.
    """
    y = np.linalg.lstsq(rows[kept].T, rows[i], rcond=None)[0]
    y[np.abs(y) < 1e-9 * max(1.0, float(np.max(np.abs(y))))] = 0.0
    implied = float(y @ right[kept])
    terms = 1.0 + abs(right[i]) + float(np.abs(y) @ np.abs(right[kept]))
    return (implied if abs(implied - right[i]) > tolerance * terms else None), y


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
