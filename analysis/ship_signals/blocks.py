"""Block diagrams: stated once, drawn with Plotly, and solved for what they say.

A diagram is a graph of blocks, sums, taps and ports with directed wires. The same graph is drawn
and, with numbers for its blocks, solved: a figure's arrows and signs can be tested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Point = tuple[float, float]
Kind = Literal["block", "sum", "tap", "source", "sink"]

_HALF: dict[str, Point] = {
    "block": (0.55, 0.32),
    "sum": (0.16, 0.16),
    "tap": (0.0, 0.0),
    "source": (0.3, 0.2),
    "sink": (0.3, 0.2),
}
"""Half width and half height of what a wire must not enter."""

_INK, _FILL = "#222222", "#eef3f8"


@dataclass(frozen=True, slots=True)
class Node:
    """Something that wires meet.

    Attributes
    ----------
    name : unique in its diagram; the key of a block's gain.
    kind : a block multiplies, a sum adds its signed inputs, a tap branches, ports begin and end.
    at : centre, x to the right and y up.
    text : as drawn; the name by default.
    note : shown when the mouse is over it, such as the formula.
    """

    name: str
    kind: Kind
    at: Point
    text: str | None = None
    note: str = ""

    @property
    def label(self) -> str:
        """What is drawn."""
        return self.name if self.text is None else self.text


@dataclass(frozen=True, slots=True)
class Wire:
    """From one node to another, through corners; the sign counts where a sum is entered."""

    start: str
    end: str
    sign: int = 1
    via: tuple[Point, ...] = ()


def wires(*paths: tuple[str | Point | int, ...]) -> tuple[Wire, ...]:
    """Wires along paths of signals, from name to name.

    A point before a name is a corner on the way to it, -1 the sign with which it is entered.
    """
    made: list[Wire] = []
    for start, *steps in paths:
        corners: list[Point] = []
        sign = 1
        for step in steps:
            if isinstance(step, str):
                made.append(Wire(str(start), step, sign, tuple(corners)))
                start, corners, sign = step, [], 1
            elif isinstance(step, int):
                sign = step
            else:
                corners.append(step)
    return tuple(made)


@dataclass(frozen=True, slots=True)
class Diagram:
    """A block diagram.

    Raises
    ------
    ValueError
        If names repeat, or a wire begins or ends nowhere or runs aslant.
    """

    title: str
    nodes: tuple[Node, ...]
    wires: tuple[Wire, ...]

    def __post_init__(self) -> None:
        names = [n.name for n in self.nodes]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"{self.title}: {', '.join(twice)} stand twice. Rename one of each.")
        for w in self.wires:
            for end in (w.start, w.end):
                if end not in names:
                    raise ValueError(f"{self.title}: a wire meets {end!r}, which is no node.")
            for a, b in zip(self.path(w)[:-1], self.path(w)[1:], strict=True):
                if abs(a[0] - b[0]) > 1e-9 and abs(a[1] - b[1]) > 1e-9:
                    raise ValueError(
                        f"{self.title}: wire {w.start} to {w.end} runs aslant from {a} to {b}. "
                        "Give it a corner, via=((x, y),)."
                    )

    def node(self, name: str) -> Node:
        """By its name."""
        return next(n for n in self.nodes if n.name == name)

    def path(self, wire: Wire) -> list[Point]:
        """Centre to centre, corners between."""
        return [self.node(wire.start).at, *wire.via, self.node(wire.end).at]

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the blocks."""
        return tuple(n.name for n in self.nodes if n.kind == "block")

    def respond(
        self, gains: Mapping[str, complex], sources: Mapping[str, complex]
    ) -> dict[str, complex]:
        """Signal at every node: the graph's linear equations, solved.

        Parameters
        ----------
        gains : of each block by its name.
        sources : value of each source; 0 for those not named.
        """
        place = {n.name: i for i, n in enumerate(self.nodes)}
        M = np.eye(len(self.nodes), dtype=complex)
        b = np.zeros(len(self.nodes), dtype=complex)
        for n in self.nodes:
            if n.kind == "source":
                b[place[n.name]] = sources.get(n.name, 0.0)
        for w in self.wires:
            gain = gains[w.end] if self.node(w.end).kind == "block" else w.sign
            M[place[w.end], place[w.start]] -= gain
        solved = np.linalg.solve(M, b)
        return {n.name: complex(solved[place[n.name]]) for n in self.nodes}

    def crossed(self) -> list[str]:
        """Wires that run through a block, a sum or a port that they do not meet."""
        found = []
        for w in self.wires:
            points = self.path(w)
            for n in self.nodes:
                if n.name in (w.start, w.end) or n.kind == "tap":
                    continue
                half = _HALF[n.kind]
                for a, b in zip(points[:-1], points[1:], strict=True):
                    if all(
                        min(a[i], b[i]) < n.at[i] + half[i] and max(a[i], b[i]) > n.at[i] - half[i]
                        for i in (0, 1)
                    ):
                        found.append(f"{w.start} to {w.end} through {n.name}")
        return found


def _shortened(points: Sequence[Point], half: Point, end_half: Point) -> list[Point]:
    """The same path, from the first node's edge to the last one's."""

    def moved(a: Point, b: Point, by: Point) -> Point:
        dx, dy = np.sign(b[0] - a[0]), np.sign(b[1] - a[1])
        return (float(a[0] + dx * by[0]), float(a[1] + dy * by[1]))

    p = list(points)
    p[0], p[-1] = moved(p[0], p[1], half), moved(p[-1], p[-2], end_half)
    return p


def draw(diagram: Diagram) -> Any:
    """The diagram as a Plotly figure; notes show when the mouse is over a node."""
    import plotly.graph_objects as go

    shapes: list[dict[str, Any]] = []
    texts: list[dict[str, Any]] = []
    pen = {"color": _INK, "width": 1.6}
    for w in diagram.wires:
        start, end = diagram.node(w.start), diagram.node(w.end)
        points = _shortened(diagram.path(w), _HALF[start.kind], _HALF[end.kind])
        for a, b in zip(points[:-1], points[1:], strict=True):
            shapes.append(
                {"type": "line", "x0": a[0], "y0": a[1], "x1": b[0], "y1": b[1], "line": pen}
            )
        before, tip = points[-2], points[-1]
        back = np.sign([before[0] - tip[0], before[1] - tip[1]])
        if end.kind != "tap":
            texts.append(
                {
                    "x": tip[0], "y": tip[1], "ax": tip[0] + 0.12 * back[0],
                    "ay": tip[1] + 0.12 * back[1], "xref": "x", "yref": "y", "axref": "x",
                    "ayref": "y", "showarrow": True, "arrowhead": 2, "arrowsize": 1.3,
                    "arrowwidth": 1.6, "arrowcolor": _INK, "text": "",
                }
            )  # fmt: skip
        if end.kind == "sum":
            side = np.array([-back[1], back[0]])  # to one side of the wire
            where = np.array(tip) + 0.16 * back + 0.16 * (side if side.sum() > 0 else -side)
            texts.append(_text(tuple(where.tolist()), "+" if w.sign > 0 else "\u2212", 13))
    for n in diagram.nodes:
        (x, y), (hx, hy) = n.at, _HALF[n.kind]
        box = {"x0": x - hx, "x1": x + hx, "y0": y - hy, "y1": y + hy, "line": pen}
        if n.kind == "block":
            shapes.append(box | {"type": "rect", "fillcolor": _FILL})
        elif n.kind == "sum":
            shapes.append(box | {"type": "circle", "fillcolor": "#ffffff"})
        elif n.kind == "tap":
            dot = {"x0": x - 0.05, "x1": x + 0.05, "y0": y - 0.05, "y1": y + 0.05}
            shapes.append(dot | {"type": "circle", "fillcolor": _INK, "line": pen})
        if n.kind in ("block", "source", "sink"):
            texts.append(_text(n.at, n.label, 15))
    noted = [n for n in diagram.nodes if n.note]
    figure = go.Figure(
        go.Scatter(
            x=[n.at[0] for n in noted],
            y=[n.at[1] for n in noted],
            text=[f"{n.label}: {n.note}" for n in noted],
            mode="markers",
            marker={"size": 34, "opacity": 0.0},
            hoverinfo="text",
            showlegend=False,
        )
    )
    xs = [p[0] for w in diagram.wires for p in diagram.path(w)]
    ys = [p[1] for w in diagram.wires for p in diagram.path(w)]
    width, height = max(xs) - min(xs) + 1.4, max(ys) - min(ys) + 1.2
    hidden = {"visible": False, "fixedrange": True}
    figure.update_xaxes(range=[min(xs) - 0.7, max(xs) + 0.7], **hidden)
    figure.update_yaxes(range=[min(ys) - 0.6, max(ys) + 0.6], scaleanchor="x", **hidden)
    figure.update_layout(
        title={"text": diagram.title, "font": {"size": 15}},
        shapes=shapes,
        annotations=texts,
        plot_bgcolor="#ffffff",
        width=round(95 * width) + 40,
        height=round(95 * height) + 90,
        margin={"l": 20, "r": 20, "t": 70, "b": 20},
        meta={"caption": diagram.title},
    )
    return figure


def _text(at: Point, text: str, size: int) -> dict[str, Any]:
    return {
        "x": at[0],
        "y": at[1],
        "text": text,
        "showarrow": False,
        "font": {"size": size, "color": _INK},
    }
