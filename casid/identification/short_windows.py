"""The fit of an unstable model in short windows, each of which begins in a state of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.data.experiment import Experiment
from casid.errors import CasidError, OutOfTimeError
from casid.estimation.local_rank import rank_of
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.instability import fewest_samples, window_for
from casid.estimation.simulation.minimization import Fit, departures
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import INSTABILITY
from casid.identification.signs_from_simulation import is_poor
from casid.model.model import Model
from casid.model.quantities import quantity_text


@dataclass(frozen=True, slots=True)
class ShortWindows:
    """Windows over which simulations of an unstable model stay with its records.

    Attributes
    ----------
    samples : of a window, the longest that determines every unknown, and no longer than a few of
        those over which the model follows the records: it diverges from them in longer ones, where
        its fit is led far astray.
    values : the parameters of a fit in windows, by variable name; none where no fit was found.
    """

    samples: int
    values: dict[str, float]


def short_windows(
    criterion: SimulationError,
    settings: FitSettings,
    say: Callable[[str], None],
    start: Mapping[str, float] | None = None,
) -> ShortWindows:
    """The windows for records of an unstable model, at the values of a fit in such windows.

    Parameters
    ----------
    criterion : of whole records.
    start : where the fit begins, over the declared start.
    """
    values, followed = _values_in_windows(criterion, settings, say, start or {})
    at = criterion.of_records(criterion.experiments, start=values)
    longest = _longest_informative_window(at, values)
    if followed:
        longest = min(longest, INSTABILITY.followed * followed)
    return ShortWindows(longest, values)


def windowed_records(experiments: Sequence[Experiment], samples: int) -> list[Experiment]:
    """The records in windows of so many samples, each of which begins in a state of its own."""
    return [replace(e, window=samples) for e in experiments]


def _values_in_windows(
    criterion: SimulationError,
    settings: FitSettings,
    say: Callable[[str], None],
    start: Mapping[str, float],
) -> tuple[dict[str, float], int]:
    """The parameters of a fit in windows, and the samples of these if it is not poor, or 0.

    No parameters where no fit is found in the shortest.

    In shorter ones where simulations leave the record, the fit ends where the model is stable, or
    it is poor: over long windows it has minima far from the truth, and over short ones what is
    missing counts little.
    """
    window, records = _longest_informative_window(criterion, start), criterion.experiments
    values: dict[str, float] = {}
    while window >= fewest_samples(criterion):
        say(f"fit it in windows of {quantity_text(window * criterion.data[0].Ts, 's')}")
        cut, once = windowed_records(records, window), replace(settings, starts=1)
        fit = tried(criterion.model, cut, once, start, is_trial=True)
        if fit is not None:
            named = zip(fit.criterion.variables, fit.x.tolist(), strict=True)
            found = {v.name: x for v, x in named if v.source in criterion.model.parameters}
            if window_for(criterion.of_records(records, start=found)):
                values = found
                if not is_poor(fit):
                    return values, window
        window //= 2
    return values, 0


def _longest_informative_window(criterion: SimulationError, start: Mapping[str, float]) -> int:
    """The window for records at their `start`, halved while simulations over it leave them.

    A model that lacks something may seem to grow more slowly than what was measured does.
    """
    window, least = window_for(criterion), fewest_samples(criterion)
    while window > least:
        cut = criterion.of_records(windowed_records(criterion.experiments, window), start=start)
        at = cut.evaluate(cut.start)
        finite = np.isfinite(at.value) and np.all(np.isfinite(at.hessian))
        if finite and rank_of(cut.variables, at.hessian, cut.start).is_full:
            break
        if not departures(cut, cut.start)[0]:
            break
        window = max(window // 2, least)
    return window


def tried(
    model: Model,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    start: Mapping[str, float] | None = None,
    *,
    is_trial: bool = False,
) -> Fit | None:
    """The fit of a model, or None where none is found.

    Parameters
    ----------
    is_trial : a poor one ends with the integration steps that it has.
    """
    settings = replace(settings, ends_at=is_poor) if is_trial else settings
    try:
        return fit_model(model, experiments, settings, start=start)
    except OutOfTimeError:
        raise
    except CasidError:
        return None
