"""Simulation with forward sensitivities: RK4 and its tangent in one mapped CasADi step.

The sensitivities of a fixed-step Runge-Kutta simulation obey (nv columns, one a parameter or
initial state)

    S[k+1] = A[k] S[k] + B[k],   A = dx[k+1]/dx[k],  B = dx[k+1]/dtheta                      (1)

with A and B the exact derivatives of the step, so the gradient belongs to the simulation as it is
computed, not to the continuous system (Hairer, Norsett, Wanner 1993, II.6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.model import Explicit, Model

Array = np.ndarray[Any, Any]

BLOCK = 2000
"""Samples that one mapped CasADi function steps through."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A simulated experiment, with sensitivities where they were asked for."""

    y: Array  # (N, ny)
    x: Array  # (N + 1, nx), x[N] belongs to the sample after the last
    dy: Array | None = None  # (N, ny, nv): d y / d (free parameters, initial state)
    dx_end: Array | None = None  # (nx, nv): d x[N] / d (...)


def rk4_sample(model: Model, e: Explicit, u_next: Any, Ts: float, substeps: int) -> Any:
    """One sample of Runge-Kutta 4 as an expression, each input held or joined by straight lines."""
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    h = Ts / substeps
    moves = [model.inputs[name].hold == "foh" for name in e.inputs]

    def u(at: float) -> Any:
        return ca.vertcat(
            *[e.u[i] + at * (u_next[i] - e.u[i]) if m else e.u[i] for i, m in enumerate(moves)]
        )

    x = e.x
    for i in range(substeps):
        left, mid, right = (u((i + c) / substeps) for c in (0.0, 0.5, 1.0))
        k1 = f(x, left, e.p)
        k2 = f(x + h / 2 * k1, mid, e.p)
        k3 = f(x + h / 2 * k2, mid, e.p)
        k4 = f(x + h * k3, right, e.p)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


class Simulator:
    """Simulates one model at one sample time, differentiated in chosen parameters.

    Parameters
    ----------
    model : the model; its inputs in declared order are the columns of `u`.
    Ts : sample time [s].
    free : names of the parameters to differentiate in; all initial states follow them.
    substeps : Runge-Kutta steps per sample.
    """

    def __init__(
        self, model: Model, Ts: float, free: Sequence[str] = (), *, substeps: int = 1
    ) -> None:
        self.model, self.Ts, self.free, self.substeps = model, Ts, tuple(free), substeps
        self.equations = model.explicit()
        e = self.equations
        self.nx, self.nu, self.ny = len(e.states), len(e.inputs), len(e.outputs)
        self.nv = len(self.free) + self.nx
        self._plain: dict[int, Any] = {}
        self._tangent: dict[int, Any] = {}
        u_next = ca.SX.sym("u_next", self.nu)
        x_next = rk4_sample(model, e, u_next, Ts, substeps)
        self._plain_step = ca.Function(
            "step", [e.x, e.u, u_next, e.p], [ca.densify(x_next), ca.densify(e.h)]
        )
        self._tangent_step = self._differentiate(e, u_next, x_next)

    def _differentiate(self, e: Explicit, u_next: Any, x_next: Any) -> Any:
        columns = [e.parameters.index(name) for name in self.free]
        p_free = ca.vertcat(*[e.p[i] for i in columns])
        s = ca.SX.sym("S", self.nx, self.nv)
        zeros = ca.SX(self.nx, self.nx)
        direct = ca.SX(self.ny, self.nx)
        if columns:
            b = ca.horzcat(ca.jacobian(x_next, p_free), zeros)
            d = ca.horzcat(ca.jacobian(e.h, p_free), direct)
        else:
            b, d = zeros, direct
        s_next = ca.jacobian(x_next, e.x) @ s + b
        dy = ca.jacobian(e.h, e.x) @ s + d
        return ca.Function(
            "tangent",
            [ca.vertcat(e.x, ca.vec(s)), e.u, u_next, e.p],
            [
                ca.densify(ca.vertcat(x_next, ca.vec(s_next))),
                ca.densify(ca.vertcat(e.h, ca.vec(dy))),
            ],
        )

    def _run(
        self, cache: dict[int, Any], step: Any, start: Array, u: Array, after: Array, p: Array
    ) -> tuple[Array, Array]:
        """States after each sample (N, ...) and outputs (N, ...), block by block.

        Blocks keep the mapped functions few and small; CasADi reads and writes the arrays in place.
        """
        n_state, n_out = step.numel_out(0), step.numel_out(1)
        states, outputs = np.empty((len(u), n_state)), np.empty((len(u), n_out))
        state = np.ascontiguousarray(start, dtype=float)
        u, after = np.ascontiguousarray(u), np.ascontiguousarray(after)
        for first in range(0, len(u), BLOCK):
            last = min(first + BLOCK, len(u))
            n = last - first
            if n not in cache:
                function = step.mapaccum("block", n)
                cache[n] = (function, *function.buffer())
            _, buffer, trigger = cache[n]
            repeated = np.tile(np.asarray(p, dtype=float), (n, 1))
            arguments = [state, u[first:last], after[first:last], repeated]
            for i, argument in enumerate(arguments):
                if argument.size:
                    buffer.set_arg(i, argument.data)
            buffer.set_res(0, states[first:last].data)
            if n_out:
                buffer.set_res(1, outputs[first:last].data)
            trigger()
            state = states[last - 1].copy()
        return states, outputs

    @staticmethod
    def _next(u: Array, after: Array | None = None) -> Array:
        """The inputs one sample later; the last is held unless the one after it is given."""
        return np.concatenate([u[1:], u[-1:] if after is None else after[None, :]])

    def simulate(self, u: Array, p: Array, x0: Array) -> Trajectory:
        """Simulate N samples from `x0` (nx,) under `u` (N, nu) with all parameters `p` (np,).

        Values that overflow come back as inf or NaN: the caller knows what diverged.
        """
        x, y = self._run(self._plain, self._plain_step, np.ravel(x0), u, self._next(u), p)
        return Trajectory(y, np.vstack([np.reshape(x0, (1, self.nx)), x]))

    def sensitivities(
        self, u: Array, p: Array, x0: Array, *, after: Array | None = None
    ) -> Trajectory:
        """As `simulate`, with dy (N, ny, nv) in (free parameters, initial state).

        `after` (nu,) is the input one sample after the last, where it is known: x[N] needs it.
        """
        n, nx, nv, ny = len(u), self.nx, self.nv, self.ny
        start = np.zeros((nv, nx))
        start[nv - nx :, :] = np.eye(nx)
        xs, yd = self._run(
            self._tangent,
            self._tangent_step,
            np.concatenate([np.ravel(x0), start.ravel()]),
            u,
            self._next(u, after),
            p,
        )
        return Trajectory(
            y=yd[:, :ny],
            x=np.vstack([np.reshape(x0, (1, nx)), xs[:, :nx]]),
            dy=yd[:, ny:].reshape(n, nv, ny).transpose(0, 2, 1),
            dx_end=xs[-1, nx:].reshape(nv, nx).T,
        )
