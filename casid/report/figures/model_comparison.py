"""Figure of a comparison of models: what was measured, and what each of them expects."""

from __future__ import annotations

from typing import Any

from casid.estimation.fitted.model_comparison import ModelComparison
from casid.report.figures.panels import Panels
from casid.report.figures.style import (
    AFTER,
    BEFORE,
    FLOOR,
    MEASURED,
    axis_text,
    figure_text,
    visible_text,
)
from casid.report.figures.thinning import thinned

_COLOURS = (AFTER, BEFORE, FLOOR, "#CC79A7", "#E69F00", "#56B4E9")  # Okabe & Ito (2008)


def model_comparison_figure(found: ModelComparison) -> Any:
    """Every output against time, one panel each; the legend has the fit of each model."""
    rows = len(found.outputs)
    figure = Panels(rows=rows, row_height=220, gap=24, shared_x=True)
    for k, (output, unit) in enumerate(zip(found.outputs, found.units, strict=True)):
        i, y = thinned(found.measured[:, k]), found.measured[:, k]
        figure.points(k, found.t[i], y[i], "measured", {"color": MEASURED, "size": 3})
        for j, (model, expected) in enumerate(found.expected.items()):
            label = f"{figure_text(model)}: {found.fit[model][output]:.1f} %"
            if rows > 1:
                label = f"{figure_text(output)}, {label}"
            i, y = thinned(expected[:, k]), expected[:, k]
            figure.line(k, found.t[i], y[i], label, _COLOURS[j % len(_COLOURS)], width=1.4)
        figure.label(k, y=axis_text(output, unit))
    figure.label(rows - 1, x="time [s]")
    return figure.done(f"{visible_text(found.record)}: measured, and {found.how}.", ())
