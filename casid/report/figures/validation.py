"""Figure of a validation: measured and simulated channels against time."""

from __future__ import annotations

from typing import Any

from casid.estimation.moments.validation import Validation


def validation_figure(validation: Validation, *, seconds: float = 20.0) -> Any:
    """Measured and simulated channels over the first `seconds` of every record (Fig. 7.14)."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    rows = len(validation.channels)
    figure = make_subplots(
        rows=rows,
        cols=1,
        subplot_titles=[f"{c.record}: {c.channel}, fit {c.fit:.1f} %" for c in validation.channels],
    )
    for i, c in enumerate(validation.channels, 1):
        t = validation.t[c.record]
        shown = t - t[0] <= seconds
        for name, source, colour in (
            ("measured", validation.measured, "#444444"),
            ("simulated", validation.simulated, "#d95f02"),
        ):
            figure.add_trace(
                go.Scatter(
                    x=t[shown],
                    y=source[c.record][c.channel][shown],
                    name=name,
                    legendgroup=name,
                    showlegend=i == 1,
                    line={"color": colour, "width": 1.4},
                ),
                row=i,
                col=1,
            )
        figure.update_yaxes(title_text=c.unit, row=i, col=1)
    figure.update_xaxes(title_text="time, s", row=rows, col=1)
    figure.update_layout(height=220 * rows + 80, template="plotly_white")
    return figure
