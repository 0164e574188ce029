"""A change at an instant, renamed to the effect that explains it best there.

An event is named once, and no other change is sought at its instant. Its first name is chosen while
the event is still missing from the model: where a load is taken off, the fit without it has such
wrong parameters that no refit of the mass converges to the truth, and a constant force is named for
its weight. With the cause included the model is near the truth, and linearised fits there show
which of the effects that may set in at this instant leaves the smallest residual in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from casid.diagnosis.evidence.scores.score_tests import scan
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement, whole_fit
from casid.diagnosis.search.candidates import Adopted, Candidate, as_placed, name_of
from casid.diagnosis.search.comparison.simulation_errors import (
    on_common_samples,
    simulation_errors,
    why_held_out,
)
from casid.diagnosis.thresholds import JUDGING
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.clock_effects import KNOCK, at_instant
from casid.model.effects.effect import Effect
from casid.model.model import Model


def with_last_event_renamed(refine: Refinement, found: Adoption) -> Adoption:
    """With the cause adopted last replaced by another effect at its instant that errs clearly less.

    `found` itself where there is none, the last cause sets in at no instant, or it leaves only
    noise.
    """
    last, absorbs = found.adopted[-1].candidate, found.at.noise_absorbs_misfit
    if found.fit is None or not absorbs or not _is_event(last.effect):
        return found
    # Under the noise of the model without it, it is placed roughly.
    moved = refine.with_refitted_instants(found)
    last, fit = moved.adopted[-1].candidate, moved.fit
    assert fit is not None
    other = _best_in_place(refine, last, fit)
    if other is None:
        return found
    pair = f"{name_of(last.effect)} with {name_of(other)} at its instant"
    refine.search.progress(f"compare {pair}")
    what = f"the comparison of {pair}"
    renamed = partial(_renamed, refine, moved.adopted, other, fit)
    tried = refine.search.attempts.attempt(what, renamed)
    return found if tried is None else refine.reweighed(found, *tried)


def _is_event(effect: Effect) -> bool:
    """True of an effect that sets in at an instant, other than a knock."""
    return effect.sets_in and effect.variant is not None and effect.shape != KNOCK


def _best_in_place(refine: Refinement, own: Candidate, fit: Fit) -> Effect | None:
    """The effect with the smallest residual at the instant of `own`; None if that is its own."""
    table, instant = refine.search.first_table, own.effect
    if table is None or instant.variant is None:
        return None
    kinds = {s.effect.key: s.effect for s in table.tested if _is_event(s.effect)}
    others = [e for key, e in kinds.items() if key != own.effect.key]

    def moved(model: Model) -> list[Effect]:
        assert instant.variant is not None
        return [at_instant(e, model, instant.variant, instant.end) for e in [own.effect, *others]]

    best = int(np.argmin(scan(fit, own.names[0], moved(fit.criterion.model))))
    return None if best == 0 else moved(refine.start.model)[best]


def _renamed(
    refine: Refinement, adopted: Sequence[Adopted], other: Effect, fit: Fit
) -> tuple[list[Adopted], Fit] | None:
    """The causes with another effect in the place of the last one, and their fit.

    Fitted beside it first, and then alone from there. None where it does not err clearly less.
    Where it does, the last cause and its own rivals are no rivals of the other effect.
    """
    model, names = other.extended(fit.criterion.model)
    both = whole_fit(model, refine.split, refine.settings, refine.units, fit.values)
    causes = [a.candidate for a in adopted]
    causes[-1] = replace(causes[-1], effect=other, names=names, model=model, fit=both, score=None)
    placed, alone = refine.with_causes(causes, both)
    errors = [simulation_errors(f, refine.split, refine.units) for f in (fit, alone)]
    old, new = on_common_samples(*errors)
    if not new.square < (1 - JUDGING.practical) * old.square or why_held_out(old, new):
        return None
    judged = _judged(refine, adopted[-1], placed[-1], alone)
    if judged is None:
        return None
    kept = as_placed(adopted, placed)
    return [*kept[:-1], replace(adopted[-1], candidate=judged, rivals=(), near=())], alone


def _judged(refine: Refinement, last: Adopted, new: Candidate, fit: Fit) -> Candidate | None:
    """The new candidate with the gain and score of the round that adopted the last cause."""
    search, before = refine.search, last.before or refine.start
    again = search.refitting.again(before, replace(new, fit=fit))
    if again is None or search.first_table is None:
        return None
    own = [s for s in search.first_table.tested if s.effect.key == new.effect.key]
    score = max(own, key=lambda s: s.unrobust)
    return replace(new, fit=fit, gain=again.gain, cost=again.cost, wald=again.wald, score=score)
