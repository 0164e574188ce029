"""Outliers: isolated spikes of a residual, found without a model of what else is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Spikes:
    """Isolated spikes in one channel."""

    channel: str
    masks: tuple[Array, ...]  # a record (N,) bool
    count: int
    share: float
    size: float  # median height, channel's unit
    energy: float  # sum of squares that they carry
    p_value: float


def find_spikes(
    channel: str, residuals: Sequence[Array], alpha: float, *, largest_share: float = 0.05
) -> Spikes | None:
    """Samples that differ from both neighbours more than noise ever would.

    With d_k = r_k - (r_{k-1} + r_{k+1}) / 2 a smooth misfit cancels; under white noise d has 1.5
    times its variance. A sample is a spike when |d_k| exceeds the Gaussian threshold for all
    samples together at `alpha`, and the neighbours themselves are not as far off. Scale: the
    larger of the median absolute deviation and the spread of the central 98 %, so that quantised
    records (many equal samples) do not count as noise-free.

    Returns None where there are none, or so many that they are not exceptions.
    """
    masks, heights = [], []
    total = sum(len(r) for r in residuals)
    worst = 0.0
    for r in residuals:
        mask = np.zeros(len(r), dtype=bool)
        if len(r) >= 20:
            d = np.zeros(len(r))
            d[1:-1] = r[1:-1] - 0.5 * (r[:-2] + r[2:])
            core = np.sort(np.abs(d[1:-1]))
            mad = 1.4826 * float(np.median(core))
            body = core[: int(0.96 * len(core))]
            # Standard deviation of a normal cut off at its central 96 %, undone.
            spread = float(np.sqrt(np.mean(body**2))) / 0.880
            sd = max(mad, spread, 1e-300)
            threshold = float(norm.isf(alpha / (2 * total)))
            candidate = np.abs(d) > threshold * sd
            # A spike's neighbours show half of it, with the other sign: keep the tops only.
            for k in np.flatnonzero(candidate):
                near = np.abs(d[max(k - 1, 0) : k + 2])
                mask[k] = np.abs(d[k]) >= near.max()
            heights.append(np.abs(d[mask]))
            worst = max(worst, float(np.max(np.abs(d), initial=0.0)) / sd)
        masks.append(mask)
    count = int(sum(m.sum() for m in masks))
    if count == 0 or count > largest_share * total:
        return None
    height = np.concatenate(heights)
    single = 2 * total * float(norm.sf(worst))
    return Spikes(
        channel=channel,
        masks=tuple(masks),
        count=count,
        share=count / total,
        size=float(np.median(height)),
        energy=float(np.sum(height**2)),
        p_value=float(min(1.0, max(single, 1e-300))),
    )
