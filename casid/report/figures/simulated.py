"""Measured against simulated, and the simulation error, against time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from casid.arrays import Array, BoolArray
from casid.diagnosis.diagnosis import Diagnosis
from casid.estimation.estimate import RecordView
from casid.report.figures.panels import Panels
from casid.report.figures.record_views import (
    drawn,
    finite,
    in_readable_time,
    of_records,
    residual,
    simulations,
    time_range,
)
from casid.report.figures.style import MEASURED, axis_text, hover_text
from casid.report.figures.thinning import points_a_trace, thinned, thinning_note

_LEFT_OUT = "#CC79A7"


def diagnosis_figure(diagnosis: Diagnosis) -> Any:
    """Measured against simulated, before and after."""
    return simulation_figure(diagnosis.records)


def simulation_figure(records: Sequence[RecordView]) -> Any:
    """Measured outputs as points, simulations before and after as lines.

    One row an output; several records are chosen from a menu below the figure. The held-out part is
    shaded.

    Raises
    ------
    ValueError
        If there is no record.
    """
    views, left_out = drawn(records)
    views, time_unit = in_readable_time(views)
    outputs = views[0].outputs
    limit = points_a_trace(len(views) * len(outputs) * 3)
    caption = of_records(
        "Measured outputs and free simulation"
        + (" before and after the extension" if views[0].extended is not None else ""),
        views,
    )
    figure = Panels(rows=len(outputs), row_height=250, gap=22, shared_x=True)
    cut = False
    for v in views:
        ranges: dict[str, Any] = time_range(v)
        for row, (output, unit) in enumerate(zip(v.outputs, v.output_units, strict=True)):
            kept = _add_output(figure, v, row, limit, time_unit)
            span, is_cut = _readable_range(kept, [s[:, row] for *_, s in simulations(v)])
            cut = cut or is_cut
            axis = "yaxis" if row == 0 else f"yaxis{row + 1}"
            ranges[f"{axis}.range"] = span
            ranges[f"{axis}.autorange"] = span is None
            if v is views[0]:
                figure.label(row, y=axis_text(output, unit))
                if span is not None:
                    figure.y_range(row, span)
        figure.parts(v, ranges)
    figure.time_range(views[0])
    figure.time_label(len(outputs) - 1, time_unit)
    if cut:
        caption += " The simulation leaves the range of the data: the axis is cut."
    return figure.done(caption + left_out + thinning_note(views, limit), views)


def _add_output(figure: Panels, v: RecordView, row: int, limit: int, time_unit: str) -> Array:
    """Add one output of a record: what was measured, what was left out, what is simulated.

    `time_unit` is the unit of the time.

    Returns the measured samples that count, (N,), NaN elsewhere.
    """
    measured, used = finite(v.measured[:, row]), v.used[:, row]
    kept = np.where(used, measured, np.nan)
    i = thinned(kept, limit)
    own: dict[str, Any] = {"view": v, "hovertemplate": hover_text(time_unit, v.output_units[row])}
    figure.points(row, v.t[i], kept[i], "measured", {"color": MEASURED, "size": 4.5}, **own)
    left_out = ~used & _is_near(measured, kept)
    if left_out.any():
        i = np.flatnonzero(left_out)
        i = i[thinned(measured[i], limit)]
        marker = {"color": _LEFT_OUT, "size": 7, "symbol": "x-thin-open"}
        figure.points(row, v.t[i], measured[i], "measured, left out", marker, **own)
    for label, colour, dash, simulated in simulations(v):
        y = finite(simulated[:, row])
        i = thinned(y, limit)
        figure.line(row, v.t[i], y[i], label, colour, width=1.3, dash=dash, **own)
    return kept


def _is_near(values: Array, kept: Array) -> BoolArray:
    """Where values are within two ranges of those that count: beside others these would be flat."""
    if not np.isfinite(kept).any():
        return np.isfinite(values)
    low, high, _ = _around(kept[np.isfinite(kept)])
    return np.asarray((values >= low) & (values <= high))


def _around(data: Array) -> tuple[float, float, float]:
    """Two ranges of finite data below and above them, and one range."""
    low, high = float(data.min()), float(data.max())
    span = (high - low) or abs(high) or 1.0
    return low - 2 * span, high + 2 * span, span


def residual_time_figure(records: Sequence[RecordView]) -> Any:
    """What the simulation leaves over against time, before and after; one row an output."""
    views, left_out = drawn(records)
    views, time_unit = in_readable_time(views)
    outputs = views[0].outputs
    limit = points_a_trace(len(views) * len(outputs) * 2)
    figure = Panels(rows=len(outputs), row_height=230, gap=22, shared_x=True)
    for v in views:
        for row, (output, unit) in enumerate(zip(v.outputs, v.output_units, strict=True)):
            for label, colour, _, simulated in simulations(v):
                e = residual(v, simulated, row)
                own: dict[str, Any] = {"view": v, "hovertemplate": hover_text(time_unit, unit)}
                if _is_scattered(e):
                    i = np.flatnonzero(np.isfinite(e))
                    i = i[thinned(e[i], limit)]
                    figure.points(row, v.t[i], e[i], label, {"color": colour, "size": 4.5}, **own)
                    continue
                i = thinned(e, limit)
                figure.line(row, v.t[i], e[i], label, colour, width=1.0, **own)
            if v is views[0]:
                figure.label(row, y=axis_text(output, unit, "error of "))
        figure.parts(v, time_range(v))
    figure.time_range(views[0])
    figure.time_label(len(outputs) - 1, time_unit)
    caption = of_records("Simulation error, measured minus simulated, against time", views)
    return figure.done(caption + left_out + thinning_note(views, limit), views)


def _is_scattered(values: Array) -> bool:
    """True where most samples that there are stand alone, which a line does not show."""
    seen = np.isfinite(values)
    beside = np.zeros_like(seen)
    beside[1:] |= seen[:-1]
    beside[:-1] |= seen[1:]
    return bool(2 * np.sum(seen & ~beside) > np.sum(seen))


def _readable_range(measured: Array, simulated: Sequence[Array]) -> tuple[list[float] | None, bool]:
    """An axis range that keeps the data readable when a simulation diverges; None: automatic."""
    data = measured[np.isfinite(measured)]
    runs = np.concatenate([s[np.isfinite(s)] for s in simulated]) if simulated else np.empty(0)
    if not data.size or not runs.size:
        return None, False
    low, high, span = _around(data)
    is_cut = bool(runs.min() < low - span or runs.max() > high + span)
    return ([low, high], True) if is_cut else (None, False)
