"""Shares of cases: their intervals, their targets, and two judges of the same cases."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import beta, binom

CHANCE = 0.01
"""Of a target being missed by chance alone, where a small study is judged at its limit."""


def rate(hits: int, of: int) -> dict[str, Any]:
    """A share with its 95 % interval (Clopper and Pearson 1934); the share is None of no cases."""
    low = float(beta.ppf(0.025, hits, of - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, of - hits)) if hits < of else 1.0
    return {"hits": hits, "of": of, "rate": hits / of if of else None, "low": low, "high": high}


def reaches(hits: int, of: int, wanted: float, *, quick: bool) -> bool:
    """True if a share is `wanted` or more, with `quick` unless it is less beyond chance."""
    return bool(binom.cdf(hits, of, wanted) > CHANCE if quick else hits / of >= wanted)


def stays_within(hits: int, of: int, wanted: float, *, quick: bool) -> bool:
    """True if a share is `wanted` or less, with `quick` unless it is more beyond chance."""
    return bool(binom.sf(hits - 1, of, wanted) > CHANCE if quick else hits / of <= wanted)


def ratio(ours: Sequence[bool], theirs: Sequence[bool]) -> tuple[float, float, float, float]:
    """Our share of hits over theirs in the same cases, its 95 % interval, and what we lose.

    The interval is McNemar's: with n cases, b that they alone have right and c that we alone have,
    the difference of the shares is (c - b) / n with variance (b + c - (b - c)^2 / n) / n^2 (Agresti
    2013, section 11.1), divided by their share. The last number is b / n.
    """
    a, t, n = np.asarray(ours, bool), np.asarray(theirs, bool), len(ours)
    b, c = int(np.sum(t & ~a)), int(np.sum(a & ~t))
    share = max(float(t.mean()), 1.0 / n)
    half = 1.96 * float(np.sqrt(b + c - (b - c) ** 2 / n)) / n / share
    R = float(a.mean()) / share
    return R, R - half, R + half, b / n
