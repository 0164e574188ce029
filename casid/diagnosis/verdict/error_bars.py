"""The error bars of the model as it is and of the extended one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.estimation.covariance import sandwich
from casid.estimation.errors_in_variables.removal import Corrected
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_estimate import ErrorBars
from casid.identification.error_bars import error_bars

ROUNDED = "; how sharply dry friction reverses is included as far as it is not known"


def bars_of(
    fit: Fit, corrected: Corrected | None, roundings: Sequence[Mapping[str, float]] = ()
) -> ErrorBars | None:
    """As `identify` has them, and what roundings of dry friction add; None of a whitened fit.

    Parameters
    ----------
    corrected : what became of the bias of noise on measured inputs, where it was looked at.
    roundings : of every cause, variable -> what a standard deviation of how sharply dry friction
        reverses moves its estimate by.
    """
    if fit.criterion.whiten is not None:
        return None
    bars = error_bars(corrected or Corrected(fit, why_not="it was not looked at"))
    roundings = [r for r in roundings if r]
    if not roundings:
        return bars
    covariance, free = bars.covariance, fit.solution.is_free
    if covariance is None:
        covariance, _ = sandwich(fit.solution.hessian, fit.criterion.scores(fit.x), free)
    for rounding in roundings:
        added = free * np.array([rounding.get(n, 0.0) for n in fit.criterion.names])
        covariance = covariance + np.outer(added, added)
    return replace(bars, covariance=covariance, assumes=bars.assumes + ROUNDED)
