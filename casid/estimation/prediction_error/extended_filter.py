"""The extended Kalman filter of a continuous model between samples, with exact sensitivities.

    dx/dt = f(x, u) + G(x, u) w,    y[t] = h(x[t], u[t]) + v[t],                            (1)
    between samples    dP/dt = A P + P A' + G W G',    A = df/dx,                             (2)
    at a sample        S = H P H' + R,    x += P H' S^-1 (y - h(x)),    P -= P H' S^-1 H P    (3)

(A. H. Jazwinski, Stochastic Processes and Filtering Theory, 1970, theorem 8.1; N. R. Kristensen,
H. Madsen, S. B. Jorgensen, Automatica 40 (2004) 225-237). State and covariance (2) go together by
Runge-Kutta steps. In (3) the outputs of a sample come one after another, each with what those
before left of its innovation, so that the innovations are independent and one that is missing is
passed over. Where the model is linear all of this is exact but for the integration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import ModelError
from casid.estimation.simulation.integration.simulator import (
    band_limited,
    inputs_within,
    rk4_sample,
    rk4_step,
)
from casid.estimation.simulation.integration.stepping import Step, Stepping, StepSymbols
from casid.linear.filtering.noisy_model import NoisePlaces
from casid.model.explicit_form import Explicit
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class FilteredRecord:
    """Output of the filter for a record; with `n` columns of sensitivities, where requested.

    Attributes
    ----------
    innovations, variances : (N, ny), each output given those before it in the same sample; zero
        and one where a sample is missing.
    predicted : (N, ny) outputs one sample ahead.
    x : (N, nx) states one sample ahead.
    d_innovations, d_variances : (N, ny, n).
    """

    innovations: Array
    variances: Array
    predicted: Array
    x: Array
    d_innovations: Array | None = None
    d_variances: Array | None = None


def require_filterable(model: Model) -> None:
    """Refuse what the filter has no state for; ModelError."""
    for stage in model.stages:
        raise ModelError(
            f"{model.name}: {stage.channel} has a {stage.kind.replace('_', ' ')}, which a Kalman "
            "filter has no state for; leave it out, or estimate without disturbances"
        )


class ExtendedFilter:
    """(1)-(3) for one model at one sample time.

    Parameters
    ----------
    places : of the noise, none of which is held; no process noise acts on an output directly.
    Ts : sample time [s].
    seeds : (values, n) derivatives of the values in what a run is differentiated in. The values are
        those of all parameters of the model, then the variances of `places.sources`.
    substeps : Runge-Kutta steps a sample.

    Raises
    ------
    ModelError
        For noise that is held, or that acts on an output directly; sensors with delays or clipping.
    """

    def __init__(self, places: NoisePlaces, Ts: float, seeds: Array, *, substeps: int = 1) -> None:
        self.places, self.Ts, self.substeps = places, Ts, substeps
        self.columns = seeds.shape[1]
        require_filterable(places.model)
        e, G = _noise_apart(places)
        self.equations = e
        self.nx, self.nu, self.ny = len(e.states), len(e.inputs), len(e.outputs)
        self.n_carry = self.nx + self.nx * (self.nx + 1) // 2
        self._build(e, G, seeds)

    def _build(self, e: Explicit, G: Any, seeds: Array) -> None:
        """The steps of the filter, plain and with sensitivities."""
        model, nu, ny = self.places.driven, self.nu, self.ny
        banded = tuple(list(model.inputs).index(name) for name in band_limited(model))
        self._stepping = Stepping(nu + 2 * ny, banded, self.substeps)
        within = ca.SX.sym("within", 3 * (1 + len(banded)))
        ahead = ca.SX.sym("ahead", nu + 2 * ny)
        y, used = ca.SX.sym("y", ny), ca.SX.sym("used", ny)
        variances = ca.SX.sym("variances", len(self.places.sources))
        values = ca.vertcat(e.p, variances)
        carry = ca.SX.sym("carry", self.n_carry)
        now = used * (within[0] <= 0)  # a sample is looked at before its first step
        q, r = ca.vertsplit(variances, [0, len(self.places.process), variances.numel()])
        x, P, out = self._updated(e, carry, y, now, r)
        at = [
            ca.vertcat(*inputs_within(model, e, ahead, within[i], ca.vertsplit(within[3 + i :: 3])))
            for i in range(3)
        ]
        flow = self._flow(e, G, q)
        after = rk4_step(flow, self._packed(x, P), values, at, self.Ts / self.substeps)
        u = ca.vertcat(e.u, y, used)
        symbols = StepSymbols(self.nx, banded, u, ahead, values, within)
        nothing = ca.SX(0, 1)
        self._plain = Step("filter", symbols, carry, after, out, nothing)
        if not self.columns:
            return
        s = ca.SX.sym("s", self.n_carry, self.columns)
        moved = ca.jtimes(
            ca.vertcat(after, out[: 2 * ny]),
            ca.vertcat(carry, values),
            ca.vertcat(s, ca.sparsify(ca.DM(seeds))),
        )
        self._tangent = Step(
            "filter_tangent",
            symbols,
            ca.vertcat(carry, ca.vec(s)),
            ca.vertcat(after, ca.vec(moved[: self.n_carry, :])),
            ca.vertcat(out, ca.vec(moved[self.n_carry :, :])),
            nothing,
        )

    def _updated(self, e: Explicit, carry: Any, y: Any, used: Any, r: Any) -> tuple[Any, Any, Any]:
        """(3): state and covariance, and innovations, variances, outputs and states before it."""
        x, P = self._unpacked(carry)
        h = ca.Function("h", [e.x, e.u, e.p], [e.h, ca.jacobian(e.h, e.x)])
        expected, H = h(x, e.u, e.p)
        moved, innovations, variances = ca.SX(self.nx, 1), [], []
        for i in range(self.ny):
            to = P @ H[i, :].T
            S = ca.if_else(used[i] > 0, H[i, :] @ to + r[i], 1.0)
            error = ca.if_else(used[i] > 0, y[i] - expected[i] - H[i, :] @ moved, 0.0)
            moved += used[i] * to * (error / S)
            P = P - used[i] * (to @ to.T) / S
            innovations.append(error)
            variances.append(S)
        return x + moved, P, ca.vertcat(*innovations, *variances, expected, x)

    def _flow(self, e: Explicit, G: Any, q: Any) -> Any:
        """(1) and (2): the rates of state and covariance, packed, under inputs and values."""
        carry = ca.SX.sym("c", self.n_carry)
        x, P = self._unpacked(carry)
        A = ca.jacobian(e.f, e.x)
        at = ca.Function("at", [e.x, e.u, e.p], [e.f, A, G])
        f, A, G = at(x, e.u, e.p)
        moving = A @ P
        rate = moving + moving.T + (G @ ca.diag(q) @ G.T if q.numel() else 0)
        values = ca.vertcat(e.p, q, ca.SX.sym("r", self.ny))
        return ca.Function("flow", [carry, e.u, values], [self._packed(f, rate)])

    def _packed(self, x: Any, P: Any) -> Any:
        return ca.vertcat(x, *[P[i, j] for j in range(self.nx) for i in range(j, self.nx)])

    def _unpacked(self, carry: Any) -> tuple[Any, Any]:
        P = ca.SX(self.nx, self.nx)
        at = self.nx
        for j in range(self.nx):
            for i in range(j, self.nx):
                P[i, j] = P[j, i] = carry[at]
                at += 1
        return carry[: self.nx], P

    def pack(self, x: Array, P: Array) -> Array:
        """State (nx,) and covariance (nx, nx) as a run takes them."""
        return np.concatenate([x, *[P[j:, j] for j in range(self.nx)]])

    def run(
        self, columns: tuple[Array, Array, Array], values: Array, start: Array, slopes: Array | None
    ) -> FilteredRecord:
        """The filter over a record.

        Parameters
        ----------
        columns : inputs (N, nu), outputs (N, ny), and which of these count.
        values : of the parameters, then of the variances.
        start : state and covariance before the first sample, packed.
        slopes : (len(start), n) their derivatives; None: no sensitivities.

        Values that overflow come back as inf or NaN.
        """
        u = self._stepping.with_courses(np.hstack([np.asarray(c, dtype=float) for c in columns]))
        after = self._stepping.next(u)
        if slopes is None:
            _, out, _ = self._stepping.run(self._plain, start, u, after, values)
        else:
            begin = np.concatenate([start, slopes.T.ravel()])
            _, out, _ = self._stepping.run(self._tangent, begin, u, after, values)
        ny, nx = self.ny, self.nx
        e, S, y, x, moved = np.split(out, np.cumsum([ny, ny, ny, nx]).tolist(), axis=1)
        if slopes is None:
            return FilteredRecord(e, S, y, x)
        d = moved.reshape(len(out), self.columns, 2 * ny).transpose(0, 2, 1)
        return FilteredRecord(e, S, y, x, d[:, :ny], d[:, ny:])

    def one_further(self, x: Array, u: Array, p: Array) -> tuple[Array, Array]:
        """Outputs (N, ny) and states (N, nx) predicted from one sample earlier than `x` is.

        Parameters
        ----------
        x : (N, nx) predicted states; the first stays as it is.
        u, p : inputs (N, nu) and all parameters (np,).
        """
        e, N = self.equations, len(x)
        ahead = ca.SX.sym("ahead", self.nu)
        later = rk4_sample(self.places.driven, e, ahead, self.Ts, self.substeps)
        step = ca.Function("step", [e.x, e.u, ahead, e.p], [later]).map(max(N - 1, 1))
        states = x.copy()
        if N > 1:
            columns = [np.tile(p[:, None], (1, N - 1)), u[:-1].T, u[1:].T]
            states[1:] = np.array(step(x[:-1].T, columns[1], columns[2], columns[0])).T
        h = ca.Function("h", [e.x, e.u, e.p], [ca.densify(e.h)]).map(N)
        return np.array(h(states.T, u.T, np.tile(p[:, None], (1, N)))).T, states


def _noise_apart(places: NoisePlaces) -> tuple[Explicit, Any]:
    """The equations without noise, and what a unit of each noise adds to the rates (nx, k)."""
    model, names = places.with_inputs()
    for source in places.process:
        if source.held:
            raise ModelError(
                f"{model.name}: noise of {source.where} is held over samples, which the extended "
                "filter has no place for; give continuous noise, or a disturbance of first order"
            )
    e = model.explicit()
    w = ca.vertcat(*[e.u[e.inputs.index(name)] for name in names]) if names else ca.SX(0, 1)
    nothing = ca.SX.zeros(w.numel())
    felt = [
        f"{output} responds to the noise of {source.where}"
        for i, output in enumerate(e.outputs)
        for j, source in enumerate(places.process)
        if ca.depends_on(e.h[i], w[j])
    ]
    if felt:
        raise ModelError(
            f"{model.name}: output {felt[0]} at once, and white noise has no finite variance at an "
            "instant; give the disturbance a spectrum, first or peak"
        )
    f, G, h = ca.substitute([e.f, ca.jacobian(e.f, w), e.h], [w], [nothing])
    kept = [i for i, name in enumerate(e.inputs) if name not in names]
    order = [e.inputs[i] for i in kept]
    u = ca.vertcat(*[e.u[i] for i in kept]) if kept else ca.SX(0, 1)
    return replace(e, f=f, h=h, u=u, inputs=tuple(order)), G
