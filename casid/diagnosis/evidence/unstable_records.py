"""Records of unstable models, such as plants that a controller holds: simulated window by window.

A simulation of an unstable model leaves the record whatever its parameters are, and says nothing of
what is missing. Each window of the record starts in a state of its own, estimated with the
parameters. Fits, residuals, tests and what is held out are then those of simulations over a window:
predictions over at most its length, free of the growth that the controller took away.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from casid.data.experiment import Experiment
from casid.errors import CasidError, OutOfTimeError
from casid.estimation.holdout import Split
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.instability import growth_rate, window_for
from casid.estimation.simulation.simulation_error import SimulationError
from casid.identification.signs_from_simulation import is_poor
from casid.model.model import Model
from casid.model.quantities import quantity_text


def in_windows(
    model: Model, split: Split, settings: FitSettings, say: Callable[[str], None]
) -> tuple[Split, str]:
    """The records in windows where the model is unstable, and a note on them.

    The same as given, and no note, where the model is stable, or a simulation of the whole record
    fits all the same (a motion that leaves an unstable equilibrium once).
    """
    criterion = SimulationError(model, split.fitted)
    window = window_for(criterion)
    if not window:
        return split, ""
    say("the model is unstable: fit the whole record once")
    if _is_simulated(model, split.fitted, settings):
        return split, ""
    seconds = quantity_text(window * criterion.data[0].Ts, "s")
    apart = quantity_text(1 / growth_rate(criterion), "s")
    say(f"simulate it in windows of {seconds}")

    def windowed(experiments: Sequence[Experiment]) -> list[Experiment]:
        return [replace(e, window=window) for e in experiments]

    cut = Split(windowed(split.fitted), windowed(split.whole), split.held, windowed(split.apart))
    return cut, (
        f"the model is unstable: at the start values a small error grows e-fold in {apart}, so a "
        f"simulation of a whole record diverges. Each window of {seconds} is simulated from an "
        "initial state of its own; errors and what is held out are those of such simulations"
    )


def _is_simulated(model: Model, experiments: Sequence[Experiment], settings: FitSettings) -> bool:
    """True if a simulation of the whole records fits them."""
    try:
        return not is_poor(fit_model(model, experiments, replace(settings, starts=1)))
    except OutOfTimeError:
        raise
    except CasidError:
        return False
