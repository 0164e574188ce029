"""Initial states by least squares: of a record that was not fitted, or anew at a point."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.estimation.nlp.solver import NEARBY
from casid.estimation.simulation.fit import value_at_start, within_bounds
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.short_horizons import begun_at, fit_of_short_horizons
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import INITIAL_STATES
from casid.model.model import Model

_FROM_MEASURED = replace(NEARBY, enough=INITIAL_STATES.enough)
"""From a state that was measured or simulated, over few unknowns: what a further step would lower
the error by shows in no comparison, and where dry friction reverses no step ends at a kink."""


def with_states_anew(criterion: SimulationError, x: Array, steps: int = 1) -> Array:
    """A point (n,) with initial states some Gauss-Newton steps nearer the least error.

    A step that the error does not fall with is not taken.
    """
    initial = np.array(criterion.initial_states, dtype=int)
    for _ in range(steps if initial.size else 0):
        here = criterion.evaluate(x)
        matrix = here.hessian[np.ix_(initial, initial)]
        if not np.all(np.isfinite([here.value, *here.gradient[initial], *matrix.ravel()])):
            return x  # it diverges there
        there = x.copy()
        there[initial] -= np.linalg.lstsq(matrix, here.gradient[initial], rcond=1e-12)[0]
        there = within_bounds(criterion, there)
        if not criterion.evaluate(there).value < here.value:
            return x
        x = there
    return x


def fit_initial_state(
    model: Model,
    experiment: Experiment,
    *,
    weights: Array | None = None,
    substeps: int = 1,
    near: Mapping[str, float] | None = None,
) -> tuple[SimulationError, Array]:
    """The criterion of one record, and its minimum (n,) over the initial state alone.

    Parameters
    ----------
    model : every parameter known, there or in the experiment.
    near : a state of each name that the search may begin at, where that fits better than what was
        measured first: a state that nobody measures has to fit the others.
    """
    criterion = SimulationError(model, [experiment], weights=weights, substeps=substeps)
    if near is not None:
        start = {f"{name}(0)": value for name, value in near.items()}
        other = SimulationError(
            model, [experiment], weights=weights, substeps=substeps, start=start
        )
        if not value_at_start(criterion) <= value_at_start(other):
            criterion = other
    short = fit_of_short_horizons(criterion)
    if short is not None:
        criterion = begun_at(criterion, short.values)
    point = criterion.start
    if len(point):
        point = minimize_simulation_error(
            criterion, solver=_FROM_MEASURED, check_rank=False, retry="none"
        ).x
    return criterion, point
