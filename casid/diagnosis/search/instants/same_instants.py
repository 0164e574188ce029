"""Other changes for a while at the instants of the best one: one event, seen in each of them.

What is over soon scores on a coarse grid of instants by how it happens to lie there, so that one
parameter may be refitted of several that explain it equally well: a push between two bodies, or a
spring that is soft as long. At the instants of the best candidate, whose refit is at hand, the
tangents show what every other change would leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from casid.diagnosis.evidence.scores.score_tests import Score, ScoreTable, scan
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, name_of
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.thresholds import JUMPS, SHORTLIST
from casid.model.effects.clock_effects import at_instant


def changes_at_the_same_instants(
    refitting: Refitting, at: Weighted, table: ScoreTable, found: Sequence[Candidate]
) -> list[Candidate]:
    """Further changes for a while between the instants of the best candidate, where it has an end.

    Those that would gain nearly as much by their tangents are refitted, unless they were there.
    """
    best = max(found, key=lambda c: c.merit, default=None)
    if best is None or best.effect.end is None:
        return []
    what = f"other changes at the instants of {name_of(best.effect)}"
    promising = refitting.attempts.attempt(what, partial(_promising, at, table, best)) or []
    known = {(c.effect.key, c.effect.variant, c.effect.end) for c in found}
    out = []
    for score in promising:
        effect = score.effect
        if (effect.key, effect.variant, effect.end) not in known:
            twin = refitting.refit(at, effect, score.step, near=True)
            out += [] if twin is None else [replace(twin, score=score)]
    return out


def _promising(at: Weighted, table: ScoreTable, best: Candidate) -> list[Score]:
    """The scores of changes that gain nearly as much as the best one at its instants."""
    assert best.effect.variant is not None
    of_each = {s.effect.key: s for s in table.scores if s.effect.sets_in and s.is_visible}
    of_each.pop(best.effect.key, None)
    if not of_each:
        return []
    span = best.effect.variant, best.effect.end
    effects = [at_instant(s.effect, at.model, *span) for s in of_each.values()]
    left = scan(best.fit, best.names[0], effects)
    enough = 2 * at.fit.solution.value - JUMPS.promising * best.gain
    order = [int(i) for i in np.argsort(left)[: SHORTLIST.passing] if left[i] < enough]
    scores = list(of_each.values())
    return [replace(scores[i], effect=effects[i]) for i in order]
