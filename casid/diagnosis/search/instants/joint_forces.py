"""One force that acts in two balances at once, from an instant on or for a while.

A gust pushes a car and turns it: neither a force alone nor a torque alone explains it, and what
enters both in a fixed ratio, as the zero of the steering does, may come nearer than each. At the
instants of the most promising change, whose refit is at hand, the tangents of constant forces show
what two of them would leave; the best pair is refitted where it would pay for its ratio.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.scores.score_tests import regressed
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, name_of
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.model.effects.clock_effects import KNOCK, joint_offset_step, offset_step


def joint_forces(
    refitting: Refitting,
    at: Weighted,
    found: Sequence[Candidate],
    progress: Callable[[str], None],
) -> list[Candidate]:
    """The best force in two balances at the instants of the best candidate; nothing if none pays.

    Parameters
    ----------
    found : what was refitted, each at its own instants.
    """
    best = max(found, key=lambda c: c.merit, default=None)
    if best is None or not best.effect.sets_in or best.effect.shape == KNOCK:
        return []
    twin = refitting.attempts.attempt(
        f"a force in two balances at the instants of {name_of(best.effect)}",
        partial(_refitted, refitting, at, best, progress),
    )
    return [] if twin is None or twin.gain <= 0.0 else [twin]


def _refitted(
    refitting: Refitting, at: Weighted, best: Candidate, progress: Callable[[str], None]
) -> Candidate | None:
    """The pair of balances in which forces leave least by their tangents, refitted if it pays."""
    time, end = best.effect.constants["time"], best.effect.end
    balances = [n for n in best.fit.criterion.model.balances if n in at.model.balances]
    if len(balances) < 2:
        return None
    forces = [offset_step(best.fit.criterion.model, name, time, end) for name in balances]
    e, psi = regressed(best.fit, best.names[0], forces)
    size = np.sqrt(np.maximum(np.einsum("ij,ij->j", psi, psi), TINY))
    leaves: dict[tuple[int, int], tuple[float, Array]] = {}
    for one, other in combinations(range(len(balances)), 2):
        along, both = psi[:, [one, other]], size[[one, other]]
        found, *_ = np.linalg.lstsq(along / both, e, rcond=None)
        rest = e - along @ (found / both)
        leaves[one, other] = float(rest @ rest), found / both
    (one, other), (left, sizes) = min(leaves.items(), key=lambda item: item[1][0])
    now = 2 * best.fit.solution.value
    if sizes[0] == 0.0 or left > now - float(np.log(at.criterion.n_samples)):
        return None
    ratio = float(sizes[1] / sizes[0])
    where = balances[one], balances[other]
    effect = joint_offset_step(at.model, where, ratio, time, end)
    progress(f"refit {name_of(effect)}")
    starts = {effect.parameters[1].name: ratio}
    twin = refitting.refit(at, effect, float(sizes[0]), starts=starts, near=True)
    return None if twin is None else replace(twin, score=best.score)
