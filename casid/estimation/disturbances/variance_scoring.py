"""Variances under many spectra of one force at once: a grid of shapes is compared in one pass.

The same scoring as `noise.variances`, a candidate a slice: its steps are weighted least squares
without negative variances, in as many unknowns as there are sources of noise, all candidates at
once; those for which exchanging zeros does not end are solved one by one.
"""

from __future__ import annotations

import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.noise.residual_periodograms import Spectra, restricted
from casid.estimation.noise.variances import non_negative

STEPS = 60
"""Of the scoring, at most."""
HALVED, STALLED = 3, 10
"""Half steps are made before the first of these, where they are long, and after the second, where
whole ones go back and forth."""
EXCHANGES = 4
"""Of zeros, before a slice is solved alone: two are enough as a rule."""
RIDGE = 1e-12
"""Of columns of unit size, which keeps equations of dependent ones regular."""


def likelihoods(spectra: Spectra, design: Array, given: Array, tolerance: float) -> Array:
    """(G,) minus Whittle's log-likelihood at its maximum over the variances, of each design.

    Parameters
    ----------
    design : (G, B, k) |G|^2 in bands, in place of that of `spectra`.
    given : (k,) variances that are kept; NaN where they are sought.
    tolerance : relative change of the spectrum at which the scoring of a design ends.
    """
    free = ~np.isfinite(given)
    power, count, floor = spectra.power, spectra.count, spectra.floor
    offset = design[:, :, ~free] @ given[~free]
    columns = design[:, :, free]
    s = np.maximum(power, 1e-4 * floor) + offset
    solution = np.zeros((len(design), columns.shape[2]))
    kept, moving = np.ones(solution.shape, dtype=bool), np.arange(len(design))
    for k in range(STEPS):
        weight = np.sqrt(count) / s[moving]
        own = columns[moving] * weight[:, :, None]
        target = np.maximum(power - offset[moving], 0.0) * weight
        new = _least(own, target, kept[moving])
        kept[moving] = new > 0.0
        share = 1.0 if k == 0 or HALVED <= k < STALLED else 0.5
        solution[moving] += share * (new - solution[moving])
        after = (columns[moving] @ solution[moving][:, :, None])[:, :, 0] + offset[moving]
        before, after = s[moving], np.maximum(after, floor)
        s[moving] = after
        moving = moving[np.any(np.abs(after - before) >= tolerance * after, axis=1)]
        if not moving.size:
            break
    return np.asarray((np.log(s) + power / s) @ count) + restricted(spectra, s)


def _least(a: Array, b: Array, kept: Array) -> Array:
    """(G, k) non-negative x that minimise |a x - b| for a (G, B, k) and b (G, B).

    By exchanging all unknowns of the wrong sign at once: those below zero for those that would rise
    from it (Judice and Pires, Comput. Oper. Res. 21 (1994) 587-596), at first those not
    `kept` (G, k).
    """
    turned = a.transpose(0, 2, 1)
    normal, right = turned @ a, (turned @ b[:, :, None])[:, :, 0]
    scale = np.sqrt(np.einsum("gkk->gk", normal)) + TINY
    normal = normal / (scale[:, :, None] * scale[:, None, :]) + RIDGE * np.eye(a.shape[2])
    right = right / scale
    x, kept, open_ = np.zeros(right.shape), kept.copy(), np.arange(len(right))
    for _ in range(EXCHANGES):
        x[open_] = _of_those(normal[open_], right[open_], kept[open_].astype(float))
        slope = right[open_] - (normal[open_] @ x[open_][:, :, None])[:, :, 0]
        wrong = np.where(kept[open_], x[open_] < 0.0, slope > RIDGE * np.abs(right[open_]))
        kept[open_] ^= wrong
        open_ = open_[wrong.any(axis=1)]
        if not open_.size:
            break
    if open_.size:
        unit = a[open_] / scale[open_, None, :]
        x[open_] = [non_negative(*of_one) for of_one in zip(unit, b[open_], strict=True)]
    return np.asarray(x / scale)


def _of_those(normal: Array, right: Array, kept: Array) -> Array:
    """Solutions (..., k) of normal equations (..., k, k) in the unknowns kept, the others zero."""
    held = (1.0 - kept)[..., None] * np.eye(right.shape[-1])
    among = normal * (kept[..., :, None] * kept[..., None, :]) + held
    return np.asarray(np.linalg.solve(among, (right * kept)[..., None])[..., 0])
