"""Rivals judged once more when everything that is missing has been named.

In the round that adopts a cause the others are still missing: the noise model absorbs their misfit,
and what imitates several causes at once looks like a rival of each. With the others in the model,
and under the noise that is then left, a rival must stand in for its cause alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import (
    Adopted,
    Candidate,
    Rival,
    extended_by,
    is_needed,
    name_of,
)
from casid.diagnosis.search.comparison.alternatives import on_common_samples, rivals_of
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import COMPARISON, ROUNDS
from casid.time_limit import require_time


def reconsidered(
    search: Search, adopted: Sequence[Adopted], start: Weighted, at: Weighted
) -> list[Adopted]:
    """The causes with the rivals that the record cannot reject in the end.

    Parameters
    ----------
    start, at : the model as it is and with all causes, under the noise found there.
    """
    out = []
    for a in adopted:
        judged_under_misfit = len(adopted) > 1 or (
            a.before is not None and a.before.noise_absorbs_misfit
        )
        rivals = a.rivals
        others = [b.candidate for b in adopted if b is not a]
        if (
            a.rivals_and_near_ones
            and judged_under_misfit
            and not at.noise_absorbs_misfit
            and not is_needed(start.model, others)
        ):
            search.progress(f"compare {name_of(a.candidate.effect)} with its rivals again")
            again = search.attempts.attempt(
                f"the second judgement of the rivals of {name_of(a.candidate.effect)}",
                partial(_rivals_beside, search, a, others, start, at),
            )
            rivals = rivals if again is None else again
        out.append(replace(a, rivals=rivals))
    return out


def _rivals_beside(
    search: Search, a: Adopted, others: Sequence[Candidate], start: Weighted, at: Weighted
) -> tuple[Rival, ...]:
    """The rivals of one cause with the others in the model."""
    again = without_cause(search, others, start, at)
    found = [
        cause_as_it_is(search, a.candidate, again, at),
        *(
            c
            for b in a.rivals_and_near_ones[: ROUNDS.rivals]
            if (c := search.refitting.again(again, b, near=False)) is not None
        ),
    ]
    require_time("the rivals")  # one that was not refitted is no less a rival
    found = on_common_samples(found)
    # Said relative to the cause as it was adopted, among whose gain was the misfit of the others.
    shift = a.candidate.merit - found[0].merit
    return tuple(
        replace(r, candidate=replace(r.candidate, gain=r.candidate.gain + shift))
        for r in rivals_of(again, found[0], found)
    )


def cause_as_it_is(search: Search, own: Candidate, again: Weighted, at: Weighted) -> Candidate:
    """A cause refitted as its rivals are, or as the model with all causes has it if that is better.

    A refit from its declared start may end elsewhere, and any rival be better than that.
    """
    kept = search.refitting.judged(again, own.effect, own.names, at.model, at.fit)
    refit = search.refitting.again(again, own, near=False)
    return refit if refit is not None and refit.gain > kept.gain else kept


def better_rivals(
    search: Search, adopted: Sequence[Adopted], start: Weighted, at: Weighted
) -> list[Candidate]:
    """Contenders of the last cause that are better under the noise found with it, the best first.

    Where the noise model absorbed misfit, gains were no likelihoods: one that imitates the cause,
    and leaves a little, may have come first. Of those that are hardly better named effects come
    first.
    """
    last = adopted[-1]
    again = without_cause(search, [a.candidate for a in adopted[:-1]], start, at)
    first = cause_as_it_is(search, last.candidate, again, at)
    found = [
        c
        for b in last.rivals_and_near_ones[: ROUNDS.rivals]
        if (c := search.refitting.again(again, b, near=False)) is not None
    ]
    first, *found = on_common_samples([first, *found])
    better = [c for c in found if c.merit > first.merit + COMPARISON.strong]
    most = max((c.merit for c in better), default=0.0)
    best = [c for c in better if c.merit > most - COMPARISON.strong]
    others = [c for c in better if c not in best]
    return [
        *sorted(best, key=lambda c: (c.effect.priority, -c.merit)),
        *sorted(others, key=lambda c: -c.merit),
    ]


def without_cause(
    search: Search, others: Sequence[Candidate], start: Weighted, at: Weighted
) -> Weighted:
    """The model with all causes but one, fitted under the last noise."""
    model, placed = extended_by(start.model, others)
    values = dict(at.fit.values)
    for new, c in zip(placed, others, strict=True):
        values |= {
            name: at.fit.values.get(old, 0.0) for name, old in zip(new.names, c.names, strict=True)
        }
    return replace(at, model=model, fit=search.weighing.fitted(model, at, values), unbiased=None)
