"""Bursts: the instant at which most of a misfit begins.

The transient that a jump of a parameter excites may decay within a period of the motion. A jump
assumed at an instant further from the true one explains almost none of it, and scores low: so the
instants tested have to include the beginning of the burst.

The burst is the stretch with the largest sum of p_k - c mean(p), p_k the square of the whitened
residual at sample k (the maximum of a cumulative sum over its running minimum). It begins where
that minimum is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.thresholds import BURSTS


def burst_onset(powers: Sequence[Array], times: Sequence[Array]) -> float | None:
    """When the strongest burst of a misfit begins [s]; None where no stretch stands out.

    Parameters
    ----------
    powers : sum of squares of the whitened residual at every sample of each record (N,); one of
        noise alone has the mean 1 an output.
    times : of these samples [s], by each record's clock.
    """
    total = sum(float(p.sum()) for p in powers)
    mean = total / max(sum(len(p) for p in powers), 1)
    best, onset = BURSTS.share * total, None
    for power, t in zip(powers, times, strict=True):
        sums = np.concatenate([[0.0], np.cumsum(power - BURSTS.over_mean * mean)])
        risen = sums - np.minimum.accumulate(sums)
        last = int(np.argmax(risen))
        first = int(np.argmin(sums[: last + 1]))
        if risen[last] > max(best, TINY) and first > BURSTS.start * len(power):
            best, onset = float(risen[last]), float(t[first])
    return onset
