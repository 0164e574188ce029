"""A program while it is put together: scaled variables, constraints, and those of the inputs."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.nlp.criterion import Callback
from casid.experiment_design.rollout import Rollout
from casid.experiment_design.setup import Setup


class Statement:
    """Variables and constraints of the program while it is put together, all scaled.

    What is integrated is a symbol in objective and constraints, a function in the program.

    Parameters
    ----------
    w0, release0 : where the search begins, (n, nu) and (nr,) in SI.
    """

    def __init__(self, rollout: Rollout, w0: Array, release0: Array) -> None:
        setup = rollout.prediction.setup
        self.rollout = rollout
        self._x: list[Any] = []
        self._sides: list[tuple[Array, Array, Array]] = []
        self._g: list[Any] = []
        self._ends: list[tuple[Array, Array]] = []
        self.problem: dict[str, Any] = {}
        self.hessian: Any = None
        self._keep: list[Any] = []
        scales, released = input_scales(setup), release_scales(setup)
        self.w, self.flat = inputs_stated(self, setup, w0, scales)
        low, high = np.array(list(setup.limits.release.values())).reshape(-1, 2).T
        begin = release0 / released
        self.release = self.variable("r", begin, low / released, high / released) * released
        self.scale = np.concatenate([np.repeat(scales, setup.excitation.n), released])
        self.begun = rollout.outputs(w0, release0).column
        self.outputs = ca.MX.sym("outputs", len(self.begun))

    def variable(self, name: str, start: Any, lower: Any = -np.inf, upper: Any = np.inf) -> Any:
        """A column of variables, begun inside its bounds."""
        start = np.atleast_1d(np.asarray(start, dtype=float)).ravel()
        lower, upper = np.broadcast_to(lower, start.shape), np.broadcast_to(upper, start.shape)
        self._x.append(ca.MX.sym(name, len(start)))
        self._sides.append((np.clip(start, lower, upper), lower, upper))
        return self._x[-1]

    def require(self, expression: Any, low: Any = 0.0, high: Any = 0.0) -> None:
        """low <= expression <= high, entry by entry."""
        column = ca.vec(expression)
        self._g.append(column)
        low, high = (np.broadcast_to(v, column.numel()) for v in (low, high))
        self._ends.append((low, high))

    def finish(self, objective: Any) -> None:
        """State the objective."""
        x, o, g = self.x, self.outputs, ca.vertcat(ca.MX(0, 1), *self._g)
        n, nv, no = x.numel(), len(self.scale), o.numel()
        dense = ca.Sparsity.dense

        def slopes(point: Array, *_: Array) -> list[Any]:
            found = self.rollout.slope(*self.parted(point)) * self.scale
            return [np.hstack([found, np.zeros((no, n - nv))])]

        def values(point: Array) -> list[Any]:
            return [self.rollout.outputs(*self.parted(point)).column]

        jac = Callback("jac_outputs", slopes, [n, no], [dense(no, n)])
        call = Callback("outputs", values, [n], [dense(no, 1)], jac)
        self._keep += [jac, call]
        now = ca.substitute([objective, g], [o], [call(x)])
        self.problem = {"x": x, "f": now[0], "g": now[1]}
        self.hessian = self._hessian(objective, g)

    def _hessian(self, objective: Any, g: Any) -> Callback:
        """Second derivatives of the Lagrangian, upper triangle."""
        x, o = self.x, self.outputs
        n, nv = x.numel(), len(self.scale)
        f, m = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
        both = ca.vertcat(x, o)
        lagrangian = f * objective + ca.dot(m, g)
        slope = ca.jacobian(lagrangian, o)
        outer = ca.hessian(lagrangian, both)[0]
        function = ca.Function("outer", [x, o, f, m], [ca.densify(slope), outer])

        def hessian(point: Array, _: Array, lam_f: Array, lam_g: Array) -> list[Any]:
            """Upper triangle of the Lagrangian's Hessian in the variables of the program."""
            place = self.parted(point)
            column = self.rollout.outputs(*place).column
            found = function(point, column, lam_f, lam_g)
            weights, curved = np.asarray(found[0]).ravel(), found[1].sparse().tocsr()
            own = self.rollout.slope(*place) * self.scale
            out = curved[:n, :n].toarray()
            inner = self.rollout.curvature(*place, weights) * np.outer(self.scale, self.scale)
            out[:nv, :nv] += inner + own.T @ (curved[n:, n:] @ own)
            mixed = np.asarray(curved[:n, n:] @ own)
            out[:, :nv] += mixed
            out[:nv, :] += mixed.T
            return [np.triu(out)]

        made = Callback("curvature", hessian, [n, 0, 1, g.numel()], [ca.Sparsity.upper(n)])
        self._keep.append(function)
        return made

    def parted(self, x: Array) -> tuple[Array, Array]:
        """Inputs' variables (n, nu) and displacements (nr,) of a point, SI."""
        setup = self.rollout.prediction.setup
        n, nu = setup.excitation.n, len(setup.designed)
        v = x[: len(self.scale)] * self.scale
        return np.ascontiguousarray(v[: n * nu].reshape(nu, n).T), v[n * nu :]

    @property
    def x(self) -> Any:
        """All variables."""
        return ca.vertcat(*self._x)

    @property
    def begin(self) -> Array:
        """Their start."""
        return np.concatenate([s for s, _, _ in self._sides])

    start = begin

    @property
    def lower(self) -> Array:
        """Their lower bounds."""
        return np.concatenate([s for _, s, _ in self._sides])

    @property
    def upper(self) -> Array:
        """Their upper bounds."""
        return np.concatenate([s for _, _, s in self._sides])

    @property
    def low(self) -> Array:
        """Lower limits of the constraints."""
        return np.concatenate([np.zeros(0), *(a for a, _ in self._ends)])

    @property
    def high(self) -> Array:
        """Upper limits of the constraints."""
        return np.concatenate([np.zeros(0), *(b for _, b in self._ends)])


def input_scales(setup: Setup) -> Array:
    """(nu,) half the range of each designed input."""
    return np.array([0.5 * (b - a) for a, b in (setup.limits.inputs[n] for n in setup.designed)])


def release_scales(setup: Setup) -> Array:
    """(nr,) half the range of each displacement."""
    return np.array([0.5 * (b - a) for a, b in setup.limits.release.values()])


def inputs_stated(made: Statement, setup: Setup, w0: Array, scales: Array) -> tuple[Any, Any]:
    """The inputs' variables (n, nu) in SI, and as the solver has them."""
    n, nu = setup.excitation.n, len(setup.designed)
    lower, upper = np.full((nu, n), -np.inf), np.full((nu, n), np.inf)
    for k, name in enumerate(setup.designed):
        if setup.excitation.shape != "multisine":
            ends = (np.array(setup.limits.inputs[name]) - setup.rest[name]) / scales[k]
            lower[k], upper[k] = ends
            if name in setup.limits.slew:
                lower[k, 0] = upper[k, 0] = 0.0  # begins at rest
    start = (w0 / scales).T.ravel()
    flat = made.variable("w", start, lower.ravel(), upper.ravel())
    if not nu:
        return ca.MX(n, 0), flat
    return ca.reshape(flat, n, nu) @ ca.diag(ca.DM(scales)), flat


def inputs_limited(made: Statement, setup: Setup, w: Any) -> None:
    """Slew rates, energies, and the range of a multisine."""
    excitation = setup.excitation
    samples = ca.DM(excitation.samples)
    for k, name in enumerate(setup.designed):
        half = input_scales(setup)[k]
        u = samples @ w[:, k]
        if excitation.shape == "multisine":
            ends = (np.array(setup.limits.inputs[name]) - setup.rest[name]) / half
            made.require(u / half, *ends)
        if name in setup.limits.slew:
            step = setup.limits.slew[name] * excitation.Ts
            if excitation.shape == "multisine":
                made.require((u[1:] - u[:-1]) / step, -1.0, 1.0)
            else:
                step *= excitation.per
                made.require((w[1:, k] - w[:-1, k]) / step, -1.0, 1.0)
        if name in setup.limits.energy:
            most = setup.limits.energy[name]
            made.require(setup.Ts * ca.sumsqr(u) / most, -np.inf, 1.0)
