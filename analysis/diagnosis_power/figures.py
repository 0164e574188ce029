"""Figures of the power study, from its summary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.common.output import titled
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
    import plotly.graph_objects as go

    figure = go.Figure()
    x = [(b["from"] * b["to"]) ** 0.5 for b in bins]
    for name, what in (("right", "named right"), ("detected", "detected"), ("flagged", "flagged")):
        y = [b[name]["rate"] for b in bins]
        above = [b[name]["high"] - b[name]["rate"] for b in bins]
        below = [b[name]["rate"] - b[name]["low"] for b in bins]
        bars = {"array": above, "arrayminus": below}
        figure.add_scatter(x=x, y=y, error_y=bars, name=what, mode="lines+markers")
    figure.update_xaxes(title="energy of the hidden effect, lambda [-]", type="log")
    figure.update_yaxes(title="share of the cases [-]", range=[0, 1.02])
    return titled(figure, "Names become right as the hidden effect becomes visible", 480)


def confusion_matrix(cells: list[Any]) -> Any:
    """Hidden effects against the first name given, lambda of 100 and more."""
    import plotly.graph_objects as go

    rows = sorted({c["hidden"] for c in cells}, reverse=True)
    columns = sorted({c["named"] for c in cells})
    count = {(c["hidden"], c["named"]): c["count"] for c in cells}
    z = [[count.get((r, c), 0) for c in columns] for r in rows]
    figure = go.Figure(
        go.Heatmap(x=columns, y=rows, z=z, texttemplate="%{z}", colorscale="Blues", showscale=False)
    )
    figure.update_xaxes(title="first name given", tickangle=40)
    figure.update_yaxes(title="hidden effect")
    return titled(figure, "What was hidden and what was named first, lambda >= 100", 720)


def false_alarms(nulls: Mapping[str, Any]) -> Any:
    """Alarms of null records by length and noise."""
    import plotly.graph_objects as go

    figure = go.Figure()
    for noise in sorted({c["noise"] for c in nulls["cells"]}):
        cells = [c for c in nulls["cells"] if c["noise"] == noise]
        figure.add_bar(
            x=[f"{c['duration']:g} s" for c in cells],
            y=[c["rate"] for c in cells],
            error_y={
                "array": [c["high"] - c["rate"] for c in cells],
                "arrayminus": [c["rate"] - c["low"] for c in cells],
            },
            name=f"noise {noise:g}",
        )
    figure.add_hline(y=0.05, line_dash="dash", annotation_text="nominal")
    figure.update_xaxes(title="length of the record [s]")
    figure.update_yaxes(title="false alarms [-]")
    return titled(figure, "Records in which nothing can be seen", 420)


def rivals(summary: Mapping[str, Any]) -> Any:
    """Right names of each peer and of casid, over all kinds."""
    import plotly.graph_objects as go

    peers = [p for p in PEERS if summary.get(p, {}).get("all", {}).get("peer", {}).get("of")]
    figure = go.Figure()
    for who in ("casid", "peer"):
        rates = [summary[p]["all"][who] for p in peers]
        figure.add_bar(
            x=peers,
            y=[r["rate"] for r in rates],
            error_y={
                "array": [r["high"] - r["rate"] for r in rates],
                "arrayminus": [r["rate"] - r["low"] for r in rates],
            },
            name="casid" if who == "casid" else "the peer",
        )
    figure.update_yaxes(title="named right [-]", range=[0, 1.02])
    figure.update_xaxes(title="peer, judged on all kinds")
    return titled(figure, "Right names at equal false-alarm rates", 420)
