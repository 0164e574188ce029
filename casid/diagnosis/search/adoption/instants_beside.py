"""The instant of a change where a random disturbance acts as well.

The least simulation error places it where the disturbance, too, is smallest: a slow one moves it by
many samples, and what the two instants leave between them looks like a further cause. Under the
disturbance that the change leaves, the instant is as sharp as the records make it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from casid.diagnosis.evidence.whitening.weighted_model import minus_log_likelihood
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement
from casid.diagnosis.search.candidates import name_of
from casid.diagnosis.search.disturbance.disturbance_price import explaining_disturbance
from casid.diagnosis.search.instants.jump_times import events_of, placed_by_refits


def with_last_change_placed(refine: Refinement, found: Adoption) -> Adoption:
    """With the change that was adopted last at its instant beside the disturbance it leaves.

    `found` itself where the last cause is no change that stays, a disturbance does not explain what
    it leaves, or no other instant is likelier.
    """
    last, search = found.adopted[-1], refine.search
    effect = last.candidate.effect
    if found.fit is None or not effect.sets_in or effect.end is not None:
        return found
    own = explaining_disturbance(search, found.at, found.fit)
    if own is None:
        return found
    before, again = last.before or refine.start, search.with_disturbances()
    bare = again.weighing.fitted(before.model, own, before.fit.values)
    at = replace(own, model=before.model, fit=bare, unbiased=None)
    first = again.refitting.again(at, last.candidate)
    if first is None:
        return found
    others = [a.candidate for a in found.adopted[:-1]]
    what, known = f"the instant of {name_of(effect)}", events_of(others)
    search.progress(f"find {what}")
    scan_of = partial(placed_by_refits, again.refitting, at, first, known)
    best = again.refitting.attempts.attempt(what, scan_of)
    if best is None or best.effect.variant == effect.variant:
        return found
    causes, fit = refine.with_causes(
        [*others, replace(last.candidate, effect=best.effect)], found.fit
    )
    adopted = [replace(a, candidate=c) for a, c in zip(found.adopted, causes, strict=True)]
    new = refine.reweighed(found, adopted, fit)
    there = search.under_disturbance(fit)
    return min((own, found), (there, new), key=lambda each: minus_log_likelihood(each[0]))[1]
