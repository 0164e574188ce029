"""Effects that make a simulation diverge before they explain anything."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.thresholds import PREWHITENING
from casid.estimation.simulation.minimization import Fit, widened
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.effect import Effect


def diverging_size(fit: Fit, effect: Effect) -> float | None:
    """The tiny value of an effect's first parameter at which the simulation diverges, or None.

    Tiny is what adds, along the simulation without the effect, a hundredth of its own rms to a
    state's derivative or to an output. A simulation that is not finite there, or whose outputs move
    by more than their own rms, leaves the neighbourhood that the test and the refit of the effect
    live in. Each sign that the parameter may have is tried: one that is stable is enough.
    """
    model, names = effect.extended(fit.criterion.model)
    wide = widened(fit, model)
    x = wide.start
    i = wide.names.index(names[0])
    tiny = PREWHITENING.trial / _added(wide, x, names[0])
    variable = wide.variables[i]
    signs = [s for s in (1.0, -1.0) if variable.lower <= x[i] + s * tiny <= variable.upper]
    for sign in signs if np.isfinite(tiny) else []:
        moved = x.copy()
        moved[i] += sign * tiny
        far = size = 0.0
        with np.errstate(all="ignore"):
            for k in range(len(wide.data)):
                y, before = wide.simulate(moved, k)[0], wide.simulate(x, k)[0]
                far += float(np.sum(((y - before) * wide.weights) ** 2))
                size += float(np.sum(((before - before.mean(axis=0)) * wide.weights) ** 2))
        if np.isfinite(far) and far < size:
            return None
    return float(x[i] + signs[0] * tiny) if signs and np.isfinite(tiny) else None


def _added(wide: SimulationError, x: Array, name: str) -> float:
    """Largest rms of d(f, h)/d(parameter) over the rms of the same row, along the simulation."""
    e = wide.model.explicit()
    rows = ca.vertcat(e.f, e.h)
    slope = ca.jacobian(rows, e.p[e.parameters.index(name)])
    function = ca.Function("added", [e.x, e.u, e.p], [ca.densify(rows), ca.densify(slope)])
    values, slopes = [], []
    for k, d in enumerate(wide.data):
        p, _ = wide.parameter_vector(x, k)
        states = wide.simulate(x, k)[1]
        found = function.map(d.N)(states.T, d.u.T, np.tile(p[:, None], (1, d.N)))
        values.append(np.array(found[0]))
        slopes.append(np.array(found[1]))
    sizes = np.sqrt(np.mean(np.concatenate(values, axis=1) ** 2, axis=1))
    added = np.sqrt(np.mean(np.concatenate(slopes, axis=1) ** 2, axis=1))
    return float(np.max(added / np.maximum(sizes, TINY), initial=0.0)) or float("nan")
