"""A fleet over time: which asset shows which cause when, and where its parameters go."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.fleets.findings import Finding, Key
from casid.fleets.fleet import Fleet, words_of
from casid.fleets.fleet_table import column
from casid.fleets.random_effects import ParameterEffects
from casid.report.figures.panels import Panels
from casid.report.figures.style import (
    AFTER,
    BEFORE,
    MEASURED,
    axis_text,
    figure_text,
    short_label,
    translucent,
    visible_text,
)

_ROWS = 40  # of the heat map
_BINS = 48  # of its time, where there are more records of an asset than that
_LINES = 40  # of assets in one panel


def fleet_figures(fleet: Fleet) -> dict[str, Any]:
    """The figures that there is something to draw of, by name."""
    out = {}
    if fleet.findings:
        out["causes"] = cause_figure(fleet)
    if fleet.effects:
        out["parameters"] = trend_figure(fleet)
    return out


def cause_figure(fleet: Fleet) -> Any:
    """Asset and cause over time: the share of the records that show it.

    Raises
    ------
    ValueError
        If there is no finding.
    """
    if not fleet.findings:
        raise ValueError("no record shows a cause, so there is nothing to draw")
    rows: dict[tuple[str, Key], list[Finding]] = {}
    for f in fleet.findings:
        rows.setdefault((f.asset, f.key), []).append(f)
    shown = list(rows.items())[:_ROWS]
    edges = _edges(fleet)
    z = [_shares(fleet, asset, found, edges) for (asset, _), found in shown]
    names = [
        f"{figure_text(asset, 30)}<br>"
        f"<sub>{short_label(words_of(fleet, key)).replace(', ', '<br>')}</sub>"
        for (asset, key), _ in shown
    ]
    figure = Panels(panels=1, row_height=38 * len(shown) + 30, gap=40)
    figure.add(
        0,
        kind="Heatmap",
        x=_times(fleet, edges),
        y=names,
        z=np.array(z, dtype=float),
        zmin=0.0,
        zmax=1.0,
        colorscale=[[0.0, translucent(AFTER, 0.06)], [1.0, AFTER]],
        xgap=1,
        ygap=2,
        showscale=False,
        name="share of the records",
        hovertemplate="%{y}<br>from %{x}: %{z:.0%} of its records<extra></extra>",
    )
    figure.figure.update_yaxes(autorange="reversed", type="category")
    figure.label(0, x="time" if fleet.is_dated else "time or order of the records")
    figure.figure.update_layout(showlegend=False)
    figure.ticks = 4
    more = f" The first {_ROWS} of {len(rows)}." if len(rows) > _ROWS else ""
    caption = (
        "Share of an asset's records that show a cause, dark: all of them; white: it has no record "
        f"there.{more}"
    )
    return figure.done(caption, ())


def trend_figure(fleet: Fleet) -> Any:
    """Each parameter over time: the fleet with its 95 % band, and every asset's own trend."""
    columns = min(2, len(fleet.effects))
    figure = Panels(panels=len(fleet.effects), columns=columns, row_height=250, gap=74)
    when = column(fleet.records, "when")
    for k, effect in enumerate(fleet.effects):
        _trends(figure, k, fleet, effect, when)
    figure.ticks = 4
    caption = (
        f"Parameters of {visible_text(fleet.problem)} over time: the fleet with the 95 % band of "
        "its mean, and each asset's shrunk trend; dashed where its drift differs from the fleet's "
        "(p below 0.01)."
    )
    return figure.done(caption, ())


def _edges(fleet: Fleet) -> Array:
    """Ends of the bins of time: no more of them than records of the most recorded asset."""
    when = column(fleet.records, "when")
    most = int(fleet.records.groupby("asset").size().max())
    bins = max(1, min(_BINS, most))
    low, high = float(when.min()), float(when.max())
    return np.linspace(low, high if high > low else low + 1.0, bins + 1)


def _shares(fleet: Fleet, asset: str, found: list[Finding], edges: Array) -> list[float | None]:
    rows = fleet.records[fleet.records["asset"] == asset]
    numbers = {n for f in found for n in f.records}
    shows = rows["number"].isin(numbers).to_numpy(float)
    bins = np.clip(
        np.searchsorted(edges, column(rows, "when"), side="right") - 1, 0, len(edges) - 2
    )
    count = np.bincount(bins, minlength=len(edges) - 1)
    sums = np.bincount(bins, weights=shows, minlength=len(edges) - 1)
    return [float(s / n) if n else None for s, n in zip(sums, count, strict=True)]


def _times(fleet: Fleet, when: Array) -> list[Any]:
    if not fleet.is_dated:
        return [float(t) for t in when]
    return [str(np.datetime64(round(t), "s")) for t in when.tolist()]


def _trends(figure: Panels, k: int, fleet: Fleet, effect: ParameterEffects, when: Array) -> None:
    ends = np.array([when.min(), when.max()])
    drifts = math.isfinite(effect.drift)
    for asset in effect.assets[:_LINES]:
        mine = column(fleet.records[fleet.records["asset"] == asset.asset], "when")
        own = np.array([mine.min(), mine.max()])
        middle = float(mine.mean())
        slope = asset.drift / effect.unit_of_time if drifts else 0.0
        differs = asset.p_value < 0.01
        name = "an asset that drifts otherwise" if differs else "an asset"
        figure.line(
            k,
            _times(fleet, own),
            asset.mean + slope * (own - middle),
            name,
            BEFORE if differs else MEASURED,
            width=2 if differs else 1,
            dash="dash" if differs else None,
            hovertemplate=f"{figure_text(asset.asset)}: %{{y:.5g}}<extra></extra>",
        )
    slope = effect.drift / effect.unit_of_time if drifts else 0.0
    error = effect.drift_error / effect.unit_of_time if drifts else 0.0
    t = np.linspace(ends[0], ends[1], 25)
    centre = effect.mean + slope * (t - effect.middle)
    half = 1.96 * np.hypot(effect.mean_error, error * (t - effect.middle))
    times = _times(fleet, t)
    figure.band(k, times, centre, half)
    figure.line(k, times, centre, "the fleet", AFTER)
    figure.label(k, y=axis_text(effect.name, effect.unit))
