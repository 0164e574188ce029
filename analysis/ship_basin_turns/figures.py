"""Figures of turns: residuals, portraits, decays, surge speed, leans."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from analysis.common.figures import Chart
from analysis.ship_algorithm.records import TS
from analysis.ship_basin_turns.decay import Decay
from analysis.ship_basin_turns.records import Sailed
from analysis.ship_basin_turns.short_sets import Lean
from casid.arrays import Array

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
DASHES = ("solid", "dash", "dot")


def residual_figure(
    sailed: Sailed, t: Array, fitted: Array, true: Array, parts: Mapping[str, Array]
) -> Any:
    """As Figure 9.17: the residual over time above the rudder, and against |rudder|."""
    chart = Chart(
        "Residuals of the roll model stand out where turns begin and end; "
        "the speed, taken as constant, makes most of them (nominal ship, no noise, 0.5 Hz)",
        720,
        rows=3,
        cols=2,
        shared_xaxes="columns",
        column_widths=[0.72, 0.28],
        row_heights=[0.36, 0.36, 0.28],
        vertical_spacing=0.04,
        horizontal_spacing=0.08,
        specs=[[{}, {}], [{}, {}], [{}, None]],
    )
    delta = np.degrees(np.interp(t, sailed.motion.t, sailed.motion["delta"]))
    shown = (t - t[0] > 0.2) & (t - t[0] < 60.0)
    x, dots = np.abs(delta)[5:], {"size": 2, "opacity": 0.5}
    for row, name, values in ((1, "fitted", fitted), (2, "at the true parameters", true)):
        colour = COLOURS[row - 1]
        chart.line(t[shown], 1e3 * values[shown], name, colour, at=(row, 1))
        chart.points(x, 1e3 * np.abs(values)[5:], "", colour, at=(row, 2), marker=dots)
        chart.y_axis("residual [mrad/s]", row=row, col=1)
        chart.y_axis("|residual| [mrad/s]", row=row, col=2)
    speed = 1e3 * parts["speed in K_r r"][shown]
    chart.line(t[shown], speed, "of it, the speed in K_r r", COLOURS[2], dash="dash", at=(2, 1))
    chart.line(t[shown], delta[shown], "rudder", "#555555", at=(3, 1))
    chart.y_axis("rudder [deg]", row=3, col=1)
    chart.x_axis("time [s]", row=3, col=1)
    chart.x_axis("|rudder| [deg]", row=2, col=2)
    return chart.figure


def portrait(turns: Mapping[str, Mapping[str, Sailed]]) -> Any:
    """As Figure 9.11: roll angle and a_s against roll rate, in a turn and after it."""
    chart = Chart(
        "Turns with each load: heel, a<sub>s</sub> and roll rate grow with the load",
        800,
        rows=len(turns),
        cols=2,
        horizontal_spacing=0.1,
        vertical_spacing=0.09,
        shared_xaxes="columns",
        subplot_titles=[t for kind in turns for t in (kind, "")],
    )
    curves = [(i, *own) for i, kind in enumerate(turns, 1) for own in turns[kind].items()]
    colours = dict(zip(next(iter(turns.values())), COLOURS, strict=False))
    for row, case, sailed in curves:
        p = np.degrees(sailed["p"])
        across = (np.degrees(sailed["phi"]), sailed.experiment.record["accel"])
        for col, x in enumerate(across, start=1):
            for what, (a, b), dash in (
                ("in the turn", (4.0, 12.0), "solid"),
                ("after it", (12.0, 20.0), "dot"),
            ):
                at = slice(round(a / TS), round(b / TS))
                name = f"{case}, {what}"
                chart.line(x[at], p[at], name, colours[case], dash=dash, at=(row, col))
    chart.x_axis("roll angle phi [deg]", row=len(turns), col=1)
    chart.x_axis("a<sub>s</sub> [m/s^2]", row=len(turns), col=2)
    chart.y_axis("roll rate [deg/s]")
    return chart.figure


def decays_figure(found: Mapping[str, tuple[Decay, Decay]]) -> Any:
    """Found with two standard errors, beside the simulator's."""
    title = "The roll dies out more slowly in a turn; a ship without its nonlinear terms does not"
    chart = Chart(title)
    dash = {"symbol": "line-ew-open", "size": 26}
    for i, where in enumerate(("in the turn", "after it")):
        own = [pair[i] for pair in found.values()]
        x = [f"{name}<br>{where}" for name in found]
        bars = {"type": "data", "array": [2 * d.std_error for d in own]}
        name = f"from the gyro, {where}"
        chart.points(x, [d.found for d in own], name, COLOURS[i], error_y=bars)
        expected = [d.expected for d in own]
        chart.points(x, expected, "the simulator's terms", "black", marker=dash)
    chart.y_axis("decay of the roll [1/s]")
    order = [f"{name}<br>{w}" for name in found for w in ("in the turn", "after it")]
    chart.x_axis(categoryorder="array", categoryarray=order)
    return chart.figure


def speed_figure(sailed: Sailed, u: Array, sd: float) -> Any:
    """Surge speed, true and smoothed, above the modulus of the rudder."""
    title = (
        "The surge speed drops in turns and comes back slowly; smoothed from positions and "
        f"heading at 5 Hz, stated error {1e3 * sd:.0f} mm/s"
    )
    chart = Chart(title, 560, rows=2, shared_xaxes=True, vertical_spacing=0.05)
    t = TS * np.arange(len(u))[::5]
    chart.line(t, u[::5], "smoothed", COLOURS[1])
    chart.line(t, sailed["u"][::5], "true", COLOURS[0], dash="dash")
    rudder = np.degrees(np.abs(sailed["delta"]))
    chart.line(t, rudder[::5], "|rudder|", "#555555", at=(2, 1))
    chart.y_axis("surge speed u [m/s]", row=1)
    chart.y_axis("|rudder| [deg]", row=2)
    chart.x_axis("time [s]", row=2)
    return chart.figure


def lean_figure(leans: tuple[Lean, Lean]) -> Any:
    """Heel after the entry and after the exit of a turn, beside linear theory."""
    title = "The ship leans into the turn before it heels outwards, and outwards before it rights"
    chart = Chart(title, 460, cols=2, subplot_titles=("entry", "exit"))
    for col, lean in enumerate(leans, start=1):
        for i, (name, phi) in enumerate((("simulator", lean.phi), ("linear", lean.linear))):
            heel = np.degrees(phi) * lean.inwards
            chart.line(lean.t, heel, name, COLOURS[i], dash=DASHES[i], at=(1, col))
    chart.x_axis("time after the rudder's first move [s]")
    chart.y_axis("change of heel to the inside [deg]", col=1)
    return chart.figure
