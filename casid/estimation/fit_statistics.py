"""Measures of fit: RMS error and NRMSE fit, missing samples left out."""

from __future__ import annotations

import numpy as np

from casid.arrays import TINY, Array


def rms(error: Array) -> Array:
    """(ny,) root mean square of the columns, NaN left out."""
    with np.errstate(all="ignore"):
        return np.asarray(np.sqrt(np.nanmean(error**2, axis=0)))


def nrmse_fit(measured: Array, error: Array) -> Array:
    """(ny,) 100 (1 - |y - yhat| / |y - mean y|) per cent, NaN left out."""
    spread = np.nansum((measured - np.nanmean(measured, axis=0)) ** 2, axis=0)
    return np.asarray(100 * (1 - np.sqrt(np.nansum(error**2, axis=0) / np.maximum(spread, TINY))))
