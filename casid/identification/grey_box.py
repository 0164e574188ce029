"""Prediction-error estimation of linear grey-box models with process and measurement noise.

Physical parameters, noise variances and initial states minimise the Gaussian prediction-error
criterion (2.36)-(2.38) of Linder (2017), an NLP whose criterion is one pass over the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.record import Record
from casid.errors import DataError, IdentifiabilityError, SolveError
from casid.estimation.estimate import Estimate, Estimated
from casid.estimation.estimate_builder import EstimateBuilder, origin_of, solver_evidence
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.fitted.from_prediction import predicting_model
from casid.estimation.local_rank import describe_null, local_rank
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Solution, not_converged
from casid.estimation.nlp.solver import Solver, as_solver
from casid.estimation.prediction_error.likelihood import CriterionOptions, PredictionError
from casid.identifiability.requirement import require_identifiable
from casid.linear.kalman import Predictor
from casid.linear.noisy_model import White
from casid.model.model import Model
from casid.presentation import Presented

SOURCES = (
    "L. Ljung, System Identification, 2nd ed., Prentice Hall 1999: prediction error",
    "B. D. O. Anderson, J. B. Moore, Optimal Filtering, Prentice Hall 1979: Kalman predictors",
    "C. F. van Loan, IEEE Trans. Autom. Control 23 (1978) 395-404: sampling of noise",
    "W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708: robust covariance",
    "A. Waechter, L. T. Biegler, Math. Program. 106 (2006) 25-57: Ipopt",
    "J. A. E. Andersson et al., Math. Program. Comput. 11 (2019) 1-36: CasADi",
)
"""Papers behind the method."""

_ROUGHLY = {"ipopt.tol": 1e-3, "ipopt.acceptable_iter": 0}
_PRECISELY = {  # beyond this tolerance the rounding error of a long sum is met
    "ipopt.tol": 1e-7,
    "ipopt.acceptable_tol": 1e-6,
    "ipopt.acceptable_iter": 2,
    "ipopt.mu_strategy": "monotone",
    "ipopt.mu_init": 1e-9,
}

ASSUMES = (
    "sandwich of Fisher information and scores ({lags} Newey-West lags): innovations of zero mean "
    "with a short correlation time compared with the record; noise on inputs taken as exact is not "
    "included"
)


@dataclass(frozen=True, slots=True, eq=False)
class Prediction(Presented):
    """A minimum of the prediction-error criterion: the estimate and the predictors it gives."""

    estimate: Estimate
    criterion: PredictionError
    solution: Solution
    log_likelihood: float

    def parameter(self, name: str) -> Estimated:
        """The parameter, noise variance or initial state called `name`, with its error."""
        return self.estimate.parameter(name)

    def references(self) -> tuple[str, ...]:
        """The papers behind the methods used."""
        return self.estimate.references()

    @property
    def model(self) -> FittedModel | None:
        """The model with its estimated values and its noise: simulates, predicts, can be saved."""
        return self.estimate.model

    def __getitem__(self, name: str) -> float:
        """The value of a parameter, noise variance or initial state."""
        return self.estimate[name]

    @property
    def noise(self) -> dict[str, tuple[float, float | None]]:
        """Standard deviation of each noise, and of that its standard error (None: known)."""
        out: dict[str, tuple[float, float | None]] = {}
        for w in self.criterion.noise:
            if w.is_known:
                out[w.where] = w.sd, None
                continue
            found = self.estimate.parameter(self.criterion.places.noise_name(w))
            sd = float(np.sqrt(found.value))
            error = found.std_error
            out[w.where] = sd, None if error is None or sd == 0.0 else error / (2 * sd)
        return out

    def predictor(self, experiment: int = 0) -> Predictor:
        """The steady-state predictor of one experiment, by its number from 0."""
        return self.criterion.predictor(self.solution.x, self._number(experiment))

    def innovations(self, experiment: int = 0) -> Array:
        """(N, ny) one-step prediction errors of one experiment, by its number from 0."""
        return self.criterion.innovations(self.solution.x, self._number(experiment))

    def _number(self, experiment: int) -> int:
        names = [d.name for d in self.criterion.data]
        if experiment not in range(len(names)):
            there = ", ".join(f"{i} ({name})" for i, name in enumerate(names))
            raise DataError(f"no experiment {experiment!r}; give the number of one, {there}")
        return int(experiment)

    @property
    def aic(self) -> float:
        """Akaike's criterion, 2 n - 2 log likelihood: comparable for the same outputs only."""
        return 2 * len(self.criterion.variables) - 2 * self.log_likelihood

    def __repr__(self) -> str:
        return f"<Prediction {self.estimate!r}>"


def minimize_prediction_error(
    model: Model | Problem,
    experiments: Sequence[Experiment | Record] | Experiment | Record,
    noise: Sequence[White] | White,
    *,
    solver: Solver | str | None = None,
    throw: bool = True,
    **options: Unpack[CriterionOptions],
) -> Prediction:
    """Estimate a linear or linearised model by its one-step prediction errors.

    Parameters
    ----------
    model : or the problem that holds it; its unknown inputs must be named in `noise`.
    experiments : records in the model's channels (SI), each with its known values; their sample
        times may differ.
    noise : the noise of every output, and the process noise, in a list; unknown sizes are
        estimated.
    solver : or its name; default ``Solver("ipopt")``.
    options : own, initial, start, rest, as `PredictionError`. The records stay near the rest.

    Raises
    ------
    ModelError
        For noise that is missing or misplaced, a start for what is no variable, or a model without
        a predictor.
    DataError
        For channels that are missing or incomplete, or a record too short.
    IdentifiabilityError
        For parameters or noise that are not identifiable from these records.
    SolveError
        If no optimum was found.

    Notes
    -----
    Consistent if the inputs are exact and the noise model is right; with an input measured in
    noise, or feedback through a direct term, it is not (Linder 2017, sections 3.5 and 7.3.2).
    The Hessian is the Fisher information: its steps are those of scoring. Where no size of noise is
    known nor in `start`, the search begins from the sizes given times one common factor, which the
    data determine; the page says so.
    """
    if isinstance(model, Problem):
        model = model.model
    given = [experiments] if isinstance(experiments, Experiment | Record) else list(experiments)
    chosen = [Experiment(e, {}, e.name) if isinstance(e, Record) else e for e in given]
    criterion = PredictionError(model, chosen, noise, **options)
    wanted = criterion.start  # as the user has it; the search may begin elsewhere
    _refuse_no_predictor(criterion)
    sources = _scaled_noise(criterion, options.get("start") or {})
    if sources is not None:
        criterion = PredictionError(model, chosen, sources, **options)
    _refuse_undetermined(criterion)
    solution = _minimum(criterion, solver)
    if throw and not solution.is_converged:
        raise not_converged(model.name, solution)
    estimate = _estimate(criterion, solution, wanted)
    structural = _structure(model, chosen, options.get("own", ()))
    estimate = replace(
        estimate, identifiability=replace(estimate.identifiability, structural=structural)
    )
    return Prediction(estimate, criterion, solution, criterion.log_likelihood(solution.x))


def _refuse_no_predictor(criterion: PredictionError) -> None:
    """Refuse a model without a predictor at the start, and records too short for the unknowns."""
    x0 = criterion.start
    for e in range(len(criterion.data)):
        criterion.predictor(x0, e)  # refuses with the reason where there is none
    if criterion.n_samples <= len(x0):
        raise DataError(
            f"{criterion.data[0].name}: {criterion.n_samples} samples cannot pay for {len(x0)} "
            "unknowns (parameters, noise and initial states); widen the window or give known values"
        )


def _scaled_noise(criterion: PredictionError, start: Mapping[str, float]) -> list[White] | None:
    """The noise sources with the best common factor, where no size is known nor in `start`.

    The gain does not change with a common factor on all variances: its optimum is known.
    """
    sources = criterion.noise
    given = {criterion.places.noise_name(w) for w in sources} & set(start)
    if given or any(w.is_known for w in sources):
        return None
    ratio = _quadratic(criterion, criterion.start) / criterion.n_samples
    if not (np.isfinite(ratio) and ratio > 0):
        return None
    return [replace(w, sd=w.sd * float(np.sqrt(ratio))) for w in sources]


def _refuse_undetermined(criterion: PredictionError) -> None:
    """Refuse unknowns without information at the start."""
    x0, name = criterion.start, criterion.model.name
    first = criterion.evaluate(x0)
    if not np.isfinite(first.value):
        raise SolveError(
            f"{name}: the prediction error is not finite at the start; change the start "
            "values or tighten the bounds"
        )
    scale = np.array([v.scale for v in criterion.variables])
    rank = local_rank(first.hessian, x0, criterion.names, scale)
    if not rank.is_full:
        raise IdentifiabilityError(
            f"{name}: rank {rank.rank} of {rank.unknowns} unknowns in "
            f"{', '.join(d.name for d in criterion.data)}; {describe_null(rank)}"
        )


def _minimum(criterion: PredictionError, solver: Solver | str | None) -> Solution:
    """The optimum, roughly first, then precisely from there.

    The curvature in a variance changes by orders of magnitude on the way.
    """
    solution = _solve(criterion, criterion.start, solver, _ROUGHLY)
    for _ in range(4):
        solution = _solve(criterion, solution.x, solver, _PRECISELY)
        if solution.is_converged:
            break
    return solution


def _structure(model: Model, experiments: Sequence[Experiment], own: Sequence[str]) -> str:
    """Identifiability without process noise; noise that drives the equations may add to it."""
    try:
        return require_identifiable(model, experiments, own=own, zero_unknown_inputs=True)
    except IdentifiabilityError as refusal:
        return f"without process noise: {refusal}"


def _quadratic(criterion: PredictionError, x: Array) -> float:
    """sum eps' F^-1 eps at `x`: as large as the number of samples where the noise is right."""
    total = 0.0
    for e in range(len(criterion.data)):
        for part in criterion.predicted(x, e):
            solved = np.linalg.solve(part.covariance, part.innovations[:, :, None])[:, :, 0]
            total += float(np.sum(part.innovations * solved))
    return total


def _solve(
    criterion: PredictionError, x: Array, solver: Solver | str | None, options: Mapping[str, Any]
) -> Solution:
    """Minimise from `x`; the constant of the criterion makes it half the sum of squares there.

    Convergence is judged relative to the criterion's value, which a density alone does not have.
    """
    criterion.offset = 0.0
    criterion.offset = 0.5 * _quadratic(criterion, x) - criterion.evaluate(x).value
    nlp = Nlp(criterion.model.name)
    for v in criterion.variables:
        nlp.variable(v.name, v.start, lower=v.lower, upper=v.upper, scale=v.scale)
    nlp.minimize(criterion)
    solver = as_solver(solver)
    if solver.name == "ipopt":
        solver = replace(solver, options={**options, **solver.options})
    return nlp.solve(solver, x.tolist(), throw=False, natural_scales=True)


def _unit(criterion: PredictionError, name: str, source: str) -> str:
    model = criterion.model
    if source in model.parameters:
        return model.parameters[source].unit
    if source in model.states and name.startswith(f"{source}(0)"):
        return model.states[source].unit
    if source in model.outputs:
        return f"({model.outputs[source][1]})^2"
    unit = model.inputs[source].unit if source in model.inputs else model.balances[source].unit
    return f"({unit})^2" + (" s" if name.startswith("psd") else "")


def _estimate(criterion: PredictionError, solution: Solution, wanted: Array) -> Estimate:
    """The estimate of a solution; `wanted` (n,) are the starts as they were given."""
    model, x = criterion.model, solution.x
    builder = EstimateBuilder(model.name, model, criterion.notes)
    rows = []
    for v, value, given in zip(criterion.variables, x.tolist(), wanted.tolist(), strict=True):
        note = "" if np.isclose(v.start, given, rtol=1e-3) else f"searched from {v.start:.2g}"
        unit = _unit(criterion, v.name, v.source)
        rows.append(Estimated(v.name, value, unit, False, None, given, note))
    uncertainty = builder.add_minimum(criterion, solution, rows, ASSUMES)
    for e, d in enumerate(criterion.data):
        error = criterion.innovations(x, e)
        builder.add_fits(d.name, criterion.outputs, d.y, error)
        for i, name in enumerate(criterion.outputs):
            where = f"{d.name}/{name}" if len(criterion.data) > 1 else name
            builder.add_whiteness(where, error[:, i], "whiteness of innovations")
    gain = "steady-state" if criterion.initial is None else "time-varying"
    return builder.build(
        f"prediction error, {gain} Kalman predictor; rms errors are one sample ahead",
        uncertainty,
        solver_evidence(solution),
        origin_of(criterion.experiments, SOURCES),
        model=predicting_model(criterion, x, uncertainty.covariance),
    )
