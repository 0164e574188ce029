"""When something set in: the instants of candidates, and events that are known already."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.records.signal_sizes import window_of
from casid.diagnosis.evidence.scores.score_tests import regressed, scan, scan_pairs
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, name_of
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.thresholds import JUMPS, SCANS
from casid.estimation.simulation.channels.sensor_dynamics import MEMORY
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.clock_effects import STEP, at_instant, knock
from casid.model.effects.effect import Effect
from casid.model.effects.names import RISING_MEDIUM
from casid.model.effects.search_ranges import PARAMETER_JUMPS
from casid.model.model import Model


def placed(
    refitting: Refitting,
    at: Weighted,
    found: Sequence[Candidate],
    known: Sequence[float],
    progress: Callable[[str], None],
) -> list[Candidate]:
    """Jumps refitted at the instants that leave least; coarse scores place them roughly only.

    The most promising one is placed first, the others start from its instant too: they may be
    the same event, seen in another parameter.

    Parameters
    ----------
    known : instants of the events known already [s], near which no jump is placed.
    """
    top = max((c.gain for c in found), default=0.0)
    out, instant = [], None
    for c in sorted(found, key=lambda c: -c.gain):
        if c.effect.end is not None and c.gain > JUMPS.promising * top:
            progress(f"find the instants of {name_of(c.effect)}")
            what = f"the instants of {name_of(c.effect)}"
            c = refitting.attempts.attempt(what, partial(_between, refitting, at, c, known)) or c
            what = f"the comparison of {name_of(c.effect)} with a change that stays"
            c = refitting.attempts.attempt(what, partial(_or_staying, refitting, at, c, known)) or c
        elif c.effect.sets_in and c.gain > JUMPS.promising * top:
            progress(f"find the instant of {name_of(c.effect)}")
            if instant is not None:
                c = _better_at(refitting, at, c, instant, known)
            scan_of = partial(placed_by_refits, refitting, at, c, known)
            what = f"the instant of {name_of(c.effect)}"
            c = refitting.attempts.attempt(what, scan_of) or c
            instant = instant if instant is not None else c.effect.variant
            twin = refitting.attempts.attempt(what, partial(_knock, refitting, at, c, known))
            out += [] if twin is None else [twin]
        out.append(c)
    return out


def _between(
    refitting: Refitting, at: Weighted, found: Candidate, known: Sequence[float]
) -> Candidate:
    """Scan both instants of what is over again, ever finer, about the last refit."""
    found = _over_elsewhere(refitting, at, found, known)
    for reach in _reaches(at):
        first, last = _best_pair(at, found.fit, found.names[0], found.effect, reach)
        found = _better_at(refitting, at, found, first, known, last)
    return found


def _or_staying(
    refitting: Refitting, at: Weighted, found: Candidate, known: Sequence[float]
) -> Candidate:
    """What is over again or, where that is better, the change that stays from its first instant on.

    One that ends just before the fitted part does explains as much there, but predicts another
    motion. A fit that begins far from a change may miss the one that stays.
    """
    first = found.effect.variant
    assert first is not None
    stays = at_instant(found.effect, at.model, first)
    twin = refitting.again(at, replace(found, effect=stays))
    if twin is None:
        return found
    twin = placed_by_refits(refitting, at, replace(twin, score=found.score), known)
    return max(found, twin, key=lambda c: c.merit)


def _over_elsewhere(
    refitting: Refitting, at: Weighted, found: Candidate, known: Sequence[float]
) -> Candidate:
    """What is over again, its end, then its beginning, anywhere in the records.

    A change that the model makes up for as it lasts shows as it begins and as it ends. Scored
    beside parameters that make up for it, it is over with the first of the two; about a refit,
    whose parameters are nearer, all of it shows.
    """
    start, stop = window_of(at)
    anywhere = np.linspace(start, stop, JUMPS.ends + 2)[1:-1].tolist()
    for which in ("end", "time"):
        sides = [
            anywhere if name == which else [found.effect.constants[name]]
            for name in ("time", "end")
        ]
        left, pair = _least_left(at, found.fit, found.names[0], found.effect, sides)
        if left < 2 * found.fit.solution.value - JUMPS.worth:
            found = _better_at(refitting, at, found, pair[0], known, pair[1])
    return found


def placed_by_tangents(at: Weighted, effect: Effect) -> Effect:
    """An effect at the instant, or between the two instants, of least misfit, without a refit.

    By its tangents at a fit without it, to a part of a sample.
    """
    for reach in _reaches(at):
        if effect.end is None:
            steps = _steps_about(at, effect, at.model, reach)
            effect = steps[int(np.argmin(scan(at.fit, None, steps)))]
        else:
            first, last = _best_pair(at, at.fit, None, effect, reach)
            effect = at_instant(effect, at.model, first, last)
    return effect


def placed_about(at: Weighted, effect: Effect, begin: float, end: float) -> Effect:
    """What is over again, between the instants that leave least about a burst [s], by tangents.

    It begins within half the burst of where that begins, and ends in the burst, whose end is that
    of what the change leaves behind.
    """
    reach = 0.5 * (end - begin)
    about = at_instant(effect, at.model, begin, begin + reach)
    return at_instant(effect, at.model, *_best_pair(at, at.fit, None, about, reach))


def _steps_about(
    at: Weighted, effect: Effect, model: Model, reach: float, count: int = JUMPS.instants
) -> list[Effect]:
    """An effect in a model at instants within reach of its own [s], inside the records."""
    start, stop = window_of(at)
    times = effect.constants["time"] + reach * np.linspace(-1, 1, count)
    return [at_instant(effect, model, float(t)) for t in times if start < t < stop]


def _best_pair(
    at: Weighted, fit: Fit, own: str | None, effect: Effect, reach: float
) -> tuple[float, float]:
    """The instants within reach of an effect's own [s] that leave least, of what is over again."""
    start, stop = window_of(at)
    grid = reach * np.linspace(-1, 1, JUMPS.ends)
    ends = (effect.constants[name] for name in ("time", "end"))
    times = [[float(t) for t in end + grid if start < t < stop] for end in ends]
    return _least_left(at, fit, own, effect, times)[1]


def _least_left(
    at: Weighted, fit: Fit, own: str | None, effect: Effect, times: Sequence[Sequence[float]]
) -> tuple[float, tuple[float, float]]:
    """The sum of squares that is left between the best pair of instants [s], and that pair.

    Parameters
    ----------
    times : at which the change may begin, and end.
    """
    Ts = min(d.Ts for d in at.criterion.data)
    steps = [[at_instant(effect, fit.criterion.model, t) for t in side] for side in times]
    left = scan_pairs(fit, own, *steps)
    left[np.subtract.outer(times[0], times[1]) > -Ts] = np.inf
    i, j = (int(k) for k in np.unravel_index(int(np.argmin(left)), left.shape))
    return float(left[i, j]), (times[0][i], times[1][j])


def _reaches(at: Weighted) -> Iterator[float]:
    """Distances [s] scanned on either side of an instant, ever finer, to parts of a sample."""
    start, stop = window_of(at)
    Ts = min(d.Ts for d in at.criterion.data)
    reach = JUMPS.reach * (stop - start) / (PARAMETER_JUMPS.times + 1)
    for _ in range(JUMPS.scans):
        yield reach
        if reach < JUMPS.fine * Ts:
            return
        reach /= JUMPS.zoom


def _knock(
    refitting: Refitting, at: Weighted, found: Candidate, known: Sequence[float]
) -> Candidate | None:
    """A knock in the place of a force that sets in: what rings on after it does so after both."""
    effect, when = found.effect, found.effect.variant
    is_force = effect.kind == "offset" and effect.shape == STEP
    if not is_force or effect.where not in at.model.balances or when is None:
        return None
    Ts = min(d.Ts for d in at.criterion.data)
    other = knock(at.model, effect.where, when, Ts)
    if other.parameters[0].name in at.model.parameters:
        return None  # one was found there
    force = found.fit.values[found.names[0]]
    twin = refitting.refit(at, other, force * JUMPS.knock * Ts)
    if twin is None:
        return None
    return placed_by_refits(refitting, at, replace(twin, score=found.score), known)


def placed_by_refits(
    refitting: Refitting, at: Weighted, found: Candidate, known: Sequence[float]
) -> Candidate:
    """Scan ever finer, linearly about the last refit: a ringing leaves many local minima.

    What a wind does is far from linear in it: its instant is searched by refits alone.
    """
    if found.effect.shape == RISING_MEDIUM:
        return _searched_by_refits(refitting, at, found, known)
    for reach in _reaches(at):
        now = found.effect.constants["time"]
        effects = _steps_about(at, found.effect, found.model, reach, _resolving(at, found, reach))
        inside = [effect.constants["time"] for effect in effects]
        left = _left(found, effects)
        best = int(np.argmin(left))
        if left[int(np.argmin(np.abs(np.subtract(inside, now))))] - left[best] > JUMPS.worth:
            found = _better_at(refitting, at, found, inside[best], known)
        if np.ptp(left[max(best - 1, 0) : best + 2]) < JUMPS.worth:
            break  # no instant between two of them leaves less
    return found


def _left(found: Candidate, effects: Sequence[Effect]) -> Array:
    """What is left with each of `effects` in the place of a candidate's own, some at a time."""
    some = range(0, len(effects), JUMPS.instants)
    parts = [effects[k : k + JUMPS.instants] for k in some]
    return np.concatenate([scan(found.fit, found.names[0], part) for part in parts])


def _resolving(at: Weighted, found: Candidate, reach: float) -> int:
    """Instants of a scan so near each other that what sets in at neighbours looks alike.

    What a jump shows may be a ringing alone, such as the release of a shaft whose two speeds are
    measured: of instants further apart than its period none may be better than one far away.
    """
    count, finest = JUMPS.instants, SCANS.finest * min(d.Ts for d in at.criterion.data)
    now, (_, stop) = found.effect.constants["time"], window_of(at)
    while (step := 2 * reach / (count - 1)) > finest and count < SCANS.most:
        beside = now + step if now + step < stop else now - step
        two = [at_instant(found.effect, found.model, t) for t in (now, beside)]
        _, psi = regressed(found.fit, found.names[0], two)
        a, b = psi.T / np.maximum(np.linalg.norm(psi, axis=0), TINY)[:, None]
        if a @ b > SCANS.alike:
            break
        count = 2 * count - 1
    return count


def _searched_by_refits(
    refitting: Refitting, at: Weighted, found: Candidate, known: Sequence[float]
) -> Candidate:
    """The instant of the largest gain within the first reach, by Brent's method, to a sample."""
    best = [found]

    def loss(instant: float) -> float:
        other = at_instant(found.effect, at.model, instant)
        again = refitting.moved(at, best[0], other)
        if again is None or is_known_event(at, other, known):
            return 0.0
        best[0] = max(best[0], replace(again, score=found.score), key=lambda c: c.gain)
        return -again.gain

    now, reach = found.effect.constants["time"], next(_reaches(at))
    start, stop = window_of(at)
    Ts = min(d.Ts for d in at.criterion.data)
    within = max(now - reach, start), min(now + reach, stop)
    minimize_scalar(loss, bounds=within, method="bounded", options={"xatol": 0.5 * Ts})
    return best[0]


def _better_at(
    refitting: Refitting,
    at: Weighted,
    found: Candidate,
    instant: float,
    known: Sequence[float],
    end: float | None = None,
) -> Candidate:
    """The jump refitted at another instant, if it explains more there; over at an `end`."""
    if (instant, end) == (found.effect.variant, found.effect.end):
        return found
    other = at_instant(found.effect, at.model, instant, end)
    if is_known_event(at, other, known):
        return found
    again = refitting.moved(at, found, other)
    if again is None or again.gain <= found.gain:
        return found
    return replace(again, score=found.score)


def events_of(adopted: Sequence[Candidate]) -> list[float]:
    """Instants of the jumps among what was adopted [s], and those at which they are over."""
    effects = [c.effect for c in adopted if c.effect.sets_in]
    return [t for e in effects for t in (e.variant, e.end) if t is not None]


def is_known_event(at: Weighted, effect: Effect, known: Sequence[float]) -> bool:
    """True if a jump is at about the instant of a known one: one event, named once.

    So is one while an actuator that lags still shows what its command was before the record.
    """
    start, stop = window_of(at)
    near = JUMPS.same_event * (stop - start) / (PARAMETER_JUMPS.times + 1)
    when = effect.variant
    times = [t for t in (when, effect.end) if t is not None]
    taus = [s.parameter for s in at.model.stages if s.kind == "lag_input"]
    lags = [at.fit.values.get(p, at.model.parameters[p].nominal) for p in taus]
    if when is not None and when - start < MEMORY["lag"] * max(lags, default=0.0):
        return True
    return any(abs(t - own) < near for t in known for own in times)
