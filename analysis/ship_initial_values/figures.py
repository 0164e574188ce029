"""Figures of section 8.6: the cost over mass and height as Figure 8.10, and where runs end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from analysis.ship_initial_values.runs import Program, admissible, family
from casid.arrays import Array
from problems.ship import NINE, TABLE_8_2

LABELS = {
    "k": "k [N m/rad]",
    "A_x": "A_x [kg m^2]",
    "d": "d [N m s/rad]",
    "K_r": "K_r [N m s/rad]",
    "K_vdot": "K_vdot [kg m]",
    "K_delta": "K_delta [N m/rad]",
    "m": "m [kg]",
    "zbar_m": "zbar_m [m]",
}
COLOURS = {"nine": "#1b9e77", "end": "#d95f02", "trust region": "#7570b3"}
NAMES = {
    "nine": "Ipopt, stopped at an optimum",
    "end": "Ipopt, to its own end",
    "trust region": "trust region",
}


def cost_map(program: Program, n: int = 121) -> Any:
    """log10 of the cost over (m, zbar_m), the others at the truth, with the Hessian's axes."""
    import plotly.graph_objects as go

    truth = np.array([TABLE_8_2[name] for name in NINE])
    i, j = NINE.index("m"), NINE.index("zbar_m")
    mass, height = np.linspace(0.2, 0.8, n), np.linspace(-0.4, -0.04, n)
    V = np.empty((n, n))
    for row, z in enumerate(height):
        for column, m in enumerate(mass):
            x = truth.copy()
            x[i], x[j] = m, z
            V[row, column] = 0.5 * np.sum(program.residual(x) ** 2)
    J = program.residual_slopes(truth)[:, [i, j]]
    values, vectors = np.linalg.eigh(J.T @ J)
    figure = go.Figure(
        go.Contour(
            x=mass,
            y=height,
            z=np.log10(np.maximum(V, 1e-16)),
            colorscale="Viridis",
            ncontours=30,
            colorbar={"title": "log10 V"},
        )
    )
    z_f = TABLE_8_2["z_f"]
    moment = TABLE_8_2["m"] * (TABLE_8_2["zbar_m"] + z_f)
    figure.add_trace(
        go.Scatter(
            x=mass,
            y=moment / mass - z_f,
            mode="lines",
            line={"color": "white", "dash": "dot"},
            name="m z_m constant",
        )
    )
    for value, vector in zip(values, vectors.T, strict=True):
        reach = 0.03 * np.sqrt(values[-1] / value) ** 0.5
        ends = np.outer([-reach, reach], vector) + truth[[i, j]]
        figure.add_trace(
            go.Scatter(
                x=ends[:, 0],
                y=ends[:, 1],
                mode="lines",
                line={"color": "white", "width": 3},
                name=f"eigenvalue {value:.2e}",
            )
        )
    figure.add_trace(
        go.Scatter(
            x=[truth[i]],
            y=[truth[j]],
            mode="markers",
            marker={"color": "red", "symbol": "x"},
            name="truth",
        )
    )
    figure.update_xaxes(title_text="mass of the load m [kg]", range=[mass[0], mass[-1]])
    figure.update_yaxes(title_text="its height zbar_m [m]", range=[height[0], height[-1]])
    figure.update_layout(
        title="Cost over mass and height of the load, others at the truth (as Figure 8.10)",
        legend={"x": 0.01, "y": 0.99, "bgcolor": "rgba(0,0,0,0.4)", "font": {"color": "white"}},
        height=650,
    )
    return figure


def cloud(ends: Mapping[str, Array]) -> Any:
    """Where runs ended, every parameter over z_f, on the family's curve.

    `ends` holds (n, 9) arrays in the order of `NINE`, by optimiser.
    """
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    names = [n for n in NINE if n != "z_f"]
    figure = make_subplots(rows=2, cols=4, subplot_titles=[LABELS[n] for n in names])
    z = np.linspace(*admissible(), 300)
    curve = family(z)
    for place, name in enumerate(names):
        at = {"row": place // 4 + 1, "col": place % 4 + 1}
        figure.add_trace(
            go.Scatter(
                x=z,
                y=curve[name],
                mode="lines",
                line={"color": "#999999"},
                name="the family",
                legendgroup="family",
                showlegend=place == 0,
            ),
            **at,
        )
        for key, x in ends.items():
            figure.add_trace(
                go.Scattergl(
                    x=x[:, NINE.index("z_f")],
                    y=x[:, NINE.index(name)],
                    mode="markers",
                    marker={"color": COLOURS[key], "size": 4, "opacity": 0.5},
                    name=NAMES[key],
                    legendgroup=key,
                    showlegend=place == 0,
                ),
                **at,
            )
        figure.add_trace(
            go.Scatter(
                x=[TABLE_8_2["z_f"]],
                y=[TABLE_8_2[name]],
                mode="markers",
                marker={"color": "red", "symbol": "x", "size": 9},
                name="truth",
                legendgroup="truth",
                showlegend=place == 0,
            ),
            **at,
        )
    figure.update_yaxes(range=[-0.183, -0.181], row=2, col=4)
    figure.update_xaxes(title_text="z_f [m]", row=2)
    figure.update_layout(
        title="Ends of the runs: one curve of parameters has the same data, and z_f is free on it",
        height=700,
    )
    return figure
