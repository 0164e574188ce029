"""Bursts: the instants at which most of a misfit begins and ends.

The transient that a jump of a parameter excites may decay within a period of the motion. A jump
assumed at an instant further from the true one explains almost none of it, and scores low: so the
instants tested have to include the beginning of the burst, and its end: a window that was open for
an hour lies between two instants of no coarse grid.

The burst is the stretch with the largest sum of p_k - c mean(p), p_k the square of the whitened
residual at sample k (the maximum of a cumulative sum over its running minimum). It begins where
that minimum is, and ends where the maximum is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import BURSTS


def burst(powers: Sequence[Array], times: Sequence[Array]) -> tuple[float, ...]:
    """When the strongest burst of a misfit begins and ends [s]; nothing where none stands out.

    The end alone is left out where it is that of the record.

    Parameters
    ----------
    powers : sum of squares of the whitened residual at every sample of each record (N,); one of
        noise alone has the mean 1 an output.
    times : of these samples [s], by each record's clock.
    """
    total = sum(float(p.sum()) for p in powers)
    mean = total / max(sum(len(p) for p in powers), 1)
    best, found = BURSTS.share * total, np.empty(0)
    for power, t in zip(powers, times, strict=True):
        sums = np.concatenate([[0.0], np.cumsum(power - BURSTS.over_mean * mean)])
        risen = sums - np.minimum.accumulate(sums)
        last = int(np.argmax(risen))
        first = int(np.argmin(sums[: last + 1]))
        if risen[last] > max(best, TINY) and first > BURSTS.start * len(power):
            best, found = float(risen[last]), t[[first, last] if last < len(t) else [first]]
    return tuple(found.tolist())


def burst_of(at: Weighted) -> tuple[float, ...]:
    """As `burst`, of the misfit of a model."""
    data = at.criterion.data
    residuals = [at.criterion.columns(at.fit.x, e)[0] for e in range(len(data))]
    powers = [np.sum(r**2, axis=1) for r in residuals]
    return burst(powers, [d.t[: len(p)] for d, p in zip(data, powers, strict=True)])
