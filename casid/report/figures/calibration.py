"""The figure of a calibration: are the smallest p-values of null records uniform?"""

from __future__ import annotations

from typing import Any

import numpy as np

from casid.diagnosis.calibration.calibration import Calibration
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, BEFORE, MEASURED, visible_text


def calibration_figure(result: Calibration) -> Any:
    """Histogram of the smallest adjusted p of every null record, against the uniform density.

    Under an exact family-wise test the bars are level; a heap near zero is a test that raises too
    many alarms.
    """
    bins = int(np.clip(np.sqrt(result.runs) * 2, 5, 20))
    count, edge = np.histogram(result.smallest, bins, (0.0, 1.0))
    expected = result.runs / bins
    top = float(max(count.max(), expected))
    figure = Panels(rows=1, row_height=300, gap=0)
    figure.add(
        0,
        kind="Bar",
        x=0.5 * (edge[1:] + edge[:-1]),
        y=count,
        width=1 / bins,
        name="null records",
        marker={"color": MEASURED, "line": {"color": "#ffffff", "width": 1}},
        hovertemplate="p about %{x:.3g}: %{y} records<extra></extra>",
    )
    hover = "uniform: %{y:.3g} records<extra></extra>"
    figure.line(0, [0.0, 1.0], [expected, expected], "uniform", AFTER, hovertemplate=hover)
    for name, at, dash in (
        ("requested level", result.alpha, "dash"),
        ("corrected threshold", result.threshold, "dot"),
    ):
        if name == "corrected threshold" and not result.is_corrected:
            continue
        hover, ends = f"{name} {at:.3g}<extra></extra>", [0.0, 1.05 * top]
        figure.line(0, [at, at], ends, name, BEFORE, dash=dash, hovertemplate=hover)
    figure.x_range(0, [0.0, 1.0])
    figure.y_range(0, [0.0, 1.1 * top])
    figure.label(0, x="smallest adjusted p of the first round", y="null records")
    figure.figure.update_layout(bargap=0)
    caption = f"{visible_text(result.problem)}: {result.sentence}."
    return figure.done(caption, ())
