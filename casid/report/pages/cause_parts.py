"""Parts of the page of a diagnosis: its causes and candidates."""

from __future__ import annotations

from casid.diagnosis.diagnosis import Cause, Diagnosis
from casid.report.pages.markup import Html, element, join, paragraph, safe, table
from casid.report.pages.numbers import estimated_texts, number_text, p_text


def cause_part(i: int, c: Cause, figure: Html) -> Html:
    """One cause in its frame: what it is, how sure, how large, and what else it could be.

    `figure` is that of the values by record, empty where one value explains all.
    """
    # A cause without a name is called so: no name of the catalogue may stand in its title.
    kind = safe("unknown cause") if c.kind == "unknown" else element("code", c.kind)
    title = safe(f"{i}. ") + kind + " in " + element("code", c.where)
    facts = f"family-wise p {p_text(c.p_value)}"
    if c.share > 0:
        facts += f"; removes {100 * c.share:.0f} % of the misfit"
    parts = [
        element("h3", Html(title)),
        paragraph(_as_sentence(c.sentence)),
        paragraph(_as_sentence(c.description)),
        element("p", facts, class_="facts"),
    ]
    if c.parameters:
        parts.append(
            table(
                "Parameters of this effect",
                ("parameter", "estimate", "std. error", "95 % interval", "unit", "note"),
                [(p.name, *estimated_texts(p), p.unit, p.note) for p in c.parameters],
                numbers=(1, 2, 3),
            )
        )
    if c.by_record:
        parts += [_record_table(c), figure]
    if c.alternatives:
        parts.append(
            paragraph("Could also be:")
            + element(
                "ul",
                join(
                    element(
                        "li",
                        element("code", a.kind)
                        + safe(" in ")
                        + element("code", a.where)
                        + safe(
                            f" (p {p_text(a.p_value)} against the named one)"
                            + (f": {a.why}" if a.why else "")
                        ),
                    )
                    for a in c.alternatives
                ),
            )
        )
    return element("article", join(parts), class_="cause")


def _as_sentence(text: str) -> str:
    """Diagnoses join the words of several causes to one sentence; here each has its own."""
    text = text[:1].upper() + text[1:]
    return text if not text or text.endswith((".", "!", "?")) else f"{text}."


def _record_table(c: Cause) -> Html:
    rows = [
        (record, p.name, *estimated_texts(p), p.unit, p.note)
        for record, found in c.by_record.items()
        for p in found.values()
    ]
    return table(
        "Record by record: one value does not explain all of them",
        ("record", "parameter", "estimate", "std. error", "95 % interval", "unit", "note"),
        rows,
        numbers=(2, 3, 4),
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


def ranking_table(d: Diagnosis) -> Html:
    """The catalogue as tested in the first round."""
    if not d.ranking:
        return Html("")
    return table(
        "Every candidate as tested in the first round. p: of the candidate alone; family-wise: for "
        "the whole catalogue; gain: fall of the criterion after a refit",
        ("", "effect", "where", "p", "family-wise p", "gain", "status", "why"),
        [
            (
                str(i),
                element("code", r.kind),
                element("code", r.where),
                p_text(r.p_value),
                p_text(r.adjusted),
                "\u2013" if r.gain is None else number_text(r.gain),
                element("span", r.status, class_=f"status {_status_class(r.status)}"),
                r.why,
            )
            for i, r in enumerate(d.ranking, 1)
        ],
        numbers=(3, 4, 5),
    )


def _status_class(status: str) -> str:
    known = ("named", "cannot be rejected", "rejected", "not significant", "invisible")
    return status.replace(" ", "-") if status in known else "other"
