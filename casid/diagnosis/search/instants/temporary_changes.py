"""Changes that are over before the record is: a window left open, a load taken on and off again.

The signature of a step from t_1 until t_2 is that of a step at t_1 less that of one at t_2, so that
the scores of steps, which a round has at hand, give those of every pair of their instants. With g_i
the score of a step, G the products of their signatures,

    (g_i - g_j)^2 / (G_ii + G_jj - 2 G_ij)                                                    (1)

is the statistic of one unit of the change between them. A pair is refitted beside the steps where
it promises more than the two parameters that its second instant costs.

The instants of the steps are a coarse grid, on which what lasts a small part of an interval scores
by how it happens to lie. Where the misfit has a burst, which begins and ends, every parameter is
tested between the two instants about it that leave least.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY
from casid.diagnosis.evidence.residual.bursts import burst_of
from casid.diagnosis.evidence.scores.score_tests import Score, ScoreTable, regressed
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.instants.jump_times import placed_about
from casid.diagnosis.thresholds import COMPARISON, JUMPS, SHORTLIST
from casid.model.effects.clock_effects import at_instant
from casid.model.effects.search_ranges import PARAMETER_JUMPS


def temporary_changes(at: Weighted, table: ScoreTable, burst: Sequence[float] = ()) -> list[Score]:
    """The most promising changes for a while, each with the p of the steps of its parameter.

    Parameters
    ----------
    burst : when a burst of the misfit begins and ends [s], or nothing; about it a change is placed.
    """
    steps: dict[tuple[str, str], list[int]] = {}
    for i, s in enumerate(table.scores):
        if s.effect.sets_in and s.is_visible and s.effect.variant is not None:
            steps.setdefault(s.effect.key, []).append(i)
    dearer = PARAMETER_JUMPS.cost_of_two - PARAMETER_JUMPS.cost
    more = dearer * float(np.log(at.criterion.n_samples))
    least = COMPARISON.relative_gain * max((s.unrobust for s in table.tested), default=0.0)
    found = []
    for places in steps.values():
        best = _best_pair(at, table, places)
        if best is not None and len(burst) == 2:
            best = max(best, _scored_about(at, best, *burst), key=lambda s: s.unrobust)
        alone = max(table.scores[i].unrobust for i in places)
        if best is not None and best.unrobust > max(alone + more, least):
            found.append(best)
    found.sort(key=_by_gain)
    gains = [s for s in found if s.effect.is_new_gain][: SHORTLIST.gains]
    others = [s for s in found if not s.effect.is_new_gain][: SHORTLIST.passing]
    return sorted([*others, *gains], key=_by_gain)


def _by_gain(score: Score) -> tuple[float, int]:
    """The largest gain first; of two effects that do the same, that of the lower priority."""
    return -float(f"{score.unrobust:.6g}"), score.effect.priority


def placed_changes(at: Weighted, table: ScoreTable) -> list[Score]:
    """The most promising changes for a while, placed about the burst of the misfit, if any."""
    return temporary_changes(at, table, burst_of(at))


def _scored_about(at: Weighted, score: Score, begin: float, end: float) -> Score:
    """A change for a while at the instants about a stretch [s] that leave least, scored there."""
    effect = placed_about(at, score.effect, begin, end)
    residual, signatures = regressed(at.fit, None, [effect])
    own = signatures[:, 0]
    energy, along = max(float(own @ own), TINY), float(own @ residual)
    gain = along**2 / energy
    return replace(score, effect=effect, energy=energy, step=along / energy, unrobust=gain)


def _best_pair(at: Weighted, table: ScoreTable, places: list[int]) -> Score | None:
    """The pair of instants of one parameter with the largest (1)."""
    places = sorted(places, key=lambda i: table.scores[i].effect.variant or 0.0)
    rows = [table.scores[i] for i in places]
    energy = np.array([s.energy for s in rows])
    score = np.array([s.step for s in rows]) * energy
    size = np.sqrt(energy)
    products = table.cosines[np.ix_(places, places)] * np.outer(size, size)
    left = energy[:, None] + energy[None, :] - 2 * products
    is_seen = left > JUMPS.seen * (energy[:, None] + energy[None, :])
    pairs = np.triu(is_seen, 1)
    if not pairs.any():
        return None
    gain = np.where(pairs, (score[:, None] - score[None, :]) ** 2 / np.maximum(left, TINY), 0.0)
    i, j = (int(k) for k in np.unravel_index(int(np.argmax(gain)), gain.shape))
    strongest = min(rows, key=lambda s: s.p_value)
    begin, end = rows[i].effect.variant, rows[j].effect.variant
    assert begin is not None
    return replace(
        strongest,
        effect=at_instant(rows[i].effect, at.model, begin, end),
        energy=float(left[i, j]),
        step=float((score[i] - score[j]) / left[i, j]),
        unrobust=float(gain[i, j]),
        visible=min(rows[i].visible, rows[j].visible),
    )
