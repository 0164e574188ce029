"""A Plotly figure drawn small and still, as SVG: what a notebook shows beside the tables.

It needs no script and no browser of its own. Lines, points with their errors, bars and maps are
drawn in panels with the ends of their axes; the figure itself (`plot()`) has the rest.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.sampling import stretches_of
from casid.report.figures.thinning import thinned
from casid.report.html.markup import Html, element, join

_WIDTH, _TALLEST = 620, 420
_RIGHT, _TOP, _BOTTOM = 12, 34, 34  # margins, pixels
_LONGEST = 26  # characters of a name beside an axis
_MOST = 600  # points of a line


@dataclass(frozen=True)
class _Axis:
    """Data to pixels: a line, its logarithm, or places of categories.

    start, stop : pixels of `low` and `high`, which are logarithms where `is_log`.
    texts : place -> text, for an axis with texts at places of its own.
    """

    low: float
    high: float
    start: float
    stop: float
    is_log: bool
    categories: Mapping[str, int]
    texts: Mapping[float, str]
    title: str

    def at(self, values: Any) -> Array:
        """Pixels; not a number where there is no value."""
        numbers = _numbers(values, self.categories, self.is_log)
        return self.start + (numbers - self.low) * (self.stop - self.start) / (self.high - self.low)

    def marks(self) -> list[tuple[float, str]]:
        """Pixels and texts of what is written beside the axis: names, or its ends."""
        if self.categories:
            pixels = self.at(list(self.categories))
            return list(zip(pixels.tolist(), map(_words, self.categories), strict=True))
        if self.texts:
            return list(zip(self.at(list(self.texts)).tolist(), self.texts.values(), strict=True))
        ends = ((self.start, self.low), (self.stop, self.high))
        return [(pixel, f"{10**end if self.is_log else end:.3g}") for pixel, end in ends]


def thumbnail(figure: Any, caption: str) -> Html:
    """The figure as an SVG element; `caption` is its name for readers who do not see it."""
    layout = figure.layout
    height = min(_TALLEST, max(130, 0.6 * ((layout.height or 450) - (layout.margin.t or 80))))
    panels: dict[tuple[str, str], list[Any]] = {}
    for trace in figure.data:
        if trace.visible is not False and trace.type in _DRAWN:
            panels.setdefault((trace.xaxis or "x", trace.yaxis or "y"), []).append(trace)
    longest = max((len(v) for t in figure.data for v in _axis_labels(t, layout)), default=6)
    margin = 8.0 + 6.0 * min(longest, _LONGEST)
    drawn = [_panel(layout, n, traces, (margin, height)) for n, traces in panels.items()]
    names = {t.name: _colour(t) for t in figure.data if t.name and t.showlegend is not False}
    return element(
        "svg",
        join([*_legend(names if len(names) > 1 else {}, margin), *drawn]),
        viewBox=f"0 0 {_WIDTH} {height:.0f}",
        width=str(_WIDTH),
        role="img",
        aria_label=caption,
    )


def _axis_labels(trace: Any, layout: Any) -> Sequence[str]:
    """Labels of the vertical axis of a trace that are texts; numbers are short."""
    axis = layout[f"yaxis{(trace.yaxis or 'y')[1:]}"]
    if axis.ticktext is not None:
        return [_words(text) for text in axis.ticktext]
    return [v for v in (trace.y if trace.y is not None else ()) if isinstance(v, str)]


def _legend(names: Mapping[str, str], x: float) -> Iterator[Html]:
    for name, colour in names.items():
        text = _words(name)
        yield _text(x, 12, f"\u25cf {text}", "start", colour)
        x += 6.2 * len(text) + 24


def _panel(
    layout: Any, names: tuple[str, str], traces: list[Any], place: tuple[float, float]
) -> Html:
    """One pair of axes with its traces; `place` is the left margin and the height of the whole."""
    margin, height = place
    across, up = (layout[f"{name[0]}axis{name[1:]}"] for name in names)
    (x0, x1), (y0, y1) = (axis.domain or (0.0, 1.0) for axis in (across, up))
    width, tall = _WIDTH - margin - _RIGHT, height - _TOP - _BOTTOM
    left, right = margin + width * x0, margin + width * x1
    bottom, top = _TOP + tall * (1 - y0), _TOP + tall * (1 - y1)
    x = _axis(across, "x", traces, (left, right))
    y = _axis(up, "y", traces, (bottom, top))
    box = (left, top, right - left, max(bottom - top, 1.0))
    view = " ".join(f"{v:.1f}" for v in box)
    clip = _shape("svg", _inside(layout, traces, x, y), **_corners(box), viewBox=view)
    frame = _shape("rect", **_corners(box), fill="none", stroke="#888888", stroke_width=0.7)
    below = x.marks() if across.showticklabels is not False else []
    is_span = len(below) == 2 and not x.categories
    anchors = ["start", "end"] if is_span else ["middle"] * len(below)
    words = [
        _text(at, bottom + 12, s, anchor) for (at, s), anchor in zip(below, anchors, strict=True)
    ]
    if up.showticklabels is not False:
        words += [_text(left - 4, at + 4, s[:_LONGEST], "end") for at, s in y.marks()]
    words.append(_text((left + right) / 2, bottom + 25, x.title, "middle"))
    return join([clip, frame, *words, _text(left, top - 3, y.title, "start")])


def _inside(layout: Any, traces: list[Any], x: _Axis, y: _Axis) -> Html:
    """The traces; bars that would stand in one place stand beside one another."""
    bars = [t for t in traces if t.type == "bar"]
    places = [v for t in bars for v in (t.y if t.orientation == "h" else t.x)]
    if len(places) == len(set(places)) or layout.barmode not in (None, "group"):
        bars = []
    return join(
        _bars(t, x, y, (bars.index(t), len(bars))) if t in bars else _DRAWN[t.type](t, x, y)
        for t in traces
    )


def _axis(axis: Any, letter: str, traces: list[Any], pixels: tuple[float, float]) -> _Axis:
    values = [v for t in traces if t[letter] is not None for v in t[letter]]
    names = list(axis.categoryarray) if axis.categoryarray is not None else []
    if axis.type == "category" or any(isinstance(v, str) for v in values):
        names = list(dict.fromkeys([*names, *map(str, values)]))
    is_log = axis.type == "log"
    if names:
        low, high = -0.5, len(names) - 0.5
    elif axis.range is not None:
        low, high = map(float, axis.range)
    else:
        numbers = _numbers(values, {}, is_log)
        along = "h" if letter == "x" else "v"
        from_zero = any(t.type == "bar" and (t.orientation or "v") == along for t in traces)
        found = [*numbers[np.isfinite(numbers)], *([0.0] if from_zero and not is_log else [])]
        low, high = (min(found), max(found)) if found else (0.0, 1.0)
        spare = 0.04 * (high - low) or 0.5
        low, high = low - spare, high + spare
    if axis.autorange == "reversed":
        low, high = high, low
    texts = {}
    if axis.tickvals is not None and axis.ticktext is not None:
        texts = dict(zip(map(float, axis.tickvals), map(_words, axis.ticktext), strict=True))
    categories = {name: i for i, name in enumerate(names)}
    title = _words(axis.title.text or "")
    return _Axis(low, high, *pixels, is_log, categories, texts, title)


def _numbers(values: Any, categories: Mapping[str, int], is_log: bool) -> Array:
    """Values as places on a linear axis."""
    if categories:
        return np.array([categories.get(str(v), math.nan) for v in values], dtype=float)
    numbers = np.array(values, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log10(numbers) if is_log else numbers


def _scatter(trace: Any, x: _Axis, y: _Axis) -> Html:
    across, up = x.at(trace.x), y.at(trace.y)
    colour, mode = _colour(trace), trace.mode or "lines"
    parts = []
    if trace.fill:
        look = {"fill": trace.fillcolor or colour, "stroke": "none"}
        parts.append(_shape("polygon", points=_points(across, up), **look))
    elif "lines" in mode:
        dash = {"dash": "5 3", "dot": "2 3"}.get(trace.line.dash or "", "")
        width = min(float(trace.line.width or 1.5), 1.6)
        for a, b in _unbroken(across, up):
            kept = thinned(b, _MOST)
            look = {"points": _points(a[kept], b[kept]), "fill": "none", "stroke": colour}
            parts.append(_shape("polyline", **look, stroke_width=width, stroke_dasharray=dash))
    if "markers" in mode:
        size = trace.marker.size if isinstance(trace.marker.size, int | float) else 5
        places = [p for p in zip(across, up, strict=True) if all(map(math.isfinite, p))]
        for a, b in places[:: max(1, 2 * len(places) // _MOST)]:
            parts.append(_shape("circle", cx=a, cy=b, r=min(size / 2, 2.4), fill=colour))
    if trace.error_x.array is not None:
        for value, half, b in zip(trace.x, trace.error_x.array, up, strict=True):
            if half:
                x1, x2 = x.at([value - half, value + half])
                parts.append(_shape("line", x1=x1, x2=x2, y1=b, y2=b, stroke=colour))
    return join(parts)


def _bars(trace: Any, x: _Axis, y: _Axis, group: tuple[int, int] = (0, 1)) -> Html:
    """Bars from zero; `group` is which of how many that share their places."""
    is_flat = trace.orientation == "h"
    along, beside = (x, y) if is_flat else (y, x)
    values, places = (trace.x, trace.y) if is_flat else (trace.y, trace.x)
    ends, middles = along.at(values), beside.at(places)
    base = along.start if along.is_log else float(along.at([0.0])[0])
    apart = np.diff(np.unique(middles))
    thick = min(0.7 * float(apart.min()) if apart.size else 40.0, 40.0) / group[1]
    parts = []
    for end, middle in zip(ends, middles + thick * (group[0] - (group[1] - 1) / 2), strict=True):
        if math.isfinite(end) and math.isfinite(middle):
            low, size, edge = min(base, end), abs(end - base), middle - thick / 2
            box = (low, edge, size, thick) if is_flat else (edge, low, thick, size)
            parts.append(_shape("rect", **_corners(box), fill=_colour(trace)))
    return join(parts)


def _map(trace: Any, x: _Axis, y: _Axis) -> Html:
    z = np.array(trace.z, dtype=float)
    columns, rows = x.at(trace.x), y.at(trace.y)
    low = float(trace.zmin) if trace.zmin is not None else float(np.nanmin(z))
    high = float(trace.zmax) if trace.zmax is not None else float(np.nanmax(z))
    wide = abs(x.stop - x.start) / max(1, len(columns))
    tall = abs(y.stop - y.start) / max(1, len(rows))
    places = [float(at) for at, _ in trace.colorscale]
    colours = np.array([_rgb(colour) for _, colour in trace.colorscale])
    parts = []
    for i, j in np.argwhere(np.isfinite(z)):
        share = (z[i, j] - low) / ((high - low) or 1.0)
        r, g, b = (int(np.interp(share, places, channel)) for channel in colours.T)
        box = (columns[j] - wide / 2, rows[i] - tall / 2, wide, tall)
        parts.append(_shape("rect", **_corners(box), fill=f"rgb({r},{g},{b})"))
    return join(parts)


_DRAWN = {"scatter": _scatter, "scattergl": _scatter, "bar": _bars, "heatmap": _map}


def _unbroken(x: Array, y: Array) -> Iterator[tuple[Array, Array]]:
    """Stretches of a line between its gaps."""
    seen = np.isfinite(x) & np.isfinite(y)
    for a, b in zip(*stretches_of(seen), strict=True):
        yield x[a:b], y[a:b]


def _points(x: Array, y: Array) -> str:
    seen = np.isfinite(x) & np.isfinite(y)
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[seen], y[seen], strict=True))


def _colour(trace: Any) -> str:
    parts = (trace.marker, trace.line) if trace.type.startswith("scatter") else ()
    for part in (trace.marker,) if trace.type == "bar" else parts:
        if isinstance(part.color, str):
            return str(part.color)
    return "#444444"


def _rgb(colour: str) -> tuple[int, ...]:
    if colour.startswith("#"):
        return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return tuple(int(float(v)) for v in re.findall(r"[\d.]+", colour)[:3])


def _words(text: str) -> str:
    """Text of a figure without its breaks, tags and entities, of a length that fits."""
    words = html.unescape(re.sub(r"<[^>]*>", " ", str(text)))
    return words if len(words) <= 2 * _LONGEST else words[: 2 * _LONGEST - 1] + "\u2026"


def _corners(box: tuple[float, float, float, float]) -> dict[str, float]:
    return dict(zip(("x", "y", "width", "height"), map(float, box), strict=True))


def _shape(tag: str, content: str = "", /, **attributes: float | str) -> Html:
    given = {k: f"{v:.1f}" if isinstance(v, float) else str(v) for k, v in attributes.items()}
    return element(tag, content, **{k: v for k, v in given.items() if v})


def _text(x: float, y: float, text: str, anchor: str, colour: str = "currentColor") -> Html:
    place = {"x": f"{x:.1f}", "y": f"{y:.1f}", "text_anchor": anchor}
    return element("text", text, **place, font_size="10.5", fill=colour) if text else Html("")
