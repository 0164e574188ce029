"""Figures of the simulation study 7.5.1: signals as Figure 7.10, histograms as 7.11 and 7.12."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from analysis.common.figures import Chart
from analysis.pendulum_study.runs import THETA, Bench
from casid.arrays import Array
from casid.linear.sampled.difference_equation import difference_equation
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
    study = bench.study
    t = study.Ts * np.arange(round(seconds / study.Ts))
    drawn, clean = study.draw(study.generator(0))["loaded"], study.clean["loaded"]
    title = f"Loaded record behind the low-pass, A = {study.amplitude:g} m/s^2 (as Figure 7.10)"
    chart = Chart(title, 650, rows=3, shared_xaxes=True)
    for row, (name, label) in enumerate(SIGNALS.items(), start=1):
        chart.line(t, drawn[name][: t.size].copy(), "with noise", "#999999", at=(row, 1))
        chart.line(t, clean[name][: t.size], "without noise", "#1b9e77", at=(row, 1))
        chart.y_axis(label, row=row)
    chart.x_axis("time [s]", row=3)
    return chart.figure


def histograms(table: Any, case: str, estimators: Sequence[str], amplitude: float) -> Any:
    """Physical and linear parameters of one stage over all runs, as Figure 7.11 or 7.12."""
    table = table[table["failed"].isna()]
    physical = ("I_x", "d") if case == "nominal" else ("m", "z_m")
    number = "7.11" if case == "nominal" else "7.12"
    true = _theta(case)
    chart = Chart(
        f"{len(table)} runs, {case} record, A = {amplitude:g} m/s^2 (as Figure {number}); "
        "dashed: the truth",
        650,
        rows=2,
        cols=6,
        specs=[[{"colspan": 3}, None, None] * 2, [{"colspan": 2}, None] * 3],
        subplot_titles=[LABELS[p] for p in physical] + [f"error of {t}" for t in THETA],
    )
    for name in estimators:
        look: dict[str, Any] = {"histnorm": "probability density", "nbinsx": 80, "opacity": 0.6}
        look |= {"name": NAMES[name], "marker": {"color": COLOURS[name]}}
        for i, p in enumerate(physical):
            chart.add("Histogram", (1, 3 * i + 1), x=table[f"{name}.{p}"].to_numpy(), **look)
        for i, t in enumerate(THETA):
            error = table[f"{name}.{t}.{case}"].to_numpy() - true[i]
            chart.add("Histogram", (2, 2 * i + 1), x=error, **look)
    for i, p in enumerate(physical):
        chart.figure.add_vline(x=TABLE_7_2[p], line={"dash": "dash"}, row=1, col=3 * i + 1)
    chart.x_axis(exponentformat="power", nticks=5)
    chart.y_axis("density", col=1)
    chart.figure.update_layout(barmode="overlay")
    return chart.figure


def _theta(case: str) -> Array:
    """(3,) the linear parameters of the true system by the bilinear transform, (7.39)."""
    load = {"m": TABLE_7_2["m"] if case == "loaded" else 0.0}
    names = ("k", "d", "I_x", "z_m")
    model = indirect_model().with_known(**{n: TABLE_7_2[n] for n in names}, **load)
    return np.asarray(difference_equation(model, "gyro", 0.01).theta({}))


def amplitudes(rows: Sequence[Mapping[str, float]]) -> Any:
    """How far the nonlinear truth moves the estimates of linear models, over the amplitude."""
    chart = Chart("Bias of linear models from the nonlinear truth, no noise")
    A = [r["amplitude"] for r in rows]
    for key, label, dash in (
        ("direct I_x", "direct model (7.10), a_y known: I_x", "solid"),
        ("direct k", "direct model (7.10), a_y known: k", "solid"),
        ("indirect I_x", "indirect model (7.24): I_x", "solid"),
        ("standard error", "standard error of I_x in the study", "dash"),
    ):
        chart.line(A, [abs(r[key]) for r in rows], label, dash=dash, mode="lines+markers")
    chart.x_axis("amplitude of the reference [m/s^2]", type="log")
    chart.y_axis("relative error", type="log", exponentformat="power")
    return chart.figure
