"""Figures of an assessment: expected errors, correlations, profiles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from casid.identifiability.assessment import Assessment
from casid.identifiability.records.practical_result import (
    POOR,
    UNDETERMINED,
    UNJUDGED,
    WELL,
    Practical,
)
from casid.report.figures.panels import Panels
from casid.report.figures.profiles import profiles_figure
from casid.report.figures.style import AFTER, BEFORE, FLOOR, MEASURED, figure_text, visible_text

_COLOURS = {WELL: FLOOR, POOR: BEFORE, UNDETERMINED: "#5f6073", UNJUDGED: MEASURED}


def figures(assessment: Assessment) -> dict[str, Any]:
    """Plotly figures by name: "errors", "correlations" and "profiles", as far as there are data."""
    out: dict[str, Any] = {}
    p = assessment.practical
    if p is not None and any(r.relative is not None and r.relative > 0 for r in p.parameters):
        out["errors"] = error_figure(p, assessment)
    if p is not None and sum(math.isfinite(r.std_error) for r in p.parameters) > 1:
        out["correlations"] = correlation_figure(p)
    if assessment.profiles is not None and len(assessment.profiles.profiles):
        out["profiles"] = profiles_figure(assessment.profiles)
    return out


def error_figure(practical: Practical, assessment: Assessment) -> Any:
    """Expected relative standard error of every parameter, one bar each, on a logarithmic axis."""
    rows = [r for r in practical.parameters if r.relative is not None]
    shown = [r for r in rows if math.isfinite(r.relative or math.nan) and (r.relative or 0) > 0]
    panel = Panels(row_height=60 + 26 * len(rows), gap=0)
    largest = max((100 * (r.relative or 0.0) for r in shown), default=100.0)
    smallest = min((100 * (r.relative or 0.0) for r in shown), default=1.0)
    for verdict, colour in _COLOURS.items():
        inside = [r for r in rows if r.verdict == verdict]
        if not inside:
            continue
        width = [
            100 * r.relative
            if r.relative is not None and math.isfinite(r.relative)
            else 30 * largest
            for r in inside
        ]
        panel.add(
            0,
            kind="Bar",
            orientation="h",
            y=[figure_text(r.name) for r in inside],
            x=width,
            name=verdict,
            marker={"color": colour},
            hovertemplate="%{y}: %{x:.3g} %<extra></extra>",
        )
    figure = panel.figure
    panel.label(0, x="expected standard error, % of the value")
    figure.update_xaxes(
        type="log",
        range=[math.log10(smallest) - 0.7, math.log10(30 * largest)],
        exponentformat="power",
    )
    figure.update_yaxes(
        categoryorder="array", categoryarray=[figure_text(r.name) for r in reversed(rows)]
    )
    figure.add_vline(x=100 * practical.largest_relative, line_dash="dash", line_color=MEASURED)
    lost = len(assessment.answer.not_identifiable)
    caption = (
        f"Expected standard errors with {visible_text(', '.join(practical.records))}, "
        f"relative to the values. Beyond the dashed line ({100 * practical.largest_relative:g} %) "
        "a parameter is poorly determined; a bar up to the right edge has an infinite error."
    )
    if lost:
        caption += f" {lost} of the parameters are structurally unidentifiable."
    return panel.done(caption, ())


def correlation_figure(practical: Practical) -> Any:
    """Correlations of the expected errors of the parameters, as a map."""
    inside = [
        i for i, n in enumerate(practical.names) if n in {r.name for r in practical.parameters}
    ]
    names = [figure_text(practical.names[i]) for i in inside]
    values = practical.correlation[np.ix_(inside, inside)]
    panel = Panels(row_height=140 + 30 * len(inside), gap=0)
    panel.add(
        0,
        kind="Heatmap",
        in_legend=False,
        name="correlation",
        x=names,
        y=names,
        z=values,
        zmin=-1,
        zmax=1,
        colorscale=[[0, AFTER], [0.5, "#ffffff"], [1, BEFORE]],
        hovertemplate="%{y} and %{x}: %{z:.3f}<extra></extra>",
        colorbar={"title": {"text": ""}, "thickness": 14},
    )
    panel.figure.update_yaxes(autorange="reversed")
    return panel.done(
        "Correlation of the expected errors: of a pair near +1 or -1 only a combination is "
        "determined. Parameters with an infinite error are left out.",
        (),
    )
