"""The page of a diagnosis: the verdict first, then why, then everything it rests on."""

from __future__ import annotations

from casid.diagnosis.diagnosis import Diagnosis
from casid.report.figures.diagnosis import diagnosis_figures
from casid.report.figures.look import visible_text
from casid.report.pages.cause_parts import cause_part, no_cause, ranking_table
from casid.report.pages.estimate_parts import (
    error_bars,
    evidence_table,
    notice,
    parameter_table,
    provenance,
)
from casid.report.pages.limit_parts import (
    calibration_part,
    inseparable,
    invisible_part,
    pairs_part,
    proposals_part,
)
from casid.report.pages.markup import Html, bullets, element, join, mapping_table, paragraph, safe
from casid.report.pages.numbers import change_text, number_text, plus_minus
from casid.report.pages.page import Page
from casid.report.pages.remainder_parts import gain_table, moved_part, remaining_part
from casid.report.pages.unexplained_parts import unexplained_part

_VERDICTS = {
    "adequate": "The model explains this record",
    "deficient": "The model is missing something",
    "undecided": "This record cannot decide",
}
_FIGURE_NAMES = {
    "simulation": "Measured against simulated",
    "residual_time": "Simulation error against time",
    "residual_against": "Simulation error against states and inputs",
    "residual_spectrum": "Simulation error in frequency",
}


def diagnosis_page(diagnosis: Diagnosis) -> str:
    """The diagnosis as one HTML page; the same diagnosis gives the same page, byte for byte."""
    d = diagnosis
    figures = diagnosis_figures(d)
    page = Page(figures)
    estimates = d.estimates
    warnings = [w for e in estimates.values() for w in e.warnings]

    page.section("", _banner(d), _key_numbers(d), notice(d.notes, warnings))
    page.section(
        "Causes",
        join(cause_part(i, c, page.figure(f"by_record_{i}")) for i, c in enumerate(d.causes, 1))
        or paragraph(no_cause(d)),
        element("div", element("h3", "Advice") + paragraph(d.advice), class_="advice")
        if d.advice
        else "",
    )
    page.section("What remains", remaining_part(d), page.figure("remaining"))
    unknown = [page.figure(n) for n in figures if n.startswith("unknown_")]
    page.section("What is unknown", unexplained_part(d), *unknown)
    page.section("Parameters that moved", moved_part(d), page.figure("moved"))
    for name, heading in _FIGURE_NAMES.items():
        if name in figures:
            page.section(heading, page.figure(name))
    page.section("Ranked candidates", ranking_table(d), page.figure("ranking"))
    page.section(
        "Parameters",
        parameter_table(estimates),
        page.figure("parameters"),
        join(paragraph(line) for line in error_bars(estimates)),
    )
    page.section("Gain", gain_table(d), page.figure("gain"))
    page.section(
        "What cannot be distinguished", inseparable(d), page.figure("isolability"), pairs_part(d)
    )
    page.section("Undetectable in this set-up", invisible_part(d))
    page.section("Next experiment", proposals_part(d))
    page.section("Calibration", calibration_part(d), page.figure("calibration"))
    page.section("Noise", mapping_table(d.noise, ("channel", "what is known of its noise")))
    page.section("May the fits be trusted?", evidence_table(estimates))
    page.section("Provenance", *provenance(d.provenance, d.settings, d.versions))
    page.section("References", bullets(d.sources))
    return page.text(f"Diagnosis of {visible_text(d.problem)}", "Diagnosis", d.problem)


def _banner(d: Diagnosis) -> Html:
    verdict = d.verdict if d.verdict in _VERDICTS else "undecided"
    return element(
        "div",
        element("p", element("b", d.verdict) + safe(_VERDICTS[verdict]), class_="word")
        + element("p", d.sentence, class_="sentence"),
        class_=f"banner {verdict}",
        role="status",
    )


def _key_numbers(d: Diagnosis) -> Html:
    units = d.output_units
    cards = []
    for part, numbers in (("held out", d.held_out), ("fitted", d.fitted)):
        for output, before in numbers.get("baseline_rmse", {}).items():
            after = numbers.get("extended_rmse", {}).get(output)
            floor = numbers.get("noise_floor", {}).get(output)
            unit = units.get(output, "")
            if after is None:
                value, rest = number_text(before), ""
            else:
                value = f"{number_text(before)} \u2192 {number_text(after)}"
                rest = f"error {change_text(before, after)}"
            if floor is not None:
                rest += ("; " if rest else "") + f"noise floor {number_text(floor)}"
            cards.append(
                element("dt", f"rms error of {output}, {part}")
                + element("dd", safe(value + " ") + element("small", unit))
                + element("dd", rest, class_="rest")
            )
        if cards:
            break  # held-out numbers say it all; the table below has the rest
    for c in d.causes[:1]:
        for p in c.parameters[:2]:
            cards.append(
                element("dt", f"{p.name}, new parameter")
                + element("dd", safe(plus_minus(p) + " ") + element("small", p.unit))
                + element("dd", f"{c.kind} in {c.where}", class_="rest")
            )
    if not cards:
        return Html("")
    return element("dl", join(element("div", c, class_="card") for c in cards[:8]), class_="cards")
