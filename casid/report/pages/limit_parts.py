"""Parts of the page of a diagnosis: its limits, and experiments that would move them."""

from __future__ import annotations

import math

from casid.diagnosis.diagnosis import Diagnosis
from casid.report.pages.markup import Html, bullets, element, join, paragraph, table
from casid.report.pages.numbers import number_text

_PAIRS = 12  # in the table of pairs
_NEVER = 1e6  # beyond it, an energy means never


def inseparable(d: Diagnosis) -> Html:
    """Effects that this record can neither name nor exclude."""
    rows: list[tuple[str, ...]] = [
        (
            element("code", a.kind),
            element("code", a.where),
            Html(f"indistinguishable from {element('code', c.kind)} in {element('code', c.where)}"),
            a.why,
        )
        for c in d.causes
        for a in c.alternatives
    ]
    listed = {(a.kind, a.where) for c in d.causes for a in c.alternatives}
    for r in d.ranking:
        if r.status == "cannot be rejected" and (r.kind, r.where) not in listed:
            rows.append((element("code", r.kind), element("code", r.where), r.status, r.why))
    for r in d.ranking:
        if r.status == "invisible" and not d.invisible:  # else they have a section of their own
            rows.append(
                (
                    element("code", r.kind),
                    element("code", r.where),
                    "undetectable in this record",
                    r.why,
                )
            )
    if not rows:
        is_more = d.isolability is not None and d.isolability.groups
        nothing = "Nothing: every candidate was either named or rejected."
        return paragraph(nothing) if d.ranking and not is_more else Html("")
    return table(
        "Effects that this record can neither name nor exclude",
        ("effect", "where", "what", "why"),
        rows,
    )


def pairs_part(d: Diagnosis) -> Html:
    """Causes that are the same in this record, and the pairs that are hardest to distinguish."""
    found = d.isolability
    if found is None:
        return Html("")
    same = [
        "Indistinguishable in this record: "
        + ", ".join(f"{kind} in {where}" for kind, where in group)
        for group in found.groups
    ]
    rows = [
        (
            _effect(p.first),
            _effect(p.second),
            f"{p.cosine:+.3f}",
            number_text(p.energy) if p.energy < _NEVER else "never",
        )
        for p in found.pairs[:_PAIRS]
    ]
    if not rows:
        return bullets(same)
    return bullets(same) + table(
        f"Hardest to distinguish. Energy: of the misfit, in units of the noise, at which the right "
        f"one wins by {found.margin:g} units of BIC with probability {found.power:g}",
        ("cause", "or", "cosine", "energy needed"),
        rows,
        numbers=(2, 3),
    )


def invisible_part(d: Diagnosis) -> Html:
    """Causes that this set-up or this record cannot show, why, and the remedy."""
    if not d.invisible:
        return Html("")
    rows = [
        (
            element("code", i.kind),
            element("code", i.where),
            "any record of these channels" if i.is_structural else "this record",
            i.why,
            i.remedy,
        )
        for i in d.invisible
    ]
    return paragraph("That these were not found does not say that they are not there.") + table(
        "Effects that do nothing to the outputs which the model's own parameters could not do",
        ("effect", "where", "invisible in", "why", "remedy"),
        rows,
    )


def proposals_part(d: Diagnosis) -> Html:
    """Next experiments, the best first."""
    if not d.proposals:
        return Html("")
    rows = [
        (
            str(i),
            p.name,
            p.description,
            element("span", _effect(p.pair[0]) + " from " + _effect(p.pair[1])),
            _seconds(p.record_length),
            f"{p.gain_factor:.3g}" if math.isfinite(p.gain_factor) else "\u2013",
            number_text(p.cosine),
        )
        for i, p in enumerate(d.proposals, 1)
    ]
    return table(
        "What to record next, by how soon it separates the tied causes. Separates: the hardest "
        "pair in it; seconds: of record needed; gain: how many times less visible the misfit may "
        "be than in this record",
        ("", "experiment", "what to do", "separates", "seconds", "gain", "cosine"),
        rows,
        numbers=(4, 5, 6),
    )


def calibration_part(d: Diagnosis) -> Html:
    """The false-alarm rate found on records like this one."""
    c = d.calibration
    if c is None:
        return Html("")
    low, high = c.interval
    rows = [
        ("requested false-alarm rate", f"{100 * c.alpha:.3g} %"),
        ("rate found", f"{100 * c.rate:.3g} % ({100 * low:.2g} .. {100 * high:.2g} %)"),
        ("null records", f"{c.runs}"),
        ("level that this record is judged at", f"{c.threshold:.3g}"),
    ]
    return join(
        (
            paragraph(f"{c.sentence}."),
            table("False alarms on records that the fitted model drew", ("", "value"), rows),
            bullets(c.notes),
        )
    )


def _effect(key: tuple[str, str]) -> Html:
    return element("code", key[0]) + " in " + element("code", key[1])


def _seconds(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "never"
