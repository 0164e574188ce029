"""Whether a model is too unstable to be simulated over its records, and the segments it needs.

An error of the initial state grows by exp(rate T) over a record of length T, `rate` the largest
real part of the poles of the model linearised where its records begin. An arm that hangs as its
record begins is upright later: the mean over what was measured counts where it is larger. Multiple
shooting cuts the record into segments over which it grows little (Bock, Birkhauser 1983).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.records.measured_states import measured_states, output_equations
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import INSTABILITY


def growth_rate(criterion: SimulationError) -> float:
    """The growth [1/s] of a small error of a state, 0 for none.

    The larger of that where the records begin, at the mean of the inputs, and the mean along the
    states that measurements determine; at the start values of the parameters.
    """
    e = criterion.model.explicit()
    slopes = ca.Function("A", [e.x, e.u, e.p], [ca.densify(ca.jacobian(e.f, e.x))])
    equations = output_equations(criterion.model, criterion.free)

    def growth(x: Array, u: Array, p: Array) -> float:
        A = slopes(x, u, p).full()
        finite = A.size and np.all(np.isfinite(A))
        return max(float(np.linalg.eigvals(A).real.max()), 0.0) if finite else 0.0

    fastest = 0.0
    for i, d in enumerate(criterion.data):
        p, x0 = criterion.parameter_vector(criterion.start, i)
        at = np.unique(np.linspace(0, d.N - 1, INSTABILITY.instants).astype(int))
        states = measured_states(equations, d, p, at, x0)
        known = np.all(np.isfinite(states), axis=1)
        along = [growth(x, d.u[k], p) for k, x in zip(at[known], states[known], strict=True)]
        # Of what is not determined nothing is known, and it counts as stable.
        fastest = max(fastest, growth(x0, d.u.mean(axis=0), p), sum(along) / len(at))
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
