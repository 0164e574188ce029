"""The candidates of a diagnosis by evidence and gain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from casid.arrays import TINY
from casid.diagnosis.diagnosis import Diagnosis, Ranked
from casid.diagnosis.facts import Facts
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, effect_label, figure_text, visible_text
from casid.report.numbers import p_text

_SHOWN_CANDIDATES = 15
_LONGEST_BAR = 30.0  # of -log10 p: one overwhelming cause must not flatten the others
_STATUS = {
    "named": (AFTER, ""),
    "cannot be rejected": ("#E69F00", "/"),
    "rejected": ("#8a8a8a", "x"),
    "not significant": ("#cfcfcf", ""),
    "invisible": ("#ffffff", "."),
}
_OTHER_STATUS = ("#F0E442", "-")


def ranking_figure(diagnosis: Diagnosis) -> Any:
    """The catalogue's candidates as the first round ranked them: evidence and gain.

    Bars of -log10 of the family-wise p-value with the threshold of the false-alarm rate, and the
    fall of the criterion where a candidate was refitted. Invisible candidates are left to the
    report's table.

    Raises
    ------
    ValueError
        If no candidate was ranked.
    """
    ranked = [r for r in diagnosis.ranking if r.status != "invisible"]
    if not ranked:
        raise ValueError("no candidate was ranked, so there is nothing to draw")
    facts = Facts.of(diagnosis)
    ranked = [replace(r, adjusted=facts.p_value(r.kind, r.where)) for r in ranked]
    shown = ranked[:_SHOWN_CANDIDATES]
    figure = Panels(panels=2, columns=2, row_height=34 * len(shown) + 20, gap=70, column_gap=0.04)
    gains = [r.gain if r.gain is not None and math.isfinite(r.gain) else None for r in shown]
    alpha = diagnosis.false_alarm_rate
    threshold = -math.log10(alpha) if alpha > 0 else None
    _bars(figure, shown, gains)
    _numbers(figure, shown, gains, threshold)
    _axes(figure, shown, gains)
    if threshold is not None:
        figure.figure.add_shape(
            type="line",
            x0=threshold,
            x1=threshold,
            y0=0,
            y1=1,
            xref="x",
            yref="y domain",
            line={"color": "#555555", "width": 1.5, "dash": "dash"},
            layer="below",
        )
    caption = f"Candidates for {visible_text(diagnosis.problem)} by evidence and gain."
    if threshold is not None:
        caption += f" Dashed line: false-alarm rate {alpha:.2g} for the whole catalogue."
    if any(_exponent(r.adjusted) > _LONGEST_BAR for r in shown):
        caption += f" Bars are cut at {_LONGEST_BAR:g}."
    if len(ranked) > len(shown):
        caption += f" The first {len(shown)} of {len(ranked)}."
    figure.figure.update_layout(showlegend=False)  # every row says its status
    return figure.done(caption, ())


def _bars(figure: Panels, shown: Sequence[Ranked], gains: Sequence[float | None]) -> None:
    """Evidence to the left and gain to the right, one colour and hatching a status."""
    for status in dict.fromkeys(r.status for r in shown):
        colour, pattern = _STATUS.get(status, _OTHER_STATUS)
        rows = [i for i, r in enumerate(shown) if r.status == status]
        hatching = {"shape": pattern, "fgcolor": "#333333", "size": 6, "fillmode": "overlay"}
        line = {"color": "#444444", "width": 0.8}
        lengths = (
            ([_evidence(shown[i].adjusted) for i in rows], ".3g"),
            ([gains[i] or 0.0 for i in rows], ".4g"),
        )
        for k, (x, digits) in enumerate(lengths):
            figure.add(
                k,
                kind="Bar",
                y=rows,
                x=x,
                customdata=[figure_text(f"{shown[i].kind} in {shown[i].where}", 80) for i in rows],
                hovertemplate=f"%{{customdata}}<br>%{{x:{digits}}}<extra></extra>",
                name=figure_text(status),
                orientation="h",
                width=0.62,
                marker={"color": colour, "line": line, "pattern": hatching},
            )


def _numbers(
    figure: Panels,
    shown: Sequence[Ranked],
    gains: Sequence[float | None],
    threshold: float | None,
) -> None:
    """The numbers beside the bars, clear of the threshold's line."""
    ends = [max(_evidence(r.adjusted), threshold or 0.0) for r in shown]
    texts = [p_text(r.adjusted) for r in shown]
    gain_texts = ["not refitted" if g is None else f"{g:.3g}" for g in gains]
    for k, x, text in ((0, ends, texts), (1, [max(g or 0.0, 0.0) for g in gains], gain_texts)):
        figure.add(
            k,
            in_legend=False,
            name="numbers",
            x=x,
            y=list(range(len(shown))),
            text=[f"\u2002{figure_text(t)}" for t in text],
            mode="text",
            textposition="middle right",
            cliponaxis=False,
            hoverinfo="skip",
        )


def _axes(figure: Panels, shown: Sequence[Ranked], gains: Sequence[float | None]) -> None:
    """Names and status of the candidates, and ranges with room for the numbers."""
    labels = [
        f"{effect_label(r.kind, r.where, r.law)}<br>{figure_text(r.status, 20)}" for r in shown
    ]
    figure.figure.update_yaxes(
        tickvals=list(range(len(shown))),
        ticktext=labels,
        range=[len(shown) - 0.4, -0.6],
        showgrid=False,
        zeroline=False,
        tickfont={"size": 11},
    )
    figure.figure.update_yaxes(showticklabels=False, row=1, col=2)
    figure.x_range(0, [0, 1.4 * max(1.0, *(_evidence(r.adjusted) for r in shown))])
    known = [0.0, *(g for g in gains if g is not None)]
    low, high = min(known), max(known)
    room = (high - low) or 1.0
    figure.x_range(1, [low - (0.35 * room if low < 0 else 0), high + 0.45 * room])
    figure.ticks = 5
    figure.label(0, x="-log10 of family-wise p")
    figure.label(1, x="fall of criterion after refit")


def _exponent(p: float) -> float:
    return -math.log10(max(p, TINY)) if math.isfinite(p) else 0.0


def _evidence(p: float) -> float:
    return min(max(_exponent(p), 0.0), _LONGEST_BAR)
