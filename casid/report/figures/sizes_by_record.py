"""A cause's parameters record by record, where one value does not explain all records."""

from __future__ import annotations

import math
from typing import Any

from casid.diagnosis.diagnosis import Cause
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, MEASURED, axis_text, figure_text, visible_text


def by_record_figure(cause: Cause) -> Any:
    """One panel a parameter, one row a record: the value with its 95 % interval.

    Where the cause has a value for all records together, a dashed line marks it.

    Raises
    ------
    ValueError
        If one value explains all records.
    """
    if not cause.by_record:
        raise ValueError("one value explains all records, so there is nothing to draw")
    records = list(cause.by_record)
    names = list(dict.fromkeys(n for found in cause.by_record.values() for n in found))
    figure = Panels(
        panels=len(names),
        columns=min(2, len(names)),
        row_height=34 * len(records) + 30,
        gap=70,
        column_gap=0.04,
    )
    last = len(records) - 1
    for k, name in enumerate(names):
        _parameter_panel(figure, k, name, cause)
    figure.figure.update_yaxes(
        tickvals=list(range(len(records))),
        ticktext=[figure_text(r, 16) for r in records],
        range=[last + 0.5, -0.5],
        zeroline=False,
        tickfont={"size": 12},
    )
    for k in range(1, len(names), 2):
        figure.figure.update_yaxes(showticklabels=False, row=k // 2 + 1, col=2)
    figure.ticks = 5
    return figure.done(
        "Record by record with 95 % intervals: "
        f"{visible_text(cause.words)}. One value does not explain all "
        "records.",
        (),
    )


def _parameter_panel(figure: Panels, k: int, name: str, cause: Cause) -> None:
    """Draw one parameter's values in panel `k`, and its common value where there is one."""
    records = list(cause.by_record)
    common = {p.name: p.value for p in cause.parameters if math.isfinite(p.value)}
    rows = [i for i, r in enumerate(records) if name in cause.by_record[r]]
    found = [cause.by_record[records[i]][name] for i in rows]
    halves = [1.96 * p.std_error if p.std_error is not None else None for p in found]
    figure.points(
        k,
        [p.value for p in found],
        rows,
        "value in this record",
        {"color": AFTER, "size": 10},
        error_x={"type": "data", "array": halves, "color": AFTER, "thickness": 2, "width": 5},
        hovertemplate=f"%{{x:.5g}} {figure_text(found[0].unit)}<extra></extra>",
    )
    if name in common:
        label, ends = "one value for all", [-0.5, len(records) - 0.5]
        hover = f"{label} %{{x:.5g}}<extra></extra>"
        x = [common[name]] * 2
        figure.line(k, x, ends, label, MEASURED, dash="dash", hovertemplate=hover)
    figure.label(k, x=axis_text(name, found[0].unit))
