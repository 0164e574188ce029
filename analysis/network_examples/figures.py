"""Figures 4.2, 6.1 and 6.2 of the network examples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from casid.data.record import Record
from casid.unknown_inputs.networks.prediction.node_predictor import NodePredictor
from casid.unknown_inputs.networks.rings import RecursiveElimination

COLOURS = ("#E69F00", "#CC79A7", "#56B4E9", "#0072B2", "#D55E00")


def signals(record: Record, skip: int) -> Any:
    """Figure 6.1: the eight nodes and the excitation."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    names = [*(f"w{i}" for i in range(1, 9)), "delta_6"]
    figure = make_subplots(rows=len(names), cols=1, shared_xaxes=True, vertical_spacing=0.01)
    for i, name in enumerate(names, start=1):
        figure.add_trace(
            go.Scatter(
                x=record.t[skip:], y=record[name][skip:], name=name, line={"width": 1},
                showlegend=False,
            ),
            row=i,
            col=1,
        )  # fmt: skip
        figure.update_yaxes(title_text=name, row=i, col=1)
    figure.update_xaxes(title_text="sample", row=len(names))
    figure.update_layout(
        title="The network of Example 6.1, simulated", height=110 * len(names), template="none"
    )
    return figure


def predictions(record: Record, skip: int, predictors: Mapping[str, NodePredictor]) -> Any:
    """Figure 6.2: node 2 and its predictions, their fits in the legend."""
    import plotly.graph_objects as go

    figure = go.Figure()
    t = record.t[skip:]
    figure.add_trace(
        go.Scatter(x=t, y=record["w2"][skip:], name="w2", line={"color": "black", "width": 2})
    )
    for (name, p), colour in zip(predictors.items(), COLOURS, strict=True):
        fit = p.fit(record, skip=skip)
        figure.add_trace(
            go.Scatter(
                x=t,
                y=p.predict(record)[skip:],
                name=f"{name}, {fit:.1f} %",
                line={"color": colour, "width": 1},
            )
        )
    figure.update_layout(
        title="Predictors of Example 6.1", xaxis_title="sample", yaxis_title="w2", template="none"
    )
    return figure


def rings(found: RecursiveElimination) -> Any:
    """How the target's model grows with every ring."""
    import plotly.graph_objects as go

    figure = go.Figure()
    number = [r.number for r in found.rings]
    series = {
        "nodes involved": [len(r.involved) for r in found.rings],
        "inputs of the model": [len(r.inputs) for r in found.rings],
        "unobserved nodes in it": [len(r.unobserved) for r in found.rings],
        "McMillan degree": [r.degree for r in found.rings],
    }
    for (name, values), colour in zip(series.items(), COLOURS, strict=False):
        figure.add_trace(
            go.Scatter(x=number, y=values, name=name, mode="lines+markers", line={"color": colour})
        )
    figure.update_layout(
        title="Recursive elimination: the model grows ring by ring (Figure 4.2)",
        xaxis={"title": "ring", "dtick": 1},
        yaxis_title="count",
        template="none",
    )
    return figure
