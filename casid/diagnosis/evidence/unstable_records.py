"""Records of unstable models, such as plants that a controller holds: simulated window by window.

A simulation of an unstable model diverges from the record whatever its parameters are, and so does
not show what is missing. Each window of the record starts in a state of its own, estimated with the
parameters. Fits, residuals, tests and what is held out are then those of simulations over a window:
predictions over at most its length, free of the growth that the controller took away.

How fast the model grows, and so how long a window is, its parameters say: far from the truth their
windows are so long that simulations leave the record in all of them, or so short that they show
little. A fit in joined segments, which the record itself holds, comes first: windows begin with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from casid.data.experiment import Experiment
from casid.diagnosis.thresholds import BUDGET
from casid.errors import OutOfTimeError
from casid.estimation.fit_statistics import rms
from casid.estimation.holdout import Split, whole_simulation
from casid.estimation.local_rank import rank_of
from casid.estimation.simulation.fit import FitSettings, value_at_start
from casid.estimation.simulation.instability import (
    fewest_samples,
    growth_rate,
    segments_for,
    window_for,
)
from casid.estimation.simulation.minimization import Fit, departures
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import INSTABILITY
from casid.identification.signs_from_simulation import is_poor
from casid.identification.unstable import tried
from casid.model.model import Model
from casid.model.quantities import quantity_text
from casid.time_limit import seconds_left, until, wall_clock


def records_in_windows(
    model: Model, split: Split, settings: FitSettings, say: Callable[[str], None]
) -> tuple[Split, str, dict[str, float]]:
    """The records in windows where the model is unstable, a note on them, and where to begin.

    The same as given, no note and no values where the model is stable, or a simulation of the whole
    record fits all the same, to its end (a motion that leaves an unstable equilibrium once).
    """
    criterion = SimulationError(model, split.fitted)
    if not window_for(criterion):
        return split, "", {}
    say("the model is unstable: fit the whole record once")
    whole = tried(model, split.fitted, replace(settings, starts=1))
    if whole is not None and not (is_poor(whole) or _runs_away(whole, split)):
        return split, "", {}
    criterion, start = _nearer(criterion, settings, say)
    window = _longest_informative_window(criterion, start, window_for(criterion))
    seconds = quantity_text(window * criterion.data[0].Ts, "s")
    apart = quantity_text(1 / growth_rate(criterion), "s")
    say(f"simulate it in windows of {seconds}")

    def windowed(experiments: Sequence[Experiment]) -> list[Experiment]:
        return [replace(e, window=window) for e in experiments]

    cut = Split(windowed(split.fitted), windowed(split.whole), split.held, windowed(split.apart))
    at = "the values of a fit in segments" if start else "the start values"
    return (
        cut,
        f"the model is unstable: at {at} a small error grows e-fold in {apart}, so a "
        f"simulation of a whole record diverges. Each window of {seconds} is simulated from an "
        "initial state of its own; errors and what is held out are those of such simulations",
        start,
    )


def _runs_away(whole: Fit, split: Split) -> bool:
    """True if a simulation that reproduces the fitted part departs from what is held out.

    The parameters of an unstable model can bend the path of one record where its own do not.
    """
    for i, held in enumerate(split.held):
        d, y, _ = whole_simulation(whole, split, i)
        if not np.all(np.isfinite(y)):
            return True
        error = np.where(d.used, d.y - y, np.nan)
        if held.any() and np.any(rms(error[held]) > INSTABILITY.departs * rms(error[~held])):
            return True
    return False


def _nearer(
    criterion: SimulationError, settings: FitSettings, say: Callable[[str], None]
) -> tuple[SimulationError, dict[str, float]]:
    """The criterion at the values of a fit in segments, and the values.

    As it is, and no values, where the model is stable at those, or no segments fit the record in
    their share of the time: what the model is missing may be to blame then, and the start values
    stay unless windows diverge.
    """
    model, records = criterion.model, criterion.experiments
    segments = segments_for(criterion)
    say(f"fit it in {segments} segments")
    fit: Fit | None = None
    with suppress(OutOfTimeError), until(wall_clock() + BUDGET.segments * seconds_left()):
        fit = tried(model, records, replace(settings, starts=1, segments=segments))
    if fit is None:
        return criterion, {}
    values = {name: v for name, v in fit.values.items() if name in model.parameters}
    there = SimulationError(model, records, start=values)
    if not window_for(there) or (is_poor(fit) and not _diverges(criterion)):
        return criterion, {}
    return there, values


def _longest_informative_window(
    criterion: SimulationError, start: Mapping[str, float], window: int
) -> int:
    """The window, halved while simulations over it leave the record and so show no parameter.

    A model that lacks something may seem to grow more slowly than what was measured does.
    """
    least = fewest_samples(criterion)
    while window > least:
        records = [replace(e, window=window) for e in criterion.experiments]
        cut = SimulationError(criterion.model, records, start=start)
        at = cut.evaluate(cut.start)
        finite = np.isfinite(at.value) and np.all(np.isfinite(at.hessian))
        if finite and rank_of(cut.variables, at.hessian, cut.start).is_full:
            break
        if not departures(cut, cut.start)[0]:
            break
        window = max(window // 2, least)
    return window


def _diverges(criterion: SimulationError) -> bool:
    """True if simulations in windows leave all numbers at the start values."""
    window = window_for(criterion)
    cut = [replace(e, window=window) for e in criterion.experiments]
    return not math.isfinite(value_at_start(SimulationError(criterion.model, cut)))
