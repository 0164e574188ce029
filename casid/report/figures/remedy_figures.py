"""Figures of a comparison of remedies."""

from __future__ import annotations

from typing import Any

import numpy as np

from casid.arrays import Array
from casid.report.figures.style import AFTER, BEFORE, FLOOR, MEASURED, figure_text
from casid.unknown_inputs.limits.comparison import Comparison

KIND_COLOURS = {
    "known": MEASURED,
    "neglect": BEFORE,
    "approximate": "#E69F00",
    "predict": "#CC79A7",
    "measure": AFTER,
    "eliminate": FLOOR,
    "own": "#000000",
}
_DASHES = ("solid", "dash", "dot", "dashdot")


def comparison_figure(comparison: Comparison) -> Any:
    """Two panels a coefficient: limits with 95 % intervals at N beside the truth; rmse against N.

    Raises
    ------
    ModelError
        If the comparison is symbolic.
    """
    from plotly.subplots import make_subplots

    drawn = [p for p in comparison.parameters if comparison.candidates(p)]
    N = comparison.N
    titles = []
    for p in drawn:
        titles += [f"{figure_text(p)}: limit and 95 % at N = {N:g}", f"{figure_text(p)}: rmse"]
    figure = make_subplots(
        rows=len(drawn), cols=2, subplot_titles=titles, column_widths=[0.5, 0.5],
        horizontal_spacing=0.09,
    )  # fmt: skip
    samples = np.geomspace(max(10.0, N / 1000), 100 * N, 61)
    for i, parameter in enumerate(drawn, 1):
        _parameter_row(figure, i, comparison, parameter, samples)
    unknown = ", ".join(comparison.unknown)
    caption = f"What each remedy for the unknown input {unknown} gives, and its error against N."
    figure.update_layout(
        template="plotly_white",
        height=380 * max(1, len(drawn)),
        title=figure_text(caption, 120),
        meta={"caption": caption},
    )
    return figure


def _parameter_row(
    figure: Any, i: int, comparison: Comparison, parameter: str, samples: Array
) -> None:
    """Draw the two panels of one coefficient in row `i`."""
    N = comparison.N
    seen: dict[str, int] = {}
    rows = [r for r in comparison.rows if r.estimates(parameter)]
    for row in rows:
        result = row._found()
        colour = KIND_COLOURS.get(row.kind, KIND_COLOURS["own"])
        dash = _DASHES[seen.get(row.kind, 0) % len(_DASHES)]
        seen[row.kind] = seen.get(row.kind, 0) + 1
        name = figure_text(row.name, 60)
        figure.add_scatter(
            x=[result[parameter]],
            y=[name],
            error_x={"type": "data", "array": [1.96 * result.std_error(parameter, N)]},
            mode="markers",
            marker={"color": colour, "size": 9},
            showlegend=False,
            row=i,
            col=1,
        )
        figure.add_scatter(
            x=samples,
            y=[row.rmse(parameter, n) for n in samples],
            mode="lines",
            line={"color": colour, "dash": dash},
            name=name,
            legendgroup=name,
            showlegend=i == 1,
            row=i,
            col=2,
        )
    truth = rows[0]._found().truth[parameter]
    figure.add_vline(x=truth, line={"color": "black", "dash": "dot"}, row=i, col=1)
    figure.update_xaxes(title_text=f"{figure_text(parameter)} (true value dotted)", row=i, col=1)
    figure.update_yaxes(autorange="reversed", row=i, col=1)
    figure.update_xaxes(type="log", title_text="samples N", row=i, col=2)
    figure.update_yaxes(type="log", title_text="root mean square error", row=i, col=2)
