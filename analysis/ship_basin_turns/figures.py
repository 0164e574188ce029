"""Figures of turns: residuals, portraits, decays, surge speed, leans."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from analysis.common.output import titled
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
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(
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
    lines = [
        (1, "fitted", fitted, COLOURS[0], "solid"),
        (2, "at the true parameters", true, COLOURS[1], "solid"),
        (2, "of it, the speed in K_r r", parts["speed in K_r r"], COLOURS[2], "dash"),
    ]
    for row, name, values, colour, dash in lines:
        figure.add_trace(
            go.Scatter(
                x=t[shown], y=1e3 * values[shown], name=name, line={"color": colour, "dash": dash}
            ),
            row=row,
            col=1,
        )
        if name.startswith("of it"):
            continue
        figure.add_trace(
            go.Scatter(
                x=np.abs(delta)[5:],
                y=1e3 * np.abs(values)[5:],
                mode="markers",
                marker={"color": colour, "size": 2, "opacity": 0.5},
                showlegend=False,
            ),
            row=row,
            col=2,
        )
        figure.update_yaxes(title_text="|residual| [mrad/s]", row=row, col=2)
        figure.update_yaxes(title_text="residual [mrad/s]", row=row, col=1)
    figure.add_trace(
        go.Scatter(x=t[shown], y=delta[shown], name="rudder", line={"color": "#555555"}),
        row=3,
        col=1,
    )
    figure.update_yaxes(title_text="rudder [deg]", row=3, col=1)
    figure.update_xaxes(title_text="time [s]", row=3, col=1)
    figure.update_xaxes(title_text="|rudder| [deg]", row=2, col=2)
    title = (
        "Residuals of the roll model stand out where turns begin and end; "
        "the speed, taken as constant, makes most of them (nominal ship, no noise, 0.5 Hz)"
    )
    return titled(figure, title, 720)


def portrait(turns: Mapping[str, Mapping[str, Sailed]]) -> Any:
    """As Figure 9.11: roll angle and a_s against roll rate, in a turn and after it."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    titles = [t for kind in turns for t in (kind, "")]
    figure = make_subplots(
        rows=len(turns),
        cols=2,
        horizontal_spacing=0.1,
        vertical_spacing=0.09,
        shared_xaxes="columns",
        subplot_titles=titles,
    )
    curves = [(i, *own) for i, kind in enumerate(turns, 1) for own in turns[kind].items()]
    colours = dict(zip(next(iter(turns.values())), COLOURS, strict=False))
    for row, case, sailed in curves:
        record = sailed.experiment.record
        p = np.degrees(sailed["p"])
        across = (np.degrees(sailed["phi"]), record["accel"])
        for col, x in enumerate(across, start=1):
            for what, (a, b), dash in (
                ("in the turn", (4.0, 12.0), "solid"),
                ("after it", (12.0, 20.0), "dot"),
            ):
                at = slice(round(a / TS), round(b / TS))
                figure.add_trace(
                    go.Scatter(
                        x=x[at],
                        y=p[at],
                        name=f"{case}, {what}",
                        legendgroup=case + what,
                        showlegend=(row, col) == (1, 1),
                        line={"color": colours[case], "dash": dash},
                    ),
                    row=row,
                    col=col,
                )
    figure.update_xaxes(title_text="roll angle phi [deg]", row=len(turns), col=1)
    figure.update_xaxes(title_text="a<sub>s</sub> [m/s^2]", row=len(turns), col=2)
    figure.update_yaxes(title_text="roll rate [deg/s]")
    title = "Turns with each load: heel, a<sub>s</sub> and roll rate grow with the load"
    return titled(figure, title, 800)


def decays_figure(found: Mapping[str, tuple[Decay, Decay]]) -> Any:
    """Found with two standard errors, beside the simulator's."""
    import plotly.graph_objects as go

    figure = go.Figure()
    for i, where in enumerate(("in the turn", "after it")):
        own = [pair[i] for pair in found.values()]
        x = [f"{name}<br>{where}" for name in found]
        figure.add_trace(
            go.Scatter(
                x=x,
                y=[d.found for d in own],
                error_y={"type": "data", "array": [2 * d.std_error for d in own]},
                mode="markers",
                marker={"color": COLOURS[i], "size": 9},
                name=f"from the gyro, {where}",
            )
        )
        figure.add_trace(
            go.Scatter(
                x=x,
                y=[d.expected for d in own],
                mode="markers",
                marker={"color": "black", "symbol": "line-ew-open", "size": 26},
                name="the simulator's terms",
                showlegend=i == 0,
            )
        )
    figure.update_yaxes(title_text="decay of the roll [1/s]")
    order = [f"{name}<br>{w}" for name in found for w in ("in the turn", "after it")]
    figure.update_xaxes(categoryorder="array", categoryarray=order)
    title = "The roll dies out more slowly in a turn; a ship without its nonlinear terms does not"
    return titled(figure, title, 480)


def speed_figure(sailed: Sailed, u: Array, sd: float) -> Any:
    """Surge speed, true and smoothed, above the modulus of the rudder."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.05)
    t = TS * np.arange(len(u))
    lines = (("smoothed", u, COLOURS[1], "solid"), ("true", sailed["u"], COLOURS[0], "dash"))
    for name, y, colour, dash in lines:
        figure.add_trace(
            go.Scatter(x=t[::5], y=y[::5], name=name, line={"color": colour, "dash": dash}),
            row=1,
            col=1,
        )
    rudder = np.degrees(np.abs(sailed["delta"]))
    figure.add_trace(
        go.Scatter(x=t[::5], y=rudder[::5], name="|rudder|", line={"color": "#555555"}),
        row=2,
        col=1,
    )
    figure.update_yaxes(title_text="surge speed u [m/s]", row=1)
    figure.update_yaxes(title_text="|rudder| [deg]", row=2)
    figure.update_xaxes(title_text="time [s]", row=2)
    title = (
        "The surge speed drops in turns and comes back slowly; smoothed from positions and "
        f"heading at 5 Hz, stated error {1e3 * sd:.0f} mm/s"
    )
    return titled(figure, title, 560)


def lean_figure(leans: tuple[Lean, Lean]) -> Any:
    """Heel after the entry and after the exit of a turn, beside linear theory."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=1, cols=2, subplot_titles=("entry", "exit"))
    for col, lean in enumerate(leans, start=1):
        for i, (name, phi) in enumerate((("simulator", lean.phi), ("linear", lean.linear))):
            figure.add_trace(
                go.Scatter(
                    x=lean.t,
                    y=np.degrees(phi) * lean.inwards,
                    name=name,
                    showlegend=col == 1,
                    line={"color": COLOURS[i], "dash": DASHES[i]},
                ),
                row=1,
                col=col,
            )
    figure.update_xaxes(title_text="time after the rudder's first move [s]")
    figure.update_yaxes(title_text="change of heel to the inside [deg]", row=1, col=1)
    title = "The ship leans into the turn before it heels outwards, and outwards before it rights"
    return titled(figure, title, 460)
