"""The growth of an indirect model, ring by ring: inputs, nodes involved, McMillan degree."""

from __future__ import annotations

import plotly.graph_objects as go

from casid.unknown_inputs.networks.nodes import labels, node_label
from casid.unknown_inputs.networks.rings import RecursiveElimination, Ring


def ring_figure(elimination: RecursiveElimination) -> go.Figure:
    """The size of the target's equation against the ring (Linder 2017, Figure 4.2).

    Returns
    -------
    plotly figure: lines for inputs, unobserved nodes, nodes involved, and the McMillan degree
        where modules have numbers; each ring is named by the nodes eliminated in it.
    """
    import plotly.graph_objects as go

    rings = elimination.rings
    names = [_name(ring) for ring in rings]
    lines = {
        "inputs": [len(r.inputs) for r in rings],
        "unobserved nodes": [len(r.unobserved) for r in rings],
        "nodes involved": [len(r.involved) for r in rings],
    }
    degrees = [r.degree for r in rings]
    figure = go.Figure()
    for name, values in lines.items():
        figure.add_scatter(x=names, y=values, mode="lines+markers", name=name)
    if None not in degrees:
        figure.add_scatter(x=names, y=degrees, mode="lines+markers", name="McMillan degree")
    figure.update_layout(
        title=f"Recursive elimination towards {node_label(elimination.target)}",
        xaxis_title="ring: nodes eliminated, by which measured ones",
        yaxis_title="number",
    )
    return figure


def _name(ring: Ring) -> str:
    if not ring.eliminated:
        return f"{ring.number}: as it is"
    how = f"by {labels(ring.by)}" if ring.by else "immersed"
    return f"{ring.number}: {labels(ring.eliminated)} {how}"
