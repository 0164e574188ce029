"""The error bars of the model as it is and of the extended one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY
from casid.diagnosis.thresholds import JUDGING
from casid.diagnosis.verdict.cause import Cause
from casid.estimation.covariance import sandwich
from casid.estimation.errors_in_variables.removal import Corrected
from casid.estimation.estimate import Estimate
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


def unknown_sizes(causes: Sequence[Cause], reported: Estimate) -> tuple[str, ...]:
    """A note on each cause that is there beyond doubt, of a size that is not known to itself.

    Its p is that of the effect, whatever its size; its size may exchange for those of other causes
    and for parameters of the model. Those that its error goes with are named, the nearest first.
    """
    names = list(reported.covariance_names)
    errors = np.sqrt(np.maximum(np.diag(reported.covariance), TINY))
    correlations = np.abs(reported.covariance) / np.outer(errors, errors)
    states = {p.name for p in reported.initial_states}
    out = []
    for p in (c.parameters[0] for c in causes if c.parameters):
        if p.std_error is None or p.std_error < abs(p.value) or p.name not in names:
            continue
        row = correlations[names.index(p.name)]
        with_it = [names[j] for j in np.argsort(-row) if row[j] >= JUDGING.exchanges]
        others = [n for n in with_it if n != p.name and n not in states]
        why = f": {' and '.join(others)} would make up for another one" if others else ""
        out.append(
            f"the size of {p.name} is not known to within itself{why}. What is significant is that "
            "the effect is there, not how large it is"
        )
    return tuple(out)
