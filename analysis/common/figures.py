"""Plotly figures of studies: panels in a grid, and each name in the legend once."""

from __future__ import annotations

from typing import Any

At = tuple[int, int]
"""Row and column of a panel, from 1."""


class Chart:
    """A Plotly figure with its title, which is its caption too.

    Parameters
    ----------
    title, height : as shown, and in pixels.
    rows, cols, grid : of `plotly.subplots.make_subplots`.

    Attributes
    ----------
    figure : of Plotly.
    """

    def __init__(
        self, title: str, height: int = 480, *, rows: int = 1, cols: int = 1, **grid: Any
    ) -> None:
        from plotly.subplots import make_subplots

        self.figure = make_subplots(rows=rows, cols=cols, **grid)
        self.figure.update_layout(
            title={"text": title, "font": {"size": 15}},
            height=height,
            width=1100,
            template="plotly_white",
            meta={"caption": title},
        )
        self._named: set[str] = set()

    def add(self, kind: str, at: At = (1, 1), *, name: str = "", **trace: Any) -> None:
        """Add a trace of a kind that Plotly has; without a name it is not in the legend."""
        import plotly.graph_objects as go

        is_new = bool(name) and name not in self._named
        self._named.add(name)
        own = {"name": name, "legendgroup": name, "showlegend": is_new}
        self.figure.add_trace(getattr(go, kind)(**own | trace), row=at[0], col=at[1])

    def line(
        self,
        x: Any,
        y: Any,
        name: str = "",
        colour: str | None = None,
        *,
        dash: str = "solid",
        at: At = (1, 1),
        **trace: Any,
    ) -> None:
        """A line, or with `mode` "lines+markers" one with its points."""
        look = {"mode": "lines", "line": {"color": colour, "dash": dash}}
        self.add("Scatter", at, name=name, x=x, y=y, **look | trace)

    def points(
        self,
        x: Any,
        y: Any,
        name: str = "",
        colour: str | None = None,
        *,
        at: At = (1, 1),
        marker: dict[str, Any] | None = None,
        **trace: Any,
    ) -> None:
        """Points, `marker` with what distinguishes theirs: size, symbol, opacity."""
        look = {"mode": "markers", "marker": {"color": colour, "size": 8} | (marker or {})}
        self.add("Scatter", at, name=name, x=x, y=y, **look | trace)

    def x_axis(self, title: str | None = None, **options: Any) -> None:
        """Name and set the horizontal axes, of one `row` and `col` or of all panels."""
        self.figure.update_xaxes(title_text=title, **options)

    def y_axis(self, title: str | None = None, **options: Any) -> None:
        """Name and set the vertical axes, of one `row` and `col` or of all panels."""
        self.figure.update_yaxes(title_text=title, **options)
