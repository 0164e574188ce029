"""The channels of a record over time."""

from __future__ import annotations

from typing import Any

from casid.data.record import Record
from casid.report.figures.panels import Panels
from casid.report.figures.style import MEASURED, axis_text, figure_text, hover_text, visible_text
from casid.report.figures.thinning import points_a_trace, thinned

_MOST = 8  # channels


def record_figure(record: Record) -> Any:
    """One panel a channel, over the record's clock."""
    shown = dict(list(record.channels.items())[:_MOST])
    figure = Panels(rows=len(shown), row_height=130, gap=24, shared_x=True)
    limit = points_a_trace(len(shown))
    for k, (name, values) in enumerate(shown.items()):
        unit, kept = record.units[name], thinned(values, limit)
        own: dict[str, Any] = {"in_legend": False, "hovertemplate": hover_text("s", unit)}
        t, y = record.t[kept], values[kept]
        figure.line(k, t, y, figure_text(name), MEASURED, width=1.2, **own)
        figure.label(k, x="time [s]" if k == len(shown) - 1 else None, y=axis_text(name, unit))
    more = len(record.channels) - len(shown)
    caption = f"Channels of {visible_text(record.name) or 'the record'}" + (
        f"; {more} more" if more else ""
    )
    return figure.done(f"{caption}.", ())
