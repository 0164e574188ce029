"""A channel that shows the size of its quantity, found by the simulation error with the size shown.

A tachometer without a sign shows |speed|. To its record the model as it is fits next to nothing,
with parameters at their bounds, and no effect can be tested from there. So where a fit is poor, a
channel that never goes below zero, while its simulation does, is simulated as the absolute value
and the parameters are estimated anew, as with a channel of the wrong sign: it is named if the
simulation then misses by less than half the power, and by no chance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.diagnosis.settings import DiagnosisSettings
from casid.errors import IdentifiabilityError, OutOfTimeError, SolveError
from casid.estimation.holdout import Split
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.identification.signs_from_simulation import (
    CLEARLY,
    better_by_chance,
    is_better_than_the_mean,
    squared_errors,
)
from casid.model.effects.channels.sensor_effects import rectified, shows_sizes
from casid.model.effects.search_ranges import RECTIFIED
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Rectified:
    """A channel that shows absolute values, and the model in which it does.

    Attributes
    ----------
    name : of the parameter that is 1 in `model`.
    p_value : that it fits better by chance, corrected for the number of channels tried.
    fit : of `model`.
    """

    channel: str
    name: str
    model: Model
    p_value: float
    fit: Fit


def rectified_channel(split: Split, settings: DiagnosisSettings, fit: Fit) -> Rectified | None:
    """The output that shows absolute values, if any, where the `fit` of the model is poor."""
    if "rectified" in settings.without:
        return None
    before, tried = squared_errors(fit), list(_possible(fit))
    found: list[Rectified] = []
    for channel in tried:
        settings.progress(f"fit the model with the absolute value of {channel}")
        effect = rectified(fit.criterion.model, channel)
        first = effect.parameters[0].name
        model, (name,) = effect.extended(fit.criterion.model, starts={first: 1.0})
        model = model.with_known(**{name: 1.0})
        new = _fitted(model, split, settings.fit)
        if new is None or not is_better_than_the_mean(new):
            continue
        after = squared_errors(new)
        p = min(1.0, len(tried) * better_by_chance(before - after))
        if p < settings.alpha and float(after.sum()) < CLEARLY * float(before.sum()):
            found.append(Rectified(channel, name, model, p, new))
    return min(found, key=lambda r: float(squared_errors(r.fit).sum()), default=None)


def _possible(fit: Fit) -> Iterator[str]:
    """Outputs that are never less than zero, while the simulation of them changes its sign.

    Where the parameters are declared to start, or where the fit ended.
    """
    c = fit.criterion
    for i, channel in enumerate(c.outputs):
        y = np.concatenate([d.y[d.used[:, i] > 0, i] for d in c.data])
        if y.size and shows_sizes(float(y.min()), float(y.max())):
            simulated = (
                np.concatenate([c.simulated(x, e).y[:, i] for e in range(len(c.data))])
                for x in (c.start, fit.x)
            )
            if any(map(_changes_sign, simulated)):
                yield channel


def _changes_sign(y: Array) -> bool:
    low, high = float(np.min(y)), float(np.max(y))
    least = RECTIFIED.below_zero * max(abs(low), abs(high))
    return low < -least and high > least


def _fitted(model: Model, split: Split, settings: FitSettings) -> Fit | None:
    """The fit, with the signs of the states at the beginning that it has or with the others."""
    try:
        fit = fit_model(model, split.fitted, settings, throw=False)
        turned = {
            v.name: -fit.values[v.name]
            for v in fit.criterion.variables
            if v.source in model.states and v.lower <= -fit.values[v.name] <= v.upper
        }
        once = replace(settings, starts=1)
        start = {**fit.values, **turned}
        other = fit_model(model, split.fitted, once, start=start, check_rank=False, throw=False)
    except OutOfTimeError:
        raise
    except (SolveError, IdentifiabilityError):
        return None
    return min((fit, other), key=lambda f: f.solution.value)
