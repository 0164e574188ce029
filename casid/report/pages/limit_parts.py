"""Parts of the report of a diagnosis: its limits, and experiments that would move them."""

from __future__ import annotations

import math

from casid.diagnosis.advice.next_experiment import Proposal, record_length_text
from casid.diagnosis.diagnosis import Diagnosis
from casid.model.effects.names import effect_words
from casid.model.quantities import quantity_text
from casid.report.document import Bullets, Identifier, Inline, Part, Table
from casid.report.numbers import number_text
from casid.report.texts.diagnosis import effect_in_words, pairs_table


def inseparable(d: Diagnosis) -> Table | str | None:
    """Effects that this record can neither name nor exclude."""
    rows: list[tuple[Inline, ...]] = []
    listed = set()
    for c in d.causes:
        same = ("indistinguishable from ", *effect_in_words(c.kind, c.where, c.description))
        for a in c.alternatives:
            listed |= {_without_function(a.kind, a.where), (a.kind, a.words)}
            rows.append((effect_in_words(a.kind, a.where, a.description), same, a.why))
    for r in d.ranking:
        names = {_without_function(r.kind, r.where), (r.kind, r.words)}
        if r.status == "cannot be rejected" and not names & listed:
            rows.append((effect_in_words(r.kind, r.where, r.law), r.status, r.why))
    for r in d.ranking:
        if r.status == "invisible" and not d.undetectable:  # else they have a section of their own
            rows.append(
                (effect_in_words(r.kind, r.where, r.law), "undetectable in this record", r.why)
            )
    if not rows:
        is_more = d.isolability is not None and d.isolability.groups
        nothing = "Nothing: every candidate was either named or rejected."
        return nothing if d.ranking and not is_more else None
    caption = "Effects that this record can neither name nor exclude"
    return Table(("effect", "what", "why"), rows, caption=caption)


def _without_function(kind: str, where: str) -> tuple[str, str]:
    """Kind and place as alternatives have them, where the place of an unknown has no function."""
    return kind, where.partition(": ")[0] if kind == "unknown" else where


def pairs_parts(d: Diagnosis) -> list[Part]:
    """Causes that act nearly alike in this record, and the pairs hardest to distinguish."""
    found = d.isolability
    if found is None:
        return []
    same = [
        "Nearly alike in this record, so that only a large misfit separates them: "
        + ", ".join(found.words(key) for key in group)
        for group in found.groups
    ]
    return [Bullets(same), pairs_table(found, in_words=True)]


def undetectable_parts(d: Diagnosis) -> list[Part]:
    """Causes that this set-up or this record cannot show, why, and the remedy."""
    if not d.undetectable:
        return []
    rows = [
        (
            effect_in_words(i.kind, i.where, i.law),
            "any record of these channels" if i.is_structural else "this record",
            i.why,
            i.remedy,
        )
        for i in d.undetectable
    ]
    caption = "Effects that the model's own parameters can imitate, so that they leave no trace"
    return [
        "That these were not found does not mean that they are absent.",
        Table(("effect", "undetectable in", "why", "remedy"), rows, caption=caption),
    ]


def proposals_table(d: Diagnosis) -> Table:
    """Next experiments, the best first."""
    rows = [
        (
            str(i),
            p.name,
            p.description,
            (*_in_words(p, 0), " from ", *_in_words(p, 1)),
            _length_text(p),
            f"{p.gain_factor:.3g}" if math.isfinite(p.gain_factor) else "\u2013",
            number_text(p.cosine),
        )
        for i, p in enumerate(d.proposals, 1)
    ]
    return Table(
        ("", "experiment", "what to do", "separates", "record needed", "gain", "cosine"),
        rows,
        numbers=(4, 5, 6),
        caption="What to record next, the shortest record first. Separates: the pair that is "
        "hardest to separate in it; gain: energy that separating them takes in this record, over "
        "that in the proposed one",
    )


def _in_words(p: Proposal, which: int) -> tuple[str, ...]:
    """One of the pair that a proposal separates, in words, and its identifier."""
    key = p.pair[which]
    return p.words[which] or effect_words(*key), " ", Identifier(key[0])


def _length_text(p: Proposal) -> str:
    """How long a record an experiment takes, and whether anybody would make it."""
    if not math.isfinite(p.record_length):
        return "never"
    if not p.is_realistic:
        return f"more than {record_length_text(p.longest_stated)} (too long)"
    return quantity_text(p.record_length, "s") + ("" if p.is_feasible else " (too long)")


def calibration_parts(d: Diagnosis) -> list[Part]:
    """The false-alarm rate found on records like this one."""
    c = d.calibration
    if c is None:
        return []
    low, high = c.interval
    rows = [
        ("requested false-alarm rate", f"{100 * c.alpha:.3g} %"),
        ("rate found", f"{100 * c.rate:.3g} % ({100 * low:.2g} .. {100 * high:.2g} %)"),
        ("null records", f"{c.runs}"),
        ("level that this record is judged at", f"{c.threshold:.3g}"),
    ]
    caption = "False alarms on records simulated with the fitted model"
    return [f"{c.sentence}.", Table(("", "value"), rows, caption=caption), Bullets(c.notes)]
