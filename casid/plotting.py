"""Figures of a result: what was measured, what the model says, what is left over.

Every function takes a result and returns a Plotly figure; nothing is estimated here but the
spectrum of what is left over, and nothing is shown. SI units, as recorded. A figure's caption
(claim and record) is its title and stands in `figure.layout.meta["caption"]` as plain text.

Names come from files: `figure_text` makes them harmless, since Plotly reads part of HTML in text.
"""

from __future__ import annotations

import html
import math
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.diagnosis import Diagnosis
from casid.estimate import Estimate, Estimated, RecordView

Array = NDArray[Any]

POINTS = 4000  # most points drawn in one trace
_POINTS_A_FIGURE = 60_000  # more, and a browser drags
_SCATTER_POINTS = 800
_SHOWN_CANDIDATES = 15
_LONGEST_BAR = 30.0  # of -log10 p: one overwhelming cause must not flatten the others
_BINS = 24

# Okabe & Ito (2008), told apart by colour-blind readers; dashes and hatching say the same again.
MEASURED = "#8c8c8c"
BEFORE = "#D55E00"
AFTER = "#0072B2"
FLOOR = "#009E73"
_LEFT_OUT = "#CC79A7"
_HELD_OUT = "rgba(86,180,233,0.13)"
_STATUS = {
    "named": (AFTER, ""),
    "cannot be rejected": ("#E69F00", "/"),
    "rejected": ("#8a8a8a", "x"),
    "not significant": ("#cfcfcf", ""),
    "invisible": ("#ffffff", "."),
}
_OTHER_STATUS = ("#F0E442", "-")
_FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, Helvetica, Arial, sans-serif"
_BIDI = frozenset("\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


def visible_text(text: object) -> str:
    """`text` without what a reader cannot see: control and direction marks, lone surrogates."""
    return "".join(
        " "
        if c in "\n\t\r"
        else "\ufffd"
        if c in _BIDI or unicodedata.category(c) in ("Cc", "Cs")
        else c
        for c in str(text)
    )


def figure_text(text: object, longest: int = 40) -> str:
    """`text` as Plotly shows it literally, cut at `longest`: no tag, entity or template works."""
    plain = visible_text(text)
    if len(plain) > longest:
        plain = plain[: longest - 1] + "\u2026"
    # Templates (%{x}) are filled in before entities are read, so the entity hides the sign.
    return html.escape(plain, quote=False).replace("%", "&#37;").replace("$", "&#36;")


def thinned(values: Array, limit: int = POINTS) -> Array:
    """Indices of at most about `limit` samples that keep every extreme of `values`.

    Parameters
    ----------
    values : (N,) array
        NaN and Inf count as gaps; a stretch of gaps stays a gap.
    limit : int
        Most indices wanted, 4 or more.

    Returns
    -------
    (M,) int array, increasing, M <= limit + 2
        All of them when N <= limit; else first and last sample, and the smallest and the largest of
        each of limit / 2 equal stretches, so that a spike of one sample stays in the figure.
    """
    n = values.size
    if n <= limit:
        return np.arange(n)
    width = math.ceil(n / (limit // 2))
    stretches = math.ceil(n / width)
    padded = np.full(stretches * width, np.nan)
    padded[:n] = np.where(np.isfinite(values), values, np.nan)
    blocks = padded.reshape(stretches, width)
    first = np.arange(stretches) * width
    low = first + np.argmin(np.where(np.isnan(blocks), np.inf, blocks), axis=1)
    high = first + np.argmax(np.where(np.isnan(blocks), -np.inf, blocks), axis=1)
    indices: Array = np.unique(np.concatenate([[0, n - 1], low, high]))
    return indices


# --- measured against simulated ---------------------------------------------------------------


def simulation_figure(result: Diagnosis | Sequence[RecordView]) -> Any:
    """Measured outputs as points, simulations before and after as lines.

    One row an output; several records are chosen from a menu below the figure. The held-out part is
    shaded. `result` is a diagnosis, or record views alone.

    Raises
    ------
    ValueError
        If there is no record.
    """
    views = _views(result)
    outputs = views[0].outputs
    limit = _limit(len(views) * len(outputs) * 3)
    caption = _of_records(
        "Measured outputs and free simulation"
        + (" before and after the extension" if views[0].extended is not None else ""),
        views,
    )
    figure = _Panels(rows=len(outputs), row_height=250, gap=22, shared_x=True)
    cut = False
    for v in views:
        ranges: dict[str, Any] = _time_range(v)
        for row, (output, unit) in enumerate(zip(v.outputs, v.output_units, strict=True)):
            measured, used = _finite(v.measured[:, row]), v.used[:, row]
            kept = np.where(used, measured, np.nan)
            i = thinned(kept, limit)
            figure.add(
                row,
                view=v,
                x=v.t[i],
                y=kept[i],
                name="measured",
                mode="markers",
                marker={"color": MEASURED, "size": 4.5},
                hovertemplate=_hover("s", unit),
            )
            left_out = ~used & np.isfinite(measured)
            if left_out.any():
                i = np.flatnonzero(left_out)
                i = i[thinned(measured[i], limit)]
                figure.add(
                    row,
                    view=v,
                    x=v.t[i],
                    y=measured[i],
                    name="measured, left out",
                    mode="markers",
                    marker={"color": _LEFT_OUT, "size": 7, "symbol": "x-thin-open"},
                    hovertemplate=_hover("s", unit),
                )
            for label, colour, dash, simulated in _simulations(v):
                y = _finite(simulated[:, row])
                i = thinned(y, limit)
                figure.add(
                    row,
                    view=v,
                    x=v.t[i],
                    y=y[i],
                    name=label,
                    mode="lines",
                    line={"color": colour, "width": 1.3, "dash": dash},
                    hovertemplate=_hover("s", unit),
                )
            span, is_cut = _range(kept, [s[:, row] for *_, s in _simulations(v)])
            cut = cut or is_cut
            axis = "yaxis" if row == 0 else f"yaxis{row + 1}"
            ranges[f"{axis}.range"] = span
            ranges[f"{axis}.autorange"] = span is None
            if v is views[0]:
                figure.label(row, y=_axis(output, unit))
                if span is not None:
                    figure.y_range(row, span)
        figure.parts(v, ranges)
    figure.time_range(views[0])
    figure.label(len(outputs) - 1, x="time [s]")
    if cut:
        caption += " The simulation leaves the range of the data: the axis is cut."
    return figure.done(caption + _thinning(views, limit), views)


def residual_time_figure(result: Diagnosis | Sequence[RecordView]) -> Any:
    """What the simulation leaves over against time, before and after; one row an output."""
    views = _views(result)
    outputs = views[0].outputs
    limit = _limit(len(views) * len(outputs) * 2)
    figure = _Panels(rows=len(outputs), row_height=230, gap=22, shared_x=True)
    for v in views:
        for row, (output, unit) in enumerate(zip(v.outputs, v.output_units, strict=True)):
            for label, colour, _, simulated in _simulations(v):
                e = _residual(v, simulated, row)
                i = thinned(e, limit)
                figure.add(
                    row,
                    view=v,
                    x=v.t[i],
                    y=e[i],
                    name=label,
                    mode="lines",
                    line={"color": colour, "width": 1.0},
                    hovertemplate=_hover("s", unit),
                )
            if v is views[0]:
                figure.label(row, y=_axis(output, unit, "error of "))
        figure.parts(v, _time_range(v))
    figure.time_range(views[0])
    figure.label(len(outputs) - 1, x="time [s]")
    caption = _of_records("Simulation error, measured minus simulated, against time", views)
    return figure.done(caption + _thinning(views, limit), views)


def residual_against_figure(result: Diagnosis | Sequence[RecordView]) -> Any:
    """What the simulation leaves over against every state and input: a missing effect has a shape.

    One panel for each output and signal, all records together: the mean in bins with its 95 % band,
    over a part of the samples. The band counts visits to a bin, not samples, since neighbouring
    samples are not independent: the cluster-robust variance of a mean, one cluster a visit (Liang &
    Zeger 1986, Biometrika 73, p. 13). Bins with fewer than four visits are left out.
    """
    views = _views(result)
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
    figure = _Panels(panels=len(panels), columns=min(2, len(panels)), row_height=250, gap=70)
    points = min(_SCATTER_POINTS, max(100, _POINTS_A_FIGURE // (8 * len(panels))))
    for k, (row, (name, unit, values)) in enumerate(panels):
        output, output_unit = first.outputs[row], first.output_units[row]
        signal = _finite(np.concatenate(values))
        layers: list[list[dict[str, Any]]] = [[], []]
        spread = 0.0
        for j, (label, colour, dash, _) in enumerate(_simulations(first)):
            e = np.concatenate([_residual(v, _simulations(v)[j][3], row) for v in views])
            seen = np.flatnonzero(np.isfinite(e) & np.isfinite(signal))
            some = seen[:: max(1, math.ceil(seen.size / points))]
            if some.size:
                spread = max(spread, float(np.quantile(np.abs(e[seen]), 0.99)))
            layers[0].append(
                {
                    "x": signal[some],
                    "y": e[some],
                    "name": label,
                    "in_legend": False,
                    "mode": "markers",
                    "marker": {
                        "color": colour,
                        "size": 3,
                        "opacity": 0.22 if some.size > 200 else 0.6,
                    },
                    "hoverinfo": "skip",
                }
            )
            centre, mean, half = _binned_mean(signal, e)
            layers[1] += [
                {
                    "x": np.concatenate([centre, centre[::-1]]),
                    "y": np.concatenate([mean + half, (mean - half)[::-1]]),
                    "name": label,
                    "in_legend": False,
                    "mode": "lines",
                    "line": {"width": 0},
                    "fill": "toself",
                    "fillcolor": _translucent(colour, 0.35),
                    "hoverinfo": "skip",
                },
                {
                    "x": centre,
                    "y": mean,
                    "name": label,
                    "mode": "lines+markers",
                    "line": {"color": colour, "width": 2, "dash": dash},
                    "marker": {"size": 5},
                    "hovertemplate": _hover(unit, output_unit),
                },
            ]
        for trace in layers[0] + layers[1]:
            if len(trace["x"]):
                figure.add(k, **trace)
        if spread > 0:  # single outliers would flatten the means
            figure.y_range(k, [-1.3 * spread, 1.3 * spread])
        figure.label(k, x=_axis(name, unit), y=_axis(output, output_unit, "error of "))
    caption = _of_records("Simulation error against each state and input", views, together=True)
    caption += (
        " Dots: part of the samples; lines: mean in bins with its 95 % band. A mean that leaves "
        "zero by more than its band has a shape to explain."
    )
    return figure.done(caption, ())


def residual_spectrum_figure(
    result: Diagnosis | Sequence[RecordView], noise_floor: Mapping[str, float] | None = None
) -> Any:
    """Amplitude density of what the simulation leaves over, before and after; one row an output.

    Welch's method: Hann windows, half overlapping, an eighth of the record each. Samples left out
    count as zero and the power is scaled up by their share. `noise_floor` (output -> rms; a
    diagnosis brings its own) is drawn as the level of white noise with that rms.
    """
    from scipy.signal import welch

    views = _views(result)
    if noise_floor is None and isinstance(result, Diagnosis):
        noise_floor = _noise_floor(result)
    outputs = views[0].outputs
    figure = _Panels(rows=len(outputs), row_height=260, gap=30, shared_x=True)
    for v in views:
        ts = float(np.median(np.diff(v.t))) if v.t.size > 1 else 1.0
        for row, (output, unit) in enumerate(zip(v.outputs, v.output_units, strict=True)):
            density_unit = f"({unit})/\u221aHz"
            frequency = np.empty(0)
            for label, colour, dash, simulated in _simulations(v):
                e = _residual(v, simulated, row)
                seen = np.isfinite(e)
                if seen.sum() < 16:
                    continue
                e = np.where(seen, e - np.mean(e[seen]), 0.0)
                length = min(e.size, max(64, e.size // 8))
                frequency, power = welch(e, fs=1 / ts, nperseg=length)
                with np.errstate(invalid="ignore"):
                    density = np.sqrt(np.where(power > 0, power / seen.mean(), np.nan))
                i = 1 + thinned(density[1:], POINTS)  # the mean is taken off: no density at zero
                figure.add(
                    row,
                    view=v,
                    x=frequency[i],
                    y=density[i],
                    name=label,
                    mode="lines",
                    line={"color": colour, "width": 1.6, "dash": dash},
                    hovertemplate=_hover("Hz", density_unit),
                )
            floor = (noise_floor or {}).get(output)
            if floor is not None and math.isfinite(floor) and floor > 0 and frequency.size > 1:
                figure.add(
                    row,
                    view=v,
                    x=frequency[[1, -1]],
                    y=np.full(2, floor * math.sqrt(2 * ts)),
                    name="noise floor, were it white",
                    mode="lines",
                    line={"color": FLOOR, "width": 2, "dash": "dash"},
                    hovertemplate=_hover("Hz", density_unit),
                )
            if v is views[0]:
                figure.label(row, y=_axis(output, density_unit, "error of "))
        figure.parts(v, {"xaxis.autorange": True}, shaded=False)
    figure.log()
    figure.label(len(outputs) - 1, x="frequency [Hz]")
    return figure.done(_of_records("Amplitude density of the simulation error", views), views)


# --- candidates, parameters, gain ---------------------------------------------------------------


def ranking_figure(diagnosis: Diagnosis) -> Any:
    """The catalogue's candidates as the first round ranked them: evidence and gain.

    Bars of -log10 of the family-wise p-value with the threshold of the false-alarm rate, and the
    fall of the criterion where a candidate was refitted. Invisible candidates are left to the
    report's table.

    Raises
    ------
    ValueError
        If no candidate was ranked.
    """
    ranked = [r for r in diagnosis.ranking if r.status != "invisible"]
    if not ranked:
        raise ValueError("no candidate was ranked, so there is nothing to draw")
    shown = ranked[:_SHOWN_CANDIDATES]
    figure = _Panels(panels=2, columns=2, row_height=34 * len(shown) + 20, gap=70, column_gap=0.04)
    evidence = [_evidence(r.adjusted) for r in shown]
    longest = max([*evidence, 1.0])
    gains = [r.gain if r.gain is not None and math.isfinite(r.gain) else None for r in shown]
    known = [g for g in gains if g is not None]
    for status in dict.fromkeys(r.status for r in shown):
        colour, pattern = _STATUS.get(status, _OTHER_STATUS)
        rows = [i for i, r in enumerate(shown) if r.status == status]
        style: dict[str, Any] = {
            "name": figure_text(status),
            "orientation": "h",
            "width": 0.62,
            "marker": {
                "color": colour,
                "line": {"color": "#444444", "width": 0.8},
                "pattern": {
                    "shape": pattern,
                    "fgcolor": "#333333",
                    "size": 6,
                    "fillmode": "overlay",
                },
            },
        }
        figure.add(
            0,
            kind="Bar",
            y=rows,
            x=[evidence[i] for i in rows],
            customdata=[figure_text(f"{shown[i].kind} in {shown[i].where}", 80) for i in rows],
            hovertemplate="%{customdata}<br>%{x:.3g}<extra></extra>",
            **style,
        )
        figure.add(
            1,
            kind="Bar",
            y=rows,
            x=[gains[i] or 0.0 for i in rows],
            customdata=[figure_text(f"{shown[i].kind} in {shown[i].where}", 80) for i in rows],
            hovertemplate="%{customdata}<br>%{x:.4g}<extra></extra>",
            **style,
        )
    threshold = -math.log10(diagnosis.false_alarm_rate) if diagnosis.false_alarm_rate > 0 else None
    for k, x, text in (
        (0, [max(e, threshold or 0.0) for e in evidence], [p_text(r.adjusted) for r in shown]),
        (
            1,
            [max(g or 0.0, 0.0) for g in gains],
            ["not refitted" if g is None else f"{g:.3g}" for g in gains],
        ),
    ):
        figure.add(
            k,
            in_legend=False,
            name="numbers",
            x=x,
            y=list(range(len(shown))),
            text=[f"\u2002{figure_text(t)}" for t in text],
            mode="text",
            textposition="middle right",
            cliponaxis=False,
            hoverinfo="skip",
        )
    labels = [
        f"{figure_text(r.kind, 26)}<br>{figure_text(r.where, 14)}: {figure_text(r.status, 20)}"
        for r in shown
    ]
    figure.figure.update_yaxes(
        tickvals=list(range(len(shown))),
        ticktext=labels,
        range=[len(shown) - 0.4, -0.6],
        showgrid=False,
        zeroline=False,
        tickfont={"size": 11},
    )
    figure.figure.update_yaxes(showticklabels=False, row=1, col=2)
    figure.x_range(0, [0, 1.4 * longest])
    low, high = min([*known, 0.0]), max([*known, 0.0])
    room = (high - low) or 1.0
    figure.x_range(1, [low - (0.35 * room if low < 0 else 0), high + 0.45 * room])
    if threshold is not None:
        figure.figure.add_shape(
            type="line",
            x0=threshold,
            x1=threshold,
            y0=0,
            y1=1,
            xref="x",
            yref="y domain",
            line={"color": "#555555", "width": 1.5, "dash": "dash"},
            layer="below",
        )
    figure.ticks = 5
    figure.label(0, x="-log10 of family-wise p")
    figure.label(1, x="fall of criterion after refit")
    caption = f"Candidates for {visible_text(diagnosis.problem)} by evidence and gain."
    if threshold is not None:
        caption += (
            f" Dashed line: false-alarm rate {diagnosis.false_alarm_rate:.2g} for the whole "
            "catalogue."
        )
    if any(_exponent(r.adjusted) > _LONGEST_BAR for r in shown):
        caption += f" Bars are cut at {_LONGEST_BAR:g}."
    if len(ranked) > len(shown):
        caption += f" The first {len(shown)} of {len(ranked)}."
    figure.figure.update_layout(showlegend=False)  # every row says its status
    return figure.done(caption, ())


def parameter_figure(estimates: Mapping[str, Estimate]) -> Any:
    """Parameters with 95 % intervals, as change from the first estimate's value in per cent.

    `estimates` maps a label ("before", "after") to an estimate; the first is the baseline. One row
    for each parameter that is free in the baseline. Where its value is zero, the scale is the
    largest value or half interval instead, and the row says so. Parameters that only later
    estimates have are not drawn: they have no baseline value to relate to.

    Raises
    ------
    ValueError
        If there is no estimate, or no free parameter in the first.
    """
    if not estimates:
        raise ValueError("no estimate to draw: pass a mapping of label to Estimate")
    baseline = next(iter(estimates.values()))
    free = [p for p in baseline.parameters if not p.known and math.isfinite(p.value)]
    has_interval = {p.name for e in estimates.values() for p in e.parameters if p.std_error}
    rows = [p for p in free if p.value != 0 or p.name in has_interval]
    if not rows:
        raise ValueError("the baseline has no free parameter to draw")
    scales = [_scale(p, estimates.values()) for p in rows]
    figure = _Panels(rows=1, row_height=46 * len(rows) + 30, gap=0)
    values: list[float] = []
    halves: list[float] = []
    looks = [(BEFORE, "circle-open"), (AFTER, "circle"), (FLOOR, "square"), (MEASURED, "diamond")]
    for j, (label, estimate) in enumerate(estimates.items()):
        colour, symbol = looks[j % len(looks)]
        if len(estimates) == 1:
            colour, symbol = looks[1]
        found = {p.name: p for p in estimate.parameters if math.isfinite(p.value)}
        shift = 0.3 * (j - (len(estimates) - 1) / 2) / max(1, len(estimates) - 1)
        x: list[float] = []
        y: list[float] = []
        half: list[float] = []
        text: list[str] = []
        for i, (p, scale) in enumerate(zip(rows, scales, strict=True)):
            if p.name not in found:
                continue
            q = found[p.name]
            interval = q.interval
            x.append(100 * (q.value - p.value) / scale)
            y.append(i + shift)
            half.append(50 * (interval[1] - interval[0]) / scale if interval else 0.0)
            text.append(figure_text(_with_interval(q), 90))
        values += x
        halves += [h for h in half if math.isfinite(h)]
        figure.add(
            0,
            x=x,
            y=y,
            name=figure_text(label),
            mode="markers",
            marker={
                "color": colour,
                "size": 10,
                "symbol": symbol,
                "line": {"width": 2, "color": colour},
            },
            error_x={
                "type": "data",
                "array": [h if math.isfinite(h) else None for h in half],
                "color": colour,
                "thickness": 2,
                "width": 5,
            },
            text=text,
            hovertemplate="%{text}<extra>%{fullData.name}</extra>",
        )
    reach = max((abs(v) + h for v, h in zip(values, halves, strict=False)), default=1.0)
    sensible = 1.5 * max(abs(v) for v in values) + 6 * float(np.median(halves or [0.0]))
    is_cut = reach > sensible > 0
    limit = 1.12 * (sensible if is_cut else reach) or 1.0
    figure.x_range(0, [-limit, limit])
    figure.figure.update_yaxes(
        tickvals=list(range(len(rows))),
        ticktext=[
            f"{figure_text(p.name, 20)}<br>"
            + (f"{p.value:.4g}" if p.value != 0 else f"0, scale {scale:.3g}")
            + f" {figure_text(p.unit, 14)}"
            for p, scale in zip(rows, scales, strict=True)
        ],
        range=[len(rows) - 0.5, -0.5],
        zeroline=False,
        tickfont={"size": 12},
    )
    figure.label(0, x="change from baseline [%]" if len(estimates) > 1 else "interval [% of value]")
    if len(estimates) > 1:
        caption = (
            f"Parameters of {visible_text(baseline.problem)}, {' and '.join(map(str, estimates))}, "
            "with 95 % intervals, relative to the baseline value."
        )
    else:
        caption = f"95 % intervals of {visible_text(baseline.problem)} relative to each value."
    held = [p.name for p in free if p.std_error is None]
    if held:
        caption += f" Without an interval: {', '.join(map(visible_text, held))} (see the table)."
    drawn = {p.name for p in rows}
    new = dict.fromkeys(
        p.name
        for e in estimates.values()
        for p in e.parameters
        if not p.known and p.name not in drawn | set(held)
    )
    if new:
        caption += f" Not in the baseline: {', '.join(map(visible_text, new))} (see the table)."
    if is_cut:
        caption += " The longest intervals leave the axis."
    return figure.done(caption, ())


def gain_figure(diagnosis: Diagnosis) -> Any:
    """Root mean square error before and after and the noise floor, fitted and held out.

    One panel an output, in the output's own unit.

    Raises
    ------
    ValueError
        If the diagnosis holds no rms error.
    """
    parts = {"fitted": diagnosis.fitted, "held out": diagnosis.held_out}
    outputs = list(
        dict.fromkeys(o for part in parts.values() for o in part.get("baseline_rmse", {}))
    )
    if not outputs:
        raise ValueError("the diagnosis holds no rms error to draw")
    units = output_units(diagnosis)
    figure = _Panels(panels=len(outputs), columns=min(2, len(outputs)), row_height=260, gap=50)
    looks = [
        ("baseline_rmse", "before" if diagnosis.extended else "simulated", BEFORE, ""),
        ("extended_rmse", "after", AFTER, ""),
        ("noise_floor", "noise floor", FLOOR, "/"),
    ]
    for k, output in enumerate(outputs):
        top = 0.0
        for key, label, colour, pattern in looks:
            found = {
                name: float(part[key][output])
                for name, part in parts.items()
                if output in part.get(key, {}) and math.isfinite(part[key][output])
            }
            if not found:
                continue
            top = max(top, *found.values())
            figure.add(
                k,
                kind="Bar",
                x=list(found),
                y=list(found.values()),
                name=label,
                text=[f"{v:.3g}" for v in found.values()],
                textposition="outside",
                constraintext="none",
                cliponaxis=False,
                marker={
                    "color": colour,
                    "pattern": {"shape": pattern, "fgcolor": "#ffffff", "fillmode": "overlay"},
                },
                hovertemplate=f"%{{y:.4g}} {figure_text(units.get(output, ''))}",
            )
        if top > 0:
            figure.y_range(k, [0, 1.18 * top])
        figure.label(k, y=_axis(output, units.get(output, ""), "rms of "))
    figure.figure.update_xaxes(type="category", categoryarray=list(parts), categoryorder="array")
    figure.figure.update_layout(bargap=0.25)
    caption = f"Root mean square simulation error of {visible_text(diagnosis.problem)}"
    caption += ", before and after the extension" if diagnosis.extended else ""
    return figure.done(caption + ", against the noise floor where it is known.", ())


def diagnosis_figures(diagnosis: Diagnosis) -> dict[str, Any]:
    """Every figure that the diagnosis has content for, by name, in the order of the report."""
    figures: dict[str, Any] = {}
    if diagnosis.records:
        figures["simulation"] = simulation_figure(diagnosis)
        figures["residual_time"] = residual_time_figure(diagnosis)
        if diagnosis.records[0].states or diagnosis.records[0].inputs:
            figures["residual_against"] = residual_against_figure(diagnosis)
        figures["residual_spectrum"] = residual_spectrum_figure(diagnosis)
    if any(r.status != "invisible" for r in diagnosis.ranking):
        figures["ranking"] = ranking_figure(diagnosis)
    if any(not p.known and math.isfinite(p.value) for p in diagnosis.baseline.parameters):
        figures["parameters"] = parameter_figure(before_and_after(diagnosis))
    if any(p.get("baseline_rmse") for p in (diagnosis.fitted, diagnosis.held_out)):
        figures["gain"] = gain_figure(diagnosis)
    return figures


def before_and_after(diagnosis: Diagnosis) -> dict[str, Estimate]:
    """The diagnosis' estimates by label."""
    if diagnosis.extended is None:
        return {"baseline": diagnosis.baseline}
    return {"before": diagnosis.baseline, "after": diagnosis.extended}


def output_units(diagnosis: Diagnosis) -> dict[str, str]:
    """Unit of every output that a record or the baseline names."""
    units = {str(k): str(v) for k, v in diagnosis.baseline.units.items()}
    for v in diagnosis.records:
        units |= dict(zip(v.outputs, v.output_units, strict=True))
    return units


def p_text(p: float) -> str:
    """A p-value as text."""
    if not math.isfinite(p):
        return "\u2013"
    if p <= 1e-300:
        return "< 1e-300"
    return f"{p:.2g}" if p >= 1e-3 else f"{p:.0e}"


# --- how the figures are put together ------------------------------------------------------------


class _Panels:
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
        """Add a trace to panel k; each name stands once in the legend, for every record."""
        import plotly.graph_objects as go

        owner = len(self.menu) if view is not None else 0
        name = str(trace["name"])
        first = in_legend and (owner, name) not in self.legend
        if in_legend:
            self.legend.add((owner, name))
        self.owners.append(owner)
        trace |= {"legendgroup": name, "showlegend": first, "visible": owner == 0}
        self.figure.add_trace(getattr(go, kind)(**trace), **self._at(k))

    def label(self, k: int, *, x: str | None = None, y: str | None = None) -> None:
        if x is not None:
            self.has_x_label = True
            self.figure.update_xaxes(title_text=x, **self._at(k))
        if y is not None:
            self.figure.update_yaxes(title_text=y, **self._at(k))

    def x_range(self, k: int, span: list[float]) -> None:
        self.figure.update_xaxes(range=span, **self._at(k))

    def y_range(self, k: int, span: list[float]) -> None:
        self.figure.update_yaxes(range=span, **self._at(k))

    def time_range(self, view: RecordView) -> None:
        span = _time_range(view)["xaxis.range"]
        if span is not None:
            self.figure.update_xaxes(range=span)

    def log(self) -> None:
        """Make all axes logarithmic; digits between the decades only where decades are few."""
        for axis, update in (("x", self.figure.update_xaxes), ("y", self.figure.update_yaxes)):
            values = np.concatenate([[], *(np.asarray(t[axis], float) for t in self.figure.data)])
            values = values[np.isfinite(values) & (values > 0)]
            few = not values.size or values.max() < 80 * values.min()
            update(
                type="log",
                exponentformat="power",
                dtick="D2" if few else 1,
                minor={"dtick": "D1", "showgrid": True, "gridcolor": "#f3f3f3"},
            )
        self.is_log = True

    def parts(self, view: RecordView, layout: dict[str, Any], *, shaded: bool = True) -> None:
        """Close the traces of one record: what its menu entry sets besides their visibility."""
        self.menu.append((view, _part_shapes(view) if shaded else [], layout))

    def done(self, caption: str, views: Sequence[RecordView]) -> Any:
        """Style, caption and menu; returns the figure."""
        several = len(views) > 1
        title = wrap(caption, 100)
        top = 18 * len(title) + 62
        bottom = 100 if several else 54 if self.has_x_label else 34
        axis = {
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
        self.figure.update_xaxes(
            title_standoff=6,
            tickangle=0,
            **({"nticks": self.ticks} if not self.is_log else {}),
            **axis,
        )
        self.figure.update_yaxes(title_standoff=8, **axis)
        self.figure.update_layout(
            template="none",
            font={"family": _FONT, "size": 13, "color": "#222222"},
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
            legend={
                "orientation": "h",
                "x": 0,
                "xanchor": "left",
                "y": 1.0,
                "yanchor": "bottom",
                "itemsizing": "constant",
                "font": {"size": 13},
            },
            meta={
                "caption": caption,
                "panels": self.panels,
                "columns": self.columns,
                "row_height": self.row_height,
                "gap": self.gap,
                "bottom": bottom,
            },
        )
        if self.menu:
            self.figure.update_layout(shapes=self.menu[0][1])
        if several:
            self.figure.update_layout(
                updatemenus=[
                    {
                        "type": "dropdown",
                        "direction": "up",
                        "x": 0,
                        "xanchor": "left",
                        "y": 0,
                        "yanchor": "top",
                        "pad": {"t": 52},
                        "bgcolor": "#ffffff",
                        "bordercolor": "#888888",
                        "buttons": [
                            {
                                "label": figure_text(f"record: {view.name}", 26),
                                "method": "update",
                                "args": [
                                    {"visible": [owner == i for owner in self.owners]},
                                    {"shapes": shapes, **layout},
                                ],
                            }
                            for i, (view, shapes, layout) in enumerate(self.menu)
                        ],
                    }
                ]
            )
        return self.figure


def _views(result: Diagnosis | Sequence[RecordView]) -> tuple[RecordView, ...]:
    views = tuple(result.records if isinstance(result, Diagnosis) else result)
    if not views:
        raise ValueError("the result holds no record to draw; make it with records kept")
    return views


def _simulations(view: RecordView) -> list[tuple[str, str, str, Array]]:
    """Label, colour, dash and (N, ny) values of each simulation."""
    if view.extended is None:
        return [("simulated", BEFORE, "solid", view.baseline)]
    return [
        ("before", BEFORE, "dot", view.baseline),
        ("after", AFTER, "solid", view.extended),
    ]


def _finite(values: Array) -> Array:
    found: Array = np.where(np.isfinite(values), values, np.nan)
    return found


def _residual(view: RecordView, simulated: Array, column: int) -> Array:
    """Measured minus simulated, NaN where the sample is left out."""
    with np.errstate(over="ignore", invalid="ignore"):
        e = view.measured[:, column] - simulated[:, column]
    return _finite(np.where(view.used[:, column], e, np.nan))


def _time_range(view: RecordView) -> dict[str, Any]:
    """The record from end to end, as its menu entry sets it."""
    span = [float(view.t[0]), float(view.t[-1])] if view.t.size > 1 else None
    return {"xaxis.range": span, "xaxis.autorange": span is None}


def _range(measured: Array, simulated: Sequence[Array]) -> tuple[list[float] | None, bool]:
    """An axis range that keeps the data readable when a simulation runs away; None: automatic."""
    data = measured[np.isfinite(measured)]
    runs = np.concatenate([s[np.isfinite(s)] for s in simulated]) if simulated else np.empty(0)
    if not data.size or not runs.size:
        return None, False
    low, high = float(data.min()), float(data.max())
    span = (high - low) or abs(high) or 1.0
    low, high = low - 2 * span, high + 2 * span
    is_cut = bool(runs.min() < low - span or runs.max() > high + span)
    return ([low, high], True) if is_cut else (None, False)


def _part_shapes(view: RecordView) -> list[dict[str, Any]]:
    """A shaded, labelled stretch for every held-out part, a label for every fitted one."""
    if not view.t.size:
        return []
    edges = np.flatnonzero(np.diff(view.fitted.astype(np.int8))) + 1
    shapes = []
    for a, b in zip([0, *edges.tolist()], [*edges.tolist(), view.t.size], strict=True):
        is_fitted = bool(view.fitted[a])
        shapes.append(
            {
                "type": "rect",
                "xref": "x",
                "yref": "paper",
                "x0": float(view.t[a]),
                "x1": float(view.t[min(b, view.t.size - 1)]),
                "y0": 0,
                "y1": 1,
                "layer": "below",
                "line": {"width": 0},
                "fillcolor": "rgba(0,0,0,0)" if is_fitted else _HELD_OUT,
                "label": {
                    "text": "fitted" if is_fitted else "held out",
                    "textposition": "top left",
                    "font": {"size": 12, "color": "#444444"},
                },
            }
        )
    return shapes


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


def _noise_floor(diagnosis: Diagnosis) -> Mapping[str, float]:
    return diagnosis.held_out.get("noise_floor") or diagnosis.fitted.get("noise_floor") or {}


def _exponent(p: float) -> float:
    return -math.log10(max(p, 1e-300)) if math.isfinite(p) else 0.0


def _evidence(p: float) -> float:
    return min(max(_exponent(p), 0.0), _LONGEST_BAR)


def _scale(baseline: Estimated, estimates: Iterable[Estimate]) -> float:
    if baseline.value != 0:
        return abs(baseline.value)
    sizes = [
        max(abs(q.value), 1.96 * (q.std_error or 0.0))
        for e in estimates
        for q in e.parameters
        if q.name == baseline.name
    ]
    return max([s for s in sizes if math.isfinite(s) and s > 0], default=1.0)


def _with_interval(p: Estimated) -> str:
    interval = p.interval
    between = f", 95 % in {interval[0]:.4g} .. {interval[1]:.4g}" if interval else ""
    return f"{p.name} = {p.value:.5g} {p.unit}{between}{f' ({p.note})' if p.note else ''}"


def _axis(name: str, unit: str, before: str = "") -> str:
    """Axis title: name and unit, on two lines where one would not fit a panel."""
    text = before + figure_text(name, 22)
    if not unit:
        return text
    between = "<br>" if len(name) + len(unit) > 20 else " "
    return f"{text}{between}[{figure_text(unit, 22)}]"


def _hover(x_unit: str, y_unit: str) -> str:
    return f"%{{x:.5g}} {figure_text(x_unit)}, %{{y:.4g}} {figure_text(y_unit)}"


def _translucent(colour: str, alpha: float) -> str:
    r, g, b = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},{alpha})"


def _limit(traces: int) -> int:
    return max(800, min(POINTS, _POINTS_A_FIGURE // max(1, traces)))


def _thinning(views: Sequence[RecordView], limit: int) -> str:
    longest = max(v.t.size for v in views)
    if longest <= limit:
        return ""
    return (
        f" Thinned for drawing from {longest} samples to about {limit} points a curve; "
        "every peak is kept."
    )


def _of_records(claim: str, views: Sequence[RecordView], *, together: bool = False) -> str:
    if len(views) == 1:
        return f"{claim}, record {visible_text(views[0].name)}."
    if together:
        return f"{claim}, {len(views)} records together."
    return f"{claim}; choose one of {len(views)} records below the figure."
