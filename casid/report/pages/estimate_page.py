"""The page of an estimate: parameters, fit, and what the fit rests on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from casid.estimation.estimate import Estimate, RecordView
from casid.report.figures.estimates import parameter_figure
from casid.report.figures.look import visible_text
from casid.report.figures.simulated import simulation_figure
from casid.report.pages.estimate_parts import evidence_table, notice, parameter_table, provenance
from casid.report.pages.markup import Html, bullets, element, paragraph, safe, table
from casid.report.pages.numbers import number_text
from casid.report.pages.page import Page


def estimate_page(estimate: Estimate, records: Sequence[RecordView] = ()) -> str:
    """The estimate as one HTML page, with measured against simulated where records are given.

    `records` hold the simulation at the estimate as `baseline`, and no `extended`.
    """
    e = estimate
    figures: dict[str, Any] = {}
    if any(not p.known and math.isfinite(p.value) for p in e.parameters):
        figures["parameters"] = parameter_figure({"estimate": e})
    if records:
        figures["simulation"] = simulation_figure(records)
    page = Page(figures)
    page.section("", _estimate_banner(e), notice((), (*e.suspects, *e.warnings)))
    page.section(
        "Parameters",
        parameter_table({"estimate": e}),
        page.figure("parameters"),
        paragraph(f"Error bars: {e.assumes}"),
    )
    page.section("Fit", _fit_table(e), page.figure("simulation"))
    page.section("May the fit be trusted?", evidence_table({"estimate": e}))
    page.section("Provenance", *provenance(e.provenance, {}, e.versions))
    page.section("References", bullets(e.sources))
    return page.text(f"Estimate of {visible_text(e.problem)}", "Estimate", e.problem)


def _estimate_banner(e: Estimate) -> Html:
    word = "converged" if e.is_converged else "NOT converged"
    starts = f"{e.starts_agreeing} of {e.starts_tried} starts agree"
    return element(
        "div",
        element("p", element("b", word) + safe(f"{e.method}"), class_="word")
        + element("p", f"{e.status} in {e.iterations} iterations; {starts}.", class_="sentence"),
        class_="banner " + ("adequate" if e.is_converged else "deficient"),
        role="status",
    )


def _fit_table(e: Estimate) -> Html:
    rows = []
    for part, rmse, fit in (
        ("fitted", e.rmse, e.nrmse_fit),
        ("held out", e.held_out_rmse, e.held_out_fit),
    ):
        for record, outputs in rmse.items():
            for output, value in outputs.items():
                per_cent = fit.get(record, {}).get(output)
                rows.append(
                    (
                        part,
                        record,
                        output,
                        number_text(value),
                        e.units.get(output, ""),
                        "\u2013" if per_cent is None else f"{per_cent:.1f}",
                    )
                )
    if not rows:
        return Html("")
    return table(
        e.fit_is,
        ("part", "record", "output", "rms error", "unit", "fit [%]"),
        rows,
        numbers=(3, 5),
    )
