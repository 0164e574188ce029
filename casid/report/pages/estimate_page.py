"""The report of an estimate: parameters, fit, and what the fit rests on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from casid.data.experiment import Experiment
from casid.errors import CasidError
from casid.estimation.estimate import Estimate, RecordView
from casid.estimation.free_simulation import simulated_views
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.report.document import Banner, Bullets, Document, Part, Section, Table, figure_parts
from casid.report.figures.estimates import parameter_figure
from casid.report.figures.simulated import simulation_figure
from casid.report.numbers import interval_lines, number_text
from casid.report.pages.estimate_parts import evidence_table, notice, parameter_table, provenance
from casid.report.verdicts import judged_estimate


def moment_report(found: MomentEstimate, experiments: Sequence[Experiment] = ()) -> Document:
    """The estimate from moments, with measured against simulated outputs of `experiments`.

    Moment equations simulate nothing: each record is simulated from its recorded inputs with the
    estimated values, and of these only the initial state is fitted to it.
    """
    e = found.estimate
    views: tuple[RecordView, ...] = ()
    remarks: list[Part] = []
    if experiments:
        try:
            views = simulated_views(e, experiments)
            remarks.append(
                "Every record is simulated from its recorded inputs with the estimated values; "
                "only its initial state is fitted."
            )
        except CasidError as error:
            remarks.append(f"Not simulated: {error}")
    report = estimate_report(e, views, remarks)
    if len(found.stages) < 2 and found.prior is None:
        return report
    head = ("parameter", "std. error", "with earlier stages taken as exact", "unit")
    rows = [
        (
            name,
            number_text(found.std_error(name)),
            number_text(found.std_error(name, propagated=False)),
            found.parameter(name).unit,
        )
        for name in found.names
    ]
    at = next(i for i, part in enumerate(report.parts) if _is_headed(part, "Known values"))
    stages = Section("Stages", [Table(head, rows, numbers=(1, 2))])
    return replace(report, parts=[*report.parts[:at], stages, *report.parts[at:]])


def _is_headed(part: Part, heading: str) -> bool:
    return isinstance(part, Section) and part.heading == heading


def estimate_report(
    estimate: Estimate,
    records: Sequence[RecordView] | None = None,
    remarks: Sequence[Part] = (),
) -> Document:
    """The estimate, with measured against simulated where there are records.

    `records` hold the simulation at the estimate as `baseline`, and no `extended`; by default they
    are the estimate's own. `remarks` on the simulation stand before its figure.
    """
    e = estimate
    records = e.records if records is None else records
    figures: dict[str, Any] = {}
    if any(not p.known and math.isfinite(p.value) for p in e.parameters):
        figures["parameters"] = parameter_figure({"estimate": e})
    if records:
        figures["simulation"] = simulation_figure(records)
    figure = figure_parts(figures).get
    known = {p.name for p in e.parameters if p.known}
    unknown = [n for n in e.names if n not in known]
    assumed = [f"Error bars: {e.assumes}", *(f"Intervals of {line}" for line in interval_lines(e))]
    judged = judged_estimate(e)
    advice = Section("What to do next", [judged.advice], look="advice")
    banner = Banner(judged.word, judged.beside, judged.sentence, judged.look)
    return Document(
        e.problem,
        [
            Section("", [banner, notice((), (*e.suspects, *e.warnings)), advice], is_open=True),
            Section("Parameters", [parameter_table({"estimate": e}, unknown)], is_open=True),
            Section("Measured against simulated", [*remarks, figure("simulation")], is_open=True),
            Section("Fit", [_fit_table(e)]),
            Section("Intervals", [figure("parameters"), *assumed]),
            Section("Known values", [parameter_table({"estimate": e}, sorted(known))]),
            Section("Solver, identifiability, residuals", [evidence_table({"estimate": e})]),
            provenance(e.provenance, {}, e.versions),
            Section("References", [Bullets(e.sources)]),
        ],
        kind="Estimate",
    )


def _fit_table(e: Estimate) -> Table:
    rows = []
    for part, rmse, fit in (
        ("fitted", e.rmse, e.nrmse_fit),
        ("held out", e.held_out_rmse, e.held_out_fit),
    ):
        for record, outputs in rmse.items():
            for output, value in outputs.items():
                per_cent = fit.get(record, {}).get(output)
                shown = "\u2013" if per_cent is None else f"{per_cent:.1f}"
                unit = e.units.get(output, "")
                rows.append((part, record, output, number_text(value), unit, shown))
    head = ("part", "record", "output", "rms error", "unit", "fit [%]")
    return Table(head, rows, numbers=(3, 5), caption=e.fit_is)
