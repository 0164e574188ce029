"""Figures of the study of bias: imperfections, sea states, speeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.common.output import titled
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
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=1, cols=2, shared_yaxes=True, horizontal_spacing=0.03)
    for method in METHODS:
        kept = [r for r in rows if r.method == method and len(r.kept) > 1]
        for i, what in enumerate(SOUGHT):
            figure.add_trace(
                go.Scatter(
                    x=[r.bias[i] for r in kept],
                    y=[r.imperfection for r in kept],
                    error_x={"array": [CERTAIN * r.monte_carlo[i] for r in kept]},
                    customdata=[(r.deviation[i], r.refused) for r in kept],
                    mode="markers",
                    marker={"color": COLOURS[method], "symbol": SYMBOLS[method], "size": 8},
                    name=METHODS[method],
                    legendgroup=method,
                    showlegend=i == 0,
                    hovertemplate=f"%{{y}}: {what} off by %{{x:.4f}}, one estimate +- "
                    "%{customdata[0]:.4f}, %{customdata[1]} refused",
                ),
                row=1,
                col=i + 1,
            )
            figure.update_xaxes(title_text=f"mean error of {what}", zeroline=True, col=i + 1)
    figure.update_yaxes(autorange="reversed")
    title = (
        "Noise on the channels, a torque in roll and a gyro bias move least squares and not "
        f"instruments (rudder mean {mean:g} rad; bars: 95 % Monte Carlo)"
    )
    return titled(figure, title, 520)


def sea(found: Sequence[AtSea]) -> Any:
    """Mean error and spread of m and zbar_m against the significant wave height."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(
        rows=2, cols=2, shared_xaxes=True, subplot_titles=("m [kg]", "zbar_m [m]", "", "")
    )
    for method in METHODS:
        points = []
        for s in found:
            errors = s.by_squares if method == "LS" else s.by_instruments
            kept = errors[np.isfinite(errors).all(axis=1)]
            if len(kept) > 1:
                points.append((s.Hs, kept.mean(axis=0), kept.std(axis=0, ddof=1), len(kept)))
        for i in range(2):
            for row, y, bar in (
                (1, [p[1][i] for p in points], [CERTAIN * p[2][i] / p[3] ** 0.5 for p in points]),
                # relative standard error of a standard deviation of n draws
                (
                    2,
                    [p[2][i] for p in points],
                    [CERTAIN * p[2][i] / (2 * (p[3] - 1)) ** 0.5 for p in points],
                ),
            ):
                figure.add_trace(
                    go.Scatter(
                        x=[p[0] for p in points],
                        y=y,
                        error_y={"array": bar},
                        mode="lines+markers",
                        line={"color": COLOURS[method]},
                        marker={"symbol": SYMBOLS[method], "size": 8},
                        name=METHODS[method],
                        legendgroup=method,
                        showlegend=(row, i) == (1, 0),
                        hovertemplate="Hs %{x:g} m: %{y:.4f}",
                    ),
                    row=row,
                    col=i + 1,
                )
    figure.update_yaxes(title_text="mean error", row=1, col=1)
    figure.update_yaxes(title_text="standard deviation", rangemode="tozero", row=2, col=1)
    figure.update_xaxes(title_text="significant wave height, full scale [m]", row=2)
    title = "Waves spread instruments and bias least squares (beam sea; bars: 95 % Monte Carlo)"
    return titled(figure, title, 600)


def speed(found: Sequence[AtSpeed]) -> Any:
    """k, d and K_r against the speed, with the true curves and the value at 1 m/s."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    units = {"k": "N m/rad", "d": "N m s/rad", "K_r": "N m s/rad"}
    figure = make_subplots(rows=1, cols=3, horizontal_spacing=0.08)
    grid = np.linspace(min(f.U for f in found), max(f.U for f in found), 60)
    true = [FASTER.roll_coefficients(float(U)) for U in grid]
    for col, (name, unit) in enumerate(units.items(), start=1):
        own = [f for f in found if f.name == name]
        first = col == 1
        figure.add_trace(
            go.Scatter(x=grid, y=[t[name] for t in true], name="true", line={"color": "#555555"},
                       legendgroup="true", showlegend=first),
            row=1, col=col,
        )  # fmt: skip
        figure.add_trace(
            go.Scatter(x=grid, y=np.full(len(grid), own[0].at_one), name="that of 1 m/s",
                       line={"color": "#999999", "dash": "dot"}, legendgroup="one",
                       showlegend=first),
            row=1, col=col,
        )  # fmt: skip
        figure.add_trace(
            go.Scatter(
                x=[f.U for f in own],
                y=[f.estimate for f in own],
                error_y={"array": [CERTAIN * f.std_error for f in own]},
                mode="markers",
                marker={"color": COLOURS["IV"], "size": 8},
                name=METHODS["IV"],
                legendgroup="IV",
                showlegend=first,
                hovertemplate="%{x:g} m/s: %{y:.4f}",
            ),
            row=1,
            col=col,
        )
        figure.update_yaxes(title_text=f"{name} [{unit}]", row=1, col=col)
    figure.update_xaxes(title_text="speed [m/s]")
    title = "One model for all speeds is wrong by up to two thirds of K_r (bars: 95 %, as stated)"
    return titled(figure, title, 420)
