"""The Gaussian prediction-error criterion of linear grey-box models with process noise.

    V(theta) = 1/2 sum_e sum_t ( eps' F^-1 eps + log det F ) + constant                     (1)

with the innovations eps and their covariance F from the one-step predictor of the model that the
parameters theta give: physical ones, noise variances, initial states. The continuous model is
sampled exactly (van Loan), the predictor is a Kalman filter; (2.29)-(2.38) of Linder (2017),
L. Ljung, System Identification, 2nd ed., 1999, sections 4.3 and 7.4. Maximum likelihood for
Gaussian noise, and consistent without.

Derivatives are exact: complex steps through the sampling, the Riccati equation differentiated
implicitly, sensitivity filters for the innovations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypedDict

import numpy as np
from scipy import linalg

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.errors import DataError, ModelError
from casid.estimation.nlp.solution import Evaluation
from casid.estimation.prediction_error.unknown_noise import NoisyUnknowns
from casid.estimation.simulation.records.signals import signals_of
from casid.estimation.unknowns import LastOf, Unknowns, Variable
from casid.grouping import Grouped
from casid.linear.filtering.kalman import (
    Predictor,
    covariance_scale,
    gain_tangent,
    riccati_step_tangent,
    steady_state,
    step,
)
from casid.linear.filtering.noisy_model import NoisyModel, Sampled, White, noise_sources
from casid.linear.filtering.recursion import recursion, recursion_time_last
from casid.linear.linear_model import notes_about_rest
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """Innovations, their covariances and the derivatives of both, over a stretch of one record."""

    innovations: Array  # (N, ny)
    jacobian: Array  # (N, ny, nv), d innovation / d local variables
    covariance: Array  # (N or 1, ny, ny)
    covariance_tangent: Array  # (N or 1, nv, ny, ny)


class CriterionOptions(TypedDict, total=False):
    """Optional arguments of a `PredictionError`."""

    own: Sequence[str]
    initial: Mapping[str, float] | None
    start: Mapping[str, float] | None
    rest: Mapping[str, Any] | None


class PredictionError:
    """Criterion (1) for a model, its noise and its experiments.

    Parameters
    ----------
    model : linear, or linearised about its rest. Inputs that are unknown must be noise.
    experiments : one or more, with their own sample times; known values override the model's.
    noise : one `White` for each output, and for each source of process noise.
    own : names of parameters that every experiment has for itself.
    initial : standard deviations of the initial states, by name, about their declared start: the
        predictor is then the time-varying one. Default: the initial states are estimated, and the
        gain is the steady-state one from the first sample on.
    start : start values by variable name, over the model's own.
    rest : state or input -> its value at rest, a number or an SX expression of the model's
        parameters; 0 for what is not given.

    Raises
    ------
    ModelError
        For noise that is missing, or enters nowhere; a model that cannot be linearised; a start
        for what is no variable.
    DataError
        For channels that are missing or have gaps.
    """

    def __init__(
        self,
        model: Model,
        experiments: Sequence[Experiment],
        noise: Sequence[White] | White,
        *,
        own: Sequence[str] = (),
        initial: Mapping[str, float] | None = None,
        start: Mapping[str, float] | None = None,
        rest: Mapping[str, Any] | None = None,
    ) -> None:
        if not experiments:
            raise DataError("no experiment to fit; give at least one record")
        self.model, self.experiments, self.noise = model, list(experiments), noise_sources(noise)
        self.outputs = tuple(model.outputs)
        self.initial = None if initial is None else dict(initial)
        self.unknowns = Unknowns(
            model, [(e.name, model.in_si(e.known)) for e in experiments], own, start
        )
        self.free, self.own = self.unknowns.free, self.unknowns.own
        self.noisy = NoisyModel(model, noise, self.free, rest)
        self.places, self.inputs = self.noisy.places, self.noisy.inputs
        self.notes = notes_about_rest(self.noisy.linear)
        self.data = [signals_of(self.places.driven, e) for e in experiments]
        self._refuse_gaps()
        self.offset = 0.0  # the constant of (1)
        doubted = () if initial is None else {**model.states, **initial}
        self._laid_out = NoisyUnknowns(self.unknowns, self.places, self.data, doubted, start or {})
        self._index = self._laid_out.index
        self._last: LastOf[list[Predicted]] = LastOf()
        self._near: dict[int, Array] = {}  # the last covariance, a start for the next

    # -- what is what ------------------------------------------------------------------------

    def _refuse_gaps(self) -> None:
        for d in self.data:
            if not d.used.all():
                t, i = np.argwhere(~d.used)[0].tolist()
                raise DataError(
                    f"{d.name}: output {self.outputs[i]} misses samples, the first at "
                    f"t = {d.t[t]:g} s; the prediction error needs them all. Cut the record with "
                    "between(t0, t1), fit the simulation error (identify), which takes gaps, or "
                    "interpolate the channel"
                )

    variables: ClassVar[Grouped[list[Variable]]] = Grouped("unknowns")  # The NLP's variables
    names: ClassVar[Grouped[tuple[str, ...]]] = Grouped("unknowns")  # Names of the NLP's variables
    start: ClassVar[Grouped[Array]] = Grouped("unknowns")  # (n,) start values

    @property
    def n_constraints(self) -> int:
        """Number of constraints of its own: none."""
        return 0

    @property
    def n_samples(self) -> int:
        """Samples over experiments and outputs."""
        return int(sum(d.y.size for d in self.data))

    # -- the sampled model -------------------------------------------------------------------

    def _values(self, x: Array, e: int) -> tuple[Array, Array, Array]:
        """All parameters (np,), variances of process and measurement noise, initial state (nx,)."""
        laid_out = self._laid_out
        values = laid_out.parameters(x, e)
        p = np.array([values[n] for n in self.noisy.linear.parameters], dtype=float)
        return p, laid_out.variances(x, e), laid_out.initial_state(x, e)

    def parameters(self, x: Array, e: int) -> dict[str, float]:
        """Every parameter of the model in one experiment at `x`."""
        return self._laid_out.parameters(x, e)

    def initial_state(self, x: Array, e: int) -> Array:
        """Initial state (nx,) of one experiment at `x`."""
        return self._laid_out.initial_state(x, e)

    def sampled(self, x: Array, e: int) -> Sampled:
        """The sampled system of one experiment and its derivatives."""
        p, variances, _ = self._values(x, e)
        wanted = [bool(i >= 0) for i in self._index[e][: len(self.free)]]
        return self.noisy.sampled(p, variances, self.data[e].Ts, wanted)

    def predictor(self, x: Array, e: int) -> Predictor:
        """The steady-state predictor of one experiment at `x`."""
        return steady_state(self.sampled(x, e).system)

    # -- innovations -------------------------------------------------------------------------

    def predicted(self, x: Array, e: int) -> list[Predicted]:
        """Innovations of one experiment: a transient part, if any, and the steady one."""
        return self._last(x, e, self._predicted)

    def _predicted(self, x: Array, e: int) -> list[Predicted]:
        d = self.data[e]
        at = self.sampled(x, e)
        s, tangent, nx = at.system, at.tangent, at.system.nx
        limit = steady_state(s, self._near.get(e))
        self._near[e] = limit.P
        gain = gain_tangent(limit, tangent)
        m = len(tangent.A)
        z, u0 = self._begun(x, e, at)
        dz = np.concatenate([(at.d_lead - at.d_shift @ u0).T, np.eye(nx)], axis=1)  # (nx, m + nx)
        y = d.y - at.offset
        d_y = np.concatenate([-at.d_offset.T, np.zeros((s.ny, nx))], axis=1)  # (ny, m + nx)
        parts = []
        first = 0
        if self.initial is not None:
            P = np.diag([self.initial.get(n, 0.0) ** 2 for n in self.model.states])
            part, (z, dz) = self._transient(at, limit, gain.P, (y, d_y), d.u, (z, dz), P)
            parts.append(part)
            first = len(part.innovations)
        if first < len(y):
            K, u, y, closed = limit.K, d.u[first:], y[first:], limit.A_closed
            states, eps = _steady_innovations(at, limit, y, u, z)
            # Drives and outputs of the sensitivities are linear in [x, u, eps, 1].
            known = np.vstack([states.T, u.T, eps.T, np.ones(len(y))])[:, None]
            moved = np.concatenate(
                [tangent.A - K @ tangent.C, tangent.B - K @ tangent.D, gain.K], axis=2
            )
            constant = ((K @ d_y[:, :m]).T + at.d_drift)[:, :, None]
            drive = np.zeros((nx, m + nx, len(y)))
            weights = np.concatenate([moved, constant], axis=2)  # (m, nx, columns)
            _combine(weights.transpose(1, 0, 2), known, drive[:, :m])
            dx = recursion_time_last(closed, drive, dz)[:, :, :-1]
            nil = np.zeros((m, s.ny, s.ny))
            direct = np.concatenate([tangent.C, tangent.D, nil, -d_y[:, :m].T[:, :, None]], axis=2)
            de = np.zeros((s.ny, m + nx, len(y)))
            _combine(-direct.transpose(1, 0, 2), known, de[:, :m])
            _combine(-s.C[:, None, :], dx, de)
            jac = np.ascontiguousarray(de.transpose(2, 0, 1))
            dF = np.concatenate([gain.F, np.zeros((nx, s.ny, s.ny))])
            parts.append(Predicted(eps, jac, limit.F[None], dF[None]))
        return parts

    def _begun(self, x: Array, e: int, at: Sampled) -> tuple[Array, Array]:
        """The predictor's first state (nx,), and the first inputs (nu,)."""
        u = self.data[e].u
        u0 = u[0] if len(u) else np.zeros(0)
        return self.initial_state(x, e) - at.shift @ u0 + at.lead, u0

    def _transient(
        self,
        at: Sampled,
        limit: Predictor,
        limit_dP: Array,
        outputs: tuple[Array, Array],
        u: Array,
        state: tuple[Array, Array],
        P: Array,
    ) -> tuple[Predicted, tuple[Array, Array]]:
        """The time-varying predictor until its gain and their derivatives have settled.

        Parameters
        ----------
        outputs, state : y (N, ny) and the state (nx,), each with its derivatives.
        P : (nx, nx) covariance of the initial state.

        Returns
        -------
        The innovations so far, and the next state with its derivatives.
        """
        (y, d_y), (z, dz) = outputs, state
        s, tangent = at.system, at.tangent
        m, nx = len(tangent.A), s.nx
        dP: Array = np.zeros((m, nx, nx))
        scale = covariance_scale(limit.P, P)
        d_scale = np.max(np.abs(limit_dP / scale), axis=(1, 2)) + TINY
        nil = np.zeros((nx, s.ny, s.ny))
        eps, jac, F_all, dF_all = [], [], [], []
        for t in range(len(y)):
            settled = np.max(np.abs((P - limit.P) / scale)) < 1e-11
            if settled and np.all(
                np.max(np.abs((dP - limit_dP) / scale), axis=(1, 2)) < 1e-9 * d_scale
            ):
                break
            F, K, after = step(s, P)
            gain, dP = riccati_step_tangent(s, tangent, K, P, F, dP)
            e = y[t] - s.C @ z - s.D @ u[t]
            de = d_y - s.C @ dz
            de[:, :m] -= (tangent.C @ z + tangent.D @ u[t]).T
            moved = (tangent.A @ z + tangent.B @ u[t] + gain.K @ e + at.d_drift).T
            dz = s.A @ dz + K @ de
            dz[:, :m] += moved
            z = s.A @ z + s.B @ u[t] + at.drift + K @ e
            P = after
            eps.append(e)
            jac.append(de)
            F_all.append(F)
            dF_all.append(np.concatenate([gain.F, nil]))
        shape = (len(eps), s.ny)
        part = Predicted(
            np.array(eps).reshape(shape),
            np.array(jac).reshape(*shape, m + nx),
            np.array(F_all).reshape(*shape, s.ny),
            np.array(dF_all).reshape(len(eps), m + nx, s.ny, s.ny),
        )
        return part, (z, dz)

    def innovations(self, x: Array, e: int) -> Array:
        """(N, ny) one-step prediction errors of one experiment."""
        return np.concatenate([p.innovations for p in self.predicted(x, e)])

    # -- the criterion -----------------------------------------------------------------------

    def evaluate(self, x: Array) -> Evaluation:
        """Value, gradient and expected Hessian (Fisher information) of (1) at `x` (n,).

        Where no predictor exists (a line search went too far) all are NaN.
        """
        n = len(self.variables)
        value, gradient, hessian = self.offset, np.zeros(n), np.zeros((n, n))
        try:
            with np.errstate(all="ignore"):
                for e in range(len(self.data)):
                    keep = self._index[e] >= 0
                    place = self._index[e][keep]
                    for part in self.predicted(x, e):
                        v, s, h = _likelihood(part)
                        value += v
                        gradient[place] += s.sum(axis=0)[keep]
                        hessian[np.ix_(place, place)] += h[np.ix_(keep, keep)]
        except (ModelError, np.linalg.LinAlgError, ValueError):
            return Evaluation(np.nan, np.full(n, np.nan), np.full((n, n), np.nan))
        return Evaluation(value, gradient, hessian)

    def value(self, x: Array) -> float:
        """(1) at `x` (n,) alone, without derivatives; NaN where no predictor exists."""
        if self.initial is not None:
            return self.evaluate(x).value
        value = self.offset
        try:
            with np.errstate(all="ignore"):
                for e, d in enumerate(self.data):
                    p, variances, _ = self._values(x, e)
                    at = self.noisy.sampled(p, variances, d.Ts, [False] * len(self.free))
                    limit = steady_state(at.system, self._near.get(e))
                    z, _ = self._begun(x, e, at)
                    _, eps = _steady_innovations(at, limit, d.y - at.offset, d.u, z)
                    lower = np.linalg.cholesky(limit.F)
                    white = linalg.solve_triangular(lower, eps.T, lower=True)
                    value += 0.5 * float(np.sum(white**2))
                    value += len(eps) * float(np.sum(np.log(np.diag(lower))))
        except (ModelError, np.linalg.LinAlgError, ValueError):
            return math.nan
        return value

    def scores(self, x: Array) -> Array:
        """(sum of N, n) derivatives of each sample's term in (1), experiments stacked."""
        out = []
        for e, d in enumerate(self.data):
            keep = self._index[e] >= 0
            rows = np.zeros((len(d.y), len(self.variables)))
            parts = [_likelihood(part)[1] for part in self.predicted(x, e)]
            rows[:, self._index[e][keep]] = np.concatenate(parts)[:, keep]
            out.append(rows)
        return np.concatenate(out)

    def quadratic(self, x: Array) -> float:
        """sum eps' F^-1 eps at `x`: as large as the number of samples where the noise is right."""
        total = 0.0
        for e in range(len(self.data)):
            for part in self.predicted(x, e):
                solved = np.linalg.solve(part.covariance, part.innovations[:, :, None])[:, :, 0]
                total += float(np.sum(part.innovations * solved))
        return total

    def log_likelihood(self, x: Array) -> float:
        """log of the Gaussian density of all records."""
        value = self.evaluate(x).value - self.offset
        return float(-value - 0.5 * self.n_samples * np.log(2 * np.pi))


def _steady_innovations(
    at: Sampled, limit: Predictor, y: Array, u: Array, z: Array
) -> tuple[Array, Array]:
    """States (N, nx) and errors (N, ny) of the steady-state predictor from the state z (nx,)."""
    s, K = at.system, limit.K
    driven = u @ (s.B - K @ s.D).T + y @ K.T + at.drift
    states: Array = recursion(limit.A_closed, driven, z)[:-1]
    return states, y - states @ s.C.T - u @ s.D.T


def _combine(weights: Array, signals: Array, out: Array) -> None:
    """out[i, j] += sum_k weights[i, j, k] signals[k, j]: few long rows, no matrix product.

    `weights` (rows, m or 1, K), `signals` (K, m or 1, N), `out` (rows, m, N).
    """
    for i, by_column in enumerate(weights):
        for j in range(out.shape[1]):
            row = by_column[min(j, len(by_column) - 1)]
            for weight, signal in zip(row, signals, strict=True):
                if weight != 0.0:
                    out[i, j] += weight * signal[min(j, len(signal) - 1)]


def _likelihood(part: Predicted) -> tuple[float, Array, Array]:
    """Terms of (1) over one stretch: value, scores (N, nv), information (nv, nv)."""
    N, ny, nv = part.jacobian.shape
    lower = np.linalg.cholesky(part.covariance)
    inverse = np.linalg.inv(lower)  # (N or 1, ny, ny)
    white = np.matmul(inverse, part.innovations[:, :, None])[:, :, 0]
    jac = np.matmul(inverse, part.jacobian)
    # L^-1 dF L^-T, one for each variable.
    dF = np.matmul(
        np.matmul(inverse[:, None], part.covariance_tangent), inverse.swapaxes(1, 2)[:, None]
    )
    logdet = 2 * np.sum(np.log(np.diagonal(lower, axis1=1, axis2=2)), axis=1)
    weight = N if len(lower) == 1 else 1
    value = 0.5 * float(np.sum(white**2)) + 0.5 * weight * float(np.sum(logdet))
    outer = (white[:, :, None] * white[:, None, :]).reshape(N, ny * ny)
    flat = dF.reshape(len(dF), nv, ny * ny)
    spread = outer @ flat[0].T if len(dF) == 1 else np.einsum("ta,tva->tv", outer, flat)
    trace = np.trace(dF, axis1=2, axis2=3)  # (N or 1, nv)
    scores = np.einsum("ti,tiv->tv", white, jac) + 0.5 * (trace - spread)
    stacked = jac.reshape(N * ny, nv)
    # einsum starts no threads, which for so thin a product cost more than they bring.
    information = np.einsum("ti,tj->ij", stacked, stacked)
    information += 0.5 * weight * np.einsum("tva,twa->vw", flat, flat)
    return value, scores, information
