"""Figures of a diagnosis: its candidates, what naming the causes gains, and all of them by name."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from casid.diagnosis.diagnosis import Diagnosis
from casid.diagnosis.unexplained.description import Unexplained
from casid.model.quantities import common_prefix
from casid.report.figures.candidate_ranking import ranking_figure
from casid.report.figures.estimates import parameter_figure
from casid.report.figures.misfit_shares import remaining_figure
from casid.report.figures.moved_parameters import moved_figure
from casid.report.figures.panels import Panels
from casid.report.figures.residuals import residual_against_figure, residual_spectrum_figure
from casid.report.figures.simulated import residual_time_figure, simulation_figure
from casid.report.figures.sizes_by_record import by_record_figure
from casid.report.figures.style import AFTER, BEFORE, FLOOR, axis_text, figure_text, visible_text


def diagnosis_figures(diagnosis: Diagnosis) -> dict[str, Any]:
    """Every figure that the diagnosis has content for, by name, in the order of the report."""
    figures: dict[str, Any] = {}
    if diagnosis.records:
        figures["simulation"] = simulation_figure(diagnosis.records)
        figures["residual_time"] = residual_time_figure(diagnosis.records)
        if diagnosis.records[0].states or diagnosis.records[0].inputs:
            figures["residual_against"] = residual_against_figure(diagnosis.records)
        figures["residual_spectrum"] = residual_spectrum_figure(
            diagnosis.records, _noise_floor(diagnosis)
        )
    if any(r.status != "invisible" for r in diagnosis.ranking):
        figures["ranking"] = ranking_figure(diagnosis)
    if any(not p.known and math.isfinite(p.value) for p in diagnosis.baseline.parameters):
        figures["parameters"] = parameter_figure(diagnosis.estimates)
    if any(p.get("baseline_rmse") for p in (diagnosis.fitted, diagnosis.held_out)):
        figures["gain"] = gain_figure(diagnosis)
    for i, cause in enumerate(diagnosis.causes, 1):
        if cause.by_record:
            figures[f"by_record_{i}"] = by_record_figure(cause)
    if diagnosis.remaining is not None and diagnosis.causes:
        figures["remaining"] = remaining_figure(diagnosis.remaining)
    if diagnosis.unexplained is not None:
        # Numbers, not names: a page takes these for its anchors, and names come from files.
        drawn = enumerate(_unknown_figures(diagnosis.unexplained), 1)
        figures |= {f"unknown_{i}": figure for i, figure in drawn}
    if diagnosis.moved:
        figures["moved"] = moved_figure(diagnosis.moved, diagnosis.problem)
    if diagnosis.isolability is not None and len(diagnosis.isolability.keys) > 1:
        figures["isolability"] = diagnosis.isolability.plot()
    if diagnosis.calibration is not None and diagnosis.calibration.runs > 1:
        figures["calibration"] = diagnosis.calibration.plot()
    return figures


def gain_figure(diagnosis: Diagnosis) -> Any:
    """Root mean square error before and after and the noise floor, fitted and held out.

    One panel an output, in the output's own unit.

    Raises
    ------
    ValueError
        If the diagnosis holds no rms error.
    """
    parts = {"fitted": diagnosis.fitted, "held out": diagnosis.held_out}
    outputs = list(
        dict.fromkeys(o for part in parts.values() for o in part.get("baseline_rmse", {}))
    )
    if not outputs:
        raise ValueError("the diagnosis holds no rms error to draw")
    units = diagnosis.output_units
    figure = Panels(panels=len(outputs), columns=min(2, len(outputs)), row_height=260, gap=50)
    looks = [
        ("baseline_rmse", "before" if diagnosis.extended else "simulated", BEFORE, ""),
        ("extended_rmse", "after", AFTER, ""),
        ("noise_floor", "noise floor", FLOOR, "/"),
    ]
    for k, output in enumerate(outputs):
        top = 0.0
        sizes = [float(e[output]) for p in parts.values() for e in p.values() if output in e]
        scale, unit = common_prefix(sizes, units.get(output, ""))
        for key, label, colour, pattern in looks:
            found = {
                name: float(part[key][output]) / scale
                for name, part in parts.items()
                if output in part.get(key, {}) and math.isfinite(part[key][output])
            }
            if not found:
                continue
            top = max(top, *found.values())
            figure.add(
                k,
                kind="Bar",
                x=list(found),
                y=list(found.values()),
                name=label,
                text=[f"{v:.3g}" for v in found.values()],
                textposition="outside",
                constraintext="none",
                cliponaxis=False,
                marker=_bar_look(colour, pattern),
                hovertemplate=f"%{{y:.4g}} {figure_text(unit)}",
            )
        if top > 0:
            figure.y_range(k, [0, 1.18 * top])
        figure.label(k, y=axis_text(output, unit, "rms error of "))
    figure.figure.update_xaxes(type="category", categoryarray=list(parts), categoryorder="array")
    figure.figure.update_layout(bargap=0.25)
    caption = f"Root mean square simulation error of {visible_text(diagnosis.problem)}"
    caption += ", before and after the extension" if diagnosis.extended else ""
    return figure.done(caption + ", against the noise floor where it is known.", ())


def _bar_look(colour: str, pattern: str) -> dict[str, Any]:
    """The colour of a bar, and the white pattern on it that tells it apart without colours."""
    lines = {"shape": pattern, "fgcolor": "#ffffff", "fillmode": "overlay"}
    return {"color": colour, "pattern": lines}


def _noise_floor(diagnosis: Diagnosis) -> Mapping[str, float]:
    return diagnosis.held_out.get("noise_floor") or diagnosis.fitted.get("noise_floor") or {}


def _unknown_figures(unexplained: Unexplained) -> Iterator[Any]:
    """The missing part as a function, over time where it is loudest, and in frequency."""
    from casid.report.figures.unexplained import (
        dependence_figure,
        missing_spectrum_figure,
        missing_time_figure,
    )

    best = unexplained.best
    if best is None or not unexplained.is_something:
        return
    if any(d.at.size > 1 and d.at.size == d.value.size for d in best.dependences):
        yield dependence_figure(unexplained)
    if best.over_time is not None and best.over_time.series:
        loudest = max(unexplained.occurrences, key=lambda o: o.power, default=None)
        names = [s.name for s in best.over_time.series]
        at = names.index(loudest.record) if loudest and loudest.record in names else 0
        yield missing_time_figure(unexplained, at)
        yield missing_spectrum_figure(unexplained)
