"""Lags and delays of every channel that may have one, whatever their scores promise.

An input that acts late and a sensor that is late look alike, and parameters of the model make up
for either: the fit of the model as it is may stop at a bound, with a residual that says little of
what a lag would gain there, or of its sign. Where the noise model absorbs misfit, the lags that
other effects leave off the short list are refitted beside them. One of each channel is enough,
since a lag is a delay to first order; where it comes among the best, its delay is refitted as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from casid.diagnosis.evidence.scores.score_tests import Score, ScoreTable
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, found_values
from casid.diagnosis.search.refits.joint_refit import is_dead_time
from casid.diagnosis.thresholds import COMPARISON, SHORTLIST
from casid.model.effects.effect import LATE, Effect


def lags_beside(at: Weighted, table: ScoreTable, chosen: Sequence[Score]) -> list[Score]:
    """The lags where no lag or delay is `chosen`, those first that move most.

    A lag cannot be negative, and its score says that it is where another parameter is at its bound
    in its place: it then starts from what seems best of those that are positive.
    """
    if not at.noise_absorbs_misfit:
        return []  # under the right noise a score predicts what a refit gains
    late = [s for s in table.tested if s.effect.kind in LATE]
    known = {_place(s.effect) for s in chosen if s.effect.kind in LATE}
    lags = [s for s in late if s.effect.kind != "time_delay" and _place(s.effect) not in known]
    # That an input's sensor lags is the opposite of the lag of its actuator.
    lags = [s for s in lags if s.unrobust > 0.0 or not _is_of_record(at, s.effect)]
    lags.sort(key=lambda s: -s.energy * s.step**2)
    positive = [s for s in late if s.unrobust > 0.0]
    return [_started(s, positive) for s in lags[: SHORTLIST.lags]]


def delays_of_best(
    table: ScoreTable, found: Sequence[Candidate], tried: Sequence[Score]
) -> list[Score]:
    """The delays of channels whose lags come among the best of those found, and vice versa.

    Where the best itself is a lag or delay, that is every channel that is not far worse: a delay
    that leads may stand for that of another channel, whose lag explains less as any lag does.

    Parameters
    ----------
    tried : what was refitted already, with success or without.
    """
    best = max(found, key=lambda c: c.gain, default=None)
    if best is None:
        return []
    is_late = best.effect.kind in LATE
    least = (COMPARISON.relative_gain if is_late else COMPARISON.near_share) * best.gain
    known = {s.effect.key for s in tried}
    sizes: dict[tuple[str, bool], float] = {}
    for c in sorted(found, key=lambda c: -c.gain):
        if c.effect.kind in LATE and c.gain > least:
            sizes.setdefault(_place(c.effect), found_values(c)[c.effect.parameters[0].name])
    return [
        replace(s, step=sizes[_place(s.effect)])
        for s in table.tested
        if s.effect.kind in LATE and s.effect.key not in known and _place(s.effect) in sizes
    ]


def _place(effect: Effect) -> tuple[str, bool]:
    """The channel that is late, and whether what it does is late, not its record."""
    return effect.where, effect.kind == "actuator_lag" or is_dead_time(effect)


def _is_of_record(at: Weighted, effect: Effect) -> bool:
    """True of the lag of an input's sensor."""
    return effect.kind == "sensor_lag" and effect.where in at.model.inputs


def _started(s: Score, positive: Sequence[Score]) -> Score:
    """A score with a start that is positive."""
    limit = s.effect.limit or 0.0
    within = [p for p in positive if p.step < limit]
    if s.unrobust > 0.0 or not within:
        return replace(s, step=abs(s.step))
    return replace(s, step=max(within, key=lambda p: p.unrobust).step)
