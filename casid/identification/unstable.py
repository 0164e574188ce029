"""Unstable models, such as plants that a controller alone holds: what can be estimated of them.

A simulation of the whole record diverges. In segments joined by constraints it stays with the
record where the model is exact but for the noise of its sensors. A random disturbance moves the
plant off every path that the model has: there the prediction error of a Kalman filter is minimised,
with the disturbance in the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from casid.estimation.covariance import LAGS_OUTSIDE, whiteness
from casid.estimation.simulation.fit import weighted_by_errors
from casid.estimation.simulation.instability import segments_for
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from casid.identification.short_windows import short_windows, tried, windowed_records
from casid.identification.signs_from_simulation import is_poor
from casid.identification.signs_of_terms import WrongTerm, wrong_term
from casid.identification.task import Task


@dataclass(frozen=True, slots=True)
class InWindows:
    """An unstable model, fitted in short windows of its records.

    Attributes
    ----------
    values : the parameters, by variable name; none where no fit was found.
    is_disturbed : whether simulations over a window err by more than white noise.
    segments : into which a record is to be divided for multiple shooting.
    whole : the poor fit of whole records; None where there is none.
    wrong : terms that make the model unstable by a wrong sign; it is not fitted in windows then.
    """

    values: dict[str, float]
    is_disturbed: bool
    segments: int
    whole: Fit | None
    wrong: WrongTerm | None = None


def unstable_in_windows(task: Task) -> InWindows | None:
    """The model in short windows, where a simulation of the whole record says nothing.

    None where the model is stable, or a simulation of the whole record fits all the same (a motion
    that leaves an unstable equilibrium once).
    """
    model, experiments, settings = task.problem.model, task.split.fitted, task.settings
    criterion = SimulationError(model, experiments, own=settings.own, start=task.start)
    segments = segments_for(criterion)
    if segments == 1:
        return None
    task.say("the model is unstable: fit the whole record once")
    once = replace(settings, starts=1)
    whole = tried(model, experiments, once, task.start)
    if whole is not None and not is_poor(whole):
        return None
    task.say("the fit is poor: negate each term in turn")
    wrong = wrong_term(model, experiments, settings, whole)
    if wrong is not None:
        return InWindows({}, False, segments, whole, wrong)
    windows = short_windows(criterion, settings, task.say, task.start)
    cut = windowed_records(experiments, windows.samples)
    fit = tried(model, cut, once, windows.values)
    is_white = fit is not None and _is_white(weighted_by_errors(fit, once))
    return InWindows(windows.values, not is_white, segments, whole)


def _is_white(fit: Fit) -> bool:
    """True if no more of a fit's residuals is correlated in time than of white noise."""
    for e, d in enumerate(fit.criterion.data):
        left = fit.criterion.simulated(fit.x, e).residual
        for i in range(left.shape[1]):
            if whiteness(left[d.used[:, i], i]) > LAGS_OUTSIDE:
                return False
    return True


def fit_in_segments(task: Task, unstable: InWindows) -> Fit | None:
    """The fit by multiple shooting; None without one, or where that of whole records is better."""
    task.say(f"fit it in {unstable.segments} segments")
    divided = replace(task.settings, segments=unstable.segments)
    parts = tried(task.problem.model, task.split.fitted, divided, task.start)
    whole = unstable.whole
    if parts is None or (whole is not None and whole.solution.value <= parts.solution.value):
        return None
    return parts
