"""Channels over time: of a record, measured and simulated, and as several models expect them."""

from __future__ import annotations

from typing import Any

from casid.data.record import Record
from casid.estimation.fitted.model_comparison import ModelComparison
from casid.estimation.moments.validation import Validation
from casid.model.units import from_si
from casid.report.figures.panels import Panels
from casid.report.figures.style import (
    AFTER,
    BEFORE,
    FLOOR,
    MEASURED,
    axis_text,
    figure_text,
    hover_text,
    visible_text,
)
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
        figure.label(k, y=axis_text(name, unit))
    figure.time_label(len(shown) - 1)
    more = len(record.channels) - len(shown)
    caption = f"Channels of {visible_text(record.name) or 'the record'}" + (
        f"; {more} more" if more else ""
    )
    return figure.done(f"{caption}.", ())


def validation_figure(validation: Validation, *, seconds: float = 20.0) -> Any:
    """Measured and simulated channels over the first `seconds` of every record (Fig. 7.14)."""
    figure = Panels(rows=len(validation.channels), row_height=190, gap=60)
    for k, c in enumerate(validation.channels):
        t = validation.t[c.record]
        shown = t - t[0] <= seconds
        for name, source, colour in (
            ("measured", validation.measured, MEASURED),
            ("simulated", validation.simulated, AFTER),
        ):
            figure.line(k, t[shown], source[c.record][c.channel][shown], name, colour, width=1.4)
        figure.label(k, y=axis_text(c.channel, c.unit))
        figure.time_label(k)
    fits = "; ".join(f"{c.channel} in {c.record}, fit {c.fit:.1f} %" for c in validation.channels)
    return figure.done(f"Measured and simulated from the reference: {visible_text(fits)}.", ())


_OF_MODELS = (AFTER, BEFORE, FLOOR, "#CC79A7", "#E69F00", "#56B4E9")  # Okabe & Ito (2008)


def model_comparison_figure(found: ModelComparison) -> Any:
    """Every output against time, one panel each; the legend has the fit of each model."""
    rows = len(found.outputs)
    figure = Panels(rows=rows, row_height=220, gap=24, shared_x=True)
    units = found.declared or found.units
    for k, (output, unit) in enumerate(zip(found.outputs, units, strict=True)):
        y = from_si(found.measured[:, k], unit)
        i = thinned(y)
        figure.points(k, found.t[i], y[i], "measured", {"color": MEASURED, "size": 3})
        for j, (model, expected) in enumerate(found.expected.items()):
            label = f"{figure_text(model)}: {found.fit[model][output]:.1f} %"
            if rows > 1:
                label = f"{figure_text(output)}, {label}"
            y = from_si(expected[:, k], unit)
            i = thinned(y)
            figure.line(k, found.t[i], y[i], label, _OF_MODELS[j % len(_OF_MODELS)], width=1.4)
        figure.label(k, y=axis_text(output, unit))
    figure.time_label(rows - 1)
    return figure.done(f"{visible_text(found.record)}: measured, and {found.how}.", ())
