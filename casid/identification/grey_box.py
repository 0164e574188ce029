"""Prediction-error estimation of linear grey-box models with process and measurement noise.

Physical parameters, noise variances and initial states minimise the Gaussian prediction-error
criterion (2.36)-(2.38) of Linder (2017), an NLP whose criterion is one pass over the data.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, Unpack

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.record import Record
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError
from casid.estimation.covariance import sandwich
from casid.estimation.estimate import Estimate, Estimated
from casid.estimation.estimate_builder import EstimateBuilder, origin_of, solver_evidence
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.fitted.from_prediction import predicting_model
from casid.estimation.local_rank import describe_null, local_rank
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Solution, not_converged
from casid.estimation.nlp.solver import Solver, as_solver
from casid.estimation.noise.forces import unit_of_force
from casid.estimation.prediction_error.extended_likelihood import (
    ExtendedOptions,
    ExtendedPredictionError,
)
from casid.estimation.prediction_error.likelihood import CriterionOptions, PredictionError
from casid.estimation.simulation.thresholds import STEPS
from casid.identifiability.requirement import require_identifiable
from casid.linear.filtering.kalman import Predictor
from casid.linear.filtering.noisy_model import White
from casid.model.model import Model
from casid.model.units import unit_quotient
from casid.presentation import Presented
from casid.time_limit import seconds_left

SOURCES = (
    "L. Ljung, System Identification, 2nd ed., Prentice Hall 1999: prediction error",
    "B. D. O. Anderson, J. B. Moore, Optimal Filtering, Prentice Hall 1979: Kalman predictors",
    "C. F. van Loan, IEEE Trans. Autom. Control 23 (1978) 395-404: sampling of noise",
    "W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708: robust covariance",
    "A. Waechter, L. T. Biegler, Math. Program. 106 (2006) 25-57: Ipopt",
    "J. A. E. Andersson et al., Math. Program. Comput. 11 (2019) 1-36: CasADi",
)
"""Papers behind the method."""

EXTENDED_SOURCES = (
    "N. R. Kristensen, H. Madsen, S. B. Jorgensen, Automatica 40 (2004) 225-237: estimation by an "
    "extended Kalman filter",
    "A. H. Jazwinski, Stochastic Processes and Filtering Theory, Academic Press 1970",
)
"""The same where the model is nonlinear."""

Criterion: TypeAlias = PredictionError | ExtendedPredictionError

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
    criterion: Criterion
    solution: Solution
    log_likelihood: float

    @property
    def x(self) -> Array:
        """(n,) the unknowns at the minimum."""
        return self.solution.x

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
        """The steady-state predictor of one experiment, by its number from 0.

        Raises
        ------
        ModelError
            After an extended Kalman filter, whose gain has no steady state.
        """
        if not isinstance(self.criterion, PredictionError):
            raise ModelError(
                f"{self.criterion.model.name}: the gain of an extended Kalman filter has no steady "
                "state; predict with the fitted model, model.predict(record, horizon)"
            )
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
    structural: str | None = None,
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
    structural : what the equations determine, where that is known; default: it is found.
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

    def criterion_of(sources: Sequence[White] | White) -> Criterion:
        return PredictionError(model, chosen, sources, **options)

    start = options.get("start") or {}
    return _minimised(criterion_of, noise, start, solver, throw=throw, structural=structural)


def minimize_extended_prediction_error(
    model: Model,
    experiments: Sequence[Experiment],
    noise: Sequence[White] | White,
    *,
    solver: Solver | str | None = None,
    throw: bool = True,
    structural: str | None = None,
    **options: Unpack[ExtendedOptions],
) -> Prediction:
    """Estimate a nonlinear model by the prediction errors of an extended Kalman filter.

    Parameters
    ----------
    model, experiments, noise, solver, structural : as for `minimize_prediction_error`; no noise is
        held, and outputs may miss samples.
    options : own, initial, start, substeps, as `ExtendedPredictionError`. By default substeps are
        doubled until they no longer matter.

    Raises
    ------
    ModelError, DataError, IdentifiabilityError, SolveError : as `minimize_prediction_error`.

    Notes
    -----
    The likelihood where the model is linear; otherwise of the motion linearised about the predicted
    states, which biases where these are uncertain on the scale of the curvature.
    """
    steps, start = options.get("substeps"), dict(options.get("start") or {})
    options["substeps"] = steps or 1

    def criterion_of(sources: Sequence[White] | White) -> ExtendedPredictionError:
        return ExtendedPredictionError(model, experiments, sources, **options)

    while steps is None and options["substeps"] < STEPS.most:
        coarse, fine = criterion_of(noise), _finer(criterion_of(noise))
        both = coarse.value(coarse.start), fine.value(fine.start)
        if not moves_likelihood(*both, coarse.n_samples):
            break
        options["substeps"] *= 2
    wanted: Array | None = None
    while True:
        found = _minimised(
            criterion_of, noise, start, solver, throw=False, structural=structural, wanted=wanted
        )
        criterion, solution = found.criterion, found.solution
        assert isinstance(criterion, ExtendedPredictionError)
        is_finest = steps is not None or criterion.substeps >= STEPS.most or seconds_left() <= 0.0
        if is_finest or not _filter_steps_matter(criterion, solution):
            break
        options["substeps"] *= 2
        if solution.is_converged:  # a search that unstable steps led astray begins anew
            wanted = criterion.start if wanted is None else wanted
            start = dict(zip(criterion.names, solution.x.tolist(), strict=True))
            options["start"] = start
    if throw and not solution.is_converged:
        raise not_converged(criterion.model.name, solution)
    return found


def _finer(c: ExtendedPredictionError) -> ExtendedPredictionError:
    """The criterion with half the step."""
    return ExtendedPredictionError(
        c.model,
        c.experiments,
        c.noise,
        own=c.own,
        initial=c.initial,
        start=dict(zip(c.names, c.start.tolist(), strict=True)),
        substeps=2 * c.substeps,
    )


def _filter_steps_matter(c: ExtendedPredictionError, found: Solution) -> bool:
    """True if halving the step would move the minimum by a share of its standard errors.

    Where the search ended short of a minimum, if it would change the likelihood there.
    """
    fine, x = _finer(c), found.x
    if not found.is_converged:
        return moves_likelihood(c.value(x), fine.value(x), c.n_samples)
    at = fine.evaluate(x)
    if not np.isfinite(at.value):
        return False
    before = c.evaluate(x).gradient  # of variables at a bound, and what the solver left
    return moves_minimum(at.gradient - before, at.hessian)


def _minimised(
    criterion_of: Callable[[Sequence[White] | White], Criterion],
    noise: Sequence[White] | White,
    start: Mapping[str, float],
    solver: Solver | str | None,
    *,
    throw: bool,
    structural: str | None,
    wanted: Array | None = None,
) -> Prediction:
    """The minimum of the criterion that a noise gives; `wanted` (n,) are starts to be shown."""
    criterion = criterion_of(noise)
    is_first = wanted is None  # of several with finer steps
    if wanted is None:
        wanted = criterion.start  # as the user has it; the search may begin elsewhere
    _refuse_no_predictor(criterion)
    sources = _scaled_noise(criterion, start)
    if sources is not None:
        criterion = criterion_of(sources)
    _refuse_undetermined(criterion)
    solution = _minimum(criterion, solver)
    if throw and not solution.is_converged:
        raise not_converged(criterion.model.name, solution)
    estimate = _estimate(criterion, solution, wanted, is_first=is_first)
    if structural is None:
        structural = _structure(criterion.model, criterion.experiments, criterion.own)
    estimate = replace(
        estimate, identifiability=replace(estimate.identifiability, structural=structural)
    )
    return Prediction(estimate, criterion, solution, criterion.log_likelihood(solution.x))


def _refuse_no_predictor(criterion: Criterion) -> None:
    """Refuse a model without a predictor at the start, and records too short for the unknowns."""
    x0 = criterion.start
    if isinstance(criterion, PredictionError):
        for e in range(len(criterion.data)):
            criterion.predictor(x0, e)  # refuses with the reason where there is none
    if criterion.n_samples <= len(x0):
        raise DataError(
            f"{criterion.data[0].name}: {criterion.n_samples} samples are too few for {len(x0)} "
            "unknowns (parameters, noise and initial states); widen the window or give known values"
        )


def _scaled_noise(criterion: Criterion, start: Mapping[str, float]) -> list[White] | None:
    """The noise sources with the best common factor, where no size is known nor in `start`.

    The gain does not change with a common factor on all variances: its optimum is known.
    """
    sources = criterion.noise
    given = {criterion.places.noise_name(w) for w in sources} & set(start)
    if given or any(w.is_known for w in sources):
        return None
    ratio = criterion.quadratic(criterion.start) / criterion.n_samples
    if not (np.isfinite(ratio) and ratio > 0):
        return None
    return [replace(w, sd=w.sd * float(np.sqrt(ratio))) for w in sources]


def _refuse_undetermined(criterion: Criterion) -> None:
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


def _minimum(criterion: Criterion, solver: Solver | str | None) -> Solution:
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


def _solve(
    criterion: Criterion, x: Array, solver: Solver | str | None, options: Mapping[str, Any]
) -> Solution:
    """Minimise from `x`; the constant of the criterion makes it half the sum of squares there.

    Convergence is judged relative to the criterion's value, which a density alone does not have.
    """
    criterion.offset = 0.0
    criterion.offset = 0.5 * criterion.quadratic(x) - criterion.evaluate(x).value
    nlp = Nlp(criterion.model.name)
    for v in criterion.variables:
        nlp.variable(v.name, v.start, lower=v.lower, upper=v.upper, scale=v.scale)
    nlp.minimize(criterion)
    solver = as_solver(solver)
    if solver.name == "ipopt":
        solver = replace(solver, options={**options, **solver.options})
    return nlp.solve(solver, x.tolist(), throw=False, natural_scales=True)


def _unit(criterion: Criterion, name: str, source: str) -> str:
    model = criterion.model
    if source in model.parameters:
        return model.parameters[source].unit
    if source in model.states and name.startswith(f"{source}(0)"):
        return model.states[source].unit
    own = model.outputs[source][1] if source in model.outputs else unit_of_force(model, source)
    squared = unit_quotient("1", own, -2)
    return unit_quotient(squared, "s", -1) if name.startswith("psd") else squared


def _estimate(
    criterion: Criterion, solution: Solution, wanted: Array, *, is_first: bool
) -> Estimate:
    """The estimate of a solution; `wanted` (n,) are the starts as they were given.

    Of the first search, a note says where it began from another one.
    """
    model, x = criterion.model, solution.x
    builder = EstimateBuilder(model.name, model, criterion.notes)
    rows = []
    for v, value, given in zip(criterion.variables, x.tolist(), wanted.tolist(), strict=True):
        is_own = not is_first or np.isclose(v.start, given, rtol=1e-3)
        note = "" if is_own else f"searched from {v.start:.2g}"
        unit = _unit(criterion, v.name, v.source)
        rows.append(Estimated(v.name, value, unit, False, None, given, note))
    scores, tied = criterion.scores(x), solution.constraint_jacobian
    covariance, lags = sandwich(solution.hessian, scores, solution.is_free, tied)
    uncertainty = builder.add_minimum(
        criterion, solution, rows, covariance, ASSUMES.format(lags=lags)
    )
    for e, d in enumerate(criterion.data):
        error = criterion.innovations(x, e)
        builder.add_fits(d.name, criterion.outputs, np.where(d.used, d.y, np.nan), error)
        for i, name in enumerate(criterion.outputs):
            where = f"{d.name}/{name}" if len(criterion.data) > 1 else name
            found = error[d.used[:, i], i]
            builder.add_whiteness(where, found, "whiteness of innovations")
    is_extended = isinstance(criterion, ExtendedPredictionError)
    sources = (*EXTENDED_SOURCES, *SOURCES) if is_extended else SOURCES
    return builder.build(
        f"prediction error, {_gain(criterion)}; rms errors are one sample ahead",
        uncertainty,
        solver_evidence(solution),
        origin_of(criterion.experiments, sources),
        measured_by="Predictions one sample ahead against the measured outputs",
        model=predicting_model(criterion, x, uncertainty.covariance),
    )


def _gain(criterion: Criterion) -> str:
    """The predictor in words."""
    if isinstance(criterion, ExtendedPredictionError):
        return "extended Kalman filter"
    gain = "steady-state" if criterion.initial is None else "time-varying"
    return f"{gain} Kalman predictor"


def moves_likelihood(coarse: float, fine: float, samples: int) -> bool:
    """True if half the step changes the logarithm of a likelihood of so many samples too much.

    The coarse one overflowing counts as a change, both of them as none: finer is no better.
    """
    if np.isfinite(fine) and not np.isfinite(coarse):
        return True
    return bool(abs(fine - coarse) > STEPS.filter_at_start * samples)


def moves_minimum(gradient: Array, hessian: Array) -> bool:
    """True if half the step moves a minimum by too much of its standard errors.

    Parameters
    ----------
    gradient : (n,) what half the step adds to that of minus the log likelihood at the minimum.
    hessian : (n, n) Fisher information there.
    """
    length = gradient @ np.linalg.pinv(hessian, rcond=1e-12) @ gradient
    return bool(np.sqrt(abs(length)) > STEPS.filter_at_end)
