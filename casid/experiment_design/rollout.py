"""What an input gives over the whole record, with exact derivatives by its decision variables.

The steps of the record are tied together (multiple shooting, its nodes eliminated).
With A_k, B_k the slopes of step k, the tangents of its states W_k = d(z_k, q_k)/dv follow forward,
the adjoints backward, and the second derivatives of a weighted sum of all outputs are

    sum_k W_k' H_k W_k                                                                         (1)

with H_k the second derivatives of one step, weighted by the adjoints (Albersmeyer and Diehl 2010,
The lifted Newton method and its application in optimization, SIAM J. Optim. 20, 1655-1684).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from casid.arrays import Array
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.step import Branch, Step, step_of


@dataclass(frozen=True, slots=True, eq=False)
class Outputs:
    """Information and limited signals of a simulation.

    Attributes
    ----------
    information : (ng,) upper triangles of all comparisons, in scaled columns.
    signals : (steps of the record * n,) limited signals.
    """

    information: Array
    signals: Array

    @property
    def column(self) -> Array:
        """Both, one below the other."""
        return np.concatenate([self.information, self.signals])


@dataclass(slots=True, eq=False)
class Rollout:
    """Maps the decision variables w (n, nu) and displacements (nr,) to what they give; SI units.

    All derivatives are by v = (w column by column, r).

    Parameters
    ----------
    steps : Runge-Kutta steps an interval.
    """

    prediction: Prediction
    steps: int
    step: Step = field(init=False)
    count: int = field(init=False)
    into: list[Any] = field(init=False)  # of each step (nq, nv): dq/dv
    _kept: dict[str, Any] = field(init=False, default_factory=dict)  # of the last point

    def __post_init__(self) -> None:
        setup = self.prediction.setup
        self.step = step_of(self.prediction, self.steps)
        self.count = setup.excitation.intervals * self.steps
        local, nu, nr = setup.excitation.local(self.steps), len(setup.designed), len(setup.released)
        L = local.shape[0] // self.count
        self.into = []
        for k in range(self.count):
            rows = sp.block_diag([local[L * k : L * (k + 1)]] * nu) if nu else sp.csr_matrix((0, 0))
            width = nu * setup.excitation.n
            self.into.append(
                sp.hstack([sp.csr_matrix(rows, shape=(nu * L, width)), sp.csr_matrix((nu * L, nr))])
            )

    @property
    def branches(self) -> tuple[Branch, ...]:
        """The hypotheses as they are integrated."""
        return self.step.branches

    @property
    def nz(self) -> int:
        """States of a node."""
        return int(self.step.map.size1_in(0))

    def outputs(self, w: Array, release: Array) -> Outputs:
        """Information and limited signals; not finite where a simulation diverges."""
        found: Outputs = self._at(w, release)["outputs"]
        return found

    def _at(self, w: Array, release: Array) -> dict[str, Any]:
        key = w.tobytes() + release.tobytes()
        if self._kept.get("key") == key:
            return self._kept
        z0, q, c, p = self._first(release), self._local(w), self._others(), self._parameters()
        after, grams, signals = (np.asarray(v) for v in self._rolled()(z0, q, c, p))
        nodes = np.column_stack([z0, after[:, :-1]])
        found = Outputs(grams.sum(axis=1), signals.ravel(order="F"))
        self._kept = {"key": key, "outputs": found, "points": (nodes, q, c, p)}
        return self._kept

    def _rolled(self) -> Any:
        made, key = self.prediction.made, ("rolled", id(self.step), self.count)
        if key not in made:
            made[key] = self.step.map.mapaccum("rolled", self.count)
        return made[key]

    def _mapped(self, name: str) -> Any:
        made, key = self.prediction.made, (name, id(self.step), self.count)
        if key not in made:
            made[key] = getattr(self.step, name).map(self.count)
        return made[key]

    # -- what enters -------------------------------------------------------------------------

    def _local(self, w: Array) -> Array:
        """(L * nu, steps of the record) local values of the designed inputs."""
        setup = self.prediction.setup
        values = setup.excitation.local(self.steps) @ w  # (L * count, nu)
        L = len(values) // self.count
        parts = [
            setup.rest[name] + values[:, k].reshape(self.count, L).T
            for k, name in enumerate(setup.designed)
        ]
        return np.concatenate(parts) if parts else np.zeros((0, self.count))

    def _others(self) -> Array:
        """(3 * others, steps of the record) of the inputs that are not designed."""
        setup = self.prediction.setup
        length = setup.excitation.per * setup.Ts / self.steps
        t = length * np.add.outer([0.0, 0.5, 1.0], np.arange(self.count))
        rows = [
            setup.others(self.branches[i].hypothesis.acting, t.ravel())[name].reshape(3, -1)
            for i, name in self.step.others
        ]
        return np.concatenate(rows) if rows else np.zeros((0, self.count))

    def _parameters(self) -> Array:
        """(np, steps of the record): they are the same in all steps."""
        values = np.concatenate([h.vector for h in self.prediction.hypotheses])
        return np.tile(values[:, None], (1, self.count))

    def _first(self, release: Array) -> Array:
        """The first node: initial states, and S = (I, 0) in scaled columns."""
        setup, parts = self.prediction.setup, []
        for b in self.branches:
            model = b.hypothesis.model
            s = np.zeros((b.nx, b.nv))
            for j, name in enumerate(b.hypothesis.free_states[: b.nv]):
                s[list(model.states).index(name), j] = b.scale[j]
            parts += [setup.initial(model, release), s.ravel(order="F")]
        return np.concatenate(parts)

    def _first_slope(self) -> Array:
        """(nz, nv) of the first node by v: displacements enter the states that are released."""
        setup, rows = self.prediction.setup, []
        released = setup.released
        out = np.zeros((self.nz, self.into[0].shape[1]))
        for b in self.branches:
            rows += [*b.hypothesis.model.states, *[""] * (b.size - b.nx)]
        for k, name in enumerate(released):
            out[[i for i, n in enumerate(rows) if n == name], k - len(released)] = 1.0
        return out

    # -- derivatives -------------------------------------------------------------------------

    def slope(self, w: Array, release: Array) -> Array:
        """(outputs, nv) of all outputs by v."""
        at = self._at(w, release)
        if "slope" in at:
            return np.asarray(at["slope"])
        slopes, nz = _blocks(self._mapped("slope")(*at["points"]), self.count), self.nz
        ng = self.step.map.size1_out(1)
        tangent, information, signals, tangents = self._first_slope(), 0.0, [], []
        with np.errstate(all="ignore"):  # of a point that diverges, which a search may try
            for k, own in enumerate(slopes):
                both = np.vstack([tangent, self.into[k].toarray()])
                tangents.append(both)
                carried = own @ both
                tangent = carried[:nz]
                information = information + carried[nz : nz + ng]
                signals.append(carried[nz + ng :])
        at["slope"] = np.vstack([np.asarray(information), *signals])
        at["slopes"], at["tangents"] = slopes, tangents
        return np.asarray(at["slope"])

    def curvature(self, w: Array, release: Array, m: Array) -> Array:
        """(nv, nv) second derivatives of m' outputs by v."""
        self.slope(w, release)
        at, nz = self._kept, self.nz
        ng = self.step.map.size1_out(1)
        on_signals = m[ng:].reshape(self.count, -1)
        weights, adjoint = [], np.zeros(nz)
        for own, more in zip(reversed(at["slopes"]), reversed(on_signals), strict=True):
            weight = np.concatenate([adjoint, m[:ng], more])
            weights.append(weight)
            adjoint = (own.T @ weight)[:nz]
        every = np.array(weights[::-1]).T
        out = 0.0
        blocks = _blocks(self._mapped("curvature")(*at["points"], every), self.count)
        for upper, both in zip(blocks, at["tangents"], strict=True):
            half = both.T @ (upper @ both)
            diagonal = both.T @ (upper.diagonal()[:, None] * both)
            out = out + half + half.T - diagonal
        return np.asarray(out)


def _blocks(side_by_side: Any, count: int) -> list[Any]:
    """Matrices of one pattern that stand side by side, as SciPy has them."""
    rows, columns = side_by_side.shape[0], side_by_side.shape[1] // count
    starts, places = side_by_side.sparsity().get_ccs()
    n = starts[columns]
    values = np.array(side_by_side.nonzeros()).reshape(count, n)
    first = sp.csc_matrix(
        (np.arange(1, n + 1, dtype=float), places[:n], starts[: columns + 1]), (rows, columns)
    ).tocsr()
    order = first.data.astype(int) - 1
    return [
        sp.csr_matrix((v[order], first.indices, first.indptr), (rows, columns), copy=False)
        for v in values
    ]
