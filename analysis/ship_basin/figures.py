"""Figures of the basin: iterations, the scatter of many draws, and lighter calibration weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from analysis.ship_basin.runs import LOAD, Found
from casid.estimation.moments.convergence import Convergence

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
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for (case, path), colour in zip(paths.items(), COLOURS, strict=True):
        own = np.array([path.theta_p[:, path.names.index(n)] for n in LOAD])
        theirs = np.array(PUBLISHED[case]).T
        for line, n in enumerate(LOAD):
            kinds = ((own, "solid", f"case {case}"), (theirs, "dot", f"case {case}, published"))
            for values, dash, name in kinds:
                figure.add_trace(
                    go.Scatter(
                        x=np.arange(values.shape[1]),
                        y=values[line],
                        mode="lines+markers",
                        name=name,
                        legendgroup=name,
                        showlegend=line == 0,
                        line={"color": colour, "dash": dash},
                    ),
                    row=line + 1,
                    col=1,
                )
            figure.add_hline(
                y=truths[case][n], line_dash="dash", line_color=colour, row=line + 1, col=1
            )
            figure.update_yaxes(title_text=AXES[n], row=line + 1, col=1)
    figure.update_xaxes(title_text="iteration of Algorithm 8.1", dtick=1, row=2, col=1)
    return _titled(
        figure, "The first iteration does nearly all; dashed: the true weight and height"
    )


def scatter(instruments: Found, squares: Found) -> Any:
    """m and zbar_m of every draw, instruments and least squares, one panel a case."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    cases = instruments.draws.cases
    figure = make_subplots(rows=1, cols=len(cases), subplot_titles=[f"case {c}" for c in cases])
    for col, case in enumerate(cases, start=1):
        kinds = (("IV", instruments, COLOURS[0]), ("LS", squares, COLOURS[1]))
        for name, found, colour in kinds:
            x, y = (found.column(f"case {case} {name}", n)[:500] for n in LOAD)
            figure.add_trace(
                go.Scatter(
                    x=x,
                    y=y,
                    mode="markers",
                    name={"IV": "instruments", "LS": "least squares"}[name],
                    legendgroup=name,
                    showlegend=col == 1,
                    marker={"color": colour, "size": 4, "opacity": 0.5},
                ),
                row=1,
                col=col,
            )
        truth = [instruments.truth(f"case {case} IV", n) for n in LOAD]
        figure.add_trace(
            go.Scatter(
                x=[truth[0]],
                y=[truth[1]],
                mode="markers",
                name="truth",
                legendgroup="truth",
                showlegend=col == 1,
                marker={"color": "black", "symbol": "cross", "size": 10},
            ),
            row=1,
            col=col,
        )
        figure.update_xaxes(title_text=AXES["m"], row=1, col=col)
    figure.update_yaxes(title_text=AXES["zbar_m"], row=1, col=1)
    return _titled(figure, "Least squares misses the split of m zbar_m, instruments scatter about")


def lighter(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Spread of m and zbar_m over the calibration weight."""
    import plotly.graph_objects as go

    figure = go.Figure()
    weights = [row["calibration, kg"] for row in rows]
    for n, colour in zip(LOAD, COLOURS, strict=False):
        for what, dash in (("spread", "solid"), ("std. error", "dash")):
            figure.add_trace(
                go.Scatter(
                    x=weights,
                    y=[row[f"{what} of {n}, %"] for row in rows],
                    mode="lines+markers",
                    name=f"{n}, {'over the draws' if what == 'spread' else 'as reported'}",
                    line={"color": colour, "dash": dash},
                )
            )
    figure.update_xaxes(type="log", title_text="calibration weight m_c [kg]")
    figure.update_yaxes(type="log", title_text="relative error [%]")
    return _titled(figure, "The lighter the calibration weight, the less precise the load")


def _titled(figure: Any, title: str) -> Any:
    figure.update_layout(template="plotly_white", title=title, height=600)
    return figure
