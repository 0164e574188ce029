"""Figures of the ship's signals: Bode plots, steps of the rudder, correlations with the torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from analysis.common.output import titled
from analysis.ship_signals.correlation import LAG, SIGNALS, Found, Sampled
from analysis.ship_signals.inward_heel import Lean
from analysis.ship_signals.model import frequency_response, values_of

COLOURS = ("#0072B2", "#D55E00", "#009E73")
DASHES = ("solid", "dash", "dot")
LABELS = {"gyro": "roll rate", "accel": "accelerometer", "yaw": "yaw rate", "r": "yaw rate"}
UNITS = {
    "gyro/delta": "1/s", "accel/delta": "m/s^2 per rad", "yaw/delta": "1/s",
    "gyro/tau": "rad/s per N m", "accel/tau": "m/s^2 per N m", "yaw/tau": "rad/s per N m",
}  # fmt: skip


def bode() -> Any:
    """Magnitude and phase from rudder and from torque to the three signals."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    w, values = np.geomspace(0.02, 200.0, 400), values_of()
    table = [frequency_response(values, 1j * x) for x in w]
    figure = make_subplots(
        rows=2,
        cols=2,
        shared_xaxes=True,
        subplot_titles=("from the rudder [rad]", "from a torque in roll [N m]", "", ""),
        vertical_spacing=0.06,
    )
    for col, u in enumerate(("delta", "tau"), start=1):
        for name, colour, dash in zip(("gyro", "accel", "yaw"), COLOURS, DASHES, strict=True):
            H = np.array([row[f"{name}/{u}"] for row in table])
            phase = np.unwrap(np.angle(H)) * 180 / np.pi
            for row, y in ((1, np.abs(H)), (2, phase)):
                figure.add_trace(
                    go.Scatter(
                        x=w,
                        y=y,
                        name=LABELS[name],
                        legendgroup=name,
                        showlegend=(row, col) == (1, 1),
                        line={"color": colour, "dash": dash},
                        hovertemplate=f"%{{x:.3g}} rad/s: %{{y:.4g}} {UNITS[f'{name}/{u}']}"
                        if row == 1
                        else "%{x:.3g} rad/s: %{y:.0f} deg",
                    ),
                    row=row,
                    col=col,
                )
    figure.update_xaxes(type="log", dtick=1)
    figure.update_xaxes(title_text="frequency [rad/s]", row=2)
    figure.update_yaxes(type="log", dtick=1, exponentformat="power", row=1)
    figure.update_yaxes(title_text="magnitude, SI units", row=1, col=1)
    figure.update_yaxes(title_text="phase [deg]", row=2, col=1)
    title = (
        "From a torque the accelerometer's gain does not fall off, the yaw rate's does: "
        "a direct term, and none (Table 8.2, 1 m/s)"
    )
    return titled(figure, title, 650)


def steps(leans: Mapping[str, Lean]) -> Any:
    """Heel after a step of the rudder to port, the first second enlarged."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=1, cols=2, subplot_titles=("twelve seconds", "the first second"))
    for (name, found), colour in zip(leans.items(), COLOURS, strict=False):
        for col, until in ((1, found.t[-1]), (2, 1.0)):
            shown = found.t <= until
            for phi, dash, what in (
                (found.phi, "solid", "simulator"),
                (found.linear, "dash", "linear"),
            ):
                figure.add_trace(
                    go.Scatter(
                        x=found.t[shown],
                        y=np.degrees(phi[shown]),
                        name=f"{name}, {what}",
                        showlegend=col == 1,
                        line={"color": colour, "dash": dash},
                    ),
                    row=1,
                    col=col,
                )
    figure.update_xaxes(title_text="time [s]")
    figure.update_yaxes(title_text="heel to starboard [deg]", row=1, col=1)
    title = (
        "A low rudder heels the ship inwards first, to port; at z<sub>r</sub> = 0 that is gone "
        "(step of 1.1 deg to port; the low rudder with K_vdot of chapter 9)"
    )
    return titled(figure, title, 480)


def correlations(system: Sampled, found: Sequence[tuple[str, Found]]) -> Any:
    """Correlation with the torque against the lag; found values with two standard errors."""
    import plotly.graph_objects as go

    lags = np.arange(-150, 301)
    theory = np.array([system.correlation(int(lag))[:3] for lag in lags])
    figure = go.Figure()
    for i, name in enumerate(SIGNALS):
        figure.add_trace(
            go.Scatter(
                x=lags * system.Ts,
                y=theory[:, i],
                name=LABELS[name],
                line={"color": COLOURS[i], "dash": DASHES[i]},
            )
        )
        for k, (label, f) in enumerate(found):
            figure.add_trace(
                go.Scatter(
                    x=np.array([0.0, LAG * system.Ts]),
                    y=f.mean[[i, 3 + i]],
                    error_y={"type": "data", "array": 2 * f.error[[i, 3 + i]]},
                    mode="markers",
                    marker={"color": COLOURS[i], "symbol": ("circle-open", "square-open")[k % 2]},
                    name=f"{LABELS[name]}, {label}",
                )
            )
    figure.update_xaxes(title_text="time after the torque [s]")
    figure.update_yaxes(title_text="correlation with the torque")
    title = (
        "All three signals are correlated with the torque, the yaw rate least "
        "(bars of two standard errors)"
    )
    return titled(figure, title, 520)
