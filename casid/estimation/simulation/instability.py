"""Whether a model is too unstable to be simulated over its records, and the segments it needs.

An error of the initial state grows by exp(rate T) over a record of length T, `rate` the largest
real part of the poles of the model linearised where its records begin. Multiple shooting cuts the
record into segments over which it grows little (Bock, Birkhauser 1983).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import INSTABILITY


def growth_rate(criterion: SimulationError) -> float:
    """The fastest growth [1/s] of a small error of a state where the records begin, 0 for none.

    At the start values of the parameters, and the mean of the inputs.
    """
    e = criterion.model.explicit()
    slopes = ca.Function("A", [e.x, e.u, e.p], [ca.densify(ca.jacobian(e.f, e.x))])
    fastest = 0.0
    for i, d in enumerate(criterion.data):
        p, x0 = criterion.parameter_vector(criterion.start, i)
        A = slopes(x0, d.u.mean(axis=0), p).full()
        if A.size and np.all(np.isfinite(A)):
            fastest = max(fastest, float(np.linalg.eigvals(A).real.max()))
    return fastest


def segments_for(criterion: SimulationError) -> int:
    """Shooting segments a record that keep the growth of errors small; 1 where they are not needed.

    1 too where the records are too short for so many.
    """
    growth = growth_rate(criterion) * max(d.N * d.Ts for d in criterion.data)
    if growth < INSTABILITY.growth:
        return 1
    most = min(d.N for d in criterion.data) // fewest_samples(criterion)
    return int(max(1, min(np.ceil(growth / INSTABILITY.per_segment), most, INSTABILITY.most)))


def window_for(criterion: SimulationError) -> int:
    """Samples over which errors grow little, the window of every record; 0 where none is needed.

    Longer where a record would have more windows than segments are allowed.
    """
    rate = growth_rate(criterion)
    if rate * max(d.N * d.Ts for d in criterion.data) < INSTABILITY.growth:
        return 0
    within = min(INSTABILITY.per_window / (rate * d.Ts) for d in criterion.data)
    least = max(d.N for d in criterion.data) // INSTABILITY.most + 1
    return int(max(within, least, fewest_samples(criterion)))


def fewest_samples(criterion: SimulationError) -> int:
    """Samples of a segment or window, at least: it has states to estimate."""
    return max(INSTABILITY.samples, 4 * len(criterion.model.states))
