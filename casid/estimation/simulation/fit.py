"""Least-squares fits of the simulation error, with integration steps as fine as needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.errors import OutOfTimeError, SolveError
from casid.estimation.nlp.solver import Solver
from casid.estimation.simulation.minimization import Constraint, Fit, minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model

_ROUNDS = 5
"""Weighing and fitting in turn, at most."""
_SETTLED = 0.05
"""Relative change of the weights below which they are kept."""
_ROUNDING = 1e-6
"""Of an output's spread: errors below it are those of the simulation."""


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How a fit is searched for.

    Attributes
    ----------
    starts : number of starts; the best optimum is kept.
    segments : shooting segments a record; more than one for unstable models.
    substeps : Runge-Kutta steps a sample; None doubles them until they no longer matter.
    own : parameters that every record has for itself.
    constraints : each takes a mapping of names to symbols and returns what is to be zero.
    """

    starts: int = 3
    segments: int = 1
    substeps: int | None = None
    own: Sequence[str] = ()
    constraints: Sequence[Constraint] = ()
    solver: Solver | None = None
    seed: int = 0


def fit_model(
    model: Model,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    *,
    start: Mapping[str, float] | None = None,
    weights: Array | None = None,
    check_rank: bool = True,
    throw: bool = True,
) -> Fit:
    """Minimise the simulation error, with as many Runge-Kutta substeps as the data need.

    Parameters
    ----------
    weights : (ny,) of the outputs, as for `SimulationError`.

    Raises
    ------
    IdentifiabilityError, SolveError
        As `minimize_simulation_error`.
    """
    substeps = settings.substeps or 1
    fit: Fit | None = None
    while True:
        criterion = SimulationError(
            model,
            experiments,
            own=settings.own,
            weights=weights,
            segments=settings.segments,
            substeps=substeps,
            start=start if fit is None else fit.values,
        )
        try:
            fit = minimize_simulation_error(
                criterion,
                solver=settings.solver,
                starts=settings.starts if fit is None else 1,
                seed=settings.seed,
                constraints=settings.constraints,
                check_rank=check_rank and fit is None,
                throw=throw,
            )
            if settings.substeps is not None or substeps >= 16 or not _steps_matter(fit):
                return fit
        except OutOfTimeError:
            if fit is None:
                raise
            # With the steps that there was time for.
            return replace(fit, not_done=(*fit.not_done, "finer integration steps"))
        except SolveError:
            # Too long a step makes a stable simulation diverge, too.
            diverges = not np.isfinite(criterion.evaluate(criterion.start).value)
            if fit is not None or settings.substeps is not None or substeps >= 64 or not diverges:
                raise
        substeps *= 2


def weighted_by_errors(fit: Fit, settings: FitSettings) -> Fit:
    """The fit with every output counted in units of the error that it leaves.

    The maximum of the likelihood for white noise of unknown size in each output (Goodwin and Payne
    1977, section 5.4), found by weighing and fitting in turn. A fit by the outputs' spread gives
    the word to the noisiest of them.
    """
    if len(fit.criterion.outputs) == 1:
        return fit
    settings = replace(settings, starts=1, substeps=fit.criterion.substeps)
    for _ in range(_ROUNDS):
        weights = one_over_errors(fit)
        if np.all(abs(np.log(weights / fit.criterion.weights)) < _SETTLED):
            break
        c = fit.criterion
        again = fit_model(
            c.model,
            c.experiments,
            settings,
            start=fit.values,
            weights=weights,
            check_rank=False,
            throw=False,
        )
        if not np.isfinite(again.solution.value):
            break
        fit = replace(again, starts_tried=fit.starts_tried, starts_agreeing=fit.starts_agreeing)
    return fit


def one_over_errors(fit: Fit) -> Array:
    """(ny,) one over the RMS error of each output, which is taken to be no less than rounding."""
    c = fit.criterion
    square, count = np.zeros(len(c.outputs)), np.zeros(len(c.outputs))
    for e, d in enumerate(c.data):
        square += np.sum(c.simulated(fit.x, e).residual ** 2, axis=0)
        count += d.used.sum(axis=0)
    errors = np.sqrt(square / np.maximum(count, 1))
    return np.asarray(1 / np.maximum(errors, _ROUNDING * c.spread))


def _steps_matter(fit: Fit) -> bool:
    """True if halving the step moves the simulation by over a hundredth of the residual."""
    old = fit.criterion
    fine = SimulationError(
        old.model,
        old.experiments,
        own=old.own,
        weights=old.weights,
        segments=old.segments,
        substeps=2 * old.substeps,
        start=fit.values,
    )
    moved, left = 0.0, 0.0
    with np.errstate(all="ignore"):
        for e, d in enumerate(old.data):
            a, b = old.simulate(fit.x, e)[0], fine.simulate(fit.x, e)[0]
            moved += float(np.sum(((a - b) * d.used * old.weights) ** 2))
            left += float(np.sum(((d.y - a) * d.used * old.weights) ** 2))
    return bool(np.isfinite(moved)) and moved > 1e-4 * left + 1e-16 * old.n_samples
