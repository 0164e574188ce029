"""Measures of fit: RMS error and NRMSE fit, missing samples left out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from casid.arrays import TINY, Array

POOR = 20.0
"""Fit [%] of an output up to which the model explains next to nothing of it (a heuristic)."""


def poor_fit_text(fits: Mapping[str, Mapping[str, float]]) -> str:
    """A warning of outputs that the model explains next to nothing of; empty where there is none.

    Parameters
    ----------
    fits : record -> output -> fit [%].
    """
    poor = poor_outputs(fits)
    if not poor:
        return ""
    return (
        f"the model explains next to nothing of {', '.join(poor)}: the fit is 100 % where "
        "simulation and measurement agree, 0 % for the mean. Check signs, units and mapping of "
        "the channels; the parameters mean little"
    )


def poor_outputs(fits: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Outputs that the model explains next to nothing of, with their records and fits."""
    return [
        f"{output} in {record} ({fit:.3g} %)"
        for record, by_output in fits.items()
        for output, fit in by_output.items()
        if fit <= POOR
    ]


def rms(error: Array) -> Array:
    """(ny,) root mean square of the columns, NaN left out; NaN of a column without a number."""
    with np.errstate(all="ignore"):
        there = np.sum(~np.isnan(error), axis=0)
        return np.asarray(np.sqrt(np.nansum(error**2, axis=0) / there))


def nrmse_fit(measured: Array, error: Array) -> Array:
    """(ny,) 100 (1 - |y - yhat| / |y - mean y|) per cent, NaN left out."""
    with np.errstate(all="ignore"):
        mean = np.nansum(measured, axis=0) / np.sum(~np.isnan(measured), axis=0)
    spread = np.nansum((measured - mean) ** 2, axis=0)
    return np.asarray(100 * (1 - np.sqrt(np.nansum(error**2, axis=0) / np.maximum(spread, TINY))))
