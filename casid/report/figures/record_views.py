"""What a figure takes from the views of records: simulations, residuals, parts, ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.estimate import RecordView
from casid.model.quantities import common_prefix
from casid.report.figures.style import AFTER, BEFORE, visible_text

_HELD_OUT = "rgba(86,180,233,0.13)"
_LONG = 7200.0
"""Length [s] of a record from which its time is drawn in hours or days; windows are in seconds."""


def checked(records: Sequence[RecordView]) -> tuple[RecordView, ...]:
    """The views of records, refused where there is none."""
    views = tuple(records)
    if not views:
        raise ValueError("the result holds no record to draw; make it with records kept")
    return views


def drawn(records: Sequence[RecordView]) -> tuple[tuple[RecordView, ...], str]:
    """The records to choose from below a figure, and what its caption says of those left out.

    Of many records, those with the largest errors relative to the motion: with all of them the page
    would be slow to open.
    """
    views = checked(records)
    most = max(_FEWEST_RECORDS, _MOST_CURVES // len(views[0].outputs))
    if len(views) <= most:
        return views, ""
    worst = sorted(range(len(views)), key=lambda i: -_relative_error(views[i]))[:most]
    note = f" Of {len(views)} records, the {most} with the largest errors relative to their motion."
    return tuple(views[i] for i in sorted(worst)), note


_MOST_CURVES, _FEWEST_RECORDS = 8, 3  # outputs of all records drawn; records


def _relative_error(view: RecordView) -> float:
    """RMS error of the last simulation over the standard deviation, of the worst output."""
    *_, simulated = simulations(view)[-1]
    worst = 0.0
    for i in range(len(view.outputs)):
        e = residual(view, simulated, i)
        y = np.where(np.isfinite(e), view.measured[:, i], np.nan)
        if np.isfinite(e).any():
            error = float(np.sqrt(np.nanmean(e**2)))
            worst = max(worst, error / max(float(np.nanstd(y)), TINY))
    return worst


def simulations(view: RecordView) -> list[tuple[str, str, str, Array]]:
    """Label, colour, dash and (N, ny) values of each simulation."""
    if view.extended is None:
        return [("simulated", BEFORE, "solid", view.baseline)]
    return [
        ("before", BEFORE, "dot", view.baseline),
        ("after", AFTER, "solid", view.extended),
    ]


def finite(values: Array) -> Array:
    """`values` with NaN, a gap of the figure, in the place of infinities."""
    found: Array = np.where(np.isfinite(values), values, np.nan)
    return found


def residual(view: RecordView, simulated: Array, column: int) -> Array:
    """Measured minus simulated, NaN where the sample is left out."""
    with np.errstate(over="ignore", invalid="ignore"):
        e = view.measured[:, column] - simulated[:, column]
    return finite(np.where(view.used[:, column], e, np.nan))


def time_range(view: RecordView) -> dict[str, Any]:
    """The record from end to end, as its menu entry sets it."""
    span = [float(view.t[0]), float(view.t[-1])] if view.t.size > 1 else None
    return {"xaxis.range": span, "xaxis.autorange": span is None}


def in_readable_time(views: Sequence[RecordView]) -> tuple[tuple[RecordView, ...], str]:
    """The views with their time in hours or days where a record is long, and the unit of it."""
    longest = max((float(np.ptp(v.t)) for v in views if v.t.size), default=0.0)
    if longest < _LONG:
        return tuple(views), "s"
    scale, unit = common_prefix([longest], "s")
    return tuple(replace(v, t=v.t / scale) for v in views), unit


def part_shapes(view: RecordView) -> list[dict[str, Any]]:
    """A shaded, labelled stretch for every held-out part, a label for every fitted one."""
    if not view.t.size:
        return []
    edges = np.flatnonzero(np.diff(view.fitted.astype(np.int8))) + 1
    shapes = []
    for a, b in zip([0, *edges.tolist()], [*edges.tolist(), view.t.size], strict=True):
        is_fitted = bool(view.fitted[a])
        shapes.append(
            {
                "type": "rect",
                "xref": "x",
                "yref": "paper",
                "x0": float(view.t[a]),
                "x1": float(view.t[min(b, view.t.size - 1)]),
                "y0": 0,
                "y1": 1,
                "layer": "below",
                "line": {"width": 0},
                "fillcolor": "rgba(0,0,0,0)" if is_fitted else _HELD_OUT,
                "label": {
                    "text": "fitted" if is_fitted else "held out",
                    "textposition": "top left",
                    "font": {"size": 12, "color": "#444444"},
                },
            }
        )
    return shapes


def of_records(claim: str, views: Sequence[RecordView], *, together: bool = False) -> str:
    """The caption: the claim, and the record or records that it is about."""
    if len(views) == 1:
        return f"{claim}, record {visible_text(views[0].name)}."
    if together:
        return f"{claim}, {len(views)} records together."
    return f"{claim}; choose one of {len(views)} records below the figure."
