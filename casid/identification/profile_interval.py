"""Profile interval of one parameter: the values that the moments cannot reject.

The covariance of `propagation` is linear in the moments' noise. Where the map from moments to
parameters is not, its intervals are wrong in place and size; the profile inverts a test instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import ModelError
from casid.estimation.moments.equations.moment_covariance import (
    are_short,
    combined_covariance,
    moment_covariance,
)
from casid.estimation.moments.equations.moment_nlp import Condensed, PhysicalNlp
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.propagation import free_slope
from casid.estimation.moments.stages.stage import StageFit
from casid.model.units import from_si
from casid.presentation import Viewed, present


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Profile(Viewed):
    """The values of one parameter that the moments cannot reject.

    Attributes
    ----------
    lower, upper : end points in the parameter's unit, +-inf where the moments set no limit.
    best : where the efficient criterion is smallest.
    grid, drop : (m,) values tried and 2 (V - V_min) there, chi squared with one degree of freedom.
    """

    name: str
    level: float
    lower: float
    upper: float
    best: float
    grid: Array
    drop: Array

    def __repr__(self) -> str:
        return (
            f"<Profile {self.name}: {100 * self.level:g} % interval {self.lower:.6g} to "
            f"{self.upper:.6g}, best {self.best:.6g}>"
        )

    def plot(self) -> Any:
        """The drop over the values tried, with the level that bounds the interval."""
        return present(self, "figure")


def _score_equations(st: StageFit, k: int, covariance: Array) -> Condensed:
    """The combinations A'Q (Y - Phi theta) that the estimate sets to zero, in units of their noise.

    As many as the stage has free parameters: surplus moments, whose estimated weights would make
    the interval too narrow, have no say, and with a mild map the interval is that of `std_error`.
    """
    e, root = st.equations[k], st.roots[k]
    own = [f for f in st.free if f not in st.parts[k].known]
    T = (root @ e.Phi @ free_slope(st, k, own)).T @ root
    spread = T @ covariance @ T.T
    if are_short([e]):  # combined before their spectra are taken, as `propagate` does
        spread = combined_covariance([e], [st.thetas[k]], [st.parts[k].record], T)
    values, vectors = np.linalg.eigh(spread)
    keep = values > 1e-12 * values[-1]
    noise = (vectors[:, keep] / np.sqrt(values[keep])).T
    return Condensed.of(e, noise @ T)


class _Profiled:
    """The criterion of all stages' estimating equations, one parameter held."""

    def __init__(self, estimate: MomentEstimate, name: str) -> None:
        stages: Sequence[StageFit] = estimate.stages
        self.free = [f for f in estimate.names if f != name]
        self.name = name
        entries = [(st, k) for st in stages for k in range(len(st.parts))]
        records = [st.parts[k].record for st, k in entries]
        covariance = moment_covariance(
            [st.equations[k] for st, k in entries],
            [st.thetas[k] for st, k in entries],
            records,
        )
        found = {f: float(st.theta_p[i]) for st in stages for i, f in enumerate(st.free)}
        self.data, self.values, equations, known = [], [], [], []
        at = 0
        for st, k in entries:
            e = st.equations[k]
            n = len(e.Z)
            self.data.append(_score_equations(st, k, covariance[at : at + n, at : at + n]))
            at += n
            part = st.parts[k]
            self.values.append(
                {**part.values, **{f: v for f, v in found.items() if f not in part.known}}
            )
            equations.append(e.equation)
            known.append(part.known)
        self.known = known
        by_name = {p.name: p for st in stages for p in st.stage.parameters}
        parameters = [by_name[f] for f in self.free]
        self.bounds = (by_name[name].lower, by_name[name].upper)
        self.start = np.array([found[f] for f in self.free])
        self.at = found[name]
        self.nlp = (
            PhysicalNlp(equations, parameters, [k & set(self.free) for k in known], name="profile")
            if parameters
            else None
        )
        self.equations = equations

    def value(self, held: float) -> float:
        """Smallest V with the parameter held; warm-started from the last."""
        values = [
            v if self.name in k else {**v, self.name: held}
            for v, k in zip(self.values, self.known, strict=True)
        ]
        if self.nlp is None:
            total = 0.0
            for d, v, e in zip(self.data, values, self.equations, strict=True):
                r = d.left - d.right @ e.theta(v)
                total += float(r @ r) + d.rest
            return total / 2
        solution = self.nlp.solve(self.data, values, self.start.tolist(), throw=False)
        if np.isfinite(solution.value):
            self.start = np.array([solution[f] for f in self.free])
        return float(solution.value)


@names_wrong_types()
def profile(estimate: MomentEstimate, name: str, *, level: float = 0.95) -> Profile:
    """Invert the test of one parameter: an interval that covers however curved the map is.

    2 (V(name) - V_min) of the estimating equations, weighted by their covariance, is chi squared
    with one degree of freedom at the true value. With several outputs of one record their
    correlation is left out here.

    Parameters
    ----------
    estimate : with the parameter `name`, by moments.
    level : of confidence.

    Raises
    ------
    ModelError
        If the parameter was not estimated.
    """
    from scipy.optimize import brentq, minimize_scalar
    from scipy.stats import chi2

    if name not in estimate.names:
        raise ModelError(
            f"profile: {name} was not estimated; estimated are {', '.join(estimate.names)}"
        )
    p = _Profiled(estimate, name)
    tried: dict[float, float] = {}

    def value(x: float) -> float:
        if x not in tried:
            tried[x] = p.value(x)
        return tried[x]

    i = estimate.names.index(name)
    error, begin = np.sqrt(max(estimate.propagated.covariance[i, i], 0.0)), p.start
    step = max(float(error), 1e-9 * abs(p.at), 1e-12)
    low, high = p.bounds
    inside = (max(low, p.at - 2 * step), min(high, p.at + 2 * step))
    found = minimize_scalar(value, bounds=inside, method="bounded", options={"xatol": 0.01 * step})
    best, smallest = float(found.x), float(found.fun)
    threshold = float(chi2.isf(1 - level, 1)) / 2

    def drop(x: float) -> float:
        return value(x) - smallest - threshold

    ends = []
    for side, limit in ((-1.0, low), (1.0, high)):
        p.start = begin
        inner, size, end = best, step, side * np.inf
        for _ in range(25):
            outer = float(np.clip(inner + side * size, low, high))
            if drop(outer) > 0:
                end = float(brentq(drop, min(inner, outer), max(inner, outer), xtol=1e-3 * step))
                break
            if outer == limit:
                end = limit
                break
            inner, size = outer, 1.7 * size
        ends.append(end)
    grid, unit = np.array(sorted(tried)), estimate.parameter(name).unit
    lower, upper, middle = (float(from_si(x, unit)) for x in (*ends, best))
    drops = np.array([2 * (tried[x] - smallest) for x in grid.tolist()])
    return Profile(name, level, lower, upper, middle, np.asarray(from_si(grid, unit)), drops)
