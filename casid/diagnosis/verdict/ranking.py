"""The first round's candidates, and what became of each."""

from __future__ import annotations

from collections.abc import Sequence

from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.verdict.cause import Cause, Ranked
from casid.model.effects.names import law_of


def ranking(
    search: Search, adopted: Sequence[Adopted], causes: Sequence[Cause]
) -> tuple[Ranked, ...]:
    """The first round's candidates, most significant first, one row a kind and place."""
    named = {c.key for c in causes} | {a.candidate.effect.key for a in adopted}
    tied = {(x.kind, x.where) for c in causes for x in c.alternatives}
    tied |= {r.candidate.effect.key for a in adopted for r in a.rivals}
    gains = {c.effect.key: c.gain for c in search.first_candidates}
    refused = {c.effect.key: why.text for c, why in search.refused}
    rows: dict[tuple[str, str], Ranked] = {}
    if search.first_table is None:
        return ()
    for s in sorted(
        (*search.first_table.scores, *search.first_table.peaks),
        key=lambda s: (s.adjusted, s.p_value),
    ):
        key = s.effect.key
        if key in rows:
            continue
        why = refused.get(key, "")
        if key in named:
            status = "named"
        elif not s.is_visible:
            status = "invisible"
            why = "the baseline's own parameters and initial state absorb it in this record"
        elif key in tied:
            status = "cannot be rejected"
        elif key in gains or s.adjusted < search.alpha:
            status = "rejected"
            why = why or "another candidate explains the misfit better"
        else:
            status = "not significant"
        law = law_of(s.effect.kind, s.effect.description)
        rows[key] = Ranked(*key, s.p_value, s.adjusted, gains.get(key), status, why, law)
    return tuple(rows.values())
