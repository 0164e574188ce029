"""Points of the fits under a noise: moved, and at bounds."""

from __future__ import annotations

from dataclasses import replace

from casid.arrays import Array
from casid.diagnosis.thresholds import PREWHITENING
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.unknowns import Variable


def is_at_bound(v: Variable, value: float) -> bool:
    """True at a bound, or as near as a solver that stays inside comes."""
    near = PREWHITENING.near_bound * max(abs(value), v.scale)
    return bool(not v.lower + near < value < v.upper - near)


def moved(fit: Fit, criterion: SimulationError, x: Array) -> Fit:
    """A fit at another point, or of another criterion."""
    there = criterion.evaluate(x)
    sides = {
        side: tuple(
            v.name for v, a in zip(criterion.variables, x, strict=True) if a == getattr(v, side)
        )
        for side in ("lower", "upper")
    }
    solution = replace(
        fit.solution,
        x=x,
        value=there.value,
        hessian=there.hessian,
        at_lower=sides["lower"],
        at_upper=sides["upper"],
    )
    return replace(fit, criterion=criterion, solution=solution)


def use_samples_of(criterion: SimulationError, other: SimulationError) -> None:
    """Count the samples that another criterion of the same records counts; a delay leaves out some.

    To be called before `criterion` is simulated: it keeps the residuals of its last simulation.
    """
    for mine, its in zip(criterion.data, other.data, strict=True):
        mine.used[:] = its.used
