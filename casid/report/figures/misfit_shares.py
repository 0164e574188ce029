"""Shares of the excess misfit: what each cause explains, and what nothing does."""

from __future__ import annotations

from typing import Any

from casid.diagnosis.verdict.remainder import Remaining
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, BEFORE, effect_label


def remaining_figure(remaining: Remaining) -> Any:
    """One bar a cause in the order of contribution, and one for what stays unexplained."""
    named = remaining.explained
    labels = [effect_label(e.kind, e.where, e.description) for e in named]
    labels.append("unexplained")
    shares = [100 * e.share for e in named] + [100 * remaining.unexplained]
    last = len(shares) - 1
    figure = Panels(row_height=42 * len(shares) + 16, gap=0)
    parts = (
        ("explained", range(last), AFTER, ""),
        ("unexplained", range(last, last + 1), BEFORE, "/"),
    )
    for name, rows, colour, pattern in parts:
        if not rows:
            continue
        values = [shares[i] for i in rows]
        figure.add(
            0,
            kind="Bar",
            in_legend=False,
            orientation="h",
            name=name,
            y=list(rows),
            x=values,
            width=0.6,
            text=[f"{x:.1f} %" if 0 < x < 10 else f"{x:.0f} %" for x in values],
            textposition="outside",
            cliponaxis=False,
            marker={
                "color": colour,
                "pattern": {"shape": pattern, "fgcolor": "#ffffff", "fillmode": "overlay"},
            },
            hovertemplate="%{x:.3g} &#37;<extra></extra>",
        )
    figure.x_range(0, [0, 1.15 * max([*shares, 1.0])])
    figure.figure.update_yaxes(
        tickvals=list(range(len(shares))),
        ticktext=labels,
        range=[last + 0.6, -0.6],
        showgrid=False,
        zeroline=False,
        tickfont={"size": 12},
    )
    figure.ticks = 6
    figure.label(0, x="share of excess misfit [%]")
    return figure.done(
        "What each cause explains of the squared error above the noise floor, all outputs in units "
        "of their floor, and what stays unexplained.",
        (),
    )
