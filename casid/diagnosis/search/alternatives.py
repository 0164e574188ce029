"""Candidates compared: which is the best, how significant it is, and what it cannot reject.

They are ranked by

    gain - k log N                                                                             (1)

with the gain of `joint_refit` under the noise that the best of them leaves: before it is included,
what the model lacks passes for noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.stats import chi2, norm

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.prewhitening import Weighted, use_samples_of
from casid.diagnosis.evidence.score_tests import ScoreTable
from casid.diagnosis.search.candidates import Candidate, Rival, name_of
from casid.diagnosis.search.joint_refit import Refitting
from casid.diagnosis.thresholds import COMPARISON
from casid.estimation.covariance import bartlett_lags, long_run_covariance
from casid.model.effects.effect import ON_THE_CLOCK
from casid.time_limit import seconds_left

IMITATORS = (*ON_THE_CLOCK, "missing_mode")
"""Kinds with a time or a frequency of their own."""


def by_likelihood(
    refitting: Refitting, at: Weighted, found: Sequence[Candidate]
) -> list[Candidate]:
    """Ranked by (1) with Whittle's likelihood, the noise estimated again under each candidate."""
    before = at.noise.likelihood
    out = []
    for c in found:
        noise = refitting.weighing.noise(c.fit)
        out.append(replace(c, gain=2 * (noise.likelihood - before)))
    return sorted(out, key=lambda c: -c.merit)


def rejudge(
    refitting: Refitting,
    at: Weighted,
    found: list[Candidate],
    count: int = COMPARISON.leaders,
    rounds: int = COMPARISON.rounds,
) -> list[Candidate]:
    """Compare the leaders again under the noise that the best of them leaves.

    Under the first whitening the unexplained misfit counts as noise and masks differences.
    """
    best = found[0]
    weighing = refitting.weighing
    noise = weighing.noise(best.fit)
    criterion = weighing.criterion(at.model, noise, at.fit.values, at.criterion)
    base_fit = weighing.minimum(criterion)
    again = replace(at, fit=base_fit, noise=noise, input_sd=weighing.input_sd(noise, criterion))
    out = []
    for c in found[:count]:
        if c is not best and c.gain <= COMPARISON.relative_gain * best.gain:
            continue
        judged = refitting.attempts.attempt(
            name_of(c.effect), partial(_judged_again, refitting, again, c)
        )
        if judged is not None:
            out.append(judged)
    if not out or seconds_left() <= 0.0:
        return found
    out.sort(key=lambda c: -c.merit)
    if out[0].effect.key != best.effect.key and rounds > 1:
        return rejudge(refitting, at, out, count, rounds - 1)
    return out


def _judged_again(refitting: Refitting, again: Weighted, c: Candidate) -> Candidate:
    """A candidate refitted and judged under another noise."""
    criterion = refitting.weighing.criterion(c.model, again.noise, c.fit.values, again.criterion)
    use_samples_of(criterion, c.fit.criterion)
    fit = refitting.weighing.minimum(criterion)
    judged = refitting.judged(again, c.effect, c.names, c.model, fit)
    return replace(judged, score=c.score)


def p_value(table: ScoreTable, candidate: Candidate) -> float:
    """Family-wise p: of the score, or of the refit once something is known to be wrong.

    A closed test: the family's smallest p, or misfit beyond the noise, shows that an effect is
    missing; its refits then show which. A large effect is far from its linearised size, and its
    own score may be small.
    """
    score = table.adjusted(candidate.effect.key)
    count, test = len(table.tested), candidate.effect.test
    if test == "peak":
        lines = sum(d.N for d in candidate.fit.criterion.data) / 2
        refit = lines * float(chi2.sf(max(candidate.gain, 0.0), 3))
    elif test == "clip":
        # A clipping has no null value to be far from: its gain is judged.
        refit = 2 * count * float(norm.sf(np.sqrt(max(candidate.gain, 0.0) / 3)))
    else:
        refit = 2 * count * float(norm.sf(abs(candidate.wald)))
    return float(max(min(score, refit, 1.0), TINY))


def rivals_of(best: Candidate, found: Sequence[Candidate]) -> tuple[Rival, ...]:
    """Candidates that the record cannot reject against the best one.

    Six units of BIC are Kass and Raftery's (1995) "strong" evidence where the noise is all that is
    left: the difference D of two candidates then has a variance of D. Where it has more, as misfit
    of another kind remains, the six units count by as much less (Vuong 1989, (5.6)).
    """
    out = []
    mine = _losses(best)
    for c in found:
        if c is best or c.effect.key == best.effect.key:
            continue
        difference = _losses(c) - mine
        lags = bartlett_lags(difference[:, None])
        sd = float(np.sqrt(long_run_covariance(difference[:, None], lags)[0, 0]))
        total = float(difference.sum()) + 0.5 * (c.cost - best.cost)
        p = float(norm.sf(total / sd)) if sd > 0 else 1.0
        ahead = best.merit - c.merit
        if ahead < COMPARISON.strong or ahead**2 < COMPARISON.strong * sd**2:
            out.append(Rival(c, max(p, TINY)))
    return tuple(sorted(out, key=lambda r: -r.p_value))


def _losses(c: Candidate) -> Array:
    """Each sample's part of the whitened criterion (N,), all records one after another."""
    parts = []
    for e in range(len(c.fit.criterion.data)):
        r, _ = c.fit.criterion.columns(c.fit.x, e)
        parts.append(0.5 * np.sum(r**2, axis=1))
    return np.concatenate(parts)
