"""Figure of a decision map: where one estimator beats another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casid.report.figures.style import figure_text
from casid.unknown_inputs.limits.decision_map import REGIONS, DecisionMap

_COLOURS = ("#f2f2f2", "#E69F00", "#56B4E9", "#009E73")


def decision_map_figure(
    found: DecisionMap, curves: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None
) -> Any:
    """The map as a Plotly figure.

    Parameters
    ----------
    curves : name -> (x, y) of a boundary to be drawn beside, such as a closed form.
    """
    import plotly.graph_objects as go

    figure = go.Figure()
    _add_regions(figure, found)
    _add_boundaries(figure, found)
    for name, (x, y) in (curves or {}).items():
        figure.add_scatter(
            x=np.asarray(x),
            y=np.asarray(y),
            mode="lines",
            line={"color": "#D55E00", "width": 3, "dash": "dot"},
            name=figure_text(name),
        )
    caption = (
        f"Where {found.first} estimates {found.parameter} better than {found.second}, "
        f"over {found.x} and {found.y}."
    )
    figure.update_layout(
        template="plotly_white",
        title=figure_text(caption, 140),
        xaxis={"title": found.x, "range": [found.x_values[0], found.x_values[-1]]},
        yaxis={"title": found.y, "range": [found.y_values[0], found.y_values[-1]]},
        legend={"orientation": "h", "y": -0.15},
        meta={"caption": caption},
    )
    return figure


def _add_regions(figure: Any, found: DecisionMap) -> None:
    """Colour the map by which estimator is better in what."""
    steps = [[k / 4, c] for i, c in enumerate(_COLOURS) for k in (i, i + 1)]
    figure.add_heatmap(
        x=found.x_values,
        y=found.y_values,
        z=found.regions,
        zmin=-0.5,
        zmax=3.5,
        colorscale=steps,
        colorbar={
            "tickvals": [0, 1, 2, 3],
            "ticktext": list(REGIONS),
            "title": f"{figure_text(found.first)} better",
        },
        name="regions",
    )


def _add_boundaries(figure: Any, found: DecisionMap) -> None:
    """Draw where both estimators have equal variance and equal mean square error."""
    for values, name, dash in (
        (found.variance, "equal variance", "solid"),
        (found.amse, f"equal mean square error, N = {found.N:g}", "dash"),
    ):
        figure.add_contour(
            x=found.x_values,
            y=found.y_values,
            z=values,
            contours={"start": 0, "end": 0, "size": 1, "coloring": "none"},
            line={"color": "black", "width": 2, "dash": dash},
            showscale=False,
            showlegend=True,
            name=name,
        )
