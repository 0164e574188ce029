"""Figures of the study of bias: imperfections, sea states, speeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.common.figures import Chart
from analysis.ship_bias.speed import FASTER, AtSea, AtSpeed
from analysis.ship_bias.table import Row

COLOURS = {"LS": "#D55E00", "IV": "#0072B2"}
SYMBOLS = {"LS": "diamond", "IV": "circle"}
METHODS = {"LS": "least squares", "IV": "instruments"}
SOUGHT = ("m [kg]", "zbar_m [m]")
CERTAIN = 1.96  # Monte Carlo standard errors


def imperfections(rows: Sequence[Row], mean: float) -> Any:
    """Mean error of m and zbar_m by imperfection, with 95 % Monte Carlo intervals.

    Parameters
    ----------
    mean : of the rudder angle [rad].
    """
    title = (
        "Noise on the channels, a torque in roll and a gyro bias move least squares and not "
        f"instruments (rudder mean {mean:g} rad; bars: 95 % Monte Carlo)"
    )
    chart = Chart(title, 520, cols=2, shared_yaxes=True, horizontal_spacing=0.03)
    for method in METHODS:
        kept = [r for r in rows if r.method == method and len(r.kept) > 1]
        for i, what in enumerate(SOUGHT):
            chart.points(
                [r.bias[i] for r in kept],
                [r.imperfection for r in kept],
                METHODS[method],
                COLOURS[method],
                at=(1, i + 1),
                error_x={"array": [CERTAIN * r.monte_carlo[i] for r in kept]},
                customdata=[(r.deviation[i], r.refused) for r in kept],
                marker={"symbol": SYMBOLS[method]},
                hovertemplate=f"%{{y}}: {what} off by %{{x:.4f}}, one estimate +- "
                "%{customdata[0]:.4f}, %{customdata[1]} refused",
            )
            chart.x_axis(f"mean error of {what}", zeroline=True, col=i + 1)
    chart.y_axis(autorange="reversed")
    return chart.figure


def sea(found: Sequence[AtSea]) -> Any:
    """Mean error and spread of m and zbar_m against the significant wave height."""
    title = "Waves spread instruments and bias least squares (beam sea; bars: 95 % Monte Carlo)"
    titles = ("m [kg]", "zbar_m [m]", "", "")
    chart = Chart(title, 600, rows=2, cols=2, shared_xaxes=True, subplot_titles=titles)
    for method in METHODS:
        points: list[tuple[float, Any, Any, int]] = []
        for s in found:
            errors = s.by_squares if method == "LS" else s.by_instruments
            kept = errors[np.isfinite(errors).all(axis=1)]
            if len(kept) > 1:
                points.append((s.Hs, kept.mean(axis=0), kept.std(axis=0, ddof=1), len(kept)))
        for i in range(2):
            mean, sd = [p[1][i] for p in points], [p[2][i] for p in points]
            bars = [CERTAIN * p[2][i] / p[3] ** 0.5 for p in points]
            # relative standard error of a standard deviation of n draws
            wide = [CERTAIN * p[2][i] / (2 * (p[3] - 1)) ** 0.5 for p in points]
            for row, y, bar in ((1, mean, bars), (2, sd, wide)):
                chart.points(
                    [p[0] for p in points],
                    y,
                    METHODS[method],
                    COLOURS[method],
                    at=(row, i + 1),
                    mode="lines+markers",
                    error_y={"array": bar},
                    marker={"symbol": SYMBOLS[method]},
                    hovertemplate="Hs %{x:g} m: %{y:.4f}",
                )
    chart.y_axis("mean error", row=1, col=1)
    chart.y_axis("standard deviation", rangemode="tozero", row=2, col=1)
    chart.x_axis("significant wave height, full scale [m]", row=2)
    return chart.figure


def speed(found: Sequence[AtSpeed]) -> Any:
    """k, d and K_r against the speed, with the true curves and the value at 1 m/s."""
    units = {"k": "N m/rad", "d": "N m s/rad", "K_r": "N m s/rad"}
    title = "One model for all speeds is wrong by up to two thirds of K_r (bars: 95 %, as stated)"
    chart = Chart(title, 420, cols=3, horizontal_spacing=0.08)
    grid = np.linspace(min(f.U for f in found), max(f.U for f in found), 60)
    true = [FASTER.roll_coefficients(float(U)) for U in grid]
    for col, (name, unit) in enumerate(units.items(), start=1):
        own, at = [f for f in found if f.name == name], (1, col)
        chart.line(grid, [t[name] for t in true], "true", "#555555", at=at)
        at_one = np.full(len(grid), own[0].at_one)
        chart.line(grid, at_one, "that of 1 m/s", "#999999", dash="dot", at=at)
        bars = {"array": [CERTAIN * f.std_error for f in own]}
        shown: dict[str, Any] = {"error_y": bars, "hovertemplate": "%{x:g} m/s: %{y:.4f}", "at": at}
        x, y = [f.U for f in own], [f.estimate for f in own]
        chart.points(x, y, METHODS["IV"], COLOURS["IV"], **shown)
        chart.y_axis(f"{name} [{unit}]", col=col)
    chart.x_axis("speed [m/s]")
    return chart.figure
