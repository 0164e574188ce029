"""Figures of the basin: iterations, the scatter of many draws, and lighter calibration weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from analysis.common.figures import Chart
from analysis.ship_basin.runs import LOAD, Found
from casid.estimation.moments.stages.convergence import Convergence

COLOURS = ("#0072B2", "#D55E00", "#009E73")
AXES = {"m": "weight m [kg]", "zbar_m": "height zbar_m [m]"}

PUBLISHED: Mapping[int, tuple[tuple[float, float], ...]] = {
    1: ((0.1388, -0.3535), (0.1867, -0.2739), (0.1986, -0.2541), (0.1997, -0.2530)),
    2: ((0.3389, -0.2742), (0.3676, -0.2426), (0.3693, -0.2424), (0.3689, -0.2426)),
    3: ((0.2814, -0.3220), (0.3299, -0.2698), (0.3326, -0.2676), (0.3335, -0.2671)),
}
"""m and zbar_m of the first iterations on the basin's own records, section 9.5."""


def iterations(paths: Mapping[int, Convergence], truths: Mapping[int, Mapping[str, float]]) -> Any:
    """m and zbar_m of each case, iteration by iteration, beside those that were published."""
    title = "The first iteration does nearly all; dashed: the true weight and height"
    chart = Chart(title, 600, rows=2, shared_xaxes=True, vertical_spacing=0.06)
    for (case, path), colour in zip(paths.items(), COLOURS, strict=True):
        for row, (n, theirs) in enumerate(zip(LOAD, np.array(PUBLISHED[case]).T, strict=True), 1):
            own = path.theta_p[:, path.names.index(n)]
            for name, values, dash in (
                (f"case {case}", own, "solid"),
                (f"case {case}, published", theirs, "dot"),
            ):
                x = np.arange(len(values))
                chart.line(x, values, name, colour, dash=dash, at=(row, 1), mode="lines+markers")
            chart.figure.add_hline(
                y=truths[case][n], line_dash="dash", line_color=colour, row=row, col=1
            )
            chart.y_axis(AXES[n], row=row)
    chart.x_axis("iteration of Algorithm 8.1", dtick=1, row=2)
    return chart.figure


def scatter(instruments: Found, squares: Found) -> Any:
    """m and zbar_m of every draw, instruments and least squares, one panel a case."""
    cases = instruments.draws.cases
    title = "Least squares misses the split of m zbar_m, instruments scatter about"
    chart = Chart(title, 600, cols=len(cases), subplot_titles=[f"case {c}" for c in cases])
    dots = {"size": 4, "opacity": 0.5}
    for col, case in enumerate(cases, start=1):
        for label, name, found, colour in (
            (f"case {case} IV", "instruments", instruments, COLOURS[0]),
            (f"case {case} LS", "least squares", squares, COLOURS[1]),
        ):
            x, y = (found.column(label, n)[:500] for n in LOAD)
            chart.points(x, y, name, colour, at=(1, col), marker=dots)
        x, y = (np.array([instruments.truth(f"case {case} IV", n)]) for n in LOAD)
        cross = {"symbol": "cross", "size": 10}
        chart.points(x, y, "truth", "black", at=(1, col), marker=cross)
    chart.x_axis(AXES["m"])
    chart.y_axis(AXES["zbar_m"], col=1)
    return chart.figure


def lighter(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Spread of m and zbar_m over the calibration weight."""
    chart = Chart("The lighter the calibration weight, the less precise the load", 600)
    weights = [row["calibration, kg"] for row in rows]
    for n, colour in zip(LOAD, COLOURS, strict=False):
        for what, said, dash in (
            ("spread", "over the draws", "solid"),
            ("std. error", "as reported", "dash"),
        ):
            y = [row[f"{what} of {n}, %"] for row in rows]
            chart.line(weights, y, f"{n}, {said}", colour, dash=dash, mode="lines+markers")
    chart.x_axis("calibration weight m_c [kg]", type="log")
    chart.y_axis("relative error [%]", type="log")
    return chart.figure
