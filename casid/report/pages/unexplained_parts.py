"""Part of the report of a diagnosis: a misfit without a name."""

from __future__ import annotations

from casid.diagnosis.diagnosis import Diagnosis
from casid.diagnosis.evidence.residual.residual_tests import ResidualTests
from casid.errors import UnitError
from casid.model.quantity_names import quantity_of
from casid.report.document import Part, Table
from casid.report.numbers import number_text, p_text, share_text


def unexplained_parts(d: Diagnosis) -> list[Part]:
    """What is known of it: in words, on what it depends, where else it could act, when."""
    u = d.unexplained
    if u is None:
        return []
    parts: list[Part] = [u.sentence]
    if u.best is not None:
        parts.append(
            Table(
                ("depends on", "share of the remainder", "family-wise p", "could also depend on"),
                [
                    (x.words, share_text(x.share, 0), p_text(x.p_value), _rivals(x.rivals))
                    for x in u.best.dependences
                ],
                numbers=(1, 2),
                caption=f"What is missing in {u.best.place} [{u.best.unit}], term by term",
            )
        )
    if len(u.places) > 1 and any(p.dependences for p in u.places):
        places = [
            (
                p.place,
                f"a missing {_quantity(p.unit)}" if p.is_balance else "an error of the sensor",
                share_text(p.explained, 0),
                number_text(p.score),
            )
            for p in u.places
        ]
        parts.append(
            Table(
                ("place", "what", "explained", "score"),
                places,
                numbers=(2, 3),
                caption="Where it could act. Explained: share that functions of states, inputs and "
                "channels explain there; score: this share less what as many functions explain by "
                "chance",
            )
        )
    occurrences = [
        (o.record, number_text(o.start), number_text(o.stop), number_text(o.power))
        for o in u.occurrences
    ]
    head = ("record", "from [s]", "to [s]", "power over the usual")
    caption = "When it is much stronger than elsewhere"
    when = Table(head, occurrences, numbers=(1, 2, 3), caption=caption)
    return [*parts, when, _tests_table(u.tests)]


def _quantity(unit: str) -> str:
    try:
        return quantity_of(unit)
    except UnitError:  # a page does not fail for a text that came with a result
        return "term"


def _tests_table(t: ResidualTests) -> Table:
    rows = [
        ("does its spectrum differ from the noise's?", p_text(t.p_spectrum)),
        ("does it depend on states or inputs?", p_text(t.p_dependence)),
        ("do its mean or its power change in time?", p_text(t.p_time)),
    ]
    caption = f"The remainder, by tests of the residual: {t.verdict}"
    return Table(("", "p"), rows, numbers=(1,), caption=caption)


def _rivals(rivals: tuple[tuple[str, ...], ...]) -> str:
    return ", ".join(" times a function of ".join(r) for r in rivals) or "\u2013"
