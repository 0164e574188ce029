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

import numpy as np

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.errors import DataError, ModelError
from casid.estimation.balance_regression import (
    BalanceRegression,
    Block,
    size_of,
    weighted_least_squares,
)
from casid.estimation.covariance import sandwich
from casid.estimation.estimate import (
    Estimate,
    Estimated,
    Identifiability,
    SolverEvidence,
    Uncertainty,
)
from casid.estimation.estimate_builder import EstimateBuilder, origin_of
from casid.estimation.fitted.from_fit import unsimulated_model
from casid.estimation.measured_motion import Butterworth, decimated, filter_edge, motion_of
from casid.estimation.simulation.records.signals import signals_of
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


@dataclass(frozen=True, slots=True, eq=False)
class EquationError:
    """An estimate from the balances alone, with how well they close.

    Attributes
    ----------
    relative_error : record -> balance -> |Y - Phi theta| / |Y|, both decimated; Y is the part of
        the balance that is known (such as the drive's force).
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
        Chebyshev low-pass. Regressors are formed before it: the sign of a rate must
        change where the rate did.
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
        If a state is not determined by the measurements, or samples are missing.
    IdentifiabilityError
        If parameters are not separately identifiable from these records; names them.

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
    _refuse_dynamics(model)
    data = [signals_of(model, e) for e in experiments]
    free = [p.name for p in model.parameters.values() if not p.is_known]
    free = [n for n in free if not all(n in d.known for d in data)]
    if not free:
        raise ModelError(f"{model.name}: every parameter is known; there is nothing to estimate")
    regression = BalanceRegression(model, free)
    blocks = []
    for d in data:
        sides = regression.sides(d, motion_of(model, d, prefilter))
        edge = filter_edge(d.Ts, prefilter, decimate)
        blocks.append(
            [
                Block(d.name, balance, *decimated(phi, y, decimate, edge))
                for balance, phi, y in zip(model.balances, *sides, strict=True)
            ]
        )
    theta, weights = weighted_least_squares(model, blocks, free)
    how = f"equation error, {prefilter or 'no prefilter'}, central differences" + (
        f", one sample in {decimate} kept" if decimate > 1 else ""
    )
    builder = EstimateBuilder(name, model, units={n: b.unit for n, b in model.balances.items()})
    solution = dict(zip(free, theta.tolist(), strict=True)), weights
    estimate, relative = _estimate(builder, how, experiments, blocks, solution)
    return EquationError(model, estimate, relative, data[0].Ts * decimate)


def _refuse_dynamics(model: Model) -> None:
    """Refuse effects between channel and balance, which no balance at a sample shows."""
    if model.stages:
        stage = model.stages[0]
        raise ModelError(
            f"{model.name}: channel {stage.channel} has a {stage.kind}, which a balance cannot "
            "show; leave that effect out, or use casid.identify"
        )
    for entry in model.inputs.values():
        for blend in entry.blends:
            raise ModelError(
                f"{model.name}: what input {entry.name} does between its samples "
                f"({blend.parameter}) is nothing that a balance at the samples can show; leave "
                "that effect out, or use casid.identify"
            )


def _estimate(
    builder: EstimateBuilder,
    method: str,
    experiments: Sequence[Experiment],
    blocks: Sequence[Sequence[Block]],
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
            size = size_of(residual)
            nrmse = 100 * (1 - size / (float(np.std(b.y)) or 1.0))
            builder.add_fit(b.record, b.balance, size, nrmse)
            relative.setdefault(b.record, {})[b.balance] = size / (size_of(b.y) or 1.0)
            where = f"{b.record}/{b.balance}" if len(blocks) > 1 else b.balance
            builder.add_whiteness(where, residual, coloured="")
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
    size = float(np.linalg.norm([weights[b.balance] * size_of(b.y) for row in blocks for b in row]))
    gradient = float(np.max(np.abs(scores.sum(axis=0)) / length)) / (size or 1.0)
    estimate = builder.build(
        method,
        Uncertainty(tuple(free), covariance, ASSUMES.format(lags=lags)),
        SolverEvidence("solved by QR", True, 1, gradient),
        origin_of(experiments, SOURCES),
        model=unsimulated_model(
            builder.problem,
            builder.model,
            values,
            [(e.name, e.record.Ts, e.known) for e in experiments],
            (tuple(free), covariance),
        ),
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
