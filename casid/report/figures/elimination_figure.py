"""The growth of an indirect model, step by step: inputs, nodes involved, McMillan degree."""

from __future__ import annotations

import plotly.graph_objects as go

from casid.unknown_inputs.networks.nodes import labels, node_label
from casid.unknown_inputs.networks.recursive_elimination import (
    EliminationStep,
    RecursiveElimination,
)


def elimination_figure(elimination: RecursiveElimination) -> go.Figure:
    """The size of the target's equation against the step (Linder 2017, Figure 4.2).

    Returns
    -------
    plotly figure: lines for inputs, unobserved nodes, nodes involved, and the McMillan degree
        where modules have numbers; each step is named by the nodes eliminated in it.
    """
    import plotly.graph_objects as go

    steps = elimination.steps
    names = [_name(step) for step in steps]
    lines = {
        "inputs": [len(r.inputs) for r in steps],
        "unobserved nodes": [len(r.unobserved) for r in steps],
        "nodes involved": [len(r.involved) for r in steps],
    }
    degrees = [r.degree for r in steps]
    figure = go.Figure()
    for name, values in lines.items():
        figure.add_scatter(x=names, y=values, mode="lines+markers", name=name)
    if None not in degrees:
        figure.add_scatter(x=names, y=degrees, mode="lines+markers", name="McMillan degree")
    figure.update_layout(
        title=f"Recursive elimination towards {node_label(elimination.target)}",
        xaxis_title="step: nodes eliminated, by which measured ones",
        yaxis_title="number",
    )
    return figure


def _name(step: EliminationStep) -> str:
    if not step.eliminated:
        return f"{step.number}: as it is"
    how = f"by {labels(step.by)}" if step.by else "immersed"
    return f"{step.number}: {labels(step.eliminated)} {how}"
