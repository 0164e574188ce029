"""Parts of the report of a diagnosis: its causes and candidates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from casid.diagnosis.diagnosis import Cause, Diagnosis, Ranked
from casid.diagnosis.facts import Facts
from casid.estimation.estimate import Estimated
from casid.report.document import (
    Bullets,
    Figure,
    Paragraph,
    Part,
    Section,
    Status,
    Table,
)
from casid.report.numbers import estimated_texts, in_readable_unit, number_text, p_text
from casid.report.texts.diagnosis import effect_in_words

_SIZES = ("parameter", "estimate", "std. error", "95 % interval", "unit", "note")


def cause_part(i: int, c: Cause, by_record: Figure | None) -> Section:
    """One cause in its frame: what it is, how sure, how large, and what else it could be.

    `by_record` shows the values by record; None where one value explains all.
    """
    title = effect_in_words(c.kind, c.where, c.description)
    facts = f"p {p_text(c.p_value)}"
    if c.share > 0:
        facts += f"; {100 * c.share:.0f} % of what all causes explain"
    sizes = Table(
        _SIZES,
        [_size(p) for p in c.parameters],
        numbers=(1, 2, 3),
        caption=f"Parameters of {c.words}",
    )
    parts: list[Part] = [
        _as_sentence(c.sentence),
        "" if c.description in c.sentence else _as_sentence(c.description),
        Paragraph(facts, look="facts"),
        sizes,
    ]
    if c.by_record:
        parts += [_record_table(c), by_record]
    if c.alternatives:
        others = [
            (
                *effect_in_words(a.kind, a.where, a.description),
                ("" if a.is_as_likely else f" (p {p_text(a.p_value)} against the named one)")
                + (f": {a.why}" if a.why else ""),
            )
            for a in c.alternatives
        ]
        parts += ["Could also be:", Bullets(others)]
    first = f"{i}. one of: " if c.tied else f"{i}. "
    return Section((first, *title, *_others(c)), parts, look="cause")


def _others(c: Cause) -> Iterator[str]:
    """The rest of a title that names everything that the record does not separate."""
    seen = {(c.kind, c.where)}
    for a in c.alternatives if c.tied else ():
        if (a.kind, a.where) not in seen:
            seen.add((a.kind, a.where))
            yield from (", ", *effect_in_words(a.kind, a.where, a.description))


def _size(p: Estimated) -> Sequence[str]:
    p = in_readable_unit(p)
    return (p.name, *estimated_texts(p), p.unit, p.note)


def _as_sentence(text: str) -> str:
    """Diagnoses join the words of several causes to one sentence; here each has its own."""
    text = text[:1].upper() + text[1:]
    return text if not text or text.endswith((".", "!", "?")) else f"{text}."


def _record_table(c: Cause) -> Table:
    return Table(
        ("record", *_SIZES),
        [(record, *_size(p)) for record, found in c.by_record.items() for p in found.values()],
        numbers=(2, 3, 4),
        caption="Record by record: one value does not explain all of them",
    )


def no_cause(d: Diagnosis) -> str:
    """Why no cause is named."""
    if d.verdict == "adequate":
        return (
            "None. No effect of the catalogue explains more than chance would, at a false-alarm "
            f"rate of {d.false_alarm_rate:.2g} for the whole catalogue."
        )
    if d.verdict == "deficient":
        return "Something is missing, but nothing in the catalogue explains it."
    return "None can be named: the record cannot support an answer."


_MOST = 10  # candidates of which more unfold


_FATES = ("named", "cannot be rejected", "rejected", "invisible")  # of what is listed at once


def ranking_parts(d: Diagnosis) -> list[Part]:
    """The catalogue as it was tested: ten candidates, then the others unfold.

    By what became of them, then by their p, and those of the same p by what they gain.
    """
    facts = Facts.of(d)

    def order(r: Ranked) -> tuple[int, float, float]:
        """Place of a row in the table; one without a p-value comes last."""
        p = facts.p_value(r.kind, r.where)
        return _FATES.index(r.status), math.inf if math.isnan(p) else p, -(r.gain or 0.0)

    shown = sorted((r for r in d.ranking if r.status in _FATES), key=order)
    first, others = shown[:_MOST], shown[_MOST:]
    not_significant = [r for r in d.ranking if r.status == "not significant"]
    return [
        _candidates(first, facts, f"{P_VALUE} {_WHICH_TEST} {_GAIN}"),
        Section(f"{len(others)} more", [_candidates(others, facts, "Further candidates")], "fold"),
        Section(
            f"{len(not_significant)} not significant",
            [_candidates(not_significant, facts, "Candidates that are not significant")],
            "fold",
        ),
    ]


P_VALUE = (
    "p: the probability that noise alone makes any of the candidates look this strong "
    "(family-wise)."
)


_GAIN = "Gain: fall of the criterion after a refit"
_WHICH_TEST = (
    "Of what is named, the test is that of the refit at which it was named, as above; of all "
    "others, the score test of the model as it is."
)


def _candidates(rows: Sequence[Ranked], facts: Facts, caption: str) -> Table:
    return Table(
        ("candidate", "p", "gain", "status", "why"),
        [
            (
                effect_in_words(r.kind, r.where, r.law),
                p_text(facts.p_value(r.kind, r.where)),
                "\u2013" if r.gain is None else number_text(r.gain),
                Status("undetectable" if r.status == "invisible" else r.status),
                r.why,
            )
            for r in rows
        ],
        numbers=(1, 2),
        caption=caption,
    )
