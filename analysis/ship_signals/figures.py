"""Figures of the ship's signals: Bode plots, steps of the rudder, correlations with the torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from analysis.common.figures import Chart
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
    w, values = np.geomspace(0.02, 200.0, 400), values_of()
    table = [frequency_response(values, 1j * x) for x in w]
    chart = Chart(
        "From a torque the accelerometer's gain does not fall off, the yaw rate's does: "
        "a direct term, and none (Table 8.2, 1 m/s)",
        650,
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
            for row, y, unit in (
                (1, np.abs(H), f"%{{y:.4g}} {UNITS[f'{name}/{u}']}"),
                (2, phase, "%{y:.0f} deg"),
            ):
                look = {"dash": dash, "hovertemplate": f"%{{x:.3g}} rad/s: {unit}"}
                chart.line(w, y, LABELS[name], colour, at=(row, col), **look)
    chart.x_axis(type="log", dtick=1)
    chart.x_axis("frequency [rad/s]", row=2)
    chart.y_axis(type="log", dtick=1, exponentformat="power", row=1)
    chart.y_axis("magnitude, SI units", row=1, col=1)
    chart.y_axis("phase [deg]", row=2, col=1)
    return chart.figure


def steps(leans: Mapping[str, Lean]) -> Any:
    """Heel after a step of the rudder to port, the first second enlarged."""
    title = (
        "A low rudder heels the ship inwards first, to port; at z<sub>r</sub> = 0 that is gone "
        "(step of 1.1 deg to port; the low rudder with K_vdot of chapter 9)"
    )
    chart = Chart(title, cols=2, subplot_titles=("twelve seconds", "the first second"))
    for (name, found), colour in zip(leans.items(), COLOURS, strict=False):
        for col, until in ((1, found.t[-1]), (2, 1.0)):
            shown, at = found.t <= until, (1, col)
            t, phi, linear = found.t[shown], found.phi[shown], found.linear[shown]
            chart.line(t, np.degrees(phi), f"{name}, simulator", colour, at=at)
            chart.line(t, np.degrees(linear), f"{name}, linear", colour, dash="dash", at=at)
    chart.x_axis("time [s]")
    chart.y_axis("heel to starboard [deg]", col=1)
    return chart.figure


def correlations(system: Sampled, found: Sequence[tuple[str, Found]]) -> Any:
    """Correlation with the torque against the lag; found values with two standard errors."""
    title = (
        "All three signals are correlated with the torque, the yaw rate least "
        "(bars of two standard errors)"
    )
    chart = Chart(title, 520)
    lags = np.arange(-150, 301)
    theory = np.array([system.correlation(int(lag))[:3] for lag in lags])
    for i, name in enumerate(SIGNALS):
        chart.line(lags * system.Ts, theory[:, i], LABELS[name], COLOURS[i], dash=DASHES[i])
        for k, (label, f) in enumerate(found):
            x, y = np.array([0.0, LAG * system.Ts]), f.mean[[i, 3 + i]]
            bars = {"type": "data", "array": 2 * f.error[[i, 3 + i]]}
            symbol = {"symbol": ("circle-open", "square-open")[k % 2], "size": 6}
            own = f"{LABELS[name]}, {label}"
            chart.points(x, y, own, COLOURS[i], marker=symbol, error_y=bars)
    chart.x_axis("time after the torque [s]")
    chart.y_axis("correlation with the torque")
    return chart.figure
