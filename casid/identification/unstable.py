"""The fit of an unstable model, such as a plant that its controller alone holds, in segments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.errors import CasidError, OutOfTimeError
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.instability import segments_for
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from casid.identification.signs_from_simulation import is_poor
from casid.model.model import Model


def fit_unstable(
    problem: Problem,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    start: Mapping[str, float] | None,
    say: Callable[[str], None],
) -> Fit | None:
    """The fit by multiple shooting, where a simulation of the whole record says nothing.

    None where the model is stable, or a simulation of the whole record fits all the same (a motion
    that leaves an unstable equilibrium once), or no fit in segments is found either.
    """
    criterion = SimulationError(problem.model, experiments, own=settings.own, start=start)
    segments = segments_for(criterion)
    if segments == 1:
        return None
    say("the model is unstable: fit the whole record once")
    whole = tried(problem.model, experiments, replace(settings, starts=1), start)
    if whole is not None and not is_poor(whole):
        return None
    say(f"fit it in {segments} segments")
    parts = tried(problem.model, experiments, replace(settings, segments=segments), start)
    if parts is None or (whole is not None and whole.solution.value <= parts.solution.value):
        return None
    return parts


def tried(
    model: Model,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    start: Mapping[str, float] | None = None,
) -> Fit | None:
    """The fit of a model, or None where none is found."""
    try:
        return fit_model(model, experiments, settings, start=start)
    except OutOfTimeError:
        raise
    except CasidError:
        return None
