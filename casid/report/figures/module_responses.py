"""Figure of one module as several methods estimate it: magnitude and phase with 95 % bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.report.figures.style import AFTER, BEFORE, FLOOR, MEASURED, figure_text
from casid.unknown_inputs.networks.estimation.module_estimate import ModuleEstimate
from casid.unknown_inputs.networks.nodes import edge_label

COLOURS = (AFTER, BEFORE, FLOOR, "#CC79A7")
DASHES = ("solid", "dash", "dot", "dashdot")


def response_figure(
    estimates: Sequence[ModuleEstimate], true: Rational | None = None, *, points: int = 200
) -> Any:
    """Magnitude [-] and phase [deg] against angular frequency [rad/s], up to the Nyquist frequency.

    Parameters
    ----------
    estimates : of one module, by several methods or from several records.
    true : the module itself, where it is known.

    Raises
    ------
    ModelError
        If there is no estimate, or they are of different modules.
    """
    from plotly.subplots import make_subplots

    first = _first_of_one_module(estimates)
    nyquist = np.pi / first.data.Ts
    omega = np.geomspace(nyquist / 1000, nyquist * (1 - 1e-9), points)
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    if true is not None:
        value = true.frequency_response(omega)
        _lines(figure, omega, value, "true", MEASURED, "solid")
    for k, e in enumerate(estimates):
        colour, found = COLOURS[k % 4], e.response(omega)
        low, high = found.band()
        figure.add_scatter(
            x=np.concatenate([omega, omega[::-1]]),
            y=np.concatenate([high, np.maximum(low, 1e-12)[::-1]]),
            fill="toself",
            fillcolor=colour,
            opacity=0.2,
            line={"width": 0},
            name=f"{e.method} 95 %",
            hoverinfo="skip",
            row=1,
            col=1,
        )
        doubt = "" if e.consistency.is_consistent else ", not consistent"
        _lines(figure, omega, found.value, e.method + doubt, colour, DASHES[k % 4])
    floor = float(np.min(np.abs(first.response(omega).value)))
    top = max(float(np.max(e.response(omega).band()[1])) for e in estimates)
    figure.update_yaxes(
        type="log",
        title="magnitude |G| [-]",
        range=[np.log10(max(floor, 1e-12) / 3), np.log10(1.2 * top)],
        row=1,
        col=1,
    )
    figure.update_yaxes(title="phase [deg]", row=2, col=1)
    figure.update_xaxes(type="log")
    figure.update_xaxes(title="angular frequency omega [rad/s]", row=2, col=1)
    kept = first.equation
    what = edge_label(first.module) if kept.is_kept else f"what {edge_label(first.module)} becomes"
    caption = f"{what} from {first.data.name}, with 95 % bands at each frequency"
    figure.update_layout(title=figure_text(caption, 120), meta={"caption": caption})
    return figure


def _first_of_one_module(estimates: Sequence[ModuleEstimate]) -> ModuleEstimate:
    if not estimates:
        raise ModelError("no estimate to draw; give one or more of one module")
    first = estimates[0]
    other = [e for e in estimates if e.module != first.module]
    if other:
        raise ModelError(
            f"estimates of {edge_label(first.module)} and of {edge_label(other[0].module)}; draw "
            "each module in a figure of its own"
        )
    return first


def _lines(figure: Any, omega: Any, value: Any, name: str, colour: str, dash: str) -> None:
    line = {"color": colour, "dash": dash}
    phase = np.rad2deg(np.unwrap(np.angle(value)))
    for row, y in ((1, np.abs(value)), (2, phase)):
        figure.add_scatter(
            x=omega, y=y, mode="lines", name=name, line=line, showlegend=row == 1, row=row, col=1
        )
