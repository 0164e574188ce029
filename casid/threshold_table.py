"""Tables of numbers that decide something: each with its meaning, source and the test that pins it.

A table is a few frozen groups, one a question: `casid/diagnosis/thresholds.py`,
`casid/model/effects/search_ranges.py`, `casid/estimation/simulation/thresholds.py`,
`casid/estimation/errors_in_variables/thresholds.py`, `casid/estimation/intervals/thresholds.py`,
`casid/experiment_design/thresholds.py` and `casid/fleets/thresholds.py`.
"""

from __future__ import annotations

from dataclasses import field, fields
from typing import Any, NamedTuple

HEURISTIC = "heuristic"


class Entry(NamedTuple):
    """One row of a table."""

    name: str  # group.name
    value: Any
    meaning: str
    source: str  # a reference, or "heuristic"
    pinned_by: str  # a test, or a study run as `python -m <name>`


def threshold(value: Any, meaning: str, pinned_by: str, source: str = HEURISTIC) -> Any:
    """A field of a group."""
    return field(
        default=value, metadata={"meaning": meaning, "source": source, "pinned_by": pinned_by}
    )


def entries(*groups: Any) -> tuple[Entry, ...]:
    """The rows of some groups."""
    return tuple(
        Entry(f"{type(group).__name__}.{f.name}", getattr(group, f.name), **f.metadata)
        for group in groups
        for f in fields(group)
    )
