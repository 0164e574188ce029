"""Least-squares fits of the simulation error, with integration steps as fine as needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.errors import OutOfTimeError, SolveError
from casid.estimation.nlp.criterion import PUSHED
from casid.estimation.nlp.solver import Solver
from casid.estimation.simulation.minimization import (
    Constraint,
    Fit,
    minimize_simulation_error,
    require_minimum,
)
from casid.estimation.simulation.short_horizons import begun_at, fit_of_short_horizons
from casid.estimation.simulation.simulation_error import SimulationError, Whitener
from casid.estimation.simulation.thresholds import ERROR_WEIGHTS, STEPS
from casid.model.model import Model


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
    ends_at : says of a fit whose steps are too long that none is made with shorter ones.
    """

    starts: int = 3
    segments: int = 1
    substeps: int | None = None
    own: Sequence[str] = ()
    constraints: Sequence[Constraint] = ()
    solver: Solver | None = None
    seed: int = 0
    ends_at: Callable[[Fit], bool] | None = None


def fit_model(
    model: Model,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    *,
    start: Mapping[str, float] | None = None,
    weights: Array | None = None,
    check_rank: bool = True,
    throw: bool = True,
    substeps: int = 1,
) -> Fit:
    """Minimise the simulation error, with as many Runge-Kutta substeps as the data need.

    Parameters
    ----------
    weights : (ny,) of the outputs, as for `SimulationError`.
    substeps : that are tried first, where the settings leave them free.

    Raises
    ------
    IdentifiabilityError, SolveError : as `minimize_simulation_error`.
    """
    is_free = settings.substeps is None
    criterion = _stated(model, experiments, settings, start, weights, substeps)
    begun = {v.name: v.start for v in criterion.variables}
    if (near := _near(criterion, settings)) is not None:
        start = _better_start(criterion, near, settings) if start else near.values
        criterion = begun_at(criterion, start)
    if is_free:
        criterion = _resolved(criterion, start)
    fit: Fit | None = None
    while True:
        try:
            fit = minimize_simulation_error(
                criterion,
                solver=settings.solver,
                starts=settings.starts if fit is None and near is None else 1,
                seed=settings.seed,
                constraints=settings.constraints,
                check_rank=check_rank and fit is None,
            )
            is_done = fit.not_done or not (is_free and _steps_are_too_long(criterion, fit))
            if is_done or (settings.ends_at is not None and settings.ends_at(fit)):
                break
        except OutOfTimeError:
            if fit is None:
                raise
            return replace(fit, begun=begun, not_done=(*fit.not_done, _FINER))
        except SolveError:
            # Too long a step makes a stable simulation diverge, too.
            is_last = fit is not None or not is_free or criterion.substeps >= STEPS.last
            if is_last or np.isfinite(value_at_start(criterion)):
                raise
        criterion = _refined(criterion, start, fit)
    if throw:
        require_minimum(fit)
    of_starts = fit if near is None else near
    tried, agreeing = of_starts.starts_tried, of_starts.starts_agreeing
    return replace(fit, begun=begun, starts_tried=tried, starts_agreeing=agreeing)


def _stated(
    model: Model,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    start: Mapping[str, float] | None,
    weights: Array | None,
    substeps: int,
) -> SimulationError:
    """The simulation error by the settings; `substeps` where these leave them free."""
    return SimulationError(
        model,
        experiments,
        own=settings.own,
        weights=weights,
        segments=settings.segments,
        substeps=settings.substeps or substeps,
        start=start,
    )


def _near(criterion: SimulationError, settings: FitSettings) -> Fit | None:
    """A fit near which the search over segments or windows begins, if it needs one."""
    return fit_of_short_horizons(
        criterion, solver=settings.solver, starts=settings.starts, seed=settings.seed
    )


def _better_start(criterion: SimulationError, near: Fit, settings: FitSettings) -> dict[str, float]:
    """Start values of the fit: the end of the better of two trial fits.

    One trial begins at the fit over short horizons, the other at the stated start values.
    Parameters that act alike for a short while are hardly determined over short horizons, and
    sensor noise may move them too far from their values; stated values may come from a fit over
    longer ones. Both are single trials without the retries and finer steps of the fit that begins
    here.
    """
    ends = []
    for begun in (begun_at(criterion, near.values), criterion):
        with suppress(SolveError):
            fit = minimize_simulation_error(
                begun,
                solver=settings.solver,
                starts=1,
                seed=settings.seed,
                constraints=settings.constraints,
                check_rank=False,
                retry="none",
            )
            if np.isfinite(fit.solution.value):
                ends.append(fit)
    return min(ends, key=lambda fit: fit.solution.value, default=near).values


_FINER = "finer integration steps"


def _resolved(c: SimulationError, start: Mapping[str, float] | None) -> SimulationError:
    """The criterion with steps fine enough for where its search begins.

    Too long a step makes another model of it, whose optimum may lie far away.
    """
    while _steps_matter(c, c.start, STEPS.at_start):
        c = _finer(c, start)
    return c


def _finer(c: SimulationError, start: Mapping[str, float] | None) -> SimulationError:
    """The criterion from a start, with half the step."""
    return SimulationError(
        c.model,
        c.experiments,
        own=c.own,
        weights=c.weights,
        segments=c.segments,
        substeps=2 * c.substeps,
        start=start,
    )


def _refined(
    c: SimulationError, start: Mapping[str, float] | None, fit: Fit | None
) -> SimulationError:
    """The criterion with half the step, from where it is lower: the start, or the last fit."""
    at_start = _finer(c, start)
    near = at_start if fit is None else _finer(c, fit.values)
    return at_start if value_at_start(at_start) < value_at_start(near) else near


def value_at_start(criterion: SimulationError) -> float:
    """The criterion where its search begins."""
    return _value(criterion, criterion.start)


def _value(criterion: SimulationError, x: Array) -> float:
    """The criterion, without derivatives where it can."""
    alone = criterion.value_alone
    return alone(x) if alone else float(criterion.evaluate(x).value)


def within_bounds(criterion: SimulationError, x: Array) -> Array:
    """A point (n,), each variable moved to its bound where it lies beyond."""
    low, high = ([getattr(v, side) for v in criterion.variables] for side in ("lower", "upper"))
    return np.clip(x, low, high)


def weighted_by_errors(fit: Fit, settings: FitSettings) -> Fit:
    """The fit with every output counted in units of the error that it leaves.

    The maximum of the likelihood for white noise of unknown size in each output (Goodwin and Payne
    1977, section 5.4), found by weighing and fitting in turn. A fit by the outputs' spread gives
    the word to the noisiest of them.
    """
    if len(fit.criterion.outputs) == 1:
        return fit
    settings = replace(settings, starts=1)
    for _ in range(ERROR_WEIGHTS.rounds):
        weights = one_over_errors(fit)
        if np.all(abs(np.log(weights / fit.criterion.weights)) < ERROR_WEIGHTS.settled):
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
            substeps=c.substeps,
        )
        if not np.isfinite(again.solution.value):
            break
        fit = replace(
            again,
            starts_tried=fit.starts_tried,
            starts_agreeing=fit.starts_agreeing,
            begun=fit.begun,
        )
    return fit


def one_over_errors(fit: Fit) -> Array:
    """(ny,) one over the RMS error of each output, which is taken to be no less than rounding."""
    c = fit.criterion
    square, count = np.zeros(len(c.outputs)), np.zeros(len(c.outputs))
    for e, d in enumerate(c.data):
        square += np.sum(c.simulated(fit.x, e).residual ** 2, axis=0)
        count += d.used.sum(axis=0)
    errors = np.sqrt(square / np.maximum(count, 1))
    return np.asarray(1 / np.maximum(errors, ERROR_WEIGHTS.rounding * c.spread))


def _steps_are_too_long(c: SimulationError, fit: Fit) -> bool:
    """True if they matter where a fit ended, or make the simulation diverge beside its bounds.

    The second is where a search that begins there takes its first step (`PUSHED`).
    """
    if _steps_matter(c, fit.x, STEPS.at_end):
        return True
    ended = {name: 1.0 for name in fit.solution.at_lower}
    ended |= {name: -1.0 for name in fit.solution.at_upper}
    if not ended or c.substeps >= STEPS.last:
        return False
    inside = [PUSHED * v.scale * ended.get(v.name, 0.0) for v in c.variables]
    return not np.isfinite(_value(c, within_bounds(c, fit.x + inside)))


def resolved_under(criterion: SimulationError, x: Array, whiten: Whitener) -> SimulationError:
    """The criterion with steps as fine as residuals that are whitened need at `x` (n,).

    Steps that are fine enough beside a large residual of noise on inputs may not be so where little
    of it is: a resonance that least squares hardly sees determines parameters under its weights.
    The same object where its steps are.
    """
    start = dict(zip(criterion.names, x.tolist(), strict=True))
    while _steps_matter(criterion, x, STEPS.at_end, whiten):
        criterion = _finer(criterion, start)
    return criterion


def _steps_matter(
    c: SimulationError, x: Array, share: float, whiten: Whitener | None = None
) -> bool:
    """True if halving the step moves the simulation by over a share of the residual."""
    if c.substeps >= STEPS.most:
        return False
    fine = _finer(c, None)
    moved, left = 0.0, 0.0
    with np.errstate(all="ignore"):
        for e, d in enumerate(c.data):
            a, b = c.simulate(x, e)[0], fine.simulate(x, e)[0]
            parts = np.stack([d.in_sizes(a - b) * d.used, d.errors(a)], axis=2)
            parts *= c.weights[None, :, None]
            if whiten is not None and np.all(np.isfinite(parts)):
                parts = whiten(parts, e)
            moved += float(np.sum(parts[:, :, 0] ** 2))
            left += float(np.sum(parts[:, :, 1] ** 2))
    return bool(np.isfinite(moved)) and moved > share**2 * left + 1e-16 * c.n_samples
