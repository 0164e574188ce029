"""A designed input, the outputs that hypotheses predict under it, and how they differ."""

from __future__ import annotations

from typing import Any

import numpy as np

from casid.arrays import Array
from casid.experiment_design.designed_experiment import DesignedExperiment, LimitUse, words_of
from casid.model.units import difference_from_si, from_si
from casid.report.figures.panels import Panels
from casid.report.figures.style import AFTER, BEFORE, FLOOR, MEASURED, axis_text, hover_text
from casid.report.figures.thinning import POINTS, points_a_trace, thinned

_LOOKS = ((AFTER, "solid"), (BEFORE, "dash"), (FLOOR, "dot"), (MEASURED, "dashdot"))


def designed_input_figure(found: DesignedExperiment) -> Any:
    """Inputs, outputs, and of causes what the rival's best fit leaves, against time.

    A row an input and output, and one more an output where there are rivals: the difference of the
    first truth and its rival, with the 95 % band of the noise.
    """
    outputs = [n for n in found.record if n in found.noise]
    pairs = list(found.records.values())[:2] if found.outcomes else []
    rows = len(found.inputs) + len(outputs) * (2 if len(pairs) == 2 else 1)
    figure = Panels(rows=rows, row_height=190, gap=22, shared_x=True)
    limit = points_a_trace(rows * len(found.records))
    used = {use.name: use for use in found.limits}
    for k, name in enumerate([*found.inputs, *outputs]):
        shown = list(found.records.items())[: 1 if name in found.inputs else len(_LOOKS)]
        for (label, record), look in zip(shown, _LOOKS, strict=False):
            y = np.asarray(from_si(record[name], found.units[name]))
            if name in found.inputs:
                _input(figure, k, found, y, look)
                continue
            _line(figure, k, record.t, y, words_of(found, label), look, (found.units[name], limit))
        _ends(figure, k, found, used.get(name))
        figure.label(k, y=axis_text(name, found.units[name]))
    for j, name in enumerate(outputs if len(pairs) == 2 else []):
        k = len(found.inputs) + len(outputs) + j
        unit = found.units[name]
        gap = np.asarray(difference_from_si(pairs[0][name] - pairs[1][name], unit))
        half = 1.96 * float(difference_from_si(found.noise[name], unit))
        t = pairs[0].t
        figure.band(k, t, np.zeros(len(t)), np.full(len(t), half))
        _line(figure, k, t, gap, "truth minus rival", (FLOOR, "solid"), (unit, limit))
        figure.label(k, y=axis_text(name, unit, "difference of "))
    figure.time_label(rows - 1)
    figure.figure.update_xaxes(range=[0.0, found.duration])
    caption = "The designed input, and the outputs that it is predicted to give, without noise"
    if len(pairs) == 2:
        caption += (
            "; below, what the rival's best fit leaves of them, beside the 95 % band of the noise"
        )
    return figure.done(caption + ".", [])


def _input(
    figure: Panels, k: int, found: DesignedExperiment, y: Array, look: tuple[str, str]
) -> None:
    """An input in its unit (N,): in steps to the end of the record where it is held, else straight.

    Of steps only the samples at which they begin are drawn, so that thinning moves none.
    """
    t, unit = found.record.t, found.units[found.inputs[k]]
    if not found.is_held:
        limit = points_a_trace(len(found.inputs))
        _line(figure, k, t, y, "designed input", look, (unit, limit))
        return
    begins = np.flatnonzero(np.diff(y, prepend=np.inf))
    t, y = np.append(t[begins], found.duration), np.append(y[begins], y[-1])
    _line(figure, k, t, y, "designed input", look, (unit, POINTS), shape="hv")


def _line(
    figure: Panels,
    k: int,
    t: Array,
    y: Array,
    name: str,
    look: tuple[str, str],
    drawn: tuple[str, int],
    *,
    shape: str = "linear",
) -> None:
    unit, limit = drawn
    i = thinned(y, limit)
    figure.add(
        k,
        x=t[i],
        y=y[i],
        name=name,
        mode="lines",
        line={"color": look[0], "dash": look[1], "width": 1.5, "shape": shape},
        hovertemplate=hover_text("s", unit),
    )


def _ends(figure: Panels, k: int, found: DesignedExperiment, use: LimitUse | None) -> None:
    """The limit as two thin lines."""
    for end in () if use is None else (use.lower, use.upper):
        if np.isfinite(end):
            figure.add(
                k,
                x=[0.0, found.duration],
                y=[end, end],
                name="limit",
                mode="lines",
                line={"color": MEASURED, "width": 1, "dash": "dot"},
                hoverinfo="skip",
            )
