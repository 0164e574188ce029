"""Profile likelihood: which values of a parameter the records do not reject.

    PL(c) = min over everything else of -2 log L(theta, x0),  theta_i = c                    (1)

The values with PL(c) - PL(best) below a chi-squared quantile are the confidence interval of theta_i
(Raue et al. 2009, (3)-(5)). A profile that stays flat is a structurally non-identifiable parameter;
one that rises but never crosses the threshold on one side is a practically non-identifiable one,
whose interval is open. With white Gaussian noise of known size -2 log L is the simulation error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import TINY, Array
from casid.data.arguments import in_si, problem_of
from casid.data.problem import Problem
from casid.errors import DataError, ModelError, SolveError, nearest
from casid.estimation.estimate import Estimate
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Evaluation
from casid.estimation.nlp.solver import Solver
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.simulation_error import SimulationError
from casid.identifiability.records.planned_experiment import (
    Experiments,
    Planned,
    plan,
    values_of,
)
from casid.identifiability.records.profile_result import Kind, ProfileLikelihood, Profiles
from casid.model.model import Model

__all__ = ["ProfileLikelihood", "Profiles", "profile_likelihood"]

_FLAT = 1e-3  # of the threshold


@names_wrong_types()
def profile_likelihood(
    problem: Problem | Model,
    experiments: Experiments = None,
    parameters: Sequence[str] | None = None,
    *,
    points: int = 12,
    confidence: float = 0.95,
    noise: Mapping[str, float] | None = None,
    at: Mapping[str, float] | Estimate | None = None,
    reach: float = 10.0,
    settings: FitSettings | None = None,
) -> Profiles:
    """Profile chosen parameters: each held on a grid, everything else estimated again.

    Parameters
    ----------
    experiments : records with their load cases; default the problem's own example.
    parameters : names of unknowns ("k", "phi(0)"); default every unknown parameter.
    points : most values tried on each side of the estimate.
    confidence : of the intervals.
    noise : output -> standard deviation; default that of the problem, else the residual's at the
        best fit.
    at : where the first fit starts; default the declared starts.
    reach : an open side is followed to the bound of the parameter, or until it has moved by this
        many times its value.
    settings : of the first fit; no constraints and one segment.

    Raises
    ------
    ModelError
        A name that is not unknown.
    DataError
        Records that cannot be used, or fewer than three points.
    SolveError
        If the first fit diverges.
    """
    values = values_of(problem, at)
    noise = problem_of(problem).noise_in_si(noise or {})
    problem, chosen = in_si(problem, experiments)
    settings = settings or FitSettings(starts=problem.starts)
    _check_settings(problem, settings, points, confidence)
    fit = fit_model(problem.model, chosen, settings, start=values, check_rank=False, throw=False)
    planned = plan(
        problem,
        chosen,
        at=fit.values,
        noise=noise,
        own=settings.own,
        substeps=fit.criterion.substeps,
    )
    profiled = _Profiled(planned, settings.solver)
    wanted = _requested(planned, parameters)
    threshold = _chi_squared(confidence)
    found = tuple(profiled.profile(name, threshold, points, reach) for name in wanted)
    return Profiles(
        problem.name,
        tuple(d.name for d in planned.criterion.data),
        confidence,
        found,
        planned.criterion.names,
        planned.noise.sd,
        planned.noise.source,
        planned.noise.unit,
    )


def _check_settings(
    problem: Problem, settings: FitSettings, points: int, confidence: float
) -> None:
    if points < 3 or not 0 < confidence < 1:
        raise DataError(
            f"points = {points}, confidence = {confidence}; give at least 3 points a side and a "
            "confidence between 0 and 1, as 0.95"
        )
    if settings.constraints or settings.segments != 1:
        raise DataError(
            f"profile of {problem.name}: the fit has constraints or several segments, which a "
            "profile does not know; put the constraints into the model and use segments=1"
        )


def _requested(planned: Planned, parameters: Sequence[str] | None) -> list[str]:
    """The parameters to profile: those named, or every unknown parameter."""
    shared = [n for n, s in zip(planned.criterion.names, planned.is_state, strict=True) if not s]
    wanted = list(parameters) if parameters is not None else shared
    for name in wanted:
        known = planned.criterion.names
        if name not in known:
            raise ModelError(
                f"profile of {name!r}: {planned.problem.name} has no such unknown; unknown are "
                f"{', '.join(known)}{nearest(name, known, is_listed=True)}"
            )
    return wanted


def _chi_squared(confidence: float) -> float:
    from scipy.stats import chi2

    return float(chi2.ppf(confidence, 1))


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """The simulation error with one variable held: the criterion of all the others."""

    criterion: SimulationError
    place: int
    value: float

    @property
    def n_constraints(self) -> int:
        return self.criterion.n_constraints

    def full(self, others: Array) -> Array:
        return np.insert(np.asarray(others, dtype=float), self.place, self.value)

    def evaluate(self, others: Array) -> Evaluation:
        at = self.criterion.evaluate(self.full(others))
        kept = np.arange(len(others) + 1) != self.place
        return Evaluation(
            at.value, at.gradient[kept], at.hessian[np.ix_(kept, kept)], at.constraints
        )


class _Profiled:
    """Minima of the simulation error with one variable held, each from its neighbour's."""

    def __init__(self, planned: Planned, solver: Solver | None) -> None:
        self.criterion, self.solver = planned.criterion, solver
        self.planned = planned
        # The fit weighed the outputs by their spread; the likelihood weighs them by their noise.
        self.best, self.value = self._minimum(None, 0.0, planned.x)
        with np.errstate(all="ignore"):
            root = planned.root()
            length = np.linalg.norm(root, axis=0)
            _, s, vt = np.linalg.svd(root / np.where(length > 0, length, 1.0))
            self.sd = np.sqrt(np.sum((vt.T / s) ** 2, axis=1)) / length

    def _minimum(self, place: int | None, held: float, near: Array) -> tuple[Array, float]:
        """Minimiser (n,) and smallest deviance with variable `place` held; NaN where it fails."""
        variables = [v for i, v in enumerate(self.criterion.variables) if i != place]
        target: Any = self.criterion if place is None else _Held(self.criterion, place, held)
        start = near if place is None else np.delete(near, place)
        if not variables:
            return np.array([held]), 2 * target.evaluate(start).value
        nlp = Nlp(f"profile of {self.criterion.model.name}")
        for v, s in zip(variables, start.tolist(), strict=True):
            s = float(np.clip(s, v.lower, v.upper))
            nlp.variable(v.name, s, lower=v.lower, upper=v.upper, scale=v.scale)
        nlp.minimize(target)
        try:
            solution = nlp.solve(self.solver, start.tolist(), throw=False, natural_scales=True)
        except SolveError:
            return near, math.nan
        x = solution.x if place is None else target.full(solution.x)
        return x, 2 * solution.value

    def _lowest(
        self, place: int, held: float, near: Array, threshold: float
    ) -> tuple[Array, float]:
        """The minimum from the neighbour's tangent; where that is poor, from other starts too."""
        x, value = self._minimum(place, held, self._tangent(near, place, held))
        if math.isfinite(value) and value - self.value <= threshold:
            return x, value
        for other in (near, self.best):
            again, lower = self._minimum(place, held, other)
            if math.isfinite(lower) and not lower >= value:
                x, value = again, lower
        return x, value

    def profile(self, name: str, threshold: float, points: int, reach: float) -> ProfileLikelihood:
        """Walk to both sides of the estimate until the threshold is crossed."""
        place = self.criterion.names.index(name)
        tried: dict[float, tuple[Array, float]] = {float(self.best[place]): (self.best, self.value)}
        sides = [self._walk(place, side, threshold, points, reach, tried) for side in (-1, 1)]
        grid = np.array(sorted(tried))
        path = np.array([tried[v][0] for v in grid.tolist()])
        total = np.array([tried[v][1] for v in grid.tolist()])
        lowest = int(np.argmin(total))
        deviance = total - total[lowest]
        notes = [note for _, note in sides if note]
        # A walk may find a better optimum than the fit: all counts from there.
        if total[lowest] < self.value - 1e-2 * threshold:
            notes.append("a better optimum than the fit was found along the profile")
        ends = [_crossing(grid, deviance, lowest, side, threshold) for side in (-1, 1)]
        kind: Kind = (
            "identifiable" if all(map(math.isfinite, ends)) else ("practically non-identifiable")
        )
        free = ~self._newly_bound(path, lowest, place)
        if deviance[free].max() < _FLAT * threshold and free.sum() > 2:
            kind = "flat"
            notes.insert(0, "structurally non-identifiable, or next to it, in this record")
            if not free.all():
                notes.append("it ends where another parameter meets its bound")
        return ProfileLikelihood(
            name,
            self.planned.unit(place),
            float(grid[lowest]),
            ends[0],
            ends[1],
            threshold,
            grid,
            deviance,
            path,
            kind,
            "; ".join(notes),
            self.planned.declared(place),
        )

    def _newly_bound(self, path: Array, lowest: int, place: int) -> Array:
        """(m,) True where a bound holds another variable that it did not hold at the best point."""
        variables = self.criterion.variables
        low, high = np.array([[v.lower, v.upper] for v in variables]).T
        near = 1e-6 * np.array([v.scale for v in variables])
        at_bound = (path - low < near) | (high - path < near)
        at_bound[:, place] = False
        return np.asarray((at_bound & ~at_bound[lowest]).any(axis=1))

    def _walk(
        self,
        place: int,
        side: int,
        threshold: float,
        points: int,
        reach: float,
        tried: dict[float, tuple[Array, float]],
    ) -> tuple[float, str]:
        """Try values on one side; returns the last and why an open side was left."""
        v, name = self.criterion.variables[place], self.criterion.names[place]
        limit = v.upper if side > 0 else v.lower
        at, x, deviance = float(self.best[place]), self.best, 0.0
        size = self._size(place)
        far = at + side * reach * size
        last = min(far, limit) if side > 0 else max(far, limit)
        sd = float(self.sd[place])
        step = math.sqrt(threshold) * sd / 3 if math.isfinite(sd) else math.inf
        step = min(step, 0.1 * size)
        for k in range(points):
            if at == last:
                break
            # Open sides are followed to the end with the remaining points.
            step = max(step, abs(last - at) / 2 ** (points - k - 1)) if k >= points // 2 else step
            to = at + side * step
            to = min(to, last) if side > 0 else max(to, last)
            new, value = self._lowest(place, to, x, threshold)
            if not math.isfinite(value):
                step = (to - at) * side / 2
                continue
            before, deviance = deviance, value - self.value
            tried[to] = (new, value)
            at, x = to, new
            if deviance > threshold:
                self._refine(place, threshold, side, tried)
                return at, ""
            if math.sqrt(max(deviance, 0.0)) - math.sqrt(max(before, 0.0)) < 0.25 * math.sqrt(
                threshold
            ):
                step *= 2
        why = "its bound" if at == limit else "where it was no longer followed"
        return at, f"{name} open {'above' if side > 0 else 'below'}, followed to {at:.4g}, {why}"

    def _size(self, place: int) -> float:
        """Reference of a large move: the value, or the declared start where that is larger."""
        v, value = self.criterion.variables[place], abs(float(self.best[place]))
        declared = self.planned.problem.model.parameters.get(v.source)
        if declared is not None:
            return max(value, abs(declared.start)) or 1.0
        return max(value, float(self.planned.scale[place]))

    def _tangent(self, x: Array, place: int, to: float) -> Array:
        """The other variables moved along: dx = -H_oo^+ H_op (to - x_p), inside their bounds."""
        hessian = self.criterion.evaluate(x).hessian
        others = np.arange(len(x)) != place
        length = np.sqrt(np.maximum(np.diag(hessian), TINY))
        unit = hessian / np.outer(length, length)
        move = -np.linalg.pinv(unit[np.ix_(others, others)], rcond=1e-10) @ unit[others, place]
        guess = x.copy()
        guess[others] += move / length[others] * length[place] * (to - x[place])
        variables = self.criterion.variables
        low, high = [v.lower for v in variables], [v.upper for v in variables]
        guess = np.clip(guess, low, high)
        guess[place] = to
        return guess

    def _refine(
        self, place: int, threshold: float, side: int, tried: dict[float, tuple[Array, float]]
    ) -> None:
        """Values at the crossing, until the end point does not depend on the grid."""
        for _ in range(10):
            grid = np.array(sorted(tried))
            total = np.array([tried[v][1] for v in grid.tolist()])
            low = int(np.argmin(total))
            deviance = total - total[low]
            end = _crossing(grid, deviance, low, side, threshold)
            if not math.isfinite(end):
                return
            i = int(np.argmin(np.abs(grid - end)))
            inner, outer = _bracket(grid, deviance, low, side, threshold)
            if abs(deviance[i] - threshold) < 0.01 * threshold:
                return
            if deviance[outer] > 9 * threshold:  # a kink or a cliff: no straight line to follow
                end = float(grid[inner] + grid[outer]) / 2
            near = tried[float(grid[inner])][0]
            x, value = self._lowest(place, end, near, threshold)
            if end in tried or not math.isfinite(value):
                return
            tried[end] = (x, value)


def _bracket(
    grid: Array, deviance: Array, lowest: int, side: int, threshold: float
) -> tuple[int, int]:
    """Places of the last value below the threshold on one side and of the first above."""
    i = lowest
    while 0 <= i + side < len(grid) and deviance[i + side] < threshold:
        i += side
    return i, i + side


def _crossing(grid: Array, deviance: Array, lowest: int, side: int, threshold: float) -> float:
    """Where the root of the deviance, a straight line for a linear model, meets the threshold's."""
    i, j = _bracket(grid, deviance, lowest, side, threshold)
    if not 0 <= j < len(grid):
        return side * math.inf
    root = np.sqrt(np.maximum(deviance, 0.0))
    share = (math.sqrt(threshold) - root[i]) / (root[j] - root[i])
    return float(grid[i] + share * (grid[j] - grid[i]))
