"""A picture of a network: observed, unobserved, target and confounding nodes, and the modules."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go

from casid.argument_types import names_wrong_types
from casid.unknown_inputs.networks.confounders import Confounder, confounders
from casid.unknown_inputs.networks.graph import graph_of
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import Node, as_nodes, edge_label, labels, node_label

Place = tuple[float, float]

_COLOURS = {  # readable in grey, too
    "target": "#1b5e9b",
    "predictor input": "#7fb2dd",
    "observed": "#d6e6f4",
    "unobserved": "#ffffff",
}
_LABELLED = 40  # modules beyond which their labels would cover the picture
_RADIUS = 0.09  # of a node, in units of the layout [-1, 1]


@dataclass(frozen=True, slots=True)
class Roles:
    """What each node is in the picture.

    Attributes
    ----------
    role : node -> "target", "predictor input", "observed" or "unobserved".
    confounders : disturbances that confound the target and its inputs; their nodes are marked.
    """

    role: dict[Node, str]
    confounders: tuple[Confounder, ...]

    def __str__(self) -> str:
        lines = [
            f"  {role:<16}{labels(n for n, r in self.role.items() if r == role)}"
            for role in _COLOURS
        ]
        return "\n".join(lines + [f"  {c}" for c in self.confounders])


def roles(
    network: Network, target: Node | None = None, inputs: Iterable[Node] | None = None
) -> Roles:
    """Sort the nodes for a picture.

    Parameters
    ----------
    target : node of interest; None leaves observed and unobserved nodes alone.
    inputs : its predictor inputs, by default the measured nodes with a module into it.
    """
    role = {n: "observed" if n in network.measured else "unobserved" for n in network.nodes}
    if target is None:
        return Roles(role, ())
    chosen = (
        tuple(k for k in network.sources(target) if k in network.measured)
        if inputs is None
        else as_nodes(inputs)
    )
    role |= dict.fromkeys(chosen, "predictor input") | {target: "target"}
    return Roles(role, confounders(network, target, chosen))


@names_wrong_types()
def network_figure(
    network: Network,
    target: Node | None = None,
    inputs: Iterable[Node] | None = None,
    *,
    title: str = "",
) -> go.Figure:
    """Draw the network.

    Parameters
    ----------
    target, inputs : as for `roles`.
    title : by default the network's name.

    Returns
    -------
    plotly figure: one trace of markers for each role, one for the nodes whose disturbance
    confounds, arrows for modules (labelled up to 40 of them). Excitations are named at the node.
    """
    import plotly.graph_objects as go

    sorted_nodes = roles(network, target, inputs)
    places = _layout(network)
    figure = go.Figure()
    confounding = [c.node for c in sorted_nodes.confounders]
    _add_markers(
        figure, network, places, confounding, "confounding disturbance", size=46, color="#d1495b"
    )
    for role, colour in _COLOURS.items():
        chosen = [n for n, r in sorted_nodes.role.items() if r == role]
        _add_markers(figure, network, places, chosen, role, size=36, color=colour)
    figure.update_layout(
        title=title or network.name,
        annotations=_notes(network, places),
        plot_bgcolor="white",
        xaxis={"visible": False},
        yaxis={"visible": False, "scaleanchor": "x"},
        margin={"l": 20, "r": 20, "t": 50, "b": 20},
    )
    return figure


_ABOVE = 20
"""Pixels from the middle of a node to the name above it."""


def _layout(network: Network) -> dict[Node, Place]:
    import networkx as nx

    graph = graph_of(network).to_undirected()
    if len(network.nodes) <= 60 and nx.is_connected(graph):
        found = nx.kamada_kawai_layout(graph)
    else:
        found = nx.spring_layout(graph, seed=4)
    return {n: (float(x), float(y)) for n, (x, y) in found.items()}


def _add_markers(
    figure: go.Figure,
    network: Network,
    places: dict[Node, Place],
    nodes: list[Node],
    name: str,
    *,
    size: int,
    color: str,
) -> None:
    if not nodes:
        return
    is_halo = name.startswith("confounding")
    figure.add_scatter(
        x=[places[n][0] for n in nodes],
        y=[places[n][1] for n in nodes],
        mode="markers" if is_halo else "markers+text",
        name=name,
        marker={
            "size": size,
            "color": color,
            "line": {"color": color if is_halo else "#333333", "width": 1.5},
        },
        text=[node_label(n) for n in nodes],
        textfont={"color": "white" if name == "target" else "black"},
        hovertext=[_hover(network, n) for n in nodes],
        hoverinfo="text",
    )


def _hover(network: Network, n: Node) -> str:
    parts = [f"{edge_label((n, k))} {node_label(k)}" for k in network.sources(n)]
    parts += ["delta"] * (n in network.excitations) + ["tau"] * (n in network.disturbances)
    return f"{node_label(n)} = {' + '.join(parts) or '0'}"


def _notes(network: Network, places: dict[Node, Place]) -> list[dict[str, Any]]:
    """Arrows and labels of modules, and names of excitations."""
    are_labelled = len(network.modules) <= _LABELLED
    arrows, names = [], []
    for to, source in network.modules:
        start, end = _shortened(places[source], places[to], (source, to) in network.modules)
        arrows.append(_arrow(start, end))
        if are_labelled:
            # Nearer to the source, so that the labels of two modules back and forth part.
            x, y = (0.62 * a + 0.38 * b for a, b in zip(start, end, strict=True))
            names.append(_name(x, y, edge_label((to, source)), 11))
    names += [
        {**_name(*places[n], f"delta_{n}", 12), "yanchor": "bottom", "yshift": _ABOVE}
        for n in network.excitations
    ]
    return arrows + names


def _name(x: float, y: float, text: str, size: int) -> dict[str, Any]:
    return {
        "x": x,
        "y": y,
        "text": text,
        "showarrow": False,
        "font": {"size": size},
        "bgcolor": "rgba(255,255,255,0.8)",
    }


def _arrow(start: Place, end: Place) -> dict[str, Any]:
    return {
        "x": end[0],
        "y": end[1],
        "ax": start[0],
        "ay": start[1],
        "xref": "x",
        "yref": "y",
        "axref": "x",
        "ayref": "y",
        "text": "",
        "showarrow": True,
        "arrowhead": 2,
        "arrowsize": 1.2,
        "arrowwidth": 1.2,
        "arrowcolor": "#777777",
    }


def _shortened(a: Place, b: Place, has_return: bool) -> tuple[Place, Place]:
    """The arrow between the rims of two nodes, moved aside where another one comes back."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy) or 1.0
    step = np.array([dx, dy]) / length
    aside = 0.03 * np.array([-step[1], step[0]]) * has_return
    rim = min(_RADIUS, length / 3)
    start, end = np.array(a) + rim * step + aside, np.array(b) - rim * step + aside
    return (float(start[0]), float(start[1])), (float(end[0]), float(end[1]))
