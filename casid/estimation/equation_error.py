"""Equation error: every balance as a linear regression in the unknown parameters, solved at once.

The inverse dynamic model of robotics (IDIM-LS; Gautier and Khalil 1990, Janot et al. 2014): states
and their derivatives are taken from filtered measurements instead of simulated, so that a balance

    0 = inertia dv/dt - sum(terms) = Phi(x, dx/dt, u) theta - Y(x, dx/dt, u)                  (1)

is linear in theta where theta enters linearly. No start, no iteration, no initial state, any
feedback; but the regressors carry the noise of the measurements, which biases the estimate towards
zero unless the filter removes it. A start for the simulation error, and a check on it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.data.problem import Problem
from casid.data.record import Experiment
from casid.errors import DataError, IdentifiabilityError, ModelError
from casid.estimation.covariance import sandwich
from casid.estimation.estimate import (
    Estimate,
    Estimated,
    Identifiability,
    SolverEvidence,
    Uncertainty,
)
from casid.estimation.estimate_builder import EstimateBuilder, origin_of
from casid.estimation.simulation.signals import Signals, signals_of
from casid.model.effects.effect import Effect
from casid.model.model import Model

SOURCES = (
    "M. Gautier, W. Khalil, Direct calculation of minimum set of inertial parameters of serial "
    "robots, IEEE Trans. Robotics and Automation 6 (1990) 368-373",
    "A. Janot, P.-O. Vandanjon, M. Gautier, A generic instrumental variable approach for "
    "industrial robot identification, IEEE Trans. Control Systems Technology 22 (2014) 132-145",
    "W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708: robust covariance",
)
"""Papers behind the method."""

ASSUMES = (
    "autocorrelation-robust sandwich (Newey-West, {lags} lags): balance errors of zero mean, not "
    "correlated with the regressors; noise that the filter leaves in the regressors is not included"
)


@dataclass(frozen=True, slots=True)
class Butterworth:
    """A low-pass run forward and backward: zero phase, twice the attenuation.

    Attributes
    ----------
    cutoff_hz : of one pass, -3 dB; five to ten times the fastest motion of interest.
    order : of one pass.
    """

    cutoff_hz: float
    order: int = 4

    def apply(self, signal: Array, Ts: float) -> Array:
        """Filter (N,) samples at sample time `Ts` [s].

        Raises
        ------
        DataError
            If the cutoff is not below the Nyquist frequency, or the record too short.
        """
        from scipy.signal import butter, filtfilt

        nyquist = 0.5 / Ts
        if not 0.0 < self.cutoff_hz < nyquist:
            raise DataError(
                f"cutoff_hz = {self.cutoff_hz:g} must lie between 0 and the Nyquist frequency "
                f"{nyquist:g} Hz; lower it, or pass prefilter=None"
            )
        if len(signal) <= 3 * (self.order + 1):
            raise DataError(
                f"{len(signal)} samples are too few for a filter of order {self.order}; "
                "widen the window or lower the order"
            )
        b, a = butter(self.order, self.cutoff_hz / nyquist)
        return np.asarray(filtfilt(b, a, signal))

    def __str__(self) -> str:
        return f"Butterworth {self.cutoff_hz:g} Hz, order {self.order}, forward and backward"


@dataclass(frozen=True, slots=True, eq=False)
class EquationError:
    """An estimate from the balances alone, with how well they close.

    Attributes
    ----------
    relative_error : record -> balance -> |Y - Phi theta| / |Y|, both decimated; Y is the part of
        the balance that is known (the drive's force, say).
    sample_time : of the regression [s].
    """

    model: Model
    estimate: Estimate
    relative_error: Mapping[str, Mapping[str, float]]
    sample_time: float

    def __getitem__(self, name: str) -> float:
        """The value of a parameter."""
        return self.estimate[name]

    @property
    def start(self) -> dict[str, float]:
        """Estimated values, inside their bounds: a start for `casid.identify`."""
        out = {}
        for row in self.estimate.parameters:
            if not row.known:
                p = self.model.parameters[row.name]
                out[row.name] = float(np.clip(row.value, p.lower, p.upper))
        return out

    def references(self) -> tuple[str, ...]:
        """The papers behind the method."""
        return SOURCES

    def __repr__(self) -> str:
        worst = max(v for by in self.relative_error.values() for v in by.values())
        return (
            f"<EquationError {self.estimate.problem}: {len(self.estimate.covariance_names)} free, "
            f"relative error {100 * worst:.2f} %>"
        )

    def __str__(self) -> str:
        lines = [str(self.estimate)]
        for record, by in self.relative_error.items():
            lines += [
                f"  {record}/{b}: relative error of the balance {100 * v:.2f} %"
                for b, v in by.items()
            ]
        return "\n".join(lines)


def equation_error(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    *,
    prefilter: Butterworth | None,
    decimate: int = 1,
    effects: Sequence[Effect] = (),
) -> EquationError:
    """Estimate the unknown parameters from the balances by linear least squares (QR).

    Parameters
    ----------
    experiments : records with every state measured, or the derivative of a measured state.
    prefilter : on every measured signal alike, before differentiating; None: no filter.
    decimate : one sample in so many is kept, of both sides of (1) alike, behind a zero-phase
        Chebyshev low-pass. Regressors are formed before it: the sign of a rate, say, must change
        where the rate did.
    effects : extend the model first; a regression needs no smooth friction, so
        `coulomb_friction(model, balance, speed=1e-9)` is the sign function.

    Returns
    -------
    EquationError
        With an `Estimate`; `rmse` and `nrmse_fit` there are of the balances.

    Raises
    ------
    ModelError
        If a balance is not linear in the unknown parameters, or the model delays, lags, clips or
        blends what an input does between its samples.
    DataError
        If a state cannot be had from the measurements, or samples are missing.
    IdentifiabilityError
        If these records cannot tell the parameters apart, naming those that go together.

    Notes
    -----
    Central differences have gain sin(w Ts)/(w Ts): 1.6 % low at a twentieth of the sample rate.
    With several balances, each is weighted by one over its own residual in a second pass.
    """
    name = problem.name
    model = problem.model if isinstance(problem, Problem) else problem
    for effect in effects:
        model = model.extend(effect)
    if isinstance(experiments, Experiment):
        experiments = [experiments]
    if not experiments:
        raise DataError("no record given; name at least one")
    if isinstance(decimate, bool) or int(decimate) != decimate or decimate < 1:
        raise DataError(f"decimate = {decimate!r} must be a whole number of at least 1")
    if model.stages:
        stage = model.stages[0]
        raise ModelError(
            f"{model.name}: channel {stage.channel} has a {stage.kind}, which a balance cannot "
            "show; leave that effect out, or use casid.identify"
        )
    for entry in model.inputs.values():
        if entry.ramp is not None:
            raise ModelError(
                f"{model.name}: what input {entry.name} does between its samples ({entry.ramp}) is "
                "nothing that a balance at the samples can show; leave that effect out, or use "
                "casid.identify"
            )
    data = [signals_of(model, e) for e in experiments]
    free = [p.name for p in model.parameters.values() if not p.is_known]
    free = [n for n in free if not all(n in d.known for d in data)]
    if not free:
        raise ModelError(f"{model.name}: every parameter is known; there is nothing to estimate")
    regression = _Regression(model, free)
    blocks = [
        [
            _Block(d.name, b, *_decimated(phi, y, decimate, _edge(d.Ts, prefilter, decimate)))
            for b, phi, y in zip(
                model.balances, *regression.sides(d, _states(model, d, prefilter)), strict=True
            )
        ]
        for d in data
    ]
    theta, weights = _solve(model, blocks, free)
    how = f"equation error, {prefilter or 'no prefilter'}, central differences" + (
        f", one sample in {decimate} kept" if decimate > 1 else ""
    )
    builder = EstimateBuilder(name, model, units={n: b.unit for n, b in model.balances.items()})
    solution = dict(zip(free, theta.tolist(), strict=True)), weights
    estimate, relative = _estimate(builder, how, experiments, blocks, solution)
    return EquationError(model, estimate, relative, data[0].Ts * decimate)


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """One balance in one record."""

    record: str
    balance: str
    phi: Array  # (N, d)
    y: Array  # (N,)


# -- signals --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    x: Array  # (N, nx)
    x_dot: Array  # (N, nx)
    u: Array  # (N, nu)


def _states(model: Model, d: Signals, prefilter: Butterworth | None) -> _Motion:
    """States and derivatives from filtered outputs, by central differences where not measured."""
    if not d.used.all():
        column, k = int(np.argmin(d.used.all(axis=0))), int(np.argmin(d.used.all(axis=1)))
        raise DataError(
            f"{d.name}: output {list(model.outputs)[column]} misses samples, the first at "
            f"t = {d.t[k]:g} s, and derivatives need all of them; cut the record there "
            "(record.between), or interpolate with record.filled"
        )
    if d.N < 5:
        raise DataError(f"{d.name}: {d.N} samples are too few to differentiate; widen the window")

    def smooth(signal: Array) -> Array:
        return signal if prefilter is None else prefilter.apply(signal, d.Ts)

    found: dict[str, Array] = {}
    for i, (expression, _) in enumerate(model.outputs.values()):
        for state in model.states:
            if ca.is_equal(ca.SX(expression), model.symbol(state), 1):
                found[state] = smooth(d.y[:, i])
    rate_of = {s: r for r in model.states if (s := model.position_of(r)) is not None}
    for _ in model.states:
        for position, rate in rate_of.items():
            if position in found and rate not in found:
                found[rate] = np.gradient(found[position], d.Ts)
    lacking = [s for s in model.states if s not in found]
    if lacking:
        raise DataError(
            f"{d.name}: state {lacking[0]} is neither an output of {model.name} nor the derivative "
            "of one, so its balance cannot be formed; measure it "
            f"(model.output(..., {lacking[0]}, ...)), or use casid.identify, which simulates it"
        )
    x = np.column_stack([found[s] for s in model.states])
    x_dot = np.column_stack(
        [found[rate_of[s]] if s in rate_of else np.gradient(found[s], d.Ts) for s in model.states]
    )
    u = d.u.copy()
    for j, entry in enumerate(model.inputs.values()):
        if entry.kind != "generated":
            u[:, j] = smooth(d.u[:, j])
    return _Motion(x, x_dot, u)


def _edge(Ts: float, prefilter: Butterworth | None, factor: int) -> int:
    """Samples of the decimated record that filters and differences spoil at either end.

    Five periods of every cutoff (a heuristic), as what lies outside the record is guessed there:
    on EMPS 50 ms of 25 s change the relative error from 4.65 % to 4.04 %.
    """
    spoilt = max(
        2 * Ts,
        5 / prefilter.cutoff_hz if prefilter is not None else 0.0,
        5 * factor * Ts if factor > 1 else 0.0,
    )
    return int(np.ceil(spoilt / (factor * Ts) - 1e-9))


def _decimated(phi: Array, y: Array, factor: int, edge: int) -> tuple[Array, Array]:
    """Both sides of a regression, low-passed and thinned alike, their ends cut off."""
    if len(y) < factor * (40 + 2 * edge):
        raise DataError(
            f"{len(y)} samples are too few: {edge * factor} at either end are spoilt by the filter "
            f"and one in {factor} is kept; widen the window, raise the cutoff or lower decimate"
        )
    if factor > 1:
        from scipy.signal import decimate

        both = decimate(np.column_stack([phi, y]), factor, axis=0, zero_phase=True)
        phi, y = both[:, :-1], both[:, -1]
    return phi[edge:-edge], y[edge:-edge]


# -- the regression -------------------------------------------------------------------------------


class _Regression:
    """(1) of every balance from the model's own expressions."""

    def __init__(self, model: Model, free: Sequence[str]) -> None:
        self.model, self.free = model, list(free)
        x = ca.vertcat(*[model.symbol(s) for s in model.states])
        x_dot = ca.vertcat(*[model.der(s) for s in model.states])
        u = ca.vertcat(*[model.symbol(i) for i in model.inputs])
        p = ca.vertcat(*[model.symbol(i) for i in model.parameters])
        residuals = ca.vertcat(
            *[
                b.inertia * model.der(b.rate) - ca.sum1(ca.vertcat(*b.terms))
                for b in model.balances.values()
            ]
        )
        residuals = _without_unknown_inputs(model, residuals)
        theta = ca.vertcat(*[model.symbol(n) for n in free])
        jacobian = ca.jacobian(residuals, theta)
        self._evaluate = ca.Function(
            "balance", [x, x_dot, u, p], [ca.densify(residuals), ca.densify(ca.vec(jacobian))]
        )
        self._refuse_nonlinear()

    def _parameters(self, known: Mapping[str, float]) -> Array:
        values = {
            q.name: q.value if q.value is not None else q.start
            for q in self.model.parameters.values()
        }
        values.update(known)
        return np.array([values[n] for n in self.model.parameters], dtype=float)

    def _refuse_nonlinear(self) -> None:
        """Compare the derivatives in theta at two values of theta, at random points.

        Judged by numbers, not by structure: a product of parameters may cancel, as the stiffness
        of gravity does in an indirect model.
        """
        model, free = self.model, self.free
        rng = np.random.default_rng(5)
        names = list(model.parameters)
        columns = [names.index(n) for n in free]
        nb = len(model.balances)
        for _ in range(3):
            args = [rng.uniform(0.3, 1.5, self._evaluate.numel_in(i)) for i in range(3)]
            p = self._parameters({})
            p[columns] = rng.uniform(0.3, 1.5, len(free))
            base = np.array(self._evaluate(*args, p)[1]).reshape(len(free), nb)
            for column, name in zip(columns, free, strict=True):
                moved = p.copy()
                moved[column] *= 1.37
                there = np.array(self._evaluate(*args, moved)[1]).reshape(len(free), nb)
                change = np.abs(there - base) > 1e-9 * (np.abs(base) + np.abs(there)) + 1e-12
                if change.any():
                    j, b = np.argwhere(change)[0]
                    other = free[int(j)]
                    pair = name if other == name else f"{other} times {name}"
                    raise ModelError(
                        f"{model.name}: balance {list(model.balances)[int(b)]!r} is not linear in "
                        f"its unknown parameters ({pair}): give one of them a known value, or "
                        "one name to the product, or use casid.identify"
                    )

    def sides(self, d: Signals, motion: _Motion) -> tuple[list[Array], list[Array]]:
        """Phi (N, d) and Y (N,) of every balance in one record."""
        p = self._parameters(d.known)
        at = self._evaluate(motion.x.T, motion.x_dot.T, motion.u.T, p)
        r, j = np.array(at[0]), np.array(at[1])
        nb, names = len(self.model.balances), list(self.model.parameters)
        jac = j.reshape(len(self.free), nb, d.N)
        start = np.array([p[names.index(n)] for n in self.free])
        unknown = np.array([n not in d.known for n in self.free])
        phis, ys = [], []
        for b in range(nb):
            full = jac[:, b, :].T
            phi = np.where(unknown, full, 0.0)
            ys.append(phi @ start - r[b])
            phis.append(phi)
        return phis, ys


def _without_unknown_inputs(model: Model, residuals: Any) -> Any:
    """Put what the eliminating outputs say in place of the inputs that nobody measured."""
    eliminated = [w for w, _, _ in model._eliminations]
    if not eliminated:
        return residuals
    w = ca.vertcat(*[model.symbol(name) for name in eliminated])
    rows = ca.vertcat(*[r for _, _, r in model._eliminations])
    matrix = ca.jacobian(rows, w)
    constant = ca.substitute(rows, w, ca.SX.zeros(w.numel()))
    return ca.substitute(residuals, w, -ca.solve(matrix, constant))


# -- solving --------------------------------------------------------------------------------------


def _solve(
    model: Model, blocks: Sequence[Sequence[_Block]], free: Sequence[str]
) -> tuple[Array, dict[str, float]]:
    """Least squares by QR, the balances weighted alike first and by their residuals then."""
    every = [b for row in blocks for b in row]
    names = list(dict.fromkeys(b.balance for b in every))
    sizes = {n: _size(np.concatenate([b.y for b in every if b.balance == n])) for n in names}
    if not any(sizes.values()):
        raise IdentifiabilityError(
            f"{model.name}: every term of the balances has an unknown factor, so they tell ratios "
            "only; give one parameter (an inertia, say) a known value"
        )
    largest = max(sizes.values())
    weights = {n: 1 / (s or largest) for n, s in sizes.items()}
    theta = _least_squares(model, every, weights, free)
    if len(names) > 1:
        left = {
            n: _size(np.concatenate([b.y - b.phi @ theta for b in every if b.balance == n]))
            for n in names
        }
        if all(v > 1e-12 * sizes[n] for n, v in left.items()):
            weights = {n: 1 / v for n, v in left.items()}
            theta = _least_squares(model, every, weights, free)
    return theta, weights


def _size(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _least_squares(
    model: Model, blocks: Sequence[_Block], weights: Mapping[str, float], free: Sequence[str]
) -> Array:
    from scipy.linalg import qr, solve_triangular

    phi = np.concatenate([weights[b.balance] * b.phi for b in blocks])
    y = np.concatenate([weights[b.balance] * b.y for b in blocks])
    if not (np.isfinite(phi).all() and np.isfinite(y).all()):
        raise DataError(
            f"{blocks[0].record}: the balances are not finite; look for a division by zero in "
            f"{model.name}"
        )
    if len(y) <= len(free):
        raise DataError(
            f"{blocks[0].record}: {len(y)} samples cannot pay for {len(free)} parameters; "
            "widen the window or decimate less"
        )
    length = np.linalg.norm(phi, axis=0)
    still = [n for n, s in zip(free, length, strict=True) if s == 0.0]
    if still:
        raise IdentifiabilityError(
            f"{model.name}: {', '.join(still)} moves no balance in "
            f"{', '.join(dict.fromkeys(b.record for b in blocks))}: give it a known value, or "
            "record an experiment that excites it"
        )
    scaled = phi / length
    _, singular, vt = np.linalg.svd(scaled, full_matrices=False)
    if singular[-1] < 1e-9 * singular[0]:
        together = [n for n, v in zip(free, vt[-1], strict=True) if abs(v) > 1e-3]
        raise IdentifiabilityError(
            f"{model.name}: the balances cannot tell {', '.join(together)} apart in these records: "
            "give one of them a known value"
        )
    q, r = qr(scaled, mode="economic")
    return np.asarray(solve_triangular(r, q.T @ y) / length)


def _estimate(
    builder: EstimateBuilder,
    method: str,
    experiments: Sequence[Experiment],
    blocks: Sequence[Sequence[_Block]],
    solution: tuple[Mapping[str, float], Mapping[str, float]],
) -> tuple[Estimate, dict[str, dict[str, float]]]:
    """The `Estimate`, with the relative error by record and balance.

    `solution` is the values by parameter and the weights by balance.
    """
    values, weights = solution
    free, theta = list(values), np.array(list(values.values()))
    relative: dict[str, dict[str, float]] = {}
    scores_of = []  # per sample, the balances of a sample added: they share that sample's noise
    for row in blocks:
        scores = np.zeros_like(row[0].phi)
        for b in row:
            residual = b.y - b.phi @ theta
            size = _size(residual)
            nrmse = 100 * (1 - size / (float(np.std(b.y)) or 1.0))
            builder.add_fit(b.record, b.balance, size, nrmse)
            relative.setdefault(b.record, {})[b.balance] = size / (_size(b.y) or 1.0)
            where = f"{b.record}/{b.balance}" if len(blocks) > 1 else b.balance
            builder.add_whiteness(where, residual, remark="")
            scores += weights[b.balance] ** 2 * b.phi * residual[:, None]
        scores_of.append(scores)
    scores = np.concatenate(scores_of)
    phi = np.concatenate([weights[b.balance] * b.phi for row in blocks for b in row])
    length = np.linalg.norm(phi, axis=0)
    covariance, lags = sandwich(phi.T @ phi, scores, np.ones(len(theta), dtype=bool))
    _add_rows(builder, values, dict(zip(free, np.sqrt(np.diag(covariance)).tolist(), strict=True)))
    builder.identifiability = Identifiability(
        len(free), len(free), float(np.linalg.svd(phi / length, compute_uv=False)[-1])
    )
    size = float(np.linalg.norm([weights[b.balance] * _size(b.y) for row in blocks for b in row]))
    gradient = float(np.max(np.abs(scores.sum(axis=0)) / length)) / (size or 1.0)
    estimate = builder.build(
        method,
        Uncertainty(tuple(free), covariance, ASSUMES.format(lags=lags)),
        SolverEvidence("solved by QR", True, 1, gradient),
        origin_of(experiments, SOURCES),
    )
    return estimate, relative


def _add_rows(
    builder: EstimateBuilder, values: Mapping[str, float], errors: Mapping[str, float]
) -> None:
    """Known and estimated parameters in the model's order; bounds do not act on a regression."""
    for p in builder.model.parameters.values():
        if p.name not in values:
            if p.value is not None:
                builder.add(Estimated(p.name, p.value, p.unit, True))
            continue
        value, note = values[p.name], ""
        if not p.lower <= value <= p.upper:
            note = f"outside its bounds [{p.lower:g}, {p.upper:g}]"
            builder.warnings.append(
                f"{p.name} = {value:.4g} lies {note}, which do not act here: filter more noise, "
                "extend the model, or use casid.identify"
            )
        builder.add(Estimated(p.name, value, p.unit, False, errors[p.name], None, note))
