"""Numbers given to a program, checked against what it declares: parameters and a start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import SolveError, nearest


def views(shapes: Mapping[str, tuple[int, int]], flat: Array) -> dict[str, Array]:
    """Windows of declared shape on the vector that holds all parameters."""
    found: dict[str, Array] = {}
    place = 0
    for name, (rows, columns) in shapes.items():
        found[name] = flat[place : place + rows * columns].reshape((rows, columns), order="F")
        place += rows * columns
    return found


def fill(
    program: str, windows: Mapping[str, Array], values: Mapping[str, Any], flat: Array
) -> None:
    """Put values into the windows of their parameters, which look at `flat`.

    Raises
    ------
    SolveError
        If a value is missing, unknown, not finite or of another shape than was declared.
    """
    if values.keys() != windows.keys():
        missing = [name for name in windows if name not in values]
        unknown = [name for name in values if name not in windows]
        words = [f"no value for parameter {', '.join(missing)}"] if missing else []
        words += [f"no parameter is called {', '.join(unknown)}"] if unknown else []
        raise SolveError(
            f"{program}: {' and '.join(words)}; give values for exactly "
            f"{', '.join(windows) or 'none'}"
        )
    for name, window in windows.items():
        value = np.asarray(values[name], dtype=float)
        if value.shape != window.shape:
            if value.size != window.size or max(window.shape) != window.size:
                raise SolveError(
                    f"{program}: parameter {name} has shape {value.shape}; give {window.shape}, "
                    "as it was declared"
                )
            value = value.reshape(window.shape)  # a vector, lying or standing
        window[...] = value
    if not np.isfinite(flat).all():
        bad = [name for name, window in windows.items() if not np.isfinite(window).all()]
        raise SolveError(
            f"{program}: parameter {', '.join(bad)} holds values that are not finite; fix the "
            "data that they come from (record.mark_missing, record.between)"
        )


def at_start(
    program: str,
    names: Sequence[str],
    start: Sequence[float] | Array | Mapping[str, float] | None,
    declared: Array,
) -> Array:
    """A start (n,) from values in order or by name; the declared one for what is not named.

    Raises
    ------
    SolveError
        If a name is no variable's, or a value no number.
    """
    if start is None:
        return declared
    given: Any = start
    if isinstance(start, Mapping):
        for name in start:
            if name not in names:
                raise SolveError(f"{program}: no variable {name!r} to start{nearest(name, names)}")
        given = [start.get(n, d) for n, d in zip(names, declared, strict=True)]
    found = np.asarray(given)
    if found.dtype.kind not in "biuf":
        raise SolveError(
            f"{program}: the start {start!r} is not made of numbers; give {len(names)} of them in "
            f"order, or by name, as {{{names[0]!r}: {declared[0]:g}}}"
        )
    return np.array(found, dtype=float).ravel()


def inside(
    program: str, names: Sequence[str], x: Array, lower: Array, upper: Array, scale: Array
) -> Array:
    """A start within its bounds, put onto a bound that it misses by rounding alone.

    Raises
    ------
    SolveError
        If the start has another length than the variables, or lies outside by more than 1e-6 of a
        variable's scale: a solver that began elsewhere would silently answer another question.
    """
    if len(x) != len(names):
        raise SolveError(
            f"{program}: start has {len(x)} values for {len(names)} variables; give one for "
            f"each of {', '.join(names)}"
        )
    clipped: Array = np.minimum(np.maximum(x, lower), upper)
    if (np.abs(x - clipped) > 1e-6 * np.maximum(scale, np.abs(clipped))).any():
        i = int(np.argmax(np.abs(x - clipped) / scale))
        raise SolveError(
            f"{program}: start {names[i]} = {x[i]:g} lies outside its bounds "
            f"[{lower[i]:g}, {upper[i]:g}]; move the start inside or widen the bounds"
        )
    return clipped
