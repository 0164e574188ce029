"""The part of a change of the simulation that the initial states of windows absorb.

An unstable model is simulated window by window, each from a state that is fitted. It magnifies what
noise of an input adds until the window ends, as it does an error of that state: of what noise adds,
a fit has taken out all but the part that no initial state makes up for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.arrays import Array, basis_of
from casid.estimation.simulation.simulation_error import SimulationError


def states_of_windows(criterion: SimulationError, columns: Sequence[int]) -> list[int]:
    """Which of `columns`, variables of a criterion, are initial states; none if no record is cut.

    The result counts along `columns`.
    """
    if all(criterion.parts(e) == 1 for e in range(len(criterion.data))):
        return []
    initial = criterion.initial_states
    return [k for k, i in enumerate(columns) if i in initial]


def left_by_states(begun: Array, moved: Array) -> Array:
    """A change (N,) of all outputs less what initial states with the tangent (N, k) make up for."""
    if not begun.shape[1] or not (np.isfinite(begun).all() and np.isfinite(moved).all()):
        return moved
    basis = basis_of(begun)
    return np.asarray(moved - basis @ (basis.T @ moved))
