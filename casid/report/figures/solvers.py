"""Figure of a comparison of solvers: distance to the reference against time."""

from __future__ import annotations

import html
from typing import Any

from casid.estimation.nlp.comparison_table import SolverComparison


def solver_figure(comparison: SolverComparison) -> Any:
    """Plotly figure: distance to the reference against time, a point for each solver."""
    import plotly.graph_objects as go

    shown = [row for row in comparison.rows if row.x is not None]
    floor = 1e-16  # a logarithmic axis has no zero
    figure = go.Figure()
    for agrees, label, symbol, colour in (
        (True, "agrees", "circle", "#0072B2"),
        (False, "does not", "x", "#D55E00"),
    ):
        rows = [row for row in shown if row.agrees == agrees]
        figure.add_scatter(
            x=[1e3 * row.seconds for row in rows],
            y=[max(row.distance, floor) for row in rows],
            text=[row.solver for row in rows],
            hovertext=[row.reason for row in rows],
            mode="markers+text",
            textposition="top center",
            name=label,
            marker={"symbol": symbol, "color": colour, "size": 9},
        )
    figure.add_hline(y=comparison.tolerance, line_dash="dash", annotation_text="tolerance")
    figure.update_xaxes(type="log", title="time of one solve [ms]")
    figure.update_yaxes(
        type="log", title="largest relative distance to the reference", exponentformat="power"
    )
    figure.update_layout(title=html.escape(repr(comparison)[1:-1]))
    return figure
