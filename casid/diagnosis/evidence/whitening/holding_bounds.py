"""Bounds that hold a parameter by more than chance.

A coefficient that is not negative, and is small against its standard error, is estimated at zero in
about every second record: the record does not determine it, and says nothing against the model. At
a minimum under the noise, the gradient g of a parameter at its bound, all that is free moving with
it, has the standard deviation

    sqrt(S),   S = H_ii - H_if H_ff^-1 H_fi                                                     (1)

where the bound is the truth (Rao's score; H is the Gauss-Newton Hessian of half the sum of squares
of white residuals). A bound whose g / sqrt(S) is larger than chance has it leaves misfit.
"""

from __future__ import annotations

import numpy as np

from casid.arrays import TINY
from casid.diagnosis.thresholds import BOUNDS
from casid.estimation.simulation.minimization import Fit


def held_beyond_chance(fit: Fit) -> tuple[str, ...]:
    """Variables that a bound holds although the records ask for values far beyond it.

    A solver that stays inside stops beside a bound: less than a hundredth of a standard error.

    Parameters
    ----------
    fit : the minimum of a criterion that is whitened by the noise.
    """
    c, x = fit.criterion, fit.x
    here = c.evaluate(x)
    curvature = np.diag(here.hessian)
    margin = BOUNDS.beside / np.sqrt(np.maximum(curvature, TINY))
    low = (x - [v.lower for v in c.variables] < margin) & (here.gradient > 0)
    high = ([v.upper for v in c.variables] - x < margin) & (here.gradient < 0)
    free = ~(low | high)
    inner = here.hessian[np.ix_(free, free)]
    found = []
    for i in np.flatnonzero(~free):
        across = here.hessian[free, i]
        left = curvature[i] - across @ np.linalg.lstsq(inner, across, rcond=1e-12)[0]
        is_seen = left > BOUNDS.rounding * curvature[i]
        if is_seen and abs(here.gradient[i]) > BOUNDS.beyond * np.sqrt(left):
            found.append(c.names[i])
    return tuple(found)
