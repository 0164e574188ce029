"""Figures of section 8.6: the cost over mass and height as Figure 8.10, and where runs end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from analysis.common.figures import Chart
from analysis.ship_initial_values.runs import Program, admissible, family
from casid.arrays import Array
from problems.ship import NINE, TABLE_8_2, indirect_model

LABELS = {n: f"{n} [{p.unit}]" for n, p in indirect_model().parameters.items()}
LOOKS = {
    "nine": ("Ipopt, stopped at an optimum", "#1b9e77"),
    "end": ("Ipopt, to its own end", "#d95f02"),
    "trust region": ("trust region", "#7570b3"),
}
"""Name and colour of each optimiser's ends."""


def cost_map(program: Program, n: int = 121) -> Any:
    """log10 of the cost over (m, zbar_m), the others at the truth, with the Hessian's axes."""
    truth = np.array([TABLE_8_2[name] for name in NINE])
    sought = [NINE.index("m"), NINE.index("zbar_m")]
    mass, height = np.linspace(0.2, 0.8, n), np.linspace(-0.4, -0.04, n)
    V, x = np.empty((n, n)), truth.copy()
    for row, column in np.ndindex(n, n):
        x[sought] = mass[column], height[row]
        V[row, column] = 0.5 * np.sum(program.residual(x) ** 2)
    J = program.residual_slopes(truth)[:, sought]
    values, vectors = np.linalg.eigh(J.T @ J)
    title = "Cost over mass and height of the load, others at the truth (as Figure 8.10)"
    chart = Chart(title, 650)
    look: dict[str, Any] = {
        "colorscale": "Viridis",
        "ncontours": 30,
        "colorbar": {"title": "log10 V"},
    }
    chart.add("Contour", x=mass, y=height, z=np.log10(np.maximum(V, 1e-16)), **look)
    z_f = TABLE_8_2["z_f"]
    moment = TABLE_8_2["m"] * (TABLE_8_2["zbar_m"] + z_f)
    chart.line(mass, moment / mass - z_f, "m z_m constant", "white", dash="dot")
    for value, vector in zip(values, vectors.T, strict=True):
        reach = 0.03 * np.sqrt(values[-1] / value) ** 0.5
        x, y = (np.outer([-reach, reach], vector) + truth[sought]).T
        chart.line(x, y, f"eigenvalue {value:.2e}", line={"color": "white", "width": 3})
    x, y = truth[sought, None]
    chart.points(x, y, "truth", "red", marker={"symbol": "x"})
    chart.x_axis("mass of the load m [kg]", range=[mass[0], mass[-1]])
    chart.y_axis("its height zbar_m [m]", range=[height[0], height[-1]])
    legend = {"x": 0.01, "y": 0.99, "bgcolor": "rgba(0,0,0,0.4)", "font": {"color": "white"}}
    chart.figure.update_layout(legend=legend)
    return chart.figure


def cloud(ends: Mapping[str, Array]) -> Any:
    """Where runs ended, every parameter over z_f, on the family's curve.

    `ends` holds (n, 9) arrays in the order of `NINE`, by optimiser.
    """
    names = [n for n in NINE if n != "z_f"]
    title = "Ends of the runs: one curve of parameters has the same data, and z_f is free on it"
    chart = Chart(title, 700, rows=2, cols=4, subplot_titles=[LABELS[n] for n in names])
    z = np.linspace(*admissible(), 300)
    curve = family(z)
    for place, name in enumerate(names):
        at = place // 4 + 1, place % 4 + 1
        chart.line(z, curve[name], "the family", "#999999", at=at)
        for key, x in ends.items():
            (label, colour), (z_f, y) = LOOKS[key], x[:, [NINE.index("z_f"), NINE.index(name)]].T
            look = {"marker": {"color": colour, "size": 4, "opacity": 0.5}, "mode": "markers"}
            chart.add("Scattergl", at, name=label, x=z_f, y=y, **look)
        true = np.array([[TABLE_8_2["z_f"]], [TABLE_8_2[name]]])
        chart.points(true[0], true[1], "truth", "red", at=at, marker={"symbol": "x", "size": 9})
    chart.y_axis(range=[-0.183, -0.181], row=2, col=4)
    chart.x_axis("z_f [m]", row=2)
    return chart.figure
