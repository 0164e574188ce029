"""The search of the least prediction error of a model with disturbances.

It begins at the best of a grid of their sizes, frequencies and widths.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.errors import CasidError, IdentifiabilityError, OutOfTimeError, SolveError
from casid.estimation.disturbances.disturbance_estimation import with_disturbance_spectra
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.prediction_error.disturbances import (
    Disturbance,
    rest_of,
    stationary_spread,
    undisturbed,
    with_disturbances,
)
from casid.estimation.prediction_error.extended_likelihood import (
    ExtendedOptions,
    ExtendedPredictionError,
)
from casid.estimation.prediction_error.likelihood import PredictionError
from casid.estimation.simulation.fit import FitSettings, fit_model, one_over_errors
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import Signals, signals_of
from casid.identification.grey_box import (
    Criterion,
    Prediction,
    minimize_extended_prediction_error,
    minimize_prediction_error,
)
from casid.identification.task import Task
from casid.identification.unstable import fit_in_segments, unstable_in_windows
from casid.linear.filtering.noisy_model import White
from casid.model.model import Model
from casid.time_limit import require_time, seconds_left

SIZES = np.logspace(-1.5, 1.5, 7)
"""Of a disturbance, times the size that its share of the residual suggests."""
ALL_SIZES = np.logspace(-4, 4, 17)
"""The same, where no simulation suggests any."""
CORNERS = 8
"""Frequencies, even in the logarithm, that the search looks at."""
WIDTHS = (0.05, 0.3)
"""Of a peak."""
HIGHEST = 2.5
"""Corner or frequency times the sample time, at most: a Runge-Kutta step is stable up to 2.78."""
OFF_BOUND = 0.05
"""Of its size, that a start is off a bound at least."""
AGAIN = (1.0, 2.0, 0.5, 4.0)
"""Times the best size of that grid, from where the search is begun until it converges."""
SHARES = (1.0, 0.1)
"""Of the residual that the sensors may have."""


@dataclass(frozen=True, slots=True)
class Disturbed:
    """A minimum of the prediction error with some disturbances."""

    disturbances: Sequence[Disturbance]
    program: _Program
    prediction: Prediction


def minimum_with(
    task: Task, disturbances: Sequence[Disturbance], *, is_near: bool = False
) -> Disturbed:
    """The minimum found from least squares, and the best sizes and frequencies of a grid.

    Parameters
    ----------
    is_near : `task.start` is near the minimum: no fit without disturbances comes first.
    """
    experiments = task.split.fitted
    program = _Program(task.problem.model, experiments, disturbances, task.settings)
    alone = without(task, disturbances)
    problem, begin, fit = alone.problem, dict(task.start), None
    if not is_near:
        task.say("fit the model without disturbances")
        fit, values = _simulated(alone)
        begin = {**values, **begin}
    errors = _spreads(problem.model, experiments) if fit is None else 1 / one_over_errors(fit)
    noise = [White(n, float(e)) for n, e in zip(program.model.outputs, errors, strict=True)]
    noise += program.sources
    first = program.criterion(noise, 1 if fit is None else fit.criterion.substeps)
    begin = _off_bounds(first, fit.values if fit else {}) | begin
    for d in disturbances:
        task.say(f"search the spectrum of the disturbance in {d.place}")
        begin |= _best_start(first, begin, d, *_grid(problem, fit, d, first.data))
    require_time(f"the prediction error of {problem.name}")
    task.say("minimise the prediction error")
    found = program.minimum_from(noise, begin, [d.size for d in disturbances])
    return Disturbed(disturbances, program, found)


def without(task: Task, disturbances: Sequence[Disturbance]) -> Task:
    """The same for the model without disturbances."""
    model = undisturbed(task.problem.model, disturbances)
    return replace(task, problem=replace(task.problem, model=model))


def _simulated(task: Task) -> tuple[Fit | None, dict[str, float]]:
    """Least squares of the simulation error, and values to begin from where there is none.

    No fit where a simulation says nothing or diverges.
    """
    once = replace(task, settings=replace(task.settings, starts=1), say=lambda _: None)
    try:
        unstable = unstable_in_windows(once)
        if unstable is not None:
            if unstable.is_disturbed:
                return None, unstable.values
            in_segments = fit_in_segments(once, unstable)
            if in_segments is not None:
                return in_segments, {}
        fit = fit_model(
            task.problem.model,
            task.split.fitted,
            task.settings,
            start=task.start,
            check_rank=False,
            throw=False,
        )
    except OutOfTimeError:
        raise
    except (IdentifiabilityError, SolveError):
        return None, {}
    return (fit if np.all(np.isfinite(fit.x)) and np.isfinite(fit.solution.value) else None), {}


def _off_bounds(criterion: Criterion, values: Mapping[str, float]) -> dict[str, float]:
    """The values with none at a bound, where least squares in a disturbance may have put them.

    A search that begins there has no size to scale by.
    """
    out = {n: v for n, v in values.items() if n in criterion.names}
    for v in criterion.variables:
        if v.name in out:
            off = OFF_BOUND * min(v.scale, v.upper - v.lower)
            out[v.name] = float(np.clip(out[v.name], v.lower + off, v.upper - off))
    return out


def _spreads(model: Model, experiments: Sequence[Experiment]) -> Array:
    """(ny,) standard deviations of what was recorded of the outputs."""
    data = [signals_of(model, e) for e in experiments]
    return np.array(
        [
            float(np.std(np.concatenate([d.y[d.used[:, i], i] for d in data]))) or 1.0
            for i in range(len(model.outputs))
        ]
    )


class _Program:
    """The criterion that a model with disturbances has, and its minimum.

    Of the steady-state predictor of a linear model and records without gaps, or else of an extended
    Kalman filter.
    """

    def __init__(
        self,
        model: Model,
        experiments: Sequence[Experiment],
        disturbances: Sequence[Disturbance],
        settings: FitSettings,
    ) -> None:
        self.experiments, self.settings = experiments, settings
        self.rest = rest_of(undisturbed(model, disturbances))
        self.model, self.sources = with_disturbances(model, disturbances)
        gaps = any(n in e.record.missing for e in experiments for n in model.outputs)
        self.is_extended = self.rest is None or gaps
        self.spread = stationary_spread(self.model, disturbances)
        self._bound_frequencies(disturbances)

    def _bound_frequencies(self, disturbances: Sequence[Disturbance]) -> None:
        """Keep spectra to what samples show: above that a disturbance is white, and steps break."""
        highest = HIGHEST / min(e.record.Ts for e in self.experiments)
        for d in disturbances:
            if d.spectrum != "white":
                p = self.model.parameters[d.frequency]
                start, lower = min(p.start, highest), min(p.lower, p.lower * highest)
                self.model.parameters[d.frequency] = replace(
                    p, start=start, lower=lower, upper=highest
                )

    def criterion(self, noise: Sequence[White], substeps: int) -> Criterion:
        """The criterion from the starts of the model."""
        own = self.settings.own
        if not self.is_extended:
            return PredictionError(self.model, self.experiments, noise, own=own, rest=self.rest)
        return ExtendedPredictionError(
            self.model, self.experiments, noise, own=own, initial=self.spread, substeps=substeps
        )

    def minimum_from(
        self, noise: Sequence[White], start: Mapping[str, float], sizes: Sequence[str]
    ) -> Prediction:
        """The minimum from a start, or one beside it: a flat valley on the way may end a search."""
        found: Prediction | None = None
        for factor in AGAIN:
            try:
                found = self._minimum(noise, {**start, **{n: factor * start[n] for n in sizes}})
            except IdentifiabilityError:  # of the derivatives at that start alone, perhaps
                if found is None and factor == AGAIN[-1]:
                    raise
                continue
            if found.solution.is_converged or seconds_left() <= 0.0:
                break
        assert found is not None
        return found

    def _minimum(self, noise: Sequence[White], start: Mapping[str, float]) -> Prediction:
        """The minimum that is found from a start; `identify` knows what the equations determine."""
        options: ExtendedOptions = {"own": self.settings.own, "start": start}
        solver = self.settings.solver
        if not self.is_extended:
            return minimize_prediction_error(
                self.model,
                self.experiments,
                noise,
                solver=solver,
                throw=False,
                structural="",
                rest=self.rest,
                own=self.settings.own,
                start=start,
            )
        options["initial"] = self.spread
        if self.settings.substeps is not None:
            options["substeps"] = self.settings.substeps
        return minimize_extended_prediction_error(
            self.model,
            self.experiments,
            noise,
            solver=solver,
            throw=False,
            structural="",
            **options,
        )


def _grid(
    problem: Problem, fit: Fit | None, d: Disturbance, data: Sequence[Signals]
) -> tuple[list[float], list[dict[str, float]]]:
    """Starts of the size of one disturbance, ascending, and of the shape of its spectrum."""
    low = max(2 * np.pi / (s.N * s.Ts) for s in data)
    high = 0.5 * np.pi / max(s.Ts for s in data)
    frequencies = np.geomspace(low, max(high, 2 * low), CORNERS).tolist()
    size, seen = (1.0, None) if fit is None else _seen(problem, fit, d)
    if seen is not None:
        frequencies.append(float(np.clip(seen.frequency, low, max(high, 2 * low))))
    sizes = size * (ALL_SIZES if fit is None else SIZES)
    if d.spectrum == "white":
        return (sizes * np.sqrt(data[0].Ts)).tolist(), [{}]
    shapes = [{d.frequency: w} for w in frequencies]
    if d.spectrum != "first":
        shapes = [{**shape, d.width: z} for shape, z in itertools.product(shapes, WIDTHS)]
    return sizes.tolist(), shapes


def _seen(problem: Problem, fit: Fit, d: Disturbance) -> tuple[float, DisturbanceSpectrum | None]:
    """Size and spectrum that the residual of least squares shows of a force in that balance.

    The size is that of the whole residual where the estimated noise leaves the force next to none.
    """
    criterion, model = fit.criterion, problem.model
    balances = {b.rate: b.name for b in model.balances.values()}
    place = balances.get(d.place, d.place)
    moves = [np.std(criterion.simulated(fit.x, e).x) for e in range(len(criterion.data))]
    fallback = float(max(moves)) or 1.0
    if place not in model.balances or criterion.segments > 1:
        return fallback, None
    try:
        noise: NoiseModel = estimate_noise(criterion, fit.x, known=problem.noise)
        noise = with_disturbance_spectra(noise, criterion, fit.x, problem.noise, has_common=False)
    except OutOfTimeError:
        raise
    except (CasidError, ArithmeticError, ValueError):
        return fallback, None
    response, size = noise.responses[0], noise.source_sd.get(place, 0.0)
    gain = float(np.mean(response.gain2[:, :, response.sources.index(place)].sum(axis=1)))
    residual = criterion.simulated(fit.x, 0).residual[criterion.data[0].used]
    whole = float(np.sqrt(np.mean(residual**2) / max(gain, TINY)))
    if size < SIZES[0] * whole:  # the noise was given to other places
        size = whole
    return size or fallback, noise.spectra.get(place)


def _best_start(
    criterion: Criterion,
    begin: Mapping[str, float],
    d: Disturbance,
    sizes: Sequence[float],
    shapes: Sequence[Mapping[str, float]],
) -> dict[str, float]:
    """The start with the best likelihood, among a grid and shares of the residual for sensors.

    All sizes are tried until one has a likelihood, and from the best so far downhill with every
    shape behind it.
    """
    names = criterion.names
    base = {**dict(zip(names, criterion.start.tolist(), strict=True)), **begin}
    noise = {n: base[n] for n in names if n.startswith("var(")}
    best, least, k = dict[str, float](), np.inf, 0

    def value(k: int, share: float, shape: Mapping[str, float]) -> float:
        """The criterion at one point of the grid; infinite where there is no predictor."""
        nonlocal best, least
        require_time(f"the search of the spectrum of the disturbance in {d.place}")
        sensors = {n: v * share**2 for n, v in noise.items()}
        point = {**sensors, **shape, d.size: sizes[k]}
        values = {**base, **point}
        found = criterion.value(np.array([values[n] for n in names]))
        found = found if np.isfinite(found) else np.inf
        if found < least or not best:
            best, least = point, found
        return found

    for share, shape in itertools.product(SHARES, shapes):
        at = cache(partial(value, share=share, shape=shape))
        is_found = np.isfinite(least)
        k = _downhill(at, k, len(sizes)) if is_found else min(range(len(sizes)), key=at)
    return best


def _downhill(at: Callable[[int], float], k: int, count: int) -> int:
    """The place below `count` where `at` is least, from `k` on as long as it falls."""
    while True:
        beside = min((j for j in (k - 1, k + 1) if 0 <= j < count), key=at)
        if at(beside) >= at(k):
            return k
        k = beside
