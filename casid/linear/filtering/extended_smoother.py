"""States of a nonlinear stochastic model from a whole record: an extended Kalman smoother.

    x[t+1] = f(x[t]) + w[t],    y[t] = h(x[t]) + v[t],                                      (1)
    cov w = Q(x, levels),    cov v = diag(r(levels) + what is known of each sample)

Forward an extended Kalman filter, whose Jacobians CasADi derives; backward the recursion of Rauch,
Tung and Striebel (AIAA J. 3 (1965) 1445-1450; S. Sarkka, Bayesian Filtering and Smoothing, 2013,
algorithms 5.4 and 9.1). Levels of noise that are not given are those of the greatest likelihood of
the innovations, with exact derivatives. Where f and h are linear all of this is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.errors import DataError, ModelError, SolveError

FAR = float(np.log(1e5))
"""Standard deviation of ln(level / start) before the data: the start may be off by any factor that
one meets. It only decides where nothing else does, a level that might as well be zero."""

GAIN = 1e-4
"""What another step towards the greatest likelihood may still gain: far below one, the square of
a standard error."""


@dataclass(frozen=True, slots=True, eq=False)
class StochasticModel:
    """Model (1) over one sample, as functions of CasADi symbols.

    Attributes
    ----------
    states, outputs, levels : name -> unit, in order. Levels are positive: standard deviations of
        measurement noise, roots of intensities of process noise.
    transition : x (nx, 1) -> f (nx, 1).
    process : (x, levels) -> Q (nx, nx), positive semidefinite.
    measurement : x -> h (ny, 1).
    variances : levels -> (ny, 1), of the measurement noise.
    angles : outputs that return after 2 pi; their innovations are taken the short way round.
    """

    name: str
    states: Mapping[str, str]
    outputs: Mapping[str, str]
    levels: Mapping[str, str]
    transition: Callable[[Any], Any]
    process: Callable[[Any, Any], Any]
    measurement: Callable[[Any], Any]
    variances: Callable[[Any], Any]
    angles: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """The states given the whole record, and what the filter found on its way.

    Attributes
    ----------
    x : (N, nx); P : (N, nx, nx), their covariance.
    filtered : (N, nx) given the samples up to each.
    innovations : (N, ny), each given the samples before and the outputs before it in the same
        sample; zero where missing. deviations : (N, ny) their standard deviations.
    """

    states: tuple[str, ...]
    x: Array
    P: Array
    filtered: Array
    innovations: Array
    deviations: Array
    log_likelihood: float

    def __getitem__(self, state: str) -> Array:
        """(N,) smoothed values of a state."""
        return np.asarray(self.x[:, self._index(state)])

    def std_error(self, state: str) -> Array:
        """(N,) standard deviation of a smoothed state, given the levels of noise."""
        i = self._index(state)
        return np.asarray(np.sqrt(np.maximum(self.P[:, i, i], 0.0)))

    @property
    def whitened(self) -> Array:
        """(N, ny) innovations in their standard deviations."""
        return np.asarray(self.innovations / self.deviations)

    def _index(self, state: str) -> int:
        if state not in self.states:
            raise ModelError(f"no state {state!r}; there are {', '.join(self.states)}")
        return self.states.index(state)

    def __repr__(self) -> str:
        return f"<Smoothed {', '.join(self.states)}: N = {len(self.x)}>"


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Levels of noise: stated ones, and those of the greatest likelihood.

    Attributes
    ----------
    relative_errors : standard error of ln(level) of the estimated ones, from the outer product of
        the scores (Berndt et al. 1974); zero for those stated.
    undetermined : estimated ones with a relative error above one half: as good as zero, mostly.
    """

    values: Mapping[str, float]
    relative_errors: Mapping[str, float]
    undetermined: tuple[str, ...]
    log_likelihood: float


class ExtendedSmoother:
    """Filter, smoother and likelihood of a `StochasticModel`.

    Parameters
    ----------
    model : its functions are turned into one compiled step, mapped over the record.

    Example
    -------
    ``smoother = ExtendedSmoother(model)``, ``levels = smoother.fit(y, start, x0, P0)``,
    ``smoother.smooth(y, levels.values, x0, P0)["speed"]``.
    """

    def __init__(self, model: StochasticModel) -> None:
        self.model = model
        self._step = _step(model)
        n, ny = len(model.states), len(model.outputs)
        x = ca.SX.sym("x", n)
        self._slope = ca.Function("slope", [x], [ca.densify(ca.jacobian(model.transition(x), x))])
        self._shapes = (n, ny, len(model.levels))

    def smooth(
        self,
        y: Array,
        levels: Mapping[str, float],
        x0: Array,
        P0: Array,
        *,
        used: Array | None = None,
        known: Array | None = None,
    ) -> Smoothed:
        """The states given all of y (N, ny).

        Parameters
        ----------
        levels : name -> value, all of them.
        x0, P0 : (nx,) and (nx, nx), mean and covariance of the first state before any sample.
        used : (N, ny) bool, False where a sample is missing.
        known : (ny,) or (N, ny), standard deviation of measurement noise that comes on top of the
            levels: a quantisation, an accuracy that changes.

        Raises
        ------
        DataError
            For shapes that do not fit, samples that are not finite, or a filter that leaves the
            finite numbers.
        ModelError
            For levels that are missing, unknown or not positive.
        """
        columns = self._columns(y, used, known)
        values = self._levels(levels)
        n, ny, _ = self._shapes
        N = len(columns[0])
        start = _pack(np.asarray(x0, dtype=float), np.asarray(P0, dtype=float))
        sweep = self._step.mapaccum("filter", N)
        logs = np.tile(np.log(values)[:, None], N)
        carried, kept, summary = (np.array(v) for v in sweep(start, *[c.T for c in columns], logs))
        if not np.all(np.isfinite(summary)):
            t = int(np.flatnonzero(~np.all(np.isfinite(summary), axis=0))[0])
            raise DataError(
                f"{self.model.name}: the filter fails at sample {t}; give the measurements a noise "
                "that is not zero, and a P0 that is positive definite"
            )
        filtered, P_filtered = _unpack(kept, n)
        ahead, P_ahead = _unpack(carried, n)
        F = np.array(self._slope.map(N)(filtered.T)).reshape(n, N, n).transpose(1, 0, 2)
        x, P = backward_pass(F[:-1], filtered, P_filtered, ahead[:-1], P_ahead[:-1])
        P = (P + P.transpose(0, 2, 1)) / 2
        return Smoothed(
            tuple(self.model.states),
            x,
            P,
            filtered,
            summary[1 : 1 + ny].T,
            np.sqrt(summary[1 + ny :].T),
            float(np.sum(summary[0])),
        )

    def fit(
        self,
        y: Array,
        start: Mapping[str, float],
        x0: Array,
        P0: Array,
        *,
        free: Sequence[str] | None = None,
        used: Array | None = None,
        known: Array | None = None,
    ) -> Levels:
        """The levels of the greatest likelihood.

        Parameters
        ----------
        start : name -> start value of those that are free, value of the others.
        free : which are estimated; None: all.
        Others as in `smooth`.

        Raises
        ------
        SolveError
            If no optimum is reached.
        """
        columns = self._columns(y, used, known)
        values = self._levels(start)
        names = tuple(self.model.levels)
        chosen = names if free is None else tuple(free)
        for name in chosen:
            if name not in names:
                raise ModelError(
                    f"{self.model.name}: no level {name!r} to estimate; there are "
                    f"{', '.join(names)}"
                )
        carry = _pack(np.asarray(x0, dtype=float), np.asarray(P0, dtype=float))
        criterion = _Likelihood(self._step, columns, np.log(values), carry, names, chosen)
        if not chosen:
            return Levels(dict(start), dict.fromkeys(names, 0.0), (), -criterion.value(np.empty(0)))
        at, information = self._climb(criterion, np.log([start[f] for f in chosen]))
        error = np.sqrt(np.diag(np.linalg.inv(information)))
        errors = dict.fromkeys(names, 0.0)
        errors |= {f: float(v) for f, v in zip(chosen, error, strict=True)}
        loose = tuple(f for f in chosen if errors[f] > 0.5)
        found = {n: float(v) for n, v in zip(names, values, strict=True)}
        found |= {f: float(np.exp(v)) for f, v in zip(chosen, at, strict=True)}
        return Levels(found, errors, loose, -criterion.value(at))

    def _climb(self, criterion: _Likelihood, z: Array) -> tuple[Array, Array]:
        """The optimum and the information there, by BFGS in the metric of the information.

        The scores' outer product is no Hessian away from the truth: along a level that is nearly
        zero Newton steps with it go round in circles. As a metric it serves.
        """
        from scipy.optimize import minimize

        for _ in range(4):  # again in a better metric, should the line search give up
            _, _, information = criterion.evaluate(z)
            root = np.linalg.inv(np.linalg.cholesky(information))  # root' root = inv(information)

            def scaled(w: Array, z: Array = z, root: Array = root) -> tuple[float, Array]:
                value, gradient, _ = criterion.evaluate(z + root.T @ w)
                return value, root @ gradient

            found = minimize(scaled, np.zeros(len(z)), jac=True, method="BFGS", tol=1e-4)
            z = z + root.T @ found.x
            gain = 0.5 * float(found.jac @ found.hess_inv @ found.jac)
            if gain < GAIN:
                return z, criterion.evaluate(z)[2]
        raise SolveError(
            f"{self.model.name}: the likelihood of the levels has no optimum that is found "
            f"(another step would gain {gain:.2g}; {found.message}); state some of the levels, or "
            "start nearer"
        )

    def _columns(self, y: Array, used: Array | None, known: Array | None) -> list[Array]:
        """Samples, which are used, and their known variances, each (N, ny)."""
        ny = self._shapes[1]
        y = np.asarray(y, dtype=float)
        if y.ndim != 2 or y.shape[1] != ny or len(y) < 2:
            raise DataError(
                f"{self.model.name}: y has shape {y.shape}; give (N, {ny}) for "
                f"{', '.join(self.model.outputs)}, N at least 2"
            )
        mask = np.ones(y.shape, dtype=bool) if used is None else np.asarray(used, dtype=bool)
        sd = np.zeros(ny) if known is None else np.asarray(known, dtype=float)
        if mask.shape != y.shape or sd.shape not in ((ny,), y.shape):
            raise DataError(
                f"{self.model.name}: used {mask.shape} and known {sd.shape} do not fit y "
                f"{y.shape}; give ({len(y)}, {ny}), or ({ny},) for known"
            )
        bad = np.argwhere(mask & ~np.isfinite(y))
        if len(bad):
            t, i = (int(v) for v in bad[0])
            raise DataError(
                f"{self.model.name}: {tuple(self.model.outputs)[i]} is not finite at sample {t}; "
                "mark it as missing with used[t, i] = False"
            )
        if not np.all(np.isfinite(sd)) or np.any(sd < 0):
            raise DataError(
                f"{self.model.name}: known standard deviations are to be finite and not negative; "
                "mark a sample without information as missing"
            )
        variance = np.broadcast_to(sd**2, y.shape)
        return [np.where(mask, y, 0.0), mask.astype(float), np.array(variance)]

    def _levels(self, levels: Mapping[str, float]) -> Array:
        names = tuple(self.model.levels)
        for name in (*names, *levels):
            if name not in levels or name not in names:
                what = "is missing" if name in names else "is unknown"
                raise ModelError(
                    f"{self.model.name}: level {name!r} {what}; give a value for each of "
                    f"{', '.join(names)}"
                )
            if not (np.isfinite(levels[name]) and levels[name] > 0):
                raise ModelError(
                    f"{self.model.name}: level {name} = {levels[name]:g}; give a positive number "
                    "(a very small one for none)"
                )
        return np.array([float(levels[n]) for n in names])


class _Likelihood:
    """Minus the log likelihood over the logarithms of the free levels; `FAR` keeps in place those
    that the record does not determine.
    """

    def __init__(
        self,
        step: Any,
        columns: list[Array],
        logs: Array,
        carry: Array,
        names: tuple[str, ...],
        free: tuple[str, ...],
    ) -> None:
        self._start = logs[[names.index(f) for f in free]]
        self._logs, self._chosen = logs, [names.index(f) for f in free]
        self._columns = [c.T for c in columns]
        self._carry = carry
        N = len(columns[0])
        self._value = step.mapaccum("filter", N)
        # The step with its sensitivities along: forward mode, compiled once and mapped. A few times
        # quicker than differentiating the mapped filter.
        n, m = len(carry), len(free)
        wide = ca.SX.sym("wide", n * (1 + m))
        own, rows = wide[:n], [ca.SX.sym(f"c{i}", step.size1_in(1 + i)) for i in range(4)]
        after, _, summary = step(own, *rows)
        moved, scores = [after], [summary[0]]
        for j, at in enumerate(self._chosen):
            seed = ca.DM.zeros(len(logs))
            seed[at] = 1.0
            tangent = ca.vertcat(wide[n * (j + 1) : n * (j + 2)], seed)
            push = ca.jtimes(ca.vertcat(after, summary[0]), ca.vertcat(own, rows[3]), tangent)
            moved.append(push[:n])
            scores.append(push[n])
        self._sensitive = ca.Function(
            "sensitive", [wide, *rows], [ca.vertcat(*moved), ca.vertcat(*scores)]
        ).mapaccum("sensitive", N)

    def _full(self, z: Array) -> Array:
        """Logarithms of all levels at every sample."""
        logs = self._logs.copy()
        logs[self._chosen] = z
        return np.tile(logs[:, None], self._columns[0].shape[1])

    def value(self, z: Array) -> float:
        summary = self._value(self._carry, *self._columns, self._full(z))[2]
        return -float(np.sum(np.array(summary)[0]))

    def evaluate(self, z: Array) -> tuple[float, Array, Array]:
        """Value, gradient and information, with exact derivatives."""
        wide = np.concatenate([self._carry, np.zeros(len(self._carry) * len(self._chosen))])
        found = np.array(self._sensitive(wide, *self._columns, self._full(z))[1])
        if not np.all(np.isfinite(found)):  # a line search goes back from here
            return np.inf, np.zeros(len(z)), np.eye(len(z))
        scores = found[1:].T
        off = (z - self._start) / FAR
        return (
            -float(np.sum(found[0])) + 0.5 * float(off @ off),
            -np.sum(scores, axis=0) + off / FAR,
            # The scores' outer product is the information at the truth (Berndt et al. 1974).
            scores.T @ scores + np.eye(len(z)) / FAR**2,
        )


def _step(model: StochasticModel) -> Any:
    """One sample: measurement update, then prediction.

    (carry, y, used, known, logs) -> (carry, kept, summary): carry and kept hold a state and its
    covariance, summary the log likelihood, the innovations and their variances.
    """
    n, ny = len(model.states), len(model.outputs)
    carry, y, used, known, logs = (
        ca.SX.sym(name, size)
        for name, size in (
            ("carry", n + n * n),
            ("y", ny),
            ("used", ny),
            ("known", ny),
            ("logs", len(model.levels)),
        )
    )
    levels = ca.exp(logs)
    R = model.variances(levels) + known
    x, P = carry[:n], ca.reshape(carry[n:], n, n)
    symbol = ca.SX.sym("s", n)
    h, f = model.measurement(symbol), model.transition(symbol)
    _require_columns(model, measurement=(h, ny), transition=(f, n), variances=(R, ny))
    measured = ca.Function("h", [symbol], [h, ca.jacobian(h, symbol)])
    log_likelihood, innovations, variances = ca.SX(0), [], []
    # One output after the other: as good as all at once for independent noise, and no inverse.
    for i, name in enumerate(model.outputs):
        at, slope = measured(x)
        c = slope[i, :]
        e = y[i] - at[i]
        if name in model.angles:
            e = e - 2 * np.pi * ca.floor((e + np.pi) / (2 * np.pi))
        S = c @ P @ c.T + R[i]
        S = ca.if_else(used[i] > 0, S, 1.0)
        e = ca.if_else(used[i] > 0, e, 0.0)
        K = used[i] * (P @ c.T) / S
        x = x + K * e
        keep = ca.SX.eye(n) - K @ c
        P = keep @ P @ keep.T + R[i] * (K @ K.T)  # Joseph's form stays positive
        log_likelihood -= 0.5 * used[i] * (ca.log(2 * np.pi * S) + e**2 / S)
        innovations.append(e)
        variances.append(S)
    moved = ca.Function("f", [symbol], [f, ca.jacobian(f, symbol)])
    after, F = moved(x)
    ahead = F @ P @ F.T + model.process(x, levels)
    ahead = (ahead + ahead.T) / 2
    return ca.Function(
        "step",
        [carry, y, used, known, logs],
        [
            ca.densify(ca.vertcat(after, ca.vec(ahead))),
            ca.densify(ca.vertcat(x, ca.vec(P))),
            ca.densify(ca.vertcat(log_likelihood, *innovations, *variances)),
        ],
    )


def _require_columns(model: StochasticModel, **returned: tuple[Any, int]) -> None:
    """Refuse functions of the model, name -> (value, rows), that return no column of that size."""
    for name, (value, rows) in returned.items():
        if value.shape != (rows, 1):
            raise ModelError(
                f"{model.name}: {name} returns {value.shape}; give a column of {rows} entries, "
                "ca.vertcat(...)"
            )


def backward_pass(
    F: Array, x: Array, P: Array, ahead: Array, P_ahead: Array, ridge: float = 0.0
) -> tuple[Array, Array]:
    """The recursion of Rauch, Tung and Striebel: smoothed states (N, n), covariances (N, n, n).

    Parameters
    ----------
    F : (N - 1, n, n), of the step from each sample to the next.
    x, P : filtered states and covariances, (N, n) and (N, n, n).
    ahead, P_ahead : predicted ones of the samples 1 .. N - 1.
    ridge : added to the diagonal of the predicted covariance with unit variances.
    """
    x, P = x.copy(), P.copy()
    # G = P F' inv(P ahead), all samples at once. Scaled: metres beside radians per second.
    size = np.sqrt(np.maximum(np.einsum("tii->ti", P_ahead), TINY))
    unit = P_ahead / (size[:, :, None] * size[:, None, :]) + ridge * np.eye(x.shape[1])
    right = (F @ P[:-1]) / size[:, :, None]
    G = (np.linalg.solve(unit, right) / size[:, :, None]).transpose(0, 2, 1)
    for t in range(len(x) - 2, -1, -1):
        x[t] += G[t] @ (x[t + 1] - ahead[t])
        P[t] += G[t] @ (P[t + 1] - P_ahead[t]) @ G[t].T
    return x, P


def _pack(x: Array, P: Array) -> Array:
    return np.concatenate([x.ravel(), P.ravel()])


def _unpack(columns: Array, n: int) -> tuple[Array, Array]:
    return columns[:n].T, columns[n:].T.reshape(-1, n, n)
