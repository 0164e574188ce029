"""A sensor that stands still: a channel repeats one value while the motion goes on.

The reading of a sensor with noise does not repeat even at rest. A long run of equal values that
ends in a leap to where the motion has meanwhile gone is the sensor's or the logger's, not the
system's: what sticks by friction breaks away without a leap. A sensor that dies in its place, to
the end of the record, has no leap: there the noise has to be in every reading before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import TINY, Array, robust_sd
from casid.data.channel_quality import quantisation_step
from casid.data.sampling import stretches_of
from casid.diagnosis.thresholds import CLIPPING


@dataclass(frozen=True, slots=True, eq=False)
class Standstills:
    """Samples of one channel in which its sensor stood still."""

    channel: str
    masks: tuple[Array, ...]  # a record (N,) bool
    count: int
    size: float  # farthest that the simulation is from a standing value, channel's unit
    energy: float  # sum of squares of that distance
    p_value: float


def find_standstills(
    channel: str,
    measured: Sequence[Array],
    simulated: Sequence[Array],
    used: Sequence[Array],
    alpha: float,
) -> Standstills | None:
    """Runs of equal values, longer than chance makes them, that end in a leap or with the record.

    Of N samples of which a share q equals the one before, a run of n or more has a chance of at
    most N q^(n - 1).

    Parameters
    ----------
    measured, simulated : (N,) a record, channel's unit. used : (N,) bool.
    alpha : largest such chance.
    """
    masks = [np.zeros(len(y), dtype=bool) for y in measured]
    total, smallest = sum(int(u.sum()) for u in used), 1.0
    runs = [_runs(y, u) for y, u in zip(measured, used, strict=True)]
    if all(last - first <= CLIPPING.fewest for own in runs for first, last in own):
        return None
    steps = np.concatenate([_steps(y, u) for y, u in zip(measured, used, strict=True)])
    moving = steps[steps > 0.0]
    if len(moving) < CLIPPING.samples_per_plateau:
        return None
    step = quantisation_step(np.concatenate([y[u] for y, u in zip(measured, used, strict=True)]))
    if not _has_noise(measured, used, step):
        return None
    leap = CLIPPING.leap * float(np.quantile(moving, 0.95))
    always_noisy = _is_noisy_at_rest(measured, used, step)
    for e, (y, s) in enumerate(zip(measured, simulated, strict=True)):
        for first, last in runs[e]:
            n = last - first
            share = (len(steps) - len(moving) - (n - 1) + 1) / (len(steps) - (n - 1) + 2)
            p = float(total * np.exp(min((n - 1) * np.log(share), 0.0)))
            ends = [abs(y[k] - y[first]) for k in (first - 1, last) if 0 <= k < len(y)]
            is_apart = np.ptp(s[first:last]) > leap or not np.isfinite(s[first:last]).all()
            is_dead = always_noisy and not used[e][last:].any()
            leaps = max(ends, default=0.0) > leap
            if p < alpha and n > CLIPPING.fewest and (leaps or is_dead) and is_apart:
                masks[e][first:last] = True
                smallest = min(smallest, p)
    if smallest >= 1.0:
        return None
    off = np.concatenate([(y - s)[m] for y, s, m in zip(measured, simulated, masks, strict=True)])
    off = off[np.isfinite(off)]
    return Standstills(
        channel,
        tuple(masks),
        int(sum(m.sum() for m in masks)),
        float(np.max(np.abs(off), initial=0.0)),
        float(np.sum(off**2)),
        max(smallest, TINY),
    )


def _runs(y: Array, used: Array) -> list[tuple[int, int]]:
    """First and one past the last sample of every run of equal values that has several."""
    same = (np.diff(y) == 0.0) & used[1:] & used[:-1]
    return [(int(a), int(b) + 1) for a, b in zip(*stretches_of(same), strict=True)]


def _steps(y: Array, used: Array) -> Array:
    """Distances (M,) of neighbours that there are."""
    return np.asarray(np.abs(np.diff(y))[used[1:] & used[:-1]])


def _has_noise(measured: Sequence[Array], used: Sequence[Array], step: float | None) -> bool:
    """True if readings differ at rest: the noise is more than half a step of the converter."""
    if step is None:
        return True
    bends = [np.diff(y, 2)[u[2:] & u[1:-1] & u[:-2]] for y, u in zip(measured, used, strict=True)]
    noise = robust_sd(np.concatenate(bends)) / np.sqrt(6)
    return bool(noise > 0.5 * step)


def _is_noisy_at_rest(measured: Sequence[Array], used: Sequence[Array], step: float | None) -> bool:
    """True if readings differ by more than a step of the converter wherever they hardly move.

    Whether windows of equal readings alone are the sensor's is the question.
    """
    if step is None:
        return True
    noise = noise_in_windows(measured, used)
    return bool(len(noise)) and float(np.quantile(noise, CLIPPING.quiet_share)) > step


def noise_in_windows(measured: Sequence[Array], used: Sequence[Array]) -> Array:
    """(W,) noise of the readings in every window of a channel, by how they bend.

    Without windows of equal readings.
    """
    noise = [np.zeros(0)]
    for y, u in zip(measured, used, strict=True):
        kept = y[u]
        windows = kept[: len(kept) // CLIPPING.quiet_window * CLIPPING.quiet_window]
        bends = np.diff(windows.reshape(-1, CLIPPING.quiet_window), 2, axis=1)
        noise.append(np.sqrt(np.mean(bends**2, axis=1) / 6.0))
    every = np.concatenate(noise)
    return np.asarray(every[every > 0.0])
