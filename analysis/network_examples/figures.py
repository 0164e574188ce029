"""Figures 4.2, 6.1 and 6.2 of the network examples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.common.figures import Chart
from casid.data.record import Record
from casid.unknown_inputs.networks.prediction.node_predictor import NodePredictor
from casid.unknown_inputs.networks.recursive_elimination import RecursiveElimination

COLOURS = ("#E69F00", "#CC79A7", "#56B4E9", "#0072B2", "#D55E00")


def signals(record: Record, skip: int) -> Any:
    """Figure 6.1: the eight nodes and the excitation."""
    names = [*(f"w{i}" for i in range(1, 9)), "delta_6"]
    grid: dict[str, Any] = {"rows": len(names), "shared_xaxes": True, "vertical_spacing": 0.01}
    chart = Chart("The network of Example 6.1, simulated", 110 * len(names), **grid)
    for i, name in enumerate(names, start=1):
        look: dict[str, Any] = {"at": (i, 1), "line": {"width": 1}, "showlegend": False}
        chart.line(record.t[skip:], record[name][skip:], name, **look)
        chart.y_axis(name, row=i)
    chart.x_axis("sample", row=len(names))
    return chart.figure


def predictions(record: Record, skip: int, predictors: Mapping[str, NodePredictor]) -> Any:
    """Figure 6.2: node 2 and its predictions, their fits in the legend."""
    chart = Chart("Predictors of Example 6.1")
    t = record.t[skip:]
    chart.line(t, record["w2"][skip:], "w2", "black")
    for (name, p), colour in zip(predictors.items(), COLOURS, strict=True):
        label = f"{name}, {p.fit(record, skip=skip):.1f} %"
        chart.line(t, p.predict(record)[skip:], label, line={"color": colour, "width": 1})
    chart.x_axis("sample")
    chart.y_axis("w2")
    return chart.figure


def rings(found: RecursiveElimination) -> Any:
    """How the target's model grows with every ring."""
    chart = Chart("Recursive elimination: the model grows ring by ring (Figure 4.2)")
    number = [r.number for r in found.steps]
    series = {
        "nodes involved": [len(r.involved) for r in found.steps],
        "inputs of the model": [len(r.inputs) for r in found.steps],
        "unobserved nodes in it": [len(r.unobserved) for r in found.steps],
        "McMillan degree": [r.degree for r in found.steps],
    }
    for (name, values), colour in zip(series.items(), COLOURS, strict=False):
        chart.line(number, values, name, colour, mode="lines+markers")
    chart.x_axis("ring", dtick=1)
    chart.y_axis("count")
    return chart.figure
