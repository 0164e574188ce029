"""The report of a diagnosis: the verdict first, then why, then everything it rests on."""

from __future__ import annotations

from collections.abc import Iterator

from casid.diagnosis.diagnosis import Diagnosis
from casid.report.document import (
    Banner,
    Bullets,
    Card,
    Cards,
    Document,
    Part,
    Section,
    figure_parts,
    mapping_table,
)
from casid.report.figures.diagnosis import diagnosis_figures
from casid.report.numbers import change_text, number_text, plus_minus
from casid.report.pages.cause_parts import cause_part, no_cause, ranking_table
from casid.report.pages.estimate_parts import (
    error_bars,
    evidence_table,
    notice,
    parameter_table,
    provenance,
)
from casid.report.pages.limit_parts import (
    calibration_parts,
    inseparable,
    pairs_parts,
    proposals_table,
    undetectable_parts,
)
from casid.report.pages.model_page import equation_changes
from casid.report.pages.remainder_parts import (
    disturbance_parts,
    gain_table,
    moved_table,
    remaining_parts,
    small_remainders,
)
from casid.report.pages.unexplained_parts import unexplained_parts
from casid.report.texts.diagnosis import gain_rows

_VERDICTS = {
    "adequate": "The model explains this record",
    "deficient": "The model is missing something",
    "undecided": "This record cannot decide",
}
_OPEN = (  # in a notebook
    "",
    "Causes",
    "Small remainders",
    "Disturbances",
    "Equations",
    "Measured against simulated",
    "Gain",
)
_FIGURE_NAMES = {
    "simulation": "Measured against simulated",
    "residual_time": "Simulation error against time",
    "residual_against": "Simulation error against states and inputs",
    "residual_spectrum": "Simulation error in frequency",
}


def diagnosis_report(diagnosis: Diagnosis) -> Document:
    """Everything the diagnosis knows; the same diagnosis gives the same report."""
    d = diagnosis
    figures = figure_parts(diagnosis_figures(d))
    figure, estimates = figures.get, d.estimates
    warnings = [w for e in estimates.values() for w in e.warnings]
    causes: list[Part] = [
        cause_part(i, c, figure(f"by_record_{i}")) for i, c in enumerate(d.causes, 1)
    ]
    advice = Section("Advice", [d.advice], look="advice")
    unknown = [f for name, f in figures.items() if name.startswith("unknown_")]
    pairs = pairs_parts(d)
    noise = mapping_table(d.noise, ("channel", "what is known of its noise"))
    sections: dict[str, list[Part]] = {
        "": [_banner(d), Cards(list(_key_numbers(d))[:8]), notice(d.notes, warnings)],
        "Causes": [*(causes or [no_cause(d)]), advice],
        "Equations": equation_changes(d.model),
        "Small remainders": small_remainders(d),
        "Disturbances": disturbance_parts(d),
        "What remains": [*remaining_parts(d), figure("remaining")],
        "What is unknown": [*unexplained_parts(d), *unknown],
        "Parameters that moved": [moved_table(d), figure("moved")],
        **{heading: [figure(name)] for name, heading in _FIGURE_NAMES.items()},
        "Ranked candidates": [ranking_table(d), figure("ranking")],
        "Parameters": [parameter_table(estimates), figure("parameters"), *error_bars(estimates)],
        "Gain": [gain_table(d), figure("gain")],
        "What cannot be distinguished": [inseparable(d), figure("isolability"), *pairs],
        "Undetectable in this set-up": undetectable_parts(d),
        "Next experiment": [proposals_table(d)],
        "Calibration": [*calibration_parts(d), figure("calibration")],
        "Noise": [noise],
        "May the fits be trusted?": [evidence_table(estimates)],
    }
    return Document(
        d.problem,
        [
            *(Section(h, parts, is_open=h in _OPEN) for h, parts in sections.items()),
            provenance(d.provenance, d.settings, d.versions),
            Section("References", [Bullets(d.sources)]),
        ],
        kind="Diagnosis",
    )


def _banner(d: Diagnosis) -> Banner:
    look = d.verdict if d.verdict in _VERDICTS else "undecided"
    return Banner(d.verdict, _VERDICTS[look], d.sentence, look)


def _key_numbers(d: Diagnosis) -> Iterator[Card]:
    """Errors of what was held out, else of what was fitted, then sizes of the first cause.

    A table further down has the rest.
    """
    shown = "held out" if d.held_out.get("baseline_rmse") else "fitted"
    for part, output, before, after, floor in gain_rows(d):
        if part != shown:
            continue
        value, rest = number_text(before), list[str]()
        if after is not None:
            value += f" \u2192 {number_text(after)}"
            rest.append(f"error {change_text(before, after)}")
        if floor is not None:
            rest.append(f"noise floor {number_text(floor)}")
        unit = d.output_units.get(output, "")
        yield Card(f"rms error of {output}, {part}", value, unit, "; ".join(rest))
    for c in d.causes[:1]:
        for p in c.parameters[:2]:
            where = f"{c.kind} in {c.where}"
            yield Card(f"{p.name}, new parameter", plus_minus(p), p.unit, where)
