"""Records of unstable models, such as plants that a controller holds: simulated window by window.

A simulation of an unstable model diverges from the record whatever its parameters are, and so does
not show what is missing. Each window of the record starts in a state of its own, estimated with the
parameters. Fits, residuals, tests and what is held out are then those of simulations over a window:
predictions over at most its length, free of the growth that the controller took away.

How fast the model grows, and so how long a window is, its parameters say: far from the truth their
windows are so long that simulations leave the record in all of them, or so short that they show
little. A fit in windows that the record holds from the start values on comes first, and says how
long windows are to be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from casid.estimation.fit_statistics import rms
from casid.estimation.holdout import Split, whole_simulation
from casid.estimation.simulation.fit import FitSettings
from casid.estimation.simulation.instability import growth_rate, window_for
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import INSTABILITY
from casid.identification.short_windows import short_windows, tried, windowed_records
from casid.identification.signs_from_simulation import is_poor
from casid.identification.signs_of_terms import WrongTerm, wrong_term
from casid.model.model import Model
from casid.model.quantities import quantity_text


@dataclass(frozen=True, slots=True, eq=False)
class RecordsInWindows:
    """Records as they are to be simulated.

    Attributes
    ----------
    split : the records, cut into windows where the model is unstable.
    note : on the windows; empty where there are none.
    start : variable -> value that a fit in short windows found; empty without one.
    wrong : terms that make the model unstable by a wrong sign; there are no windows then.
    """

    split: Split
    note: str = ""
    start: Mapping[str, float] = field(default_factory=dict)
    wrong: WrongTerm | None = None


def records_in_windows(
    model: Model, split: Split, settings: FitSettings, say: Callable[[str], None]
) -> RecordsInWindows:
    """The records in windows where the model is unstable.

    As given where it is stable, or a simulation of the whole record fits all the same, to its end
    (a motion that leaves an unstable equilibrium once).
    """
    criterion = SimulationError(model, split.fitted)
    if not window_for(criterion):
        return RecordsInWindows(split)
    say("the model is unstable: fit the whole record once")
    whole = tried(model, split.fitted, replace(settings, starts=1), is_trial=True)
    if whole is not None and not (is_poor(whole) or _runs_away(whole, split)):
        return RecordsInWindows(split)
    say("the fit is poor: negate each term in turn")
    wrong = wrong_term(model, split.fitted, settings, whole)
    if wrong is not None:
        return RecordsInWindows(split, wrong=wrong)
    windows = short_windows(criterion, settings, say)
    criterion = criterion.of_records(split.fitted, start=windows.values)
    seconds = quantity_text(windows.samples * criterion.data[0].Ts, "s")
    apart = quantity_text(1 / growth_rate(criterion), "s")
    say(f"simulate it in windows of {seconds}")
    cut = partial(windowed_records, samples=windows.samples)
    at = "the values of a fit in short windows" if windows.values else "the start values"
    return RecordsInWindows(
        replace(split, fitted=cut(split.fitted), whole=cut(split.whole), apart=cut(split.apart)),
        f"the model is unstable: at {at} a small error grows e-fold in {apart}, so a "
        f"simulation of a whole record diverges. Each window of {seconds} is simulated from an "
        "initial state of its own; errors and what is held out are those of such simulations",
        windows.values,
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
