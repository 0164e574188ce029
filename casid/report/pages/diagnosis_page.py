"""The report of a diagnosis: what decides on one screen, then why, then everything it rests on."""

from __future__ import annotations

from collections.abc import Iterator

from casid.diagnosis.diagnosis import Diagnosis
from casid.diagnosis.facts import Facts
from casid.report.document import (
    Banner,
    Bullets,
    Card,
    Cards,
    Document,
    Equations,
    Inline,
    Paragraph,
    Part,
    Section,
    Table,
    figure_parts,
    mapping_table,
)
from casid.report.figures.diagnosis import diagnosis_figures
from casid.report.numbers import change_text, estimated_texts, in_readable_unit, p_text
from casid.report.pages.cause_parts import P_VALUE, cause_part, no_cause, ranking_parts
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
from casid.report.pages.model_page import changed_equations, equation_changes
from casid.report.pages.remainder_parts import (
    disturbance_parts,
    gain_table,
    moved_table,
    remaining_parts,
    small_remainders,
)
from casid.report.pages.unexplained_parts import unexplained_parts
from casid.report.texts.diagnosis import effect_in_words

_VERDICTS = {
    "adequate": "The model explains this record",
    "deficient": "The model is missing something",
    "undecided": "This record does not decide",
}
_FIGURE_NAMES = {
    "residual_against": "Simulation error against states and inputs",
    "residual_spectrum": "Simulation error in frequency",
}


def diagnosis_report(diagnosis: Diagnosis) -> Document:
    """Everything the diagnosis knows; the same diagnosis gives the same report."""
    d = diagnosis
    figures = figure_parts(diagnosis_figures(d))
    figure, estimates = figures.get, d.estimates
    causes: list[Part] = [
        cause_part(i, c, figure(f"by_record_{i}")) for i, c in enumerate(d.causes, 1)
    ]
    unknown = [f for name, f in figures.items() if name.startswith("unknown_")]
    noise = mapping_table(d.noise, ("channel", "what is known about its noise"))
    folded: dict[str, list[Part]] = {
        "Causes in detail": [*(causes or [no_cause(d)]), *small_remainders(d)],
        "Equations before and after": equation_changes(d.model, _mark(d)),
        "Gain": [gain_table(d), figure("gain")],
        "What remains": [*remaining_parts(d), figure("remaining")],
        "What is unknown": [*unexplained_parts(d), *unknown],
        "Disturbances": disturbance_parts(d),
        "Parameters that moved": [moved_table(d), figure("moved")],
        "Parameters": [parameter_table(estimates), figure("parameters"), *error_bars(estimates)],
        "What cannot be distinguished": [inseparable(d), figure("isolability"), *pairs_parts(d)],
        "Next experiment": [proposals_table(d)],
        "Undetectable in this set-up": undetectable_parts(d),
        "All candidates": [*ranking_parts(d), figure("ranking")],
        **{heading: [figure(name)] for name, heading in _FIGURE_NAMES.items()},
        "Evidence for the fits": [evidence_table(estimates)],
        "Calibration": [*calibration_parts(d), figure("calibration")],
        "Noise": [noise],
        "Notes": [Bullets(d.notes)],
    }
    return Document(
        d.problem,
        [
            *decision(d),
            Section(
                "Measured against simulated",
                [figure("simulation"), figure("residual_time")],
                is_open=True,
            ),
            *(Section(h, parts) for h, parts in folded.items()),
            provenance(d.provenance, d.settings, d.versions),
            Section("References", [Bullets(d.sources)]),
        ],
        kind="Diagnosis",
    )


def decision(d: Diagnosis) -> list[Section]:
    """What decides, on one screen: verdict, gain, how sure, what to change, what to do next."""
    facts = Facts.of(d)
    # A bound that the model without the causes ends at, as their error, is no warning of theirs.
    warnings = (d.extended or d.baseline).warnings
    look = d.verdict if d.verdict in _VERDICTS else "undecided"
    words = _VERDICTS[look]
    if look == "adequate" and any(each.is_dominant for each in d.disturbances):
        words = "A disturbance that nobody recorded makes most of the residual"
    banner = Banner(d.verdict, words, d.sentence, look)
    cards = Cards([*_gains(facts), *_how_sure(d, facts)][:8])
    explained = Paragraph(P_VALUE, look="facts") if d.causes else None
    change = [_nearest(d), _changed_equations(d), _new_parameters(d)] if d.causes else []
    return [
        Section("", [banner, cards, explained, notice((), warnings)], is_open=True),
        Section("What to change in the model", change, is_open=True),
        Section("", [Section("What to do next", [d.advice], look="advice")], is_open=True),
    ]


def _gains(facts: Facts) -> Iterator[Card]:
    """Errors of what was held out, else of what was fitted."""
    for c, (before, after, floor), unit in facts.change_texts():
        if c not in facts.shown:
            continue
        value = " \u2192 ".join(filter(None, (before, after)))
        rest = [f"error {change_text(c.before, c.after)}"] if c.after is not None else []
        rest += [f"noise floor {floor} {unit}"] if floor else []
        yield Card(f"rms error of {c.output}, {c.part}", value, unit, "; ".join(rest))


def _how_sure(d: Diagnosis, facts: Facts) -> Iterator[Card]:
    for c in d.causes[:2]:
        p = p_text(facts.p_value(*c.key))
        text = p if p.startswith("<") else f"= {p}"
        others = f"; not separated from {len(c.tied) - 1} other" if c.tied else ""
        others += "s" if len(c.tied) > 2 else ""
        yield Card("significance", f"p {text}", "", "".join((c.words, others)))


def _changed_equations(d: Diagnosis) -> Equations | None:
    """The equations that the causes changed, the new terms marked."""
    model = d.model
    if model is None or model.baseline is None:
        return None
    return changed_equations(model, _mark(d))


def _mark(d: Diagnosis) -> str:
    """What the terms that the extended model adds are called."""
    return "nearest" if d.extends_by_nearest else "new"


def _nearest(d: Diagnosis) -> Paragraph | None:
    """What the marked terms are where the cause has no name in the catalogue."""
    if not d.extends_by_nearest:
        return None
    unknown = next(c for c in d.causes if c.kind == "unknown")
    near = " and ".join(a.words for a in unknown.alternatives[:1]) or "the effects that were tried"
    return Paragraph(
        f"What is missing is an {unknown.words}, which the catalogue has no effect for. The terms "
        f"marked as nearest are no correction of the model: they are {near}, with which the fit "
        "after was made, and which leaves a misfit that is not noise."
    )


def _new_parameters(d: Diagnosis) -> Table:
    """The new parameters, with what they stand for."""
    rows: list[tuple[Inline, ...]] = []
    for c in d.causes:
        for p in map(in_readable_unit, c.parameters):
            value, error, between = estimated_texts(p)
            words = effect_in_words(c.kind, c.where, c.description)
            rows.append((p.name, value, error, between, p.unit, words))
    return Table(
        ("new parameter", "estimate", "std. error", "95 % interval", "unit", "of"),
        rows,
        numbers=(1, 2, 3),
        caption="Estimates of the new parameters",
    )
