"""What is assumed of a clock of plain numbers whose unit of time the file does not name."""

from __future__ import annotations

import numpy as np

from casid.arrays import FloatArray
from casid.data.reading.faults import Fault
from casid.errors import shell_option

NO_UNIT = "no unit of time"
"""What a remark on such a clock begins with."""
_COUNTS = 5.0
"""Usual step of whole numbers, at least, from which uneven ones may be milliseconds; heuristic."""
_SPREAD = 0.5
"""Of the usual step, that nine tenths of the uneven ones lie within; heuristic."""
_UNEVEN, _FEWEST = 0.05, 20
"""Of the steps that are no usual one, at least, and steps that tell; heuristics."""


def assumed_seconds(column: str, times: FloatArray) -> str | Fault:
    """The remark that plain numbers (N,) are read as seconds; a fault where they seem none.

    A clock in whole seconds steps evenly, or by one more or less; the milliseconds of a controller
    (`millis()`) step by 19 to 22.
    """
    read = f"{NO_UNIT}: column {column!r} is read in seconds"
    if _are_counts(times):
        low, high = np.quantile(np.diff(times), [0.05, 0.95])
        return Fault(
            "unit of time",
            f"{read}, though its whole numbers step unevenly, by {low:g} to {high:g}, as counts of "
            "milliseconds do.",
            f"Give the unit with {_option(column, 'ms')}, or {_option(column, 's')} "
            "where it counts seconds.",
            column,
        )
    units = ("ms", "h") if np.array_equal(times, np.floor(times)) else ("h", "ms")
    first, other = ((_option(column, u), _IN_WORDS[u]) for u in units)
    return (
        f"{read}, {times[-1] - times[0]:.4g} s in all ({first[0]} where it counts {first[1]}, "
        f"{other[0]} {other[1]})"
    )


def is_open(remark: str) -> bool:
    """Whether a remark is one on a unit that was assumed; seconds are what `t` stands for."""
    return remark.startswith(NO_UNIT) and ("column 't' " not in remark or ", though" in remark)


_IN_WORDS = {"ms": "milliseconds", "h": "hours"}


def _option(column: str, unit: str) -> str:
    return shell_option("--map", f"t={column}:{unit}")


def _are_counts(times: FloatArray) -> bool:
    """Whether whole numbers step as those of a clock in milliseconds do."""
    steps = np.diff(times)
    if steps.size < _FEWEST or not np.array_equal(times, np.floor(times)) or steps.min() <= 0:
        return False
    usual = float(np.median(steps))
    low, high = np.quantile(steps, [0.05, 0.95])
    uneven = float(np.mean(steps != usual))
    return bool(usual >= _COUNTS and 0 < high - low <= _SPREAD * usual and uneven >= _UNEVEN)
