"""Parameters of estimates with their intervals, relative to the first estimate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from casid.estimation.estimate import Estimate, Estimated
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, BEFORE, FLOOR, MEASURED, figure_text, visible_text


def estimate_figure(estimate: Estimate) -> Any:
    """The parameters of one estimate."""
    return parameter_figure({"estimate": estimate})


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
    has_interval = {p.name for e in estimates.values() for p in e.parameters if _half(p)}
    rows = [p for p in free if p.value != 0 or p.name in has_interval]
    clear = [p for p in rows if not _is_about_zero(p)]
    rows = clear or rows  # relative to a value that may be zero a change says nothing
    if not rows:
        raise ValueError("the baseline has no free parameter to draw")
    scales = [_scale(p, estimates.values()) for p in rows]
    figure = Panels(rows=1, row_height=46 * len(rows) + 30, gap=0)
    looks = [(BEFORE, "circle-open"), (AFTER, "circle"), (FLOOR, "square"), (MEASURED, "diamond")]
    values: list[float] = []
    halves: list[float] = []
    several = len(estimates) > 1
    for j, (label, estimate) in enumerate(estimates.items()):
        look = looks[j % len(looks)] if several else looks[1]
        shift = 0.3 * (j - (len(estimates) - 1) / 2) / max(1, len(estimates) - 1)
        x, half = _add_estimate(figure, label, estimate, (rows, scales), shift, look)
        values += x
        halves += [h for h in half if math.isfinite(h)]
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
    figure.label(0, x="change from baseline [%]" if several else "interval [% of value]")
    caption = _caption(estimates, free, {p.name for p in rows})
    return figure.done(caption + " The longest intervals leave the axis." * is_cut, ())


def _add_estimate(
    figure: Panels,
    label: str,
    estimate: Estimate,
    drawn: tuple[Sequence[Estimated], Sequence[float]],
    shift: float,
    look: tuple[str, str],
) -> tuple[list[float], list[float]]:
    """Add the points of one estimate; returns them and their half intervals, both in per cent.

    `drawn` are the baseline's parameters with their scales, `shift` moves the points between the
    rows, `look` is colour and symbol.
    """
    colour, symbol = look
    found = {p.name: p for p in estimate.parameters if math.isfinite(p.value)}
    x: list[float] = []
    y: list[float] = []
    above: list[float] = []
    below: list[float] = []
    text: list[str] = []
    for i, (p, scale) in enumerate(zip(*drawn, strict=True)):
        if p.name not in found:
            continue
        q = found[p.name]
        interval = q.interval
        x.append(100 * (q.value - p.value) / scale)
        y.append(i + shift)
        above.append(100 * (interval[1] - q.value) / scale if interval else 0.0)
        below.append(100 * (q.value - interval[0]) / scale if interval else 0.0)
        text.append(figure_text(_with_interval(q), 90))
    outline = {"width": 2, "color": colour}
    figure.points(
        0,
        x,
        y,
        figure_text(label),
        {"color": colour, "size": 10, "symbol": symbol, "line": outline},
        error_x={
            "type": "data",
            "array": [h if math.isfinite(h) else None for h in above],
            **_lower_ends(above, below),
            "color": colour,
            "thickness": 2,
            "width": 5,
        },
        text=text,
        hovertemplate="%{text}<extra>%{fullData.name}</extra>",
    )
    return x, [max(a, b) for a, b in zip(above, below, strict=True)]


def _lower_ends(above: Sequence[float], below: Sequence[float]) -> dict[str, Any]:
    """What a bar needs whose ends are not alike."""
    if all(
        math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-12) for a, b in zip(above, below, strict=True)
    ):
        return {}
    ends = [b if math.isfinite(b) else None for b in below]
    return {"symmetric": False, "arrayminus": ends}


def _half(p: Estimated) -> float:
    """Half the length of an interval, 0 without one."""
    return 0.0 if p.interval is None else 0.5 * (p.interval[1] - p.interval[0])


def _is_about_zero(p: Estimated) -> bool:
    """True if the interval of a parameter holds zero."""
    return p.interval is not None and p.interval[0] < 0 < p.interval[1]


def _caption(estimates: Mapping[str, Estimate], free: Iterable[Estimated], drawn: set[str]) -> str:
    problem = visible_text(next(iter(estimates.values())).problem)
    if len(estimates) > 1:
        caption = (
            f"Parameters of {problem}, {' and '.join(map(str, estimates))}, with 95 % intervals, "
            "relative to the baseline value."
        )
    else:
        caption = f"95 % intervals of {problem} relative to each value."
    held = [p.name for p in free if p.interval is None]
    if held:
        caption += f" Without an interval: {', '.join(map(visible_text, held))} (see the table)."
    zero = [p.name for p in free if p.name not in drawn and _is_about_zero(p)]
    if zero:
        caption += f" Consistent with zero: {', '.join(map(visible_text, zero))} (see the table)."
    new = dict.fromkeys(
        p.name
        for e in estimates.values()
        for p in e.parameters
        if not p.known and p.name not in drawn.union(held, zero)
    )
    if new:
        caption += f" Not in the baseline: {', '.join(map(visible_text, new))} (see the table)."
    return caption


def _scale(baseline: Estimated, estimates: Iterable[Estimate]) -> float:
    if baseline.value != 0:
        return abs(baseline.value)
    sizes = [
        max(abs(q.value), _half(q))
        for e in estimates
        for q in e.parameters
        if q.name == baseline.name
    ]
    return max([s for s in sizes if math.isfinite(s) and s > 0], default=1.0)


def _with_interval(p: Estimated) -> str:
    interval = p.interval
    kind = "" if p.interval_kind == "quick" else f" ({p.interval_kind})"
    between = f", 95 % in {interval[0]:.4g} .. {interval[1]:.4g}{kind}" if interval else ""
    return f"{p.name} = {p.value:.5g} {p.unit}{between}{f' ({p.note})' if p.note else ''}"
