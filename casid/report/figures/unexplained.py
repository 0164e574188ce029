"""Figures of the unexplained remainder: against variables, over time, and its spectrum."""

from __future__ import annotations

from typing import Any

import numpy as np

from casid.diagnosis.unexplained.description import Unexplained
from casid.diagnosis.unexplained.missing_force import MissingForce
from casid.diagnosis.unexplained.smoothed_force import SmoothedForce
from casid.report.figures.panels import Panels
from casid.report.figures.style import (
    AFTER,
    BEFORE,
    FLOOR,
    MEASURED,
    axis_text,
    figure_text,
)
from casid.report.figures.thinning import thinned

_POINTS = 1000


def dependence_figure(result: Unexplained) -> Any:
    """The missing force against each variable on which it depends, with its 95 % band.

    For a product, the coefficient of the first variable against the second.

    Raises
    ------
    ValueError
        If no dependence was found.
    """
    best = _best(result)
    drawn = [d for d in best.dependences if d.at.size > 1 and d.at.size == d.value.size]
    if not drawn:
        raise ValueError("no dependence was found that is a curve, so there is nothing to draw")
    columns = min(2, len(drawn))
    figure = Panels(panels=len(drawn), columns=columns, row_height=280, gap=70)
    for k, d in enumerate(drawn):
        figure.band(k, d.at, d.value, 1.96 * d.sd)
        dots: dict[str, Any] = {"mode": "lines+markers", "marker": {"size": 5}}
        figure.line(k, d.at, d.value, "missing part", AFTER, **dots)
        last, unit = d.variables[-1], best.unit
        label = f"missing {best.place}" if best.is_balance else f"error of {best.place}"
        if len(d.variables) > 1:
            label, unit = (
                f"factor of {d.variables[0]}",
                f"{best.unit}/({best.units[d.variables[0]]})",
            )
        figure.label(k, x=axis_text(last, best.units[last]), y=axis_text(label, unit))
    return figure.done(
        f"What is missing in {best.place}, as a function of what it depends on: "
        f"{100 * best.explained:.0f} % of the remainder. The model's own parameters may absorb "
        "part of each curve.",
        (),
    )


def missing_spectrum_figure(result: Unexplained) -> Any:
    """Amplitude density of the missing force, and what noise alone would give.

    Raises
    ------
    ValueError
        If the best place was not estimated over time.
    """
    best, force = _over_time(result)
    s = force.spectrum
    unit = f"({best.unit})/\u221aHz"
    figure = Panels(rows=1, row_height=320, gap=30)
    above = s.density > 0  # below zero by chance: nothing is seen there
    name, density = figure_text(f"missing {best.place}"), np.sqrt(s.density[above])
    dots: dict[str, Any] = {"mode": "lines+markers", "marker": {"size": 4}}
    figure.line(0, s.frequency[above], density, name, AFTER, width=1.6, **dots)
    figure.line(0, s.frequency, np.sqrt(s.floor), "noise alone", FLOOR, dash="dash")
    figure.label(0, x="frequency [Hz]", y=axis_text("density", unit))
    figure.log()
    line = f" A line stands out at {s.line:.3g} Hz." if s.line is not None else ""
    return figure.done(
        f"Amplitude density of what is missing in {best.place}. Where the noise lies above, "
        f"nothing is seen.{line}",
        (),
    )


def missing_time_figure(result: Unexplained, record: int = 0) -> Any:
    """The missing force over time with its 95 % band, above the variables, of one record.

    Raises
    ------
    ValueError
        If the best place was not estimated over time.
    """
    best, force = _over_time(result)
    s, signals = force.series[record], result.signals[record]
    names = list(signals)
    figure = Panels(rows=1 + len(names), row_height=150, gap=20, shared_x=True)
    every = slice(None, None, max(1, len(s.t) // _POINTS))
    figure.band(0, s.t[every], s.force[every], 1.96 * s.sd[every])
    i = thinned(s.force, _POINTS)
    figure.line(0, s.t[i], s.force[i], figure_text(f"missing {best.place}"), AFTER, width=1.3)
    figure.label(0, y=axis_text(best.place, best.unit))
    for row, name in enumerate(names, start=1):
        i = thinned(signals[name], _POINTS)
        colour, label = MEASURED if row % 2 else BEFORE, figure_text(name)
        figure.line(row, s.t[i], signals[name][i], label, colour, width=1.1, in_legend=False)
        figure.label(row, y=axis_text(name, best.units.get(name, "")))
    figure.time_label(len(names))
    honest = "" if force.is_seen else " It is not estimated better than its noise."
    return figure.done(f"What is missing in {best.place} over time, record {s.name}.{honest}", ())


def _over_time(result: Unexplained) -> tuple[MissingForce, SmoothedForce]:
    """The best place with its force over time."""
    best = _best(result)
    if best.over_time is None:
        raise ValueError(f"{best.place} was not estimated over time; request a place that was")
    return best, best.over_time


def _best(result: Unexplained) -> MissingForce:
    best = result.best
    if best is None or not result.is_something:
        raise ValueError("nothing is left beyond the noise, so there is nothing to draw")
    return best
