"""Candidates compared: which is the best, how significant it is, and what it cannot reject.

Under a noise that is known they are ranked by

    gain - k log N                                                                             (1)

with the gain of `joint_refit`; where the noise model absorbs misfit, by the remainder of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import comb

import numpy as np
from scipy.stats import chi2, norm

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.scores.score_tests import ScoreTable
from casid.diagnosis.evidence.whitening.fit_points import use_samples_of
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, Rival, name_of
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.thresholds import COMPARISON, ROUNDS, SUFFICIENCY
from casid.estimation.covariance import bartlett_lags, long_run_covariance
from casid.estimation.fit_statistics import rms
from casid.model.effects.effect import HYSTERESIS_SHAPE
from casid.model.effects.search_ranges import PARAMETER_JUMPS
from casid.time_limit import seconds_left

TANGENTS = ("offset", "sensor_bias", "sensor_scale")
"""Kinds that a law of flow looks like near one level."""


def is_imitator(c: Candidate) -> bool:
    """True of what has a time or a frequency of its own."""
    return c.effect.is_on_the_clock or c.effect.kind == "missing_mode"


def ranked_by_remainder(
    refitting: Refitting, at: Weighted, found: list[Candidate]
) -> list[Candidate]:
    """Rank by n log(S_model / S_extended), S the sums of squares, n the samples that count.

    The noise's size is then not known, only what each candidate leaves. n is the number of
    independent samples worth as much as the residual of the best: misfit is no white noise.
    """
    r2 = _losses(max(found, key=lambda c: c.gain))
    spread = float(np.var(r2)) * len(r2)
    long_run = float(long_run_covariance(r2[:, None], bartlett_lags(r2[:, None]))[0, 0])
    n = float(np.clip(len(r2) * spread / max(long_run, TINY), COMPARISON.least_samples, len(r2)))
    out = []
    before = refitting.value(at)
    # Less what input noise gives to each: a noise-free channel must not win by that alone. Where
    # that is nearly all, the noise of an input absorbs the misfit, and it is no measure.
    is_measure = all(before - 0.5 * c.gain > COMPARISON.least_left * before > 0 for c in found)
    before = before if is_measure else at.fit.solution.value
    for c in found:
        after = before - 0.5 * c.gain if is_measure else c.fit.solution.value
        after = max(after, COMPARISON.least_left * before)
        k = c.unknowns
        gain = n * float(np.log(before / after))
        out.append(replace(c, gain=gain, cost=k * float(np.log(n)) + k))
    return sorted(out, key=lambda c: -_merit_beside(out, c))


def without_imitations(
    found: Sequence[Candidate], significant: Sequence[Candidate], *, by_likelihood: bool = False
) -> list[Candidate]:
    """Possible causes where the noise model absorbs misfit: no imitator of a better law.

    In a decay, time and amplitude go together, and what happens in time, or rings on its own,
    imitates whatever depends on amplitude. It must explain clearly more than the best significant
    law that does, and is no cause in the place of one that was refused for its errors.

    Parameters
    ----------
    by_likelihood : beside a disturbance gains are likelihoods, and strong evidence is enough.
    """
    lasting = max((c.merit for c in significant if not is_imitator(c)), default=0.0)

    def beside(c: Candidate) -> float:
        return c.merit - COMPARISON.strong if by_likelihood else _merit_beside(significant, c)

    return [c for c in found if not is_imitator(c) or beside(c) > max(lasting, 0.0)]


def laws_before_memory(order: Sequence[Candidate]) -> list[Candidate]:
    """Hysteresis that comes first goes behind the best named law that explains nearly as much.

    A force with memory has the freedom to imitate several laws at once; of itself none explains
    more than a small part.
    """
    if not order or order[0].effect.shape != HYSTERESIS_SHAPE:
        return list(order)
    enough = COMPARISON.memory * order[0].merit
    named = [c for c in order if not is_imitator(c) and c.effect.kind != "unknown"]
    first = [c for c in named[:1] if c.merit > enough]
    return [*first, *[c for c in order if c not in first]]


def _merit_beside(found: Sequence[Candidate], c: Candidate) -> float:
    """The merit, of an imitator less half the gain of the best that is none (a heuristic)."""
    if not is_imitator(c):
        return c.merit
    lasting = max((b.gain for b in found if not is_imitator(b)), default=0.0)
    return c.merit - COMPARISON.imitator * lasting


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
    again = replace(
        at, fit=base_fit, noise=noise, full=noise, input_sd=weighing.input_sd(noise, criterion)
    )
    out = []
    for c in leaders_of(found, count):
        judged = refitting.attempts.attempt(
            name_of(c.effect), partial(_judged_again, refitting, again, c)
        )
        if judged is not None:
            out.append(judged)
    if not out or seconds_left() <= 0.0:
        return found
    out = sorted(on_common_samples(out), key=lambda c: -c.merit)
    if out[0].effect.key != best.effect.key and rounds > 1:
        return rejudge(refitting, at, out, count, rounds - 1)
    return out


def leaders_of(found: Sequence[Candidate], count: int) -> list[Candidate]:
    """So many of the best, and all that gain more than the first of them, whatever they cost.

    Where misfit counts as noise, gains are too small, and costs are not. Who explains far less than
    the first is none.
    """
    best = found[0]
    least = COMPARISON.relative_gain * best.gain
    return [
        c
        for i, c in enumerate(found)
        if c is best or c.gain > (least if i < count else max(best.gain, least))
    ]


def on_common_samples(found: Sequence[Candidate]) -> list[Candidate]:
    """Candidates with gains that samples do not flatter which others do not count.

    A late sensor leaves out what it cannot know, first of all the start of a record. Such a
    candidate gets the gain of the best that counts every sample, and what it leaves less than that
    one on the samples of both, each less what input noise gives to it.
    """
    counts = [sum(int((d.used > 0).sum()) for d in c.fit.criterion.data) for c in found]
    whole = [c for c, n in zip(found, counts, strict=True) if n == max(counts)]
    best = max(whole, key=lambda c: c.gain)
    out = []
    for c in found:
        if c in whole:
            out.append(c)
            continue
        both = np.concatenate(
            [
                np.all(mine.used == its.used, axis=1)
                for mine, its in zip(best.fit.criterion.data, c.fit.criterion.data, strict=True)
            ]
        )
        less = float(np.sum((_losses(best) - _losses(c))[both]))
        less -= best.of_inputs - c.of_inputs
        out.append(replace(c, gain=best.gain + 2 * less))
    return out


def _judged_again(refitting: Refitting, again: Weighted, c: Candidate) -> Candidate:
    """A candidate refitted and judged under another noise."""
    criterion = refitting.weighing.criterion(c.model, again.noise, c.fit.values, again.criterion)
    use_samples_of(criterion, c.fit.criterion)
    fit = refitting.weighing.minimum(criterion)
    judged = refitting.judged(again, c.effect, c.names, c.model, fit)
    return replace(judged, score=c.score)


def p_value(table: ScoreTable, candidate: Candidate, *, by_remainder: bool = False) -> float:
    """Family-wise p: of the score, or of the refit once something is known to be wrong.

    A closed test: the family's smallest p, or misfit beyond the noise, shows that an effect is
    missing; its refits then show which. A large effect is far from its linearised size, and its
    own score may be small. The first parameter of several (stiffness and place of a stop) may be
    hardly known by itself although nothing would do without the effect: with gains by
    what each candidate leaves (`by_remainder`) the likelihood ratio of all of them counts.
    """
    score = table.adjusted(candidate.effect.key)
    count, test = len(table.tested), candidate.effect.test
    if candidate.effect.end is not None:
        count *= comb(PARAMETER_JUMPS.times, 2)
    if test == "peak":
        lines = sum(d.N for d in candidate.fit.criterion.data) / 2
        refit = lines * float(chi2.sf(max(candidate.gain, 0.0), 3))
    elif test == "clip":
        # A clipping has no null value to be far from: its gain is judged.
        refit = 2 * count * float(norm.sf(np.sqrt(max(candidate.gain, 0.0) / 3)))
    else:
        refit = 2 * count * float(norm.sf(abs(candidate.wald)))
        if by_remainder and candidate.unknowns > 1:
            gain = max(candidate.gain, 0.0)
            refit = min(refit, count * float(chi2.sf(gain, candidate.unknowns)))
    return float(max(min(score, refit, 1.0), TINY))


def rivals_of(
    at: Weighted, best: Candidate, found: Sequence[Candidate], losses: Losses | None = None
) -> tuple[Rival, ...]:
    """Candidates that the record cannot reject against the best one (Vuong 1989, (5.6)).

    Where the noise is known, six units of BIC are Kass and Raftery's (1995) "strong" evidence, and
    ten, "very strong", are required of a function without a name against an effect with one; where
    it absorbs misfit, gains are no likelihoods, and Vuong's test counts as well. The best come
    first, and of those that are the same thing in this model the one named by convention.

    Nor does a likelihood tell laws of one balance apart where a disturbance adds much to the motion
    that is simulated: a law acts on the sum of both. Its mean over the motion that is not simulated
    is smooth, and a drag that grows with the square looks like one that grows with the cube.

    Parameters
    ----------
    losses : kept where each of several candidates is compared with all others.
    """
    out = []
    losses = losses or Losses()
    mine = losses(best)
    is_blurred = bool(at.noise.spectra) and _share_moved_beside(best) > SUFFICIENCY.moved
    for c in found:
        if c is best or c.effect.key == best.effect.key:
            continue
        difference = losses(c) - mine
        lags = bartlett_lags(difference[:, None])
        sd = float(np.sqrt(long_run_covariance(difference[:, None], lags)[0, 0]))
        total = float(difference.sum()) + 0.5 * (c.cost - best.cost)
        p = float(norm.sf(total / sd)) if sd > 0 else 1.0
        is_near = c.merit > COMPARISON.vuong_share * best.merit
        is_open = at.noise_absorbs_misfit and p > COMPARISON.vuong_p and is_near
        is_open |= is_blurred and _is_near_law(best, c)
        # Worse only by what noise of the inputs is taken off: neither is better. Of a channel that
        # predicts a noisy input that is all its advantage, and of what else explains little.
        is_open |= total < 0.0 and is_near and c.effect.kind != "extra_input"
        is_worse = 2 * total > COMPARISON.strong and p < COMPARISON.vuong_p
        if c.merit > best.merit and is_worse and best.effect.kind != "extra_input":
            continue  # better only by more noise of the inputs than there is
        is_plainer = best.effect.is_unnamed and not c.effect.is_unnamed
        least = ROUNDS.very_strong if is_plainer else COMPARISON.strong
        if c.merit > best.merit - least or is_open:
            out.append(Rival(c, max(p, TINY)))
    same = COMPARISON.same
    return tuple(sorted(out, key=lambda r: (-round(r.p_value / same), r.candidate.effect.priority)))


def near_ones(at: Weighted, best: Candidate, found: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Candidates that explain nearly as much as the best, if the noise model absorbs misfit.

    Their gains are no likelihoods then: which of them is the cause shows under the noise that it
    leaves (`better_rivals`, `reconsidered`).
    """
    if not at.noise_absorbs_misfit:
        return ()
    least = COMPARISON.near_share * best.merit
    return tuple(c for c in found if c is not best and c.merit > max(least, 0.0))


def _is_near_law(best: Candidate, other: Candidate) -> bool:
    """True of another law of the same balance that explains nearly as much."""
    places = {c.effect.where.partition(":")[0] for c in (best, other)}
    is_lasting = not (is_imitator(best) or is_imitator(other))
    return len(places) == 1 and is_lasting and other.merit > COMPARISON.near_share * best.merit


def _share_moved_beside(c: Candidate) -> float:
    """The rms of what the simulation leaves over that of its motion, of the output it does best."""
    left, moved = [], []
    for e in range(len(c.fit.criterion.data)):
        at = c.fit.criterion.simulated(c.fit.x, e)
        left.append(at.residual)
        moved.append(at.y - at.y.mean(axis=0))
    sizes = rms(np.concatenate(moved))
    return float(np.min(rms(np.concatenate(left)) / np.maximum(sizes, TINY)))


class Losses:
    """Each sample's part of the whitened criterion of candidates (N,), computed once."""

    def __init__(self) -> None:
        self._kept: dict[Candidate, Array] = {}

    def __call__(self, c: Candidate) -> Array:
        """All records one after another."""
        if c not in self._kept:
            self._kept[c] = _losses(c)
        return self._kept[c]


def _losses(c: Candidate) -> Array:
    """Each sample's part of the whitened criterion (N,), all records one after another."""
    parts = []
    for e in range(len(c.fit.criterion.data)):
        r, _ = c.fit.criterion.columns(c.fit.x, e)
        parts.append(0.5 * np.sum(r**2, axis=1))
    return np.concatenate(parts)
