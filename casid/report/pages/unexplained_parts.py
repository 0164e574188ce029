"""Part of the page of a diagnosis: a misfit without a name."""

from __future__ import annotations

from casid.diagnosis.diagnosis import Diagnosis
from casid.diagnosis.evidence.residual_tests import ResidualTests
from casid.report.pages.markup import Html, join, paragraph, table
from casid.report.pages.numbers import number_text, p_text


def unexplained_part(d: Diagnosis) -> Html:
    """What is known of it: in words, on what it depends, where else it could act, when."""
    u = d.unexplained
    if u is None:
        return Html("")
    best = u.best
    parts = [paragraph(u.sentence)]
    if best is not None and best.dependences:
        parts.append(
            table(
                f"What is missing in {best.place} [{best.unit}], term by term",
                ("depends on", "share of the remainder", "family-wise p", "could also depend on"),
                [
                    (x.words, _share(x.share), p_text(x.p_value), _rivals(x.rivals))
                    for x in best.dependences
                ],
                numbers=(1, 2),
            )
        )
    if len(u.places) > 1 and any(p.dependences for p in u.places):
        parts.append(
            table(
                "Where it could act: what functions of states, inputs and channels explain of it "
                "there; score: less what as many functions explain by chance",
                ("place", "what", "explained", "score"),
                [
                    (
                        p.place,
                        "a missing force" if p.is_balance else "an error of the sensor",
                        _share(p.explained),
                        number_text(p.score),
                    )
                    for p in u.places
                ],
                numbers=(2, 3),
            )
        )
    if u.occurrences:
        parts.append(
            table(
                "When it is much stronger than elsewhere",
                ("record", "from [s]", "to [s]", "power over the usual"),
                [
                    (o.record, number_text(o.start), number_text(o.stop), number_text(o.power))
                    for o in u.occurrences
                ],
                numbers=(1, 2, 3),
            )
        )
    parts.append(_tests_table(u.tests))
    return join(parts)


def _tests_table(t: ResidualTests) -> Html:
    rows = [
        ("does its spectrum differ from the noise's?", p_text(t.p_spectrum)),
        ("does it depend on states or inputs?", p_text(t.p_dependence)),
        ("do its mean or its power change in time?", p_text(t.p_time)),
    ]
    return table(
        f"The remainder, by tests of the residual: {t.verdict}", ("", "p"), rows, numbers=(1,)
    )


def _share(share: float) -> str:
    return f"{100 * share:.0f} %"


def _rivals(rivals: tuple[tuple[str, ...], ...]) -> str:
    return ", ".join(" times a function of ".join(r) for r in rivals) or "\u2013"
