"""What the error of a sensor may be said to depend on in closed loop.

A controller makes the command of a sample, and with it all that follows, of what the sensor gave
there, noise included. What comes after a sample thus goes with its noise, whatever the model.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import Array, rows_between
from casid.model.model import Model


def inputs_without_feedthrough(model: Model, output: str) -> list[str]:
    """Inputs without direct feedthrough to an output: they reach it through states alone."""
    e = model.explicit()
    h = e.h[e.outputs.index(output)]
    inputs = [name for name, entry in model.inputs.items() if entry.kind != "generated"]
    return [n for n in inputs if not any(ca.which_depends(h, e.u[e.inputs.index(n)]))]


def one_sample_late(values: Array) -> Array:
    """(N, ...) what acts on a sample of an input that reaches it through states alone."""
    return np.concatenate([values[:1], values[:-1]])


def slope(values: Array, Ts: float, *, backward: bool, anew: ArrayLike = ()) -> Array:
    """(N,) slope at the samples: between the neighbours, or of what came before alone.

    The latter is that of the parabola through a sample and the two before it. Both are exact to
    second order. Nothing leads from one part to the next at the samples `anew`, where a simulation
    starts in another state.
    """
    cuts = np.atleast_1d(np.asarray(anew, dtype=int))
    if len(cuts):
        parts = rows_between([0, *cuts, len(values)])
        return np.concatenate([slope(values[rows], Ts, backward=backward) for rows in parts])
    if not backward:
        return np.asarray(np.gradient(values, Ts))
    before = np.concatenate([3 * values[:1] - 2 * values[1:2], 2 * values[:1] - values[1:2]])
    long = np.concatenate([before, values])
    return np.asarray((1.5 * long[2:] - 2.0 * long[1:-1] + 0.5 * long[:-2]) / Ts)
