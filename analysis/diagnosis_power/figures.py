"""Figures of the power study, from its summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from analysis.common.figures import Chart
from analysis.diagnosis_power.peers import PEERS


def figures_of(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Every figure that the summary has numbers for, by name."""
    out: dict[str, Any] = {}
    if "single" in summary:
        out["power_curve"] = power_curve(summary["single"]["bins"])
        out["confusion_matrix"] = confusion_matrix(summary["single"]["confusion"])
    if "nulls" in summary:
        out["false_alarms"] = false_alarms(summary["nulls"])
    if any(peer in summary.get("rivals", {}) for peer in PEERS):
        out["rivals"] = rivals(summary["rivals"])
    return out


def power_curve(bins: list[Any]) -> Any:
    """Shares by energy, with binomial intervals."""
    chart = Chart("Names become right as the hidden effect becomes visible")
    x = [(b["from"] * b["to"]) ** 0.5 for b in bins]
    for name, what in (("right", "named right"), ("detected", "detected"), ("flagged", "flagged")):
        rates = _rates([b[name] for b in bins])
        chart.add("Scatter", x=x, name=what, mode="lines+markers", **rates)
    chart.x_axis("energy of the hidden effect, lambda [-]", type="log")
    chart.y_axis("share of the cases [-]", range=[0, 1.02])
    return chart.figure


def confusion_matrix(cells: list[Any]) -> Any:
    """Hidden effects against the first name given, lambda of 100 and more."""
    chart = Chart("What was hidden and what was named first, lambda >= 100", 720)
    rows = sorted({c["hidden"] for c in cells}, reverse=True)
    columns = sorted({c["named"] for c in cells})
    count = {(c["hidden"], c["named"]): c["count"] for c in cells}
    z = [[count.get((r, c), 0) for c in columns] for r in rows]
    look: dict[str, Any] = {"texttemplate": "%{z}", "colorscale": "Blues", "showscale": False}
    chart.add("Heatmap", x=columns, y=rows, z=z, **look)
    chart.x_axis("first name given", tickangle=40)
    chart.y_axis("hidden effect")
    return chart.figure


def false_alarms(nulls: Mapping[str, Any]) -> Any:
    """Alarms of null records by length and noise."""
    chart = Chart("Records in which nothing can be seen", 420)
    for noise in sorted({c["noise"] for c in nulls["cells"]}):
        cells = [c for c in nulls["cells"] if c["noise"] == noise]
        x = [f"{c['duration']:g} s" for c in cells]
        chart.add("Bar", x=x, name=f"noise {noise:g}", **_rates(cells))
    chart.figure.add_hline(y=0.05, line_dash="dash", annotation_text="nominal")
    chart.x_axis("length of the record [s]")
    chart.y_axis("false alarms [-]")
    return chart.figure


def rivals(summary: Mapping[str, Any]) -> Any:
    """Right names of each peer and of casid, over all kinds."""
    chart = Chart("Right names at equal false-alarm rates", 420)
    peers = [p for p in PEERS if summary.get(p, {}).get("all", {}).get("peer", {}).get("of")]
    for who, name in (("casid", "casid"), ("peer", "the peer")):
        rates = [summary[p]["all"][who] for p in peers]
        chart.add("Bar", x=peers, name=name, **_rates(rates))
    chart.y_axis("named right [-]", range=[0, 1.02])
    chart.x_axis("peer, judged on all kinds")
    return chart.figure


def _rates(shares: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Heights and binomial intervals of a trace."""
    above = [s["high"] - s["rate"] for s in shares]
    below = [s["rate"] - s["low"] for s in shares]
    return {"y": [s["rate"] for s in shares], "error_y": {"array": above, "arrayminus": below}}
