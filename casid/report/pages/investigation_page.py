"""The page of an investigation: its steps, the last answer, and the experiment to record next."""

from __future__ import annotations

from casid.diagnosis.investigation import Investigation
from casid.model.quantities import count_text
from casid.report.document import Banner, Card, Cards, Document, Figure, Part, Section
from casid.report.figures.designed_input import designed_input_figure
from casid.report.figures.simulated import diagnosis_figure
from casid.report.texts.designed_experiments import limit_table, outcome_table, standard_table
from casid.report.texts.investigations import step_table


def investigation_report(found: Investigation) -> Document:
    """What is known after the last record, and what would decide."""
    last, design = found.diagnosis, found.next
    decided = found.is_decided
    banner = Banner(
        "decided" if decided else "tied",
        f"after {count_text(len(found.records), 'record')}",
        last.sentence,
        "adequate" if decided else "undecided",
    )
    cards = [
        Card("records", str(len(found.records))),
        Card("designed experiments", str(len(found.designs))),
    ]
    parts: list[Part] = [banner, Cards(cards)]
    if design is not None:
        parts.append(
            Section(
                "The experiment to record next",
                [
                    "Play input.csv, record it, and run the investigation again with all records.",
                    design.sentence,
                    Figure("next", designed_input_figure(design)),
                    outcome_table(design),
                    standard_table(design),
                    limit_table(design),
                ],
                is_open=True,
            )
        )
    elif not decided:
        parts.append(Section("Why it ends here", [found.ending], is_open=True))
    parts.append(Section("Steps", [step_table(found)], is_open=True))
    parts.append(
        Section("Last diagnosis", [Figure("diagnosis", diagnosis_figure(last))], is_open=True)
    )
    return Document(found.problem, parts, kind="Investigation")
