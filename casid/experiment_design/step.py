"""One step of the integration: states, sensitivities and information carried through it.

The states of every hypothesis, and of a rival the sensitivities S = dx/d(theta, x_0),

    dx/dt = f(x, u),   dS/dt = f_x S + f_theta                                                 (1)

are integrated by a Runge-Kutta step. Where a measured channel drives a hypothesis (an indirect
model), it is what the sensor shows if the truth that it is compared with moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.experiment_design.hypotheses import Hypothesis
from casid.experiment_design.limits import signal_function
from casid.experiment_design.prediction import Prediction


class Branch(NamedTuple):
    """One hypothesis as it is integrated."""

    hypothesis: Hypothesis
    nx: int
    nv: int  # columns of S: initial states, then free parameters; 0 where it is no rival
    scale: Array  # (nv,) of the columns
    source: int  # the hypothesis whose motion the measured channels show

    @property
    def size(self) -> int:
        """States and sensitivities."""
        return self.nx * (1 + self.nv)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The map over one step, with its exact derivatives: SX functions.

    Attributes
    ----------
    map : (z, q, c, p) -> z after the step, information, limited signals at its beginning.
    slope : the same -> d(all of these, one below the other) / d(z, q), sparse.
    curvature : (z, q, c, p, m) -> the second derivatives of m' (all of these), upper triangle.
    branches : the hypotheses; values of their parameters enter by `p`.
    others : inputs that are not designed: (branch, name).

    `q` are the local values (L * nu,) of the designed inputs, see `Excitation.local`; `c` those of
    the others (3 * len(others),), at begin, middle and end; `p` all parameters of all hypotheses.
    """

    map: Any
    slope: Any
    curvature: Any
    branches: tuple[Branch, ...]
    others: tuple[tuple[int, str], ...]


def step_of(prediction: Prediction, steps: int) -> Step:
    """A step of a prediction, of which there are so many in an interval; made once."""
    h = prediction.hypotheses
    own = tuple((id(k.model), k.moving) for k in h)
    key = "step", steps, own, tuple(prediction.comparisons), tuple(prediction.setup.limits.signals)
    if key not in prediction.made:
        prediction.made[key] = _made(prediction, steps), [k.model for k in h]
    found: Step = prediction.made[key][0]
    return found


def _made(prediction: Prediction, steps: int) -> Step:
    setup = prediction.setup
    branches = branches_of(prediction)
    others = tuple(
        (i, n)
        for i, b in enumerate(branches)
        for n in b.hypothesis.acting.inputs
        if n not in setup.designed
    )
    inside = setup.excitation.inside
    z = ca.SX.sym("z", sum(b.size for b in branches))
    q = ca.SX.sym("q", inside.shape[1], len(setup.designed))
    c = ca.SX.sym("c", 3, len(others))
    p = ca.SX.sym("p", sum(len(b.hypothesis.vector) for b in branches))
    known = [z, ca.vec(q), ca.vec(c), p]
    u = _acting(prediction, branches, others, ca.DM(inside) @ q, c)
    rate, shown, limited = _pointwise(prediction, branches, u.shape[0], p.numel())
    weight = setup.excitation.per / steps
    after = _rk4(rate, z, u, p, setup.excitation.per * setup.Ts / steps)
    outputs = [after, weight * shown(z, u[:, 0], p), limited(z, u[:, 0], p)]
    free, every = ca.vertcat(*known[:2]), ca.vertcat(*outputs)
    m = ca.SX.sym("m", every.numel())
    second = ca.triu(ca.hessian(ca.dot(m, every), free)[0])
    return Step(
        ca.Function("step", known, outputs),
        ca.Function("slope", known, [ca.jacobian(every, free)]),
        ca.Function("curvature", [*known, m], [second]),
        branches,
        others,
    )


def branches_of(prediction: Prediction) -> tuple[Branch, ...]:
    """The hypotheses as they enter a program."""
    sources = prediction.sources
    return tuple(
        _branch(h, i in prediction.differentiated, sources[i])
        for i, h in enumerate(prediction.hypotheses)
    )


def _branch(h: Hypothesis, is_rival: bool, source: int) -> Branch:
    nx = len(h.model.states)
    if not is_rival:
        return Branch(h, nx, 0, np.zeros(0), source)
    states = [abs(h.model.states[n].start) or 1.0 for n in h.free_states]
    values = [abs(h.values[n]) or 1.0 for n in h.moving]
    return Branch(h, nx, len(states) + len(values), np.array(states + values), source)


def _acting(
    prediction: Prediction,
    branches: Sequence[Branch],
    others: Sequence[tuple[int, str]],
    designed: Any,
    c: Any,
) -> Any:
    """(inputs of the direct models, one below the other, 3), at begin, middle and end."""
    place = {name: k for k, name in enumerate(prediction.setup.designed)}
    column = {key: k for k, key in enumerate(others)}
    rows = [
        designed[:, place[n]].T if n in place else c[:, column[i, n]].T
        for i, b in enumerate(branches)
        for n in b.hypothesis.acting.inputs
    ]
    return ca.vertcat(*rows) if rows else ca.SX(0, 3)


def _pointwise(
    prediction: Prediction, branches: Sequence[Branch], width: int, parameters: int
) -> tuple[Any, Any, Any]:
    """(z, u, p) -> dz/dt; information that one sample gives; limited signals."""
    z, u = ca.SX.sym("z", sum(b.size for b in branches)), ca.SX.sym("u", width)
    p = ca.SX.sym("p", parameters)
    states = _cut(z, [b.size for b in branches])
    acting = _cut(u, [len(b.hypothesis.acting.inputs) for b in branches])
    values = _cut(p, [len(b.hypothesis.vector) for b in branches])
    x = [own[: b.nx] for own, b in zip(states, branches, strict=True)]
    rates, y = [], []
    dy: list[Any] = []
    for i, b in enumerate(branches):
        e, k = b.hypothesis.model.explicit(), b.source
        source = branches[k].hypothesis, x[k], acting[k], values[k]
        inputs = inputs_of(b.hypothesis, acting[i], *source)
        s = ca.reshape(states[i][b.nx :], b.nx, b.nv)
        rows = [e.f, e.h]
        if b.nv:
            rows += [ca.jacobian(v, e.x) @ s + _direct(v, b) for v in (e.f, e.h)]
        known, at = ca.vertcat(e.x, e.u, e.p), ca.vertcat(x[i], inputs, values[i])
        found = ca.substitute(rows, [known], [at])
        rates += [found[0], *([ca.vec(found[2])] if b.nv else [])]
        y.append(found[1])
        dy.append(found[3] if b.nv else None)
    parts = []
    for comparison in prediction.comparisons:
        columns = dy[comparison.rival]
        if comparison.truth is not None:
            columns = ca.horzcat(columns, y[comparison.truth] - y[comparison.rival])
        columns = ca.diag(ca.DM(1 / prediction.setup.noise)) @ columns
        parts.append(ca.vec(_upper(columns.T @ columns)))
    limits = [
        _limited(prediction, branches[i].hypothesis, x[i], acting[i], values[i])
        for i in prediction.possible
    ]
    made = [
        ca.Function(n, [z, u, p], [ca.densify(ca.vertcat(*v))])
        for n, v in (("rate", rates), ("shown", parts), ("limited", limits))
    ]
    return made[0], made[1], made[2]


def _cut(column: Any, sizes: Sequence[int]) -> list[Any]:
    ends = np.cumsum([0, *sizes]).tolist()
    return [column[a:b] for a, b in zip(ends, ends[1:], strict=False)]


def inputs_of(h: Hypothesis, acting: Any, source: Hypothesis, *motion: Any) -> Any:
    """(inputs of the model,): what acts on it, and what sensors show where they stand for inputs.

    Parameters
    ----------
    acting : (inputs of the direct model,) of the hypothesis.
    source : the hypothesis whose motion the sensors show; its states, inputs and parameters.
    """
    place = {n: k for k, n in enumerate(h.acting.inputs)}
    e = source.acting.explicit()
    at = ca.vertcat(*motion)
    out = []
    for name in h.model.inputs:
        if name in place:
            out.append(acting[place[name]])
        else:
            shown = e.h[e.outputs.index(name)]
            out.append(ca.substitute(shown, ca.vertcat(e.x, e.u, e.p), at))
    return ca.vertcat(*out) if out else ca.SX(0, 1)


def _direct(expression: Any, b: Branch) -> Any:
    """d expression / d(initial states, free parameters), scaled, without the states' part."""
    e = b.hypothesis.model.explicit()
    free = ca.vertcat(*[e.p[e.parameters.index(n)] for n in b.hypothesis.moving])
    own = ca.jacobian(expression, free) if b.hypothesis.moving else ca.SX(expression.numel(), 0)
    n0 = b.nv - len(b.hypothesis.moving)
    return ca.horzcat(ca.SX(expression.numel(), n0), own) @ ca.diag(ca.DM(b.scale))


def _limited(prediction: Prediction, h: Hypothesis, x: Any, acting: Any, p: Any) -> Any:
    names = list(prediction.setup.limits.signals)
    if not names:
        return ca.SX(0, 1)
    return signal_function(h.acting.explicit(), names)(x, acting, p)


def _rk4(rate: Any, z: Any, u: Any, p: Any, h: float) -> Any:
    """One step; `u` (inputs, 3) at its beginning, middle and end."""
    k1 = rate(z, u[:, 0], p)
    k2 = rate(z + h / 2 * k1, u[:, 1], p)
    k3 = rate(z + h / 2 * k2, u[:, 1], p)
    k4 = rate(z + h * k3, u[:, 2], p)
    return z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _upper(g: Any) -> Any:
    """The entries (i, j), i <= j, column by column, of a symbolic matrix."""
    n = g.shape[0]
    return ca.vertcat(*[g[i, j] for j in range(n) for i in range(j + 1)])
