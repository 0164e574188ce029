"""The heat map of an isolability: which causes look alike in a record."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import leaves_list, linkage
from scipy.spatial.distance import squareform

from casid.arrays import Array
from casid.diagnosis.advice.isolability import Isolability
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, BEFORE, figure_text, short_label

_SHOWN = 24
_NUMBERED = 8
"""Columns of a map whose numbers have room side by side on a telephone."""
_COLOUR_BAR = {
    "orientation": "h",
    "thickness": 10,
    "len": 1.0,
    "y": -0.02,
    "yanchor": "top",
    "tickvals": [-1, 0, 1],
    "ticktext": ["-1: opposite", "0: apart", "1: alike"],
    "tickfont": {"size": 11},
    "ticklabelposition": "outside bottom",
}


def isolability_figure(isolability: Isolability) -> Any:
    """Cosines of all causes' signatures; causes that look alike stand side by side.

    Rows are named, columns carry the rows' numbers, so that the map is readable on a telephone. Of
    more than `_SHOWN` causes those with the nearest rivals are drawn.

    Raises
    ------
    ValueError
        If no cause is visible.
    """
    if not isolability.keys:
        raise ValueError("no cause is visible in this record, so there are no angles to draw")
    order = _side_by_side(isolability.cosines, _nearest(isolability.cosines))
    values = isolability.cosines[np.ix_(order, order)]
    names = [isolability.words(isolability.keys[i]) for i in order]
    full = [figure_text(words, 80) for words in names]
    rows = [f"{short_label(words)} <b>{i}</b>" for i, words in enumerate(names, 1)]
    numbers = list(range(len(names)))
    panel = Panels(row_height=60 + 30 * len(names), gap=0)
    panel.add(
        0,
        kind="Heatmap",
        in_legend=False,
        name="cosine",
        x=numbers,
        y=numbers,
        z=values,
        zmin=-1,
        zmax=1,
        xgap=1,
        ygap=1,
        colorscale=[[0, AFTER], [0.5, "#ffffff"], [1, BEFORE]],
        customdata=[[[a, b] for b in full] for a in full],
        hovertemplate="%{customdata[0]}<br>and %{customdata[1]}<br>cosine %{z:.3f}<extra></extra>",
        colorbar=_COLOUR_BAR,
    )
    caption = (
        "Angles between the causes' signatures in this record: a pair near +1 or -1 acts "
        "nearly alike, and costs 1/(1 - cosine^2) times the energy of a pair at 0."
    )
    if len(names) < len(isolability.keys):
        caption += f" The {len(names)} of {len(isolability.keys)} with the nearest rivals."
    done = panel.done(caption, ())
    _label_axes(panel.figure, numbers, rows)
    top = done.layout.margin.t + 14  # the numbers are above the map
    done.update_layout(margin={"t": top, "b": 56, "r": 14}, height=panel.inside + top + 56)
    return done


def _label_axes(figure: Any, numbers: list[int], rows: list[str]) -> None:
    """Number the columns above the map, name the rows, the first on top."""
    step = math.ceil(len(numbers) / _NUMBERED)
    figure.update_xaxes(
        side="top",
        tickvals=numbers,
        ticktext=["" if i % step else str(i + 1) for i in numbers],
        tickfont={"size": 10},
        showgrid=False,
    )
    figure.update_yaxes(
        autorange="reversed",
        tickvals=numbers,
        ticktext=rows,
        tickfont={"size": 10},
        showgrid=False,
    )


def _nearest(cosines: Array) -> Array:
    """The indices of the `_SHOWN` causes with the nearest rivals, ascending."""
    size = np.abs(cosines - np.diag(np.diag(cosines)))
    return np.sort(np.argsort(-size.max(axis=1, initial=0.0), kind="stable")[:_SHOWN])


def _side_by_side(cosines: Array, chosen: Array) -> list[int]:
    """An order in which those that look alike are neighbours, by average linkage."""
    if len(chosen) < 3:
        return [int(i) for i in chosen]
    apart = 1 - np.abs(cosines[np.ix_(chosen, chosen)])
    apart = np.maximum(0.5 * (apart + apart.T), 0.0)
    np.fill_diagonal(apart, 0.0)
    leaves = leaves_list(linkage(squareform(apart, checks=False), "average"))
    return [int(chosen[i]) for i in leaves]
