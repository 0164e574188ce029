"""Tables of numbers that decide something: each with its meaning, source and the test that pins it.

A table is a few frozen groups, one a question: `casid/diagnosis/thresholds.py`,
`casid/model/effects/search_ranges.py`, `casid/estimation/simulation/thresholds.py`,
`casid/estimation/noise/thresholds.py`, `casid/estimation/intervals/thresholds.py`,
`casid/experiment_design/thresholds.py` and `casid/fleets/thresholds.py`.
"""

from __future__ import annotations

from dataclasses import field
from typing import Any


def threshold(value: Any, meaning: str, pinned_by: str, source: str = "heuristic") -> Any:
    """A field of a group.

    Parameters
    ----------
    pinned_by : a test, or a study run as `python -m <name>`.
    source : a reference, or "heuristic".
    """
    return field(
        default=value, metadata={"meaning": meaning, "source": source, "pinned_by": pinned_by}
    )
