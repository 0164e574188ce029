"""Whether the tangent of a simulation is its slope, as every standard error takes it to be.

Where a model is singular or its steps are unstable, a tangent grows without bound while the
simulation itself stays in its range: it changes direction at every rounding. J'J is then huge, and
its inverse no covariance.
"""

from __future__ import annotations

import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import TANGENTS

_ROOT = float(np.sqrt(np.finfo(float).eps))  # the relative step of a difference quotient


def steeper_than_simulation(criterion: SimulationError, x: Array, hessian: Array) -> list[str]:
    """Unknowns whose tangents promise far more than the simulation does, a small step away.

    Only where the criterion alone would determine one to within that step: others need no test.
    """
    found = []
    slope = np.sqrt(np.maximum(np.diag(hessian), 0.0))  # of the weighted simulation, all samples
    for i, v in enumerate(criterion.variables):
        h = _ROOT * abs(float(x[i]))
        if h == 0.0 or slope[i] * h <= 1.0:  # with errors of about one unit of their spread
            continue
        there = x.copy()
        there[i] += h
        total = 0.0
        with np.errstate(all="ignore"):
            for e, d in enumerate(criterion.data):
                moved = criterion.simulate(there, e)[0] - criterion.simulate(x, e)[0]
                total += float(np.sum((moved * d.used * criterion.weights) ** 2))
        if not slope[i] * h <= TANGENTS.ratio * np.sqrt(total):
            found.append(v.name)
    return found
