"""A simulation that diverges is refused, with what has no finite value where it does."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from casid.arrays import Array
from casid.errors import SolveError
from casid.estimation.fitted.driving import Driving
from casid.estimation.simulation.singular_samples import singular_sample
from casid.model.model import Model


def require_finite_simulation(
    name: str, model: Model, given: Driving, values: Mapping[str, float], y: Array, x: Array
) -> None:
    """Refuse a simulation of outputs y (N, ny) and states x (N, nx) that diverges.

    Raises
    ------
    SolveError
        With the instant, and what has no finite value there.
    """
    bad = ~np.all(np.isfinite(y), axis=1) | ~np.all(np.isfinite(x), axis=1)
    if not bad.any():
        return
    k = int(np.argmax(bad))
    p = np.array([values[n] for n in model.explicit().parameters], dtype=float)
    before = max(k - 1, 0)
    why = singular_sample(model, given.u, p, given.t, x[before], (before, k))
    at = f"{name}: the simulation of {given.name} diverges at t = {given.t[k]:g} s (sample {k})"
    if why is None:
        raise SolveError(f"{at}; check the inputs and x0, or give a smaller Ts")
    raise SolveError(f"{at}: {why[0]}; {why[1]}")
