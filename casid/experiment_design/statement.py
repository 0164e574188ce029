"""A program while it is put together: scaled variables, constraints, and those of the inputs."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.experiment_design.setup import Setup


class Statement:
    """Variables and constraints of the program while it is put together, all scaled."""

    def __init__(self) -> None:
        self._x: list[Any] = []
        self._sides: list[tuple[Array, Array, Array]] = []
        self._g: list[Any] = []
        self._ends: list[tuple[Array, Array]] = []
        self.problem: dict[str, Any] = {}

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
        self.problem = {"x": self.x, "f": objective, "g": ca.vertcat(*self._g)}

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
        return np.concatenate([a for a, _ in self._ends])

    @property
    def high(self) -> Array:
        """Upper limits of the constraints."""
        return np.concatenate([b for _, b in self._ends])


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
