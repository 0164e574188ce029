"""The error bars of the model as it is and of the extended one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY
from casid.diagnosis.search.findings import Findings
from casid.diagnosis.search.refusals import Refusal
from casid.diagnosis.thresholds import JUDGING
from casid.diagnosis.verdict.cause import Cause
from casid.estimation.errors_in_variables.error_bars import error_bars, robust_bars
from casid.estimation.errors_in_variables.removal import Corrected
from casid.estimation.estimate import Estimate
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation_estimate import ASSUMES, BIASED, ErrorBars

ROUNDED = (
    "; how sharply dry friction, or a constant voltage, reverses is included as far as it is not "
    "known"
)
PLACED = "; the instants of changes are included as far as they are not known"


def bars_of(
    fit: Fit,
    corrected: Corrected | None,
    roundings: Sequence[Mapping[str, float]] = (),
    shifts: Sequence[Mapping[str, float]] = (),
) -> ErrorBars:
    """Error bars as of `identify`, with the instants found; of a whitened fit the robust ones.

    Parameters
    ----------
    corrected : what became of the bias of noise on measured inputs, where it was looked at.
    roundings : of every cause, variable -> what a standard deviation of how sharply dry friction
        reverses moves its estimate by.
    shifts : the same of the instants of changes.
    """
    if fit.criterion.whiten is not None:
        return robust_bars(fit, ASSUMES + BIASED)
    bars = error_bars(corrected or Corrected(fit, why_not="it was not looked at"))
    roundings, shifts = [r for r in roundings if r], [s for s in shifts if s]
    if not (roundings or shifts):
        return bars
    covariance, free = bars.covariance, fit.solution.is_free
    for moved in (*roundings, *shifts):
        added = free * np.array([moved.get(n, 0.0) for n in fit.criterion.names])
        covariance = covariance + np.outer(added, added)
    assumes = bars.assumes + (ROUNDED if roundings else "") + (PLACED if shifts else "")
    return replace(bars, covariance=covariance, assumes=assumes)


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


def without_made_up(found: Findings) -> Findings:
    """What was found, without causes that do no more than make up for bounds.

    A gain that may not be as large as it is leaves what a step beside its input's explains. Beside
    a cause of that kind nothing holds the gain, and the records determine neither to within itself.
    """
    fit, bare = found.extended_fit, found.base_fit
    held = {*bare.solution.at_lower, *bare.solution.at_upper} & {*bare.criterion.model.parameters}
    bars = extended_bars(found) if found.adopted and held else None
    if fit is None or fit.criterion.whiten is not None or bars is None:
        return found
    errors = np.sqrt(np.maximum(np.diag(bars.covariance), 0.0))
    spread = zip(fit.criterion.names, errors, strict=True)
    unknown = {name for name, sd in spread if sd > abs(fit.values[name])}
    lost = sorted(held & unknown)
    if not lost or any(a.candidate.names[0] not in unknown for a in found.adopted):
        return found
    why = Refusal(f"it makes up for {' and '.join(lost)}, held at a bound without it")
    found.search.refused += [(a.candidate, why) for a in found.adopted]
    own = found.baseline.fit if found.baseline.is_extended else None
    return Findings(found.baseline, found.search, found.baseline.start, own)


def extended_bars(found: Findings) -> ErrorBars:
    """The error bars of the extended model, with all that was found of its causes."""
    assert found.extended_fit is not None
    shifts = [shift for a in found.adopted for shift in a.shifts]
    return bars_of(found.extended_fit, found.corrected, [a.rounding for a in found.adopted], shifts)
