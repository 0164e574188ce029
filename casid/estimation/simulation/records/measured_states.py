"""States that measurements determine at an instant, for simulations that start there.

Where the outputs h(x, u, p) do not depend on what is unknown they are solved for the states; then
their derivatives, as of a position whose rate is a state; then the outputs and the derivatives that
do depend on unknowns, at their start values. Each equation may change only what those before it
leave free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.records.signals import Signals, output_spread
from casid.estimation.simulation.thresholds import INSTABILITY, MEASURED_STATES
from casid.model.model import Model


@dataclass(frozen=True, slots=True)
class OutputEquations:
    """Outputs and their derivatives as functions of the states, by what they depend on.

    Attributes
    ----------
    values : (x, u, p) -> outputs, their derivatives, both with their slopes in x.
    slopes : (x, u, p) -> derivatives of the states.
    ranks : (2 ny,) of each of them, in which they are solved; -1 for those that are not.
    """

    values: Any
    slopes: Any
    ranks: Array

    def is_finite(self, x: Array, u: Array, p: Array) -> bool:
        """Whether the model has derivatives of its states, and outputs, at a point."""
        values = [*self.values(x, u, p), self.slopes(x, u, p)]
        return all(np.all(np.isfinite(v.full())) for v in values)


def output_equations(model: Model, free: Sequence[str]) -> OutputEquations:
    """The equations of a model some of whose parameters are unknown.

    The derivative of an output that depends on an input is left out: it has the input's, too.
    """
    e = model.explicit()
    rate = ca.jtimes(e.h, e.x, e.f)
    both = ca.vertcat(e.h, rate)
    unknown = ca.vertcat(ca.SX(0, 1), *[e.p[e.parameters.index(n)] for n in free])
    ny = e.h.numel()
    ranks = np.full(2 * ny, -1)
    for i in range(2 * ny):
        if i >= ny and ca.depends_on(e.h[i - ny], e.u):
            continue
        ranks[i] = 2 * int(ca.depends_on(both[i], unknown)) + int(i >= ny)
    values = ca.Function("h", [e.x, e.u, e.p], [both, ca.densify(ca.jacobian(both, e.x))])
    return OutputEquations(values, ca.Function("f", [e.x, e.u, e.p], [e.f]), ranks)


def measured_output(model: Model, state: str, d: Signals, k: int) -> float | None:
    """The measured value of a state that is itself an output, a median of five samples."""
    for i, (expression, _) in enumerate(model.outputs.values()):
        if ca.is_equal(ca.SX(expression), model.symbol(state), 1):
            values = d.y[k : k + 5, i][d.used[k : k + 5, i]]
            return float(np.median(values)) if len(values) else None
    return None


def declared_states(model: Model, d: Signals, at: Array) -> Array:
    """(len(at), nx) states at samples `at`: as an output measures them, or as declared."""
    states = np.tile([s.nominal for s in model.states.values()], (len(at), 1))
    for j, name in enumerate(model.states):
        for i, k in enumerate(at.tolist()):
            measured = measured_output(model, name, d, k)
            states[i, j] = states[i, j] if measured is None else measured
    return states


def measured_states(
    equations: OutputEquations, d: Signals, p: Array, at: Array, near: Array
) -> Array:
    """(len(at), nx) states at samples `at`, NaN where measurements do not determine one.

    Parameters
    ----------
    p : (np,) parameters, unknown ones at their start values.
    near : (nx,) where the solution begins, and what stays of a state that is not determined.
    """
    size = output_spread([d])
    found = np.full((len(at), len(near)), np.nan)
    for row, k in enumerate(np.asarray(at).tolist()):
        y = _around(d, k)
        scale = np.concatenate([size, size / (INSTABILITY.samples * d.Ts)])
        with np.errstate(all="ignore"):
            found[row] = _solved(equations, y, scale, d.u[k], p, near)
    return found


def _around(d: Signals, k: int) -> Array:
    """(2 ny,) outputs at sample k, then their derivatives: parabolas through samples around it."""
    half = INSTABILITY.samples // 2
    first = int(np.clip(k - half, 0, max(d.N - 2 * half - 1, 0)))
    part = slice(first, first + 2 * half + 1)
    t = (np.arange(d.N)[part] - k) / half
    ny = d.y.shape[1]
    out = np.full(2 * ny, np.nan)
    for i in range(ny):
        used = d.used[part, i]
        if used.sum() > half:
            _, slope, value = np.polyfit(t[used], d.y[part, i][used], 2)
            out[i], out[ny + i] = value, slope / (half * d.Ts)
    return out


def _solved(
    equations: OutputEquations, y: Array, scale: Array, u: Array, p: Array, near: Array
) -> Array:
    """(nx,) by Gauss-Newton steps; NaN for what stays free, or all where none is found."""
    x, nothing = near.astype(float), np.full(len(near), np.nan)
    free = np.eye(len(x))
    for rank in range(4):
        rows = (equations.ranks == rank) & np.isfinite(y)
        if not rows.any() or not free.shape[1]:
            continue
        for _ in range(MEASURED_STATES.steps):
            value, slope = (m.full() for m in equations.values(x, u, p))
            J = slope[rows] / scale[rows, None] @ free
            miss = (y - value[:, 0])[rows] / scale[rows]
            if not (np.all(np.isfinite(J)) and np.all(np.isfinite(miss))):
                return nothing
            length = np.linalg.norm(J, axis=0)
            length[length == 0.0] = 1.0
            left, s, right = np.linalg.svd(J / length, full_matrices=True)
            seen = int(np.sum(s > MEASURED_STATES.settled))
            step = right[:seen].T @ ((left[:, :seen].T @ miss) / s[:seen]) / length
            x = x + free @ step
            if np.linalg.norm(step * length) < MEASURED_STATES.settled:
                break
        free = np.linalg.qr(free @ (right[seen:].T / length[:, None]))[0]
    if not np.all(np.isfinite(equations.slopes(x, u, p).full())):
        return nothing
    return np.where(np.abs(free).max(axis=1, initial=0.0) > MEASURED_STATES.settled, np.nan, x)


def state_size(model: Model, name: str, d: Signals, spread: Array) -> float:
    """How large a state is: at its start, where it is measured first, or as outputs of its unit.

    `spread` (ny,) is that of the outputs.
    """
    state = model.states[name]
    measured = abs(measured_output(model, name, d, 0) or 0.0)
    alike = [
        s for s, (_, unit) in zip(spread, model.outputs.values(), strict=True) if unit == state.unit
    ]
    return max(abs(state.start), measured, *map(float, alike))
