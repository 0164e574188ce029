"""The simulation error against states and inputs, and in frequency."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.estimation.estimate import RecordView
from casid.report.figures.panels import Panels
from casid.report.figures.record_views import (
    checked,
    drawn,
    finite,
    of_records,
    residual,
    simulations,
)
from casid.report.figures.style import FLOOR, axis_text, hover_text, translucent
from casid.report.figures.thinning import MOST_POINTS, points_a_trace, thinned

_SCATTER_POINTS = 800
_BINS = 24


def residual_against_figure(records: Sequence[RecordView]) -> Any:
    """What the simulation leaves over against every state and input: a missing effect has a shape.

    One panel for each output and signal, all records together: the mean in bins with its 95 % band,
    over a part of the samples. The band counts visits to a bin, not samples, since neighbouring
    samples are not independent: the cluster-robust variance of a mean, one cluster a visit (Liang &
    Zeger 1986, Biometrika 73, p. 13). Bins with fewer than four visits are left out.
    """
    views = checked(records)
    first = views[0]
    signals = [
        (name, unit, [v.x[:, i] for v in views])
        for i, (name, unit) in enumerate(zip(first.states, first.state_units, strict=True))
    ] + [
        (name, unit, [v.u[:, i] for v in views])
        for i, (name, unit) in enumerate(zip(first.inputs, first.input_units, strict=True))
    ]
    panels = [(row, s) for row in range(len(first.outputs)) for s in signals]
    if not panels:
        raise ValueError("the record views hold no state and no input to plot against")
    figure = Panels(panels=len(panels), columns=min(2, len(panels)), row_height=250, gap=70)
    points = min(_SCATTER_POINTS, max(100, MOST_POINTS // (8 * len(panels))))
    for k, (row, (name, unit, values)) in enumerate(panels):
        output, output_unit = first.outputs[row], first.output_units[row]
        signal = finite(np.concatenate(values))
        layers: list[list[dict[str, Any]]] = [[], []]
        spread = 0.0
        for j, (label, colour, dash, _) in enumerate(simulations(first)):
            e = np.concatenate([residual(v, simulations(v)[j][3], row) for v in views])
            seen = np.flatnonzero(np.isfinite(e) & np.isfinite(signal))
            some = seen[:: max(1, math.ceil(seen.size / points))]
            if some.size:
                spread = max(spread, float(np.quantile(np.abs(e[seen]), 0.99)))
            layers[0].append(_dots(signal[some], e[some], label, colour))
            layers[1] += _mean_band(signal, e, (label, colour, dash), hover_text(unit, output_unit))
        for trace in layers[0] + layers[1]:
            if len(trace["x"]):
                figure.add(k, **trace)
        if spread > 0:  # single outliers would flatten the means
            figure.y_range(k, [-1.3 * spread, 1.3 * spread])
        figure.label(k, x=axis_text(name, unit), y=axis_text(output, output_unit, "error of "))
    caption = of_records("Simulation error against each state and input", views, together=True)
    caption += (
        " Dots: part of the samples; lines: mean in bins with its 95 % band. A mean that leaves "
        "zero by more than its band has a shape to explain."
    )
    return figure.done(caption, ())


def _dots(x: Array, y: Array, label: str, colour: str) -> dict[str, Any]:
    """Trace of single samples."""
    return {
        "x": x,
        "y": y,
        "name": label,
        "in_legend": False,
        "mode": "markers",
        "marker": {"color": colour, "size": 3, "opacity": 0.22 if x.size > 200 else 0.6},
        "hoverinfo": "skip",
    }


def _mean_band(
    signal: Array, e: Array, look: tuple[str, str, str], hover: str
) -> list[dict[str, Any]]:
    """Traces of the mean in bins and of its 95 % band; `look` is label, colour and dash."""
    label, colour, dash = look
    centre, mean, half = _binned_mean(signal, e)
    return [
        {
            "x": np.concatenate([centre, centre[::-1]]),
            "y": np.concatenate([mean + half, (mean - half)[::-1]]),
            "name": label,
            "in_legend": False,
            "mode": "lines",
            "line": {"width": 0},
            "fill": "toself",
            "fillcolor": translucent(colour, 0.35),
            "hoverinfo": "skip",
        },
        {
            "x": centre,
            "y": mean,
            "name": label,
            "mode": "lines+markers",
            "line": {"color": colour, "width": 2, "dash": dash},
            "marker": {"size": 5},
            "hovertemplate": hover,
        },
    ]


def residual_spectrum_figure(
    records: Sequence[RecordView], noise_floor: Mapping[str, float] | None = None
) -> Any:
    """Amplitude density of what the simulation leaves over, before and after; one row an output.

    Welch's method: Hann windows, half overlapping, an eighth of the record each. Samples left out
    count as zero and the power is scaled up by their share. `noise_floor` (output -> rms)
    is drawn as the level of white noise with that rms.
    """
    from scipy.signal import welch

    views, left_out = drawn(records)
    outputs = views[0].outputs
    limit = points_a_trace(len(views) * len(outputs) * 2)
    figure = Panels(rows=len(outputs), row_height=260, gap=30, shared_x=True)
    for v in views:
        ts = float(np.median(np.diff(v.t))) if v.t.size > 1 else 1.0
        for row, (output, unit) in enumerate(zip(v.outputs, v.output_units, strict=True)):
            density_unit = f"({unit})/\u221aHz"
            own: dict[str, Any] = {"view": v, "hovertemplate": hover_text("Hz", density_unit)}
            frequency = np.empty(0)
            for label, colour, dash, simulated in simulations(v):
                e = residual(v, simulated, row)
                seen = np.isfinite(e)
                if seen.sum() < 16:
                    continue
                e = np.where(seen, e - np.mean(e[seen]), 0.0)
                length = min(e.size, max(64, e.size // 8))
                frequency, power = welch(e, fs=1 / ts, nperseg=length)
                with np.errstate(invalid="ignore"):
                    density = np.sqrt(np.where(power > 0, power / seen.mean(), np.nan))
                i = 1 + thinned(density[1:], limit)  # the mean is taken off: no density at zero
                figure.line(
                    row, frequency[i], density[i], label, colour, width=1.6, dash=dash, **own
                )
            floor = (noise_floor or {}).get(output)
            if floor is not None and math.isfinite(floor) and floor > 0 and frequency.size > 1:
                level, label = np.full(2, floor * math.sqrt(2 * ts)), "noise floor, were it white"
                figure.line(row, frequency[[1, -1]], level, label, FLOOR, dash="dash", **own)
            if v is views[0]:
                figure.label(row, y=axis_text(output, density_unit, "error of "))
        figure.parts(v, {"xaxis.autorange": True}, shaded=False)
    figure.log()
    figure.label(len(outputs) - 1, x="frequency [Hz]")
    caption = of_records("Amplitude density of the simulation error", views)
    return figure.done(caption + left_out, views)


def _binned_mean(signal: Array, e: Array) -> tuple[Array, Array, Array]:
    """Bin centres, mean of `e` and half its 95 % band, in equal bins of `signal`."""
    seen = np.isfinite(signal) & np.isfinite(e)
    nothing = np.empty(0)
    if seen.sum() < 4:
        return nothing, nothing, nothing
    low, high = np.quantile(signal[seen], [0.002, 0.998])
    if not high > low:
        low, high = low - 0.5, high + 0.5
    edges = np.linspace(low, high, _BINS + 1)
    inside = seen & (signal >= low) & (signal <= high)
    bins = np.where(inside, np.clip(np.searchsorted(edges, signal, "right") - 1, 0, _BINS - 1), -1)
    visit = np.concatenate([[0], np.cumsum(np.diff(bins) != 0)])
    centre, mean, half = [], [], []
    for b in range(_BINS):
        here = bins == b
        visits, number = np.unique(visit[here], return_inverse=True)
        if visits.size < 4:
            continue
        m = float(np.mean(e[here]))
        clusters = np.bincount(number, weights=e[here] - m)
        # G / (G - 1): the usual correction for few clusters
        error = math.sqrt(visits.size / (visits.size - 1) * float(clusters @ clusters)) / here.sum()
        centre.append((edges[b] + edges[b + 1]) / 2)
        mean.append(m)
        half.append(1.96 * error)
    return np.array(centre), np.array(mean), np.array(half)
