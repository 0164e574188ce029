"""Figures of unknown inputs: what was estimated, how surely, and where it holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.report.figures.style import AFTER, BEFORE, FLOOR, MEASURED, figure_text
from casid.report.figures.thinning import thinned
from casid.unknown_inputs.observers.input_estimate import InputEstimate
from casid.unknown_inputs.observers.noncausal_inverse import NoncausalInverse

_COLOURS = (AFTER, BEFORE, FLOOR, "#CC79A7")
_TWO_SIDED = 1.959964  # 95 % of a normal distribution


def input_figure(
    *estimates: InputEstimate,
    truth: Mapping[str, Array] | None = None,
    names: tuple[str, ...] = (),
) -> Any:
    """Estimates of unknown inputs as lines with 95 % bands, one row an input.

    Parameters
    ----------
    estimates : of the same inputs, by different methods say; all that share a name are drawn.
    truth : input -> (N,) values, drawn as points, where they are known from a simulation.
    names : of the estimates in the legend; their methods by default.

    Returns
    -------
    a Plotly figure
    """
    from plotly import graph_objects as go
    from plotly.subplots import make_subplots

    inputs = list(dict.fromkeys(i for e in estimates for i in e.inputs))
    figure = make_subplots(rows=len(inputs), cols=1, shared_xaxes=True)
    for row, name in enumerate(inputs, start=1):
        for k, e in enumerate(estimates):
            if name not in e.inputs:
                continue
            label = figure_text(names[k] if names else e.method)
            look = (_COLOURS[k % len(_COLOURS)], ("solid", "dash", "dot")[k % 3])
            for trace in _band_and_line(e, name, look):
                trace |= {"legendgroup": f"{k}", "showlegend": "name" in trace and row == 1}
                if "name" in trace:
                    trace["name"] = label
                figure.add_trace(go.Scatter(**trace), row=row, col=1)
        if truth is not None and name in truth:
            j = thinned(np.asarray(truth[name], dtype=float))
            figure.add_trace(
                go.Scatter(
                    x=estimates[0].t[j],
                    y=np.asarray(truth[name], dtype=float)[j],
                    mode="markers",
                    marker={"color": MEASURED, "size": 3},
                    name="true",
                    showlegend=row == 1,
                ),
                row=row,
                col=1,
            )
        unit = next((e.units[name] for e in estimates if name in e.units), "")
        axis = f"{figure_text(name)} [{figure_text(unit)}]" if unit else figure_text(name)
        figure.update_yaxes(title_text=axis, row=row, col=1)
    figure.update_xaxes(title_text="time t [s]", row=len(inputs), col=1)
    record = estimates[0].record
    caption = f"Unknown inputs of {record}: estimates and 95 % bands"
    _finish(figure, caption, 120 + 240 * len(inputs))
    return figure


def _band_and_line(e: InputEstimate, name: str, look: tuple[str, str]) -> Iterator[dict[str, Any]]:
    """Traces of an estimate: both edges of its 95 % band, then itself; `look` is colour, dash."""
    colour, dash = look
    value, sd = e[name], e.std_error(name)
    kept = np.where(np.isfinite(sd), value, np.nan)
    i = thinned(kept)
    half = _TWO_SIDED * np.where(np.isfinite(sd), sd, np.nan)[i]
    for edge, fill in ((half, None), (-half, "tonexty")):
        yield {
            "x": e.t[i],
            "y": kept[i] + edge,
            "line": {"width": 0},
            "fill": fill,
            "fillcolor": _faint(colour),
            "hoverinfo": "skip",
        }
    line = {"color": colour, "width": 1.5, "dash": dash}
    yield {"x": e.t[i], "y": kept[i], "line": line, "name": name}


def amplification_figure(
    inverse: NoncausalInverse, noise: Mapping[str, float], *, points: int = 400
) -> Any:
    """How the inverse amplifies noise by frequency: root of its spectrum in each input.

    Parameters
    ----------
    noise : output -> standard deviation of its white noise.
    """
    from plotly import graph_objects as go

    s = inverse.system
    top = np.pi / s.Ts
    w = np.geomspace(top / 2000, top, points)
    size = inverse.amplification(w, noise)
    figure = go.Figure()
    for i, name in enumerate(s.unknown):
        figure.add_trace(
            go.Scatter(
                x=w,
                y=size[:, i],
                name=figure_text(name),
                line={"color": _COLOURS[i % len(_COLOURS)]},
            )
        )
    for zero in inverse.zeros:
        at = abs(float(np.angle(zero))) / s.Ts
        if at > w[0]:
            figure.add_vline(x=at, line={"dash": "dot", "color": MEASURED})
    figure.update_xaxes(type="log", title_text="frequency w [rad/s]")
    unit = s.units.get(s.unknown[0], "")
    label = f"[{figure_text(unit)} sqrt(s)]" if unit and s.nu == 1 else "[unit sqrt(s)]"
    figure.update_yaxes(type="log", title_text=f"root of the noise's spectrum {label}")
    _finish(figure, f"Noise that the inverse of {s.name} makes; dotted: its zeros", 420)
    return figure


def _faint(colour: str) -> str:
    r, g, b = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({r},{g},{b},0.2)"


def _finish(figure: Any, caption: str, height: int) -> None:
    figure.update_layout(
        title={"text": figure_text(caption, 200), "font": {"size": 14}},
        template="plotly_white",
        height=height,
        meta={"caption": caption},
    )
