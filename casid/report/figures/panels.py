"""A figure of equal panels, row by row, with one look for the whole package."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import Array
from casid.estimation.estimate import RecordView
from casid.report.figures.record_views import part_shapes, time_range
from casid.report.figures.style import AFTER, FONT, figure_text, translucent, visible_text

_AXIS: dict[str, Any] = {
    "title_font": {"size": 13},
    "automargin": True,
    "showline": True,
    "linecolor": "#888888",
    "ticks": "outside",
    "tickcolor": "#888888",
    "ticklen": 4,
    "gridcolor": "#e8e8e8",
    "zerolinecolor": "#bdbdbd",
    "zerolinewidth": 1,
}
_LEGEND: dict[str, Any] = {
    "orientation": "h",
    "x": 0,
    "xanchor": "left",
    "y": 1.0,
    "yanchor": "bottom",
    "itemsizing": "constant",
    "font": {"size": 13},
}
_MENU_HEIGHT = 46
"""What a figure with a menu of records below it is higher by, in pixels."""

_MENU: dict[str, Any] = {
    "type": "dropdown",
    "direction": "up",
    "x": 0,
    "xanchor": "left",
    "y": 0,
    "yanchor": "top",
    "pad": {"t": 52},
    "bgcolor": "#ffffff",
    "bordercolor": "#888888",
}


class Panels:
    """A Plotly figure of equal panels, row by row, with one look for the whole package."""

    def __init__(
        self,
        *,
        row_height: int,
        gap: int,
        rows: int = 1,
        panels: int | None = None,
        columns: int = 1,
        column_gap: float = 0.1,
        shared_x: bool = False,
    ) -> None:
        from plotly.subplots import make_subplots

        self.panels = panels if panels is not None else rows
        self.columns = columns
        self.rows = math.ceil(self.panels / columns)
        self.row_height, self.gap = row_height, gap
        inside = self.rows * row_height + (self.rows - 1) * gap
        cells = self.rows * columns
        self.figure = make_subplots(
            rows=self.rows,
            cols=columns,
            shared_xaxes=shared_x,
            vertical_spacing=gap / inside if self.rows > 1 else 0.0,
            horizontal_spacing=column_gap if columns > 1 else 0.0,
            specs=[
                [{} if r * columns + c < self.panels else None for c in range(columns)]
                for r in range(self.rows)
            ]
            if cells > self.panels
            else None,
        )
        self.inside = inside
        self.ticks = 8
        self.is_log = self.has_x_label = False
        self.legend: set[tuple[int, str]] = set()
        self.owners: list[int] = []
        self.menu: list[tuple[RecordView, list[dict[str, Any]], dict[str, Any]]] = []
        self.axes: list[tuple[str, dict[str, Any]]] = []  # "x", "y" or one of them; its look

    def _at(self, k: int) -> dict[str, int]:
        return {"row": k // self.columns + 1, "col": k % self.columns + 1}

    def add(
        self,
        k: int,
        *,
        kind: str = "Scatter",
        view: RecordView | None = None,
        in_legend: bool = True,
        **trace: Any,
    ) -> None:
        """Add a trace to panel k; each name is in the legend once, for every record."""
        import plotly.graph_objects as go

        owner = len(self.menu) if view is not None else 0
        name = str(trace["name"])
        first = in_legend and (owner, name) not in self.legend
        if in_legend:
            self.legend.add((owner, name))
        self.owners.append(owner)
        trace |= {"legendgroup": name, "showlegend": first, "visible": owner == 0}
        self.figure.add_trace(getattr(go, kind)(**trace), **self._at(k))

    def line(
        self,
        k: int,
        x: ArrayLike,
        y: ArrayLike,
        name: str,
        colour: str,
        *,
        width: float = 2,
        dash: str | None = None,
        **trace: Any,
    ) -> None:
        """Draw a line in panel k, with points where the mode says so; `trace` as for `add`."""
        look: dict[str, Any] = {"color": colour, "width": width}
        if dash is not None:
            look["dash"] = dash
        self.add(k, **{"x": x, "y": y, "name": name, "mode": "lines", "line": look, **trace})

    def points(
        self, k: int, x: ArrayLike, y: ArrayLike, name: str, marker: dict[str, Any], **trace: Any
    ) -> None:
        """Draw points in panel k; `trace` as for `add`."""
        self.add(k, x=x, y=y, name=name, mode="markers", marker=marker, **trace)

    def band(self, k: int, x: Array | list[Any], centre: Array, half: Array) -> None:
        """Shade the 95 % band centre -+ half (n,) over x in panel k."""
        self.add(
            k,
            x=[*x, *x[::-1]] if isinstance(x, list) else np.concatenate([x, x[::-1]]),
            y=np.concatenate([centre + half, (centre - half)[::-1]]),
            name="95 % band",
            mode="lines",
            line={"width": 0},
            fill="toself",
            fillcolor=translucent(AFTER, 0.3),
            hoverinfo="skip",
        )

    def mark(self, k: int, *, x: float | None = None, y: float | None = None, **line: Any) -> None:
        """Draw a straight line across panel k, upright at `x` or level at `y`."""
        if x is not None:
            self.figure.add_vline(x=x, **line, **self._at(k))
        if y is not None:
            self.figure.add_hline(y=y, **line, **self._at(k))

    def _axis(self, axis: str, k: int, **look: Any) -> None:
        """How an axis of panel k will look."""
        panel = self.figure.get_subplot(**self._at(k))
        self.axes.append((getattr(panel, f"{axis}axis").plotly_name, look))

    def _styled(self, **look: Any) -> Any:
        """The layout with these looks and its axes', changed apart from the figure.

        A figure tells each of its parts of every change, which takes longer than all else.
        """
        import plotly.graph_objects as go

        stated = self.figure.layout.to_plotly_json()
        names = [n for n in stated if n.startswith(("xaxis", "yaxis"))]
        layout = go.Layout({n: v for n, v in stated.items() if n != "template"})
        for whose, axis in self.axes:
            for name in names:
                if whose in (name, name[0]):
                    layout[name].update(axis)
        return layout.update(look)

    def label(self, k: int, *, x: str | None = None, y: str | None = None) -> None:
        """Name the axes of panel k."""
        if x is not None:
            self.has_x_label = True
            self._axis("x", k, title_text=x)
        if y is not None:
            self._axis("y", k, title_text=y)

    def time_label(self, k: int, unit: str = "s") -> None:
        """Name the time axis of panel k; a time of the day has all its digits, 33,382 and no 33.4k.

        The panels above that share the axis show no numbers.
        """
        self.label(k, x=f"time [{unit}]")
        self._axis("x", k, exponentformat="none")

    def x_range(self, k: int, span: list[float]) -> None:
        """Fix the horizontal range of panel k."""
        self._axis("x", k, range=span)

    def y_range(self, k: int, span: list[float]) -> None:
        """Fix the vertical range of panel k."""
        self._axis("y", k, range=span)

    def time_range(self, view: RecordView) -> None:
        """Show the record from end to end in every panel."""
        span = time_range(view)["xaxis.range"]
        if span is not None:
            self.axes.append(("x", {"range": span}))

    def log(self) -> None:
        """Make all axes logarithmic; digits between the decades only where decades are few."""
        for axis in "xy":
            values = np.concatenate([[], *(np.asarray(t[axis], float) for t in self.figure.data)])
            values = values[np.isfinite(values) & (values > 0)]
            few = not values.size or values.max() < 80 * values.min()
            look = {
                "type": "log",
                "exponentformat": "power",
                "dtick": "D2" if few else 1,
                "minor": {"dtick": "D1", "showgrid": True, "gridcolor": "#f3f3f3"},
            }
            self.axes.append((axis, look))
        self.is_log = True

    def parts(self, view: RecordView, layout: dict[str, Any], *, shaded: bool = True) -> None:
        """Close the traces of one record: what its menu entry sets besides their visibility."""
        self.menu.append((view, part_shapes(view) if shaded else [], layout))

    def done(self, caption: str, views: Sequence[RecordView]) -> Any:
        """Style, caption and menu; returns the figure."""
        several = len(views) > 1
        title = wrap(caption, 100)
        top = 18 * len(title) + 62
        bottom = (54 if self.has_x_label or several else 34) + several * _MENU_HEIGHT
        names = [visible_text(view.name) for view, *_ in self.menu]
        few = {"nticks": self.ticks} if not self.is_log else {}
        self.axes.append(("x", {"title_standoff": 6, "tickangle": 0, **few, **_AXIS}))
        self.axes.append(("y", {"title_standoff": 8, **_AXIS}))
        self.figure.layout = self._styled(
            template="none",
            font={"family": FONT, "size": 13, "color": "#222222"},
            autosize=True,
            height=self.inside + top + bottom,
            margin={"l": 60, "r": 44, "t": top, "b": bottom},
            paper_bgcolor="#ffffff",
            plot_bgcolor="#ffffff",
            hovermode="closest",
            hoverlabel={"namelength": -1},
            modebar={"orientation": "v"},  # beside the plot: above it, it would cover the legend
            title={
                "text": "<br>".join(figure_text(line, 120) for line in title),
                "font": {"size": 14},
                "x": 0.01,
                "xanchor": "left",
                "y": 1.0,
                "yref": "container",
                "yanchor": "top",
                "pad": {"t": 10},
            },
            legend=_LEGEND,
            meta={
                "caption": caption,
                "panels": self.panels,
                "columns": self.columns,
                "row_height": self.row_height,
                "gap": self.gap,
                "bottom": bottom,
                **({"names": names, "menu": _MENU_HEIGHT} if several else {}),
            },
            **({"shapes": self.menu[0][1]} if self.menu else {}),
            **({"updatemenus": [{**_MENU, "buttons": self._buttons()}]} if several else {}),
        )
        return self.figure

    def _buttons(self) -> list[dict[str, Any]]:
        """One entry of the menu a record: its traces, its shading, its ranges."""
        return [
            {
                "label": figure_text(f"record: {view.name}", 26),
                "method": "update",
                "args": [
                    {"visible": [owner == i for owner in self.owners]},
                    {"shapes": shapes, **layout},
                ],
            }
            for i, (view, shapes, layout) in enumerate(self.menu)
        ]
