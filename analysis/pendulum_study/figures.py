"""Figures of the simulation study 7.5.1: signals as Figure 7.10, histograms as 7.11 and 7.12."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from analysis.pendulum_study.runs import THETA, Bench
from casid.arrays import Array
from casid.linear.difference_equation import difference_equation
from problems.pendulum import TABLE_7_2, indirect_model

LABELS = {
    "I_x": "moment of inertia I_x [kg m^2]",
    "d": "damping d [N m s/rad]",
    "m": "mass m [kg]",
    "z_m": "height z_m [m]",
}
NAMES = {"ls": "least squares", "iv": "instruments", "identity": "instruments, Q = I"}
COLOURS = {"ls": "#d95f02", "iv": "#1b9e77", "identity": "#7570b3"}
SIGNALS = {"ref": "reference [m/s^2]", "accel": "a_s [m/s^2]", "gyro": "phi' [rad/s]"}


def signals(bench: Bench, seconds: float = 30.0) -> Any:
    """The first seconds of the loaded record behind the filter, with and without noise."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    study = bench.study
    n = round(seconds / study.Ts)
    drawn = study.draw(study.generator(0))["loaded"]
    t = study.Ts * np.arange(n)
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True)
    for row, (name, label) in enumerate(SIGNALS.items(), start=1):
        for signal, colour, legend in (
            (drawn[name], "#999999", "with noise"),
            (study.clean["loaded"][name], "#1b9e77", "without noise"),
        ):
            figure.add_trace(
                go.Scatter(
                    x=t,
                    y=signal[:n].copy(),
                    line={"color": colour, "width": 1.2},
                    name=legend,
                    showlegend=row == 2,
                ),
                row=row,
                col=1,
            )
        figure.update_yaxes(title_text=label, row=row, col=1)
    figure.update_xaxes(title_text="time [s]", row=3, col=1)
    figure.update_layout(
        title=f"Loaded record behind the low-pass, A = {study.amplitude:g} m/s^2 (as Figure 7.10)",
        height=650,
    )
    return figure


def histograms(table: Any, case: str, estimators: Sequence[str], amplitude: float) -> Any:
    """Physical and linear parameters of one stage over all runs, as Figure 7.11 or 7.12."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    table = table[table["failed"].isna()]
    physical = ("I_x", "d") if case == "nominal" else ("m", "z_m")
    true = _theta(case)
    titles = [LABELS[p] for p in physical] + [f"error of {t}" for t in THETA]
    figure = make_subplots(
        rows=2,
        cols=6,
        specs=[[{"colspan": 3}, None, None] * 2, [{"colspan": 2}, None] * 3],
        subplot_titles=titles,
    )
    for name in estimators:
        shown = [(table[f"{name}.{p}"].to_numpy(), 1, 3 * i + 1) for i, p in enumerate(physical)]
        shown += [
            (table[f"{name}.{t}.{case}"].to_numpy() - true[i], 2, 2 * i + 1)
            for i, t in enumerate(THETA)
        ]
        for x, row, column in shown:
            figure.add_trace(
                go.Histogram(
                    x=x,
                    nbinsx=80,
                    histnorm="probability density",
                    marker={"color": COLOURS[name]},
                    opacity=0.6,
                    name=NAMES[name],
                    legendgroup=name,
                    showlegend=(row, column) == (1, 1),
                ),
                row=row,
                col=column,
            )
    for i, p in enumerate(physical):
        figure.add_vline(x=TABLE_7_2[p], line={"dash": "dash"}, row=1, col=3 * i + 1)
    figure.update_xaxes(exponentformat="power", nticks=5)
    figure.update_yaxes(title_text="density", col=1)
    number = "7.11" if case == "nominal" else "7.12"
    figure.update_layout(
        barmode="overlay",
        height=650,
        title=f"{len(table)} runs, {case} record, A = {amplitude:g} m/s^2 (as Figure {number}); "
        "dashed: the truth",
    )
    return figure


def _theta(case: str) -> Array:
    """(3,) the linear parameters of the true system by the bilinear transform, (7.39)."""
    load = {"m": TABLE_7_2["m"] if case == "loaded" else 0.0}
    names = ("k", "d", "I_x", "z_m")
    model = indirect_model().with_known(**{n: TABLE_7_2[n] for n in names}, **load)
    return np.asarray(difference_equation(model, "gyro", 0.01).theta({}))


def amplitudes(rows: Sequence[Mapping[str, float]]) -> Any:
    """How far the nonlinear truth moves the estimates of linear models, over the amplitude."""
    import plotly.graph_objects as go

    A = [r["amplitude"] for r in rows]
    figure = go.Figure()
    for key, label in (
        ("direct I_x", "direct model (7.10), a_y known: I_x"),
        ("direct k", "direct model (7.10), a_y known: k"),
        ("indirect I_x", "indirect model (7.24): I_x"),
        ("standard error", "standard error of I_x in the study"),
    ):
        dash = "dash" if key == "standard error" else "solid"
        figure.add_trace(
            go.Scatter(x=A, y=[abs(r[key]) for r in rows], name=label, line={"dash": dash})
        )
    figure.update_xaxes(title_text="amplitude of the reference [m/s^2]", type="log")
    figure.update_yaxes(title_text="relative error", type="log", exponentformat="power")
    figure.update_layout(title="Bias of linear models from the nonlinear truth, no noise")
    return figure
