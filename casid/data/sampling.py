"""Where the samples of a channel lie: stretches without one, and slower clocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casid.arrays import Array, BoolArray

CLOCK_GAPS = 3
"""Intervals between samples that show a clock of the channel's own, at least."""
CLOCK_SHARE = 0.95
"""Of the intervals that keep that clock."""
OWN_CLOCK = 3.0
"""Times its usual interval, that the longest of an irregular clock without a gap takes."""
APART = 2.0
"""Times the next shorter interval, that a gap is long: random instants lie at all distances."""


@dataclass(frozen=True, slots=True)
class Gaps:
    """The samples that a channel lacks.

    Attributes
    ----------
    missing : how many of the record's N samples.
    stretches : of neighbouring missing samples.
    longest, first : samples of the longest stretch, and where it begins.
    rate : k, where the channel has every k-th sample alone; None otherwise.
    """

    missing: int
    stretches: int
    longest: int
    first: int
    rate: int | None


def gaps_of(missing: BoolArray) -> Gaps:
    """The gaps of a channel whose samples are `missing` (N,)."""
    starts, stops = stretches_of(missing)
    lengths = stops - starts
    at = int(np.argmax(lengths)) if lengths.size else 0
    longest, first = (int(lengths[at]), int(starts[at])) if lengths.size else (0, 0)
    return Gaps(int(missing.sum()), lengths.size, longest, first, own_rate(missing))


def stretches_of(mask: BoolArray) -> tuple[np.ndarray, np.ndarray]:
    """First samples of the stretches in which a mask (N,) is True, and those behind them."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def gaps_among(steps: Array) -> BoolArray:
    """Which intervals (n,) of an irregular clock are gaps in it.

    They stand apart from all others: samples at random instants (Poisson) have intervals of any
    length, and none is missing.
    """
    order = np.argsort(steps)
    ordered = steps[order]
    apart = np.zeros(steps.size, dtype=bool)
    apart[1:] = (ordered[1:] > OWN_CLOCK * np.median(steps)) & (ordered[1:] > APART * ordered[:-1])
    found = np.zeros(steps.size, dtype=bool)
    found[order] = np.logical_or.accumulate(apart)
    return found


def own_rate(
    missing: BoolArray, *, least: int = CLOCK_GAPS, share: float = CLOCK_SHARE
) -> int | None:
    """k, where a value is given in every k-th row alone (give or take one); None otherwise."""
    steps = np.diff(np.flatnonzero(~missing))
    if steps.size < least:
        return None
    k = int(np.median(steps))
    kept = float(np.mean(np.abs(steps - k) <= 1))
    return k if k >= 2 and kept > share else None
