"""The page of a designed experiment."""

from __future__ import annotations

from casid.experiment_design.designed_experiment import DesignedExperiment, time_text
from casid.model.quantities import count_text
from casid.report.document import (
    Banner,
    Bullets,
    Card,
    Cards,
    Code,
    Document,
    Figure,
    Section,
    Table,
)
from casid.report.figures.designed_input import designed_input_figure
from casid.report.numbers import value_text
from casid.report.pages.estimate_parts import provenance
from casid.report.texts.designed_experiments import (
    learned_table,
    limit_table,
    outcome_table,
    standard_table,
    start_text,
)


def design_report(found: DesignedExperiment) -> Document:
    """The input, what it is predicted to show, what it gains, and how it was found."""
    banner = Banner(
        time_text(found.duration),
        f"to {found.aim}",
        found.sentence,
        "adequate" if found.is_enough else "undecided",
    )
    cards = [
        Card("against the best standard input", f"{found.gain:.3g}", "times", "the information")
    ]
    if found.outcomes:
        cards.append(Card("power", f"{100 * found.power:.3g}", "%", "for the hardest truth"))
    s = found.solver
    settings = {
        "aim": str(found.aim),
        "found": f"{s.begun_from}; {count_text(s.iterations, 'iteration')} of the solver",
        "compared with": count_text(s.candidates, "standard input"),
        "grid": f"{count_text(s.steps, 'Runge-Kutta step')} an interval",
        "time": f"{s.seconds:.3g} s of the processor",
        "seed": str(s.seed),
    }
    units = found.units
    start = [(Code(n), value_text(v), units.get(n, "")) for n, v in found.initial.items()]
    return Document(
        found.problem,
        [
            banner,
            Cards(cards),
            Section("What to do next", [_advice(found)], look="advice"),
            Section("Input and outputs", [Figure("input", designed_input_figure(found))], "", True),
            Section("Power", [outcome_table(found)] if found.outcomes else [], is_open=True),
            Section("Parameters", [learned_table(found)], is_open=True),
            Section("Standard inputs", [standard_table(found)], is_open=True),
            Section(
                "Limits and start",
                [
                    limit_table(found),
                    Table(("state", "initial value", "unit"), start, numbers=(1,)),
                ],
                is_open=True,
            ),
            Section("Notes", [Bullets(found.notes)]),
            provenance((), settings, found.details.get("versions", {})),
            Section("References", [Bullets(found.references())]),
        ],
        kind="Designed experiment",
    )


def _advice(found: DesignedExperiment) -> str:
    """How to carry the experiment out, and which command answers the question with its record."""
    steps = []
    if any(found.initial.values()):
        steps.append(f"begin at {start_text(found)}")
    if found.inputs:
        steps.append("apply the input below (input.csv has its samples)")
    steps.append(f"record {time_text(found.duration)}")
    command = "identify" if found.aim.kind in ("estimate", "identifiable") else "diagnose"
    text = ", ".join(steps)
    return f"{text[:1].upper()}{text[1:]}, and run casid {command} on the record."
