"""Figure of a comparison of models: what was measured, and what each of them expects."""

from __future__ import annotations

from typing import Any

from casid.estimation.fitted.model_comparison import ModelComparison
from casid.report.figures.style import AFTER, BEFORE, FLOOR, MEASURED, axis_text, figure_text
from casid.report.figures.thinning import thinned

_COLOURS = (AFTER, BEFORE, FLOOR, "#CC79A7", "#E69F00", "#56B4E9")  # Okabe & Ito (2008)


def model_comparison_figure(found: ModelComparison) -> Any:
    """Every output against time, one panel each; the legend has the fit of each model."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    rows = len(found.outputs)
    figure = make_subplots(rows=rows, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for i, (output, unit) in enumerate(zip(found.outputs, found.units, strict=True)):
        points = {"color": MEASURED, "size": 3}
        shown = thinned(found.measured[:, i])
        figure.add_trace(
            go.Scatter(
                x=found.t[shown],
                y=found.measured[shown, i],
                name="measured",
                mode="markers",
                marker=points,
                legendgroup="measured",
                showlegend=i == 0,
            ),
            row=i + 1,
            col=1,
        )
        for j, (model, y) in enumerate(found.expected.items()):
            label = f"{figure_text(model)}: {found.fit[model][output]:.1f} %"
            if rows > 1:
                label = f"{figure_text(output)}, {label}"
            line = {"color": _COLOURS[j % len(_COLOURS)], "width": 1.4}
            kept = thinned(y[:, i])
            figure.add_trace(
                go.Scatter(x=found.t[kept], y=y[kept, i], name=label, mode="lines", line=line),
                row=i + 1,
                col=1,
            )
        figure.update_yaxes(title_text=axis_text(output, unit), row=i + 1, col=1)
    figure.update_xaxes(title_text="time [s]", row=rows, col=1)
    figure.update_layout(
        height=240 * rows + 100,
        template="plotly_white",
        title_text=f"{figure_text(found.record)}: measured, and {found.how}",
    )
    return figure
