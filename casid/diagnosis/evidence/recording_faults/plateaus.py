"""Clipping: samples of a channel that lie exactly at its limit while the motion goes beyond it.

Values of a continuous channel hardly ever repeat. Many equal ones at the very top are a limit of
the sensor or logger, unless the system itself rests there, or other levels repeat as much: a
channel that is counted or rounded repeats the levels near which it stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate
from scipy.stats import nbinom, poisson
from scipy.stats import t as student

from casid.arrays import TINY, Array, robust_sd
from casid.data.sampling import stretches_of
from casid.diagnosis.evidence.recording_faults.stuck_sensors import noise_in_windows
from casid.diagnosis.thresholds import CLIPPING


@dataclass(frozen=True, slots=True, eq=False)
class Plateaus:
    """Samples of one channel that its limits have cut off."""

    channel: str
    masks: tuple[Array, ...]  # a record (N,) bool
    lower: float | None  # limits in the channel's unit, None where that end is free
    upper: float | None
    count: int
    energy: float  # sum of squares of what the limits cut off, as the simulation has it
    p_value: float

    @property
    def limit(self) -> float:
        """The limit that cut off most, or the only one."""
        return float(max(abs(x) for x in (self.lower, self.upper) if x is not None))


def find_plateaus(
    channel: str,
    measured: Sequence[Array],
    simulated: Sequence[Array],
    used: Sequence[Array],
    alpha: float,
) -> Plateaus | None:
    """Plateaus at the ends of a channel's range, where the simulation goes beyond them.

    Ties at the end are compared with those of the values next to it: a coarse converter repeats
    all of them, and some more than others (negative binomial). What rests at the end of its travel
    repeats as well, so one of three more must hold. The simulation lies beyond the limit on those
    samples, by more than its error elsewhere explains (a t-test), and moves there. Or the channel
    runs into the limit and out of it at half its usual speed or more, where a motion that comes to
    rest slows down. Or all other readings have the same noise, which no rest takes away, and the
    simulation lies far beyond. A counted channel repeats its end where it only turns (`_turns`).

    Parameters
    ----------
    measured, simulated : (N,) a record, channel's unit. used : (N,) bool.
    alpha : of both tests.
    """
    values = np.concatenate([y[u] for y, u in zip(measured, used, strict=True)])
    if len(values) < CLIPPING.samples_per_plateau * CLIPPING.fewest or np.ptp(values) == 0.0:
        return None
    ends: dict[float, float | None] = {1.0: None, -1.0: None}
    smallest = 1.0
    masks = [np.zeros(len(y), dtype=bool) for y in measured]
    energy = 0.0
    for side in ends:
        level = float(np.max(side * values))
        at = [u & (side * y >= level) for y, u in zip(measured, used, strict=True)]
        p = 1.0 if _stands_apart(measured, used, at) else max(_ties(side * values), TINY)
        beyond = np.concatenate([side * y[m] - level for y, m in zip(simulated, at, strict=True)])
        if p >= alpha or not np.all(np.isfinite(beyond)):
            continue
        if _turns(measured, used, at, alpha):
            continue
        elsewhere = [u & ~m for u, m in zip(used, at, strict=True)]
        errors = [y - s for y, s in zip(measured, simulated, strict=True)]
        is_limit = (
            _lies_beyond(beyond, errors, elsewhere, at, alpha)
            or _runs_in(measured, at)
            or _lacks_noise(beyond, errors, elsewhere, measured, used)
        )
        if not is_limit:
            continue
        ends[side] = side * level
        smallest = min(smallest, p)
        energy += float(np.sum(np.maximum(beyond, 0.0) ** 2))
        for mask, m in zip(masks, at, strict=True):
            mask |= m
    if smallest >= 1.0:
        return None
    return Plateaus(
        channel=channel,
        masks=tuple(masks),
        lower=ends[-1.0],
        upper=ends[1.0],
        count=int(sum(m.sum() for m in masks)),
        energy=energy,
        p_value=smallest,
    )


def _lies_beyond(
    beyond: Array,
    errors: Sequence[Array],
    elsewhere: Sequence[Array],
    at: Sequence[Array],
    alpha: float,
) -> bool:
    """True if the simulation goes beyond the limit by more than its error elsewhere explains.

    Parameters
    ----------
    beyond : (n,) by how much it does, at the samples at the limit.
    errors : (N,) a record, measured less simulated.
    elsewhere, at : (N,) bool, samples beside the limit and at it.
    """
    size = _error_size(errors, elsewhere)
    mean, spread = float(beyond.mean()), float(beyond.std(ddof=1))
    if mean < CLIPPING.beyond * size or spread < CLIPPING.motion * mean:
        return False
    count = _independent(errors, elsewhere, at)
    error = np.hypot(spread, size) / np.sqrt(count)
    return float(student.sf(mean / max(error, TINY), max(count - 1.0, 1.0))) < alpha


def _lacks_noise(
    beyond: Array,
    errors: Sequence[Array],
    elsewhere: Sequence[Array],
    measured: Sequence[Array],
    used: Sequence[Array],
) -> bool:
    """True if the noise of all other readings is the same, and the simulation lies far beyond."""
    if float(beyond.mean()) <= CLIPPING.far_beyond * _error_size(errors, elsewhere):
        return False
    noise = noise_in_windows(measured, used)
    if not len(noise):
        return False
    return bool(np.quantile(noise, CLIPPING.quiet_share) > CLIPPING.even * np.median(noise))


def _error_size(errors: Sequence[Array], elsewhere: Sequence[Array]) -> float:
    """Standard deviation of the simulation error on samples `elsewhere`, by the median."""
    other = np.concatenate([r[m] for r, m in zip(errors, elsewhere, strict=True)])
    return robust_sd(other - np.median(other))


def _independent(errors: Sequence[Array], elsewhere: Sequence[Array], at: Sequence[Array]) -> float:
    """Number of independent simulation errors among the samples at the limit.

    The error of a model is slow: over one standstill it is one error, however many samples that
    has. The variance of the mean of n samples is that of one times (1 + 2 sum_k c_k rho_k / n) / n,
    with the autocorrelation rho_k of the error elsewhere, as far as it is positive (Geyer,
    Statistical Science 7 (1992) 473-483), and c_k pairs at lag k among them.
    """
    lags = max(len(r) for r in errors)
    products, pairs, among = np.zeros(lags), np.zeros(lags), np.zeros(lags)
    for r, there, limit in zip(errors, elsewhere, at, strict=True):
        for total, x in (
            (products, np.where(there, r, 0.0)),
            (pairs, there.astype(float)),
            (among, limit.astype(float)),
        ):
            total[: len(r)] += correlate(x, x, method="fft")[len(r) - 1 :]
    covariance = products / np.maximum(pairs, 1.0)
    is_known = (covariance > 0.0) & (pairs > 0.5)
    if not is_known[0]:
        return float(among[0])
    first = lags if is_known.all() else int(np.argmin(is_known))
    rho = np.minimum(covariance[1:first] / covariance[0], 1.0)
    return float(among[0] / (1.0 + 2.0 * np.sum(among[1:first] * rho) / among[0]))


def _stands_apart(measured: Sequence[Array], used: Sequence[Array], at: Sequence[Array]) -> bool:
    """True of single samples that are further from the next ones than any others from theirs.

    A sensor's or logger's value for a fault: a motion that is cut off comes near the limit.
    """
    jumps, steps = [np.zeros(0)], [np.zeros(0)]
    for y, u, m in zip(measured, used, at, strict=True):
        values, is_at = y[u], m[u]
        if np.any(is_at[1:] & is_at[:-1]):
            return False
        step, is_edge = np.abs(np.diff(values)), is_at[1:] | is_at[:-1]
        jumps.append(step[is_edge])
        steps.append(step[~is_edge])
    jump, step = np.concatenate(jumps), np.concatenate(steps)
    least = CLIPPING.apart * float(np.max(step, initial=0.0))
    return bool(len(jump)) and float(jump.min()) > least


def _runs_in(measured: Sequence[Array], at: Sequence[Array]) -> bool:
    """True if the channel keeps its speed up to the plateau and takes it up behind."""
    steps, into, out_of = [], [], []
    for y, m in zip(measured, at, strict=True):
        step = np.abs(np.diff(y))
        steps.append(step[~(m[1:] & m[:-1])])
        into.append(step[m[1:] & ~m[:-1]])
        out_of.append(step[m[:-1] & ~m[1:]])
    usual = np.concatenate(steps)
    usual = usual[usual > 0.0]
    edges = [np.concatenate(x) for x in (into, out_of)]
    if not len(usual) or not all(len(x) for x in edges):
        return False
    # A body that hits its stop comes fast and leaves slowly: each side counts.
    return min(float(np.median(x)) for x in edges) >= CLIPPING.fast * float(np.median(usual))


def _turns(
    measured: Sequence[Array], used: Sequence[Array], at: Sequence[Array], alpha: float
) -> bool:
    """True where a channel that is counted or rounded only turns back.

    Near its turn a motion is a parabola: twice as far from the middle of the samples at the end as
    the last of them, it has come four steps of the channel down, and a little. What a limit cuts
    off has come further; else it cuts off no more than a step or two.

    Noise may hide the turn: the readings at the end are the furthest of those around them, and by
    chance all rounded to one (`_equal_by_chance`). It then may have come further by their noise.
    """
    steps = np.diff(np.unique(np.concatenate(measured)))
    step = float(np.min(steps[steps > 0.0], initial=np.inf))
    runs: list[tuple[int, float]] = []
    for y, mask in zip(measured, at, strict=True):
        for start, stop in zip(*stretches_of(mask), strict=True):
            half = (stop - start + 1) // 2
            beside = [k for k in (start - half, stop - 1 + half) if 0 <= k < len(y)]
            runs += [(stop - start, abs(float(y[k] - y[start]))) for k in beside]
    longest = max((n for n, _ in runs), default=0)
    drops = [drop for n, drop in runs if 2 * n >= longest and np.isfinite(drop)]
    if not drops:
        return False
    noise = noise_in_windows(measured, used)
    sd = float(np.median(noise)) if len(noise) else 0.0
    near, far = CLIPPING.turn * step, CLIPPING.turn * step + CLIPPING.turn_noise * sd
    level = next(float(y[mask][0]) for y, mask in zip(measured, at, strict=True) if mask.any())
    close = sum(
        int(np.sum(np.abs(y[u] - level) <= far)) for y, u in zip(measured, used, strict=True)
    )
    is_chance = _equal_by_chance(longest, close, step, sd) >= alpha
    return float(np.median(drops)) <= (far if is_chance else near)


def _equal_by_chance(longest: int, close: int, step: float, sd: float) -> float:
    """Probability that noise rounds as many successive readings at rest to one value.

    A reading whose mean lies in the middle of a step, where that is likeliest, rounds to it with
    the probability P(|sd z| < step / 2). The others of a run have to do so, or one other reading
    where none follow one another, behind any of those that are `close` to the end.
    """
    share = math.erf(step / (2.0 * math.sqrt(2.0) * max(sd, TINY)))
    return min(1.0, close * share ** max(longest - 1, 1))


def _ties(values: Array) -> float:
    """Probability that chance repeats the largest value as often, from the values next to it.

    Repetitions are Poisson distributed where all values are as likely. A counted or rounded channel
    repeats the levels near which it stays and passes the others: then their mean varies, and they
    are negative binomial, with mean and variance as next to the end. Two or three equal samples are
    as likely at the end as at any other value: of n, r of which repeat elsewhere, (r + 1) / n.
    """
    distinct, counts = np.unique(values, return_counts=True)
    if counts[-1] < 2 or len(distinct) < CLIPPING.beside // 2:
        return 1.0
    if counts[-1] < CLIPPING.fewest:
        return float(np.sum(counts[:-1] > 1) + 1) / len(distinct)
    repeats = counts[-CLIPPING.beside - 1 : -1] - 1
    usual, variance = float(np.mean(repeats)) + CLIPPING.repeats, float(np.var(repeats, ddof=1))
    if variance <= usual:
        return float(poisson.sf(counts[-1] - 2, usual))
    return float(nbinom.sf(counts[-1] - 2, usual**2 / (variance - usual), usual / variance))
