"""Estimates where the data determine parameters only up to a curve: one is held, by choice.

`casid.identify` and its kin refuse parameters that are not identifiable from the experiments.
`invariants` goes on instead: it holds one parameter of each family at a value, fits the others, and
moves the estimate along the family (`along_family`). What the family does not move is determined,
with a standard error. What it moves is a range: whatever the choice was, the parameter is in there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.deprecation import renamed
from casid.errors import CasidError, IdentifiabilityError, SolveError, UnknownNameError
from casid.estimation.estimate import Estimate, Estimated
from casid.estimation.nlp.solver import Solver
from casid.identifiability.combinations.closed_form import joint_invariants
from casid.identifiability.combinations.family import Family
from casid.identifiability.combinations.family_estimate import AlongFamily, along_family
from casid.identifiability.requirement import unidentifiable_families, word
from casid.model.model import Model
from casid.presentation import Presented

Estimator = Callable[[Problem, Sequence[Experiment]], Any]
"""(problem, experiments) -> Estimate, MomentEstimate or IterativeJoint."""


@dataclass(frozen=True, slots=True)
class Moving:
    """A parameter that the data leave on a curve.

    Attributes
    ----------
    name, unit : of the parameter.
    interval : holds it with the stated level, wherever the truth is on the curve.
    range : of the estimate alone, from one end of the curve to the other.
    slope : its change for one unit of the held parameter, at the estimate.
    spread : width of `range` over the standard error; below 1 the choice hardly matters. Infinite
        for the held one.
    held : that parameter; `name` itself where it was held.
    ends : which parameters stop the curve at their bounds, below and above.
    """

    name: str
    unit: str
    interval: tuple[float, float]
    range: tuple[float, float]
    slope: float
    spread: float
    held: str
    ends: tuple[str, str]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "interval": list(self.interval),
            "range": list(self.range),
            "slope": self.slope,
            "per": self.held,
            "spread": self.spread if np.isfinite(self.spread) else None,
            "unit": self.unit,
            "stopped_by": list(self.ends),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Invariants(Presented):
    """What the data determine whatever the choice, and how far the rest moves.

    Attributes
    ----------
    identifiable : parameters with a value and a standard error that no choice touches.
    moving : those that are a range.
    combinations : of the moving ones, determined in their place; in the names of the formulas.
    held : parameter -> value that was chosen.
    along : one a family.
    estimate : with the held parameters taken as known; its errors are given the choice.
    level : of the intervals, normal approximation.
    """

    problem: str
    identifiable: Mapping[str, Estimated]
    moving: Mapping[str, Moving]
    combinations: tuple[Estimated, ...]
    held: Mapping[str, float]
    along: tuple[AlongFamily, ...]
    estimate: Any
    level: float
    told = renamed("told", "identifiable")

    def __post_init__(self) -> None:
        for name in ("identifiable", "moving", "held"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def interval(self, name: str) -> tuple[float, float]:
        """The interval of a parameter, determined or moving; NaN where the estimate is at a bound.

        Raises
        ------
        UnknownNameError
            If it is neither.
        """
        if name in self.moving:
            return self.moving[name].interval
        if name not in self.identifiable:
            raise UnknownNameError(
                f"no parameter {name!r}; there are {', '.join((*self.identifiable, *self.moving))}"
            )
        p = self.identifiable[name]
        width = _width(self.level) * (np.nan if p.std_error is None else p.std_error)
        return p.value - width, p.value + width

    def to_json(self) -> dict[str, Any]:
        """Plain values (schema casid.invariants/1); a moving parameter has no value."""
        return {
            "schema": "casid.invariants/1",
            "problem": self.problem,
            "level": self.level,
            "told": {n: self._estimated_json(n) for n in self.identifiable},
            "combinations": [
                {"formula": c.name, "value": c.value, "std_error": c.std_error}
                for c in self.combinations
            ],
            "moving": {n: m.to_json() for n, m in self.moving.items()},
            "held": dict(self.held),
        }

    def _estimated_json(self, name: str) -> dict[str, Any]:
        p = self.identifiable[name]
        known = p.std_error is not None
        return {**p.to_json(), "interval": list(self.interval(name)) if known else None}

    def __repr__(self) -> str:
        identifiable = ", ".join(self.identifiable) or "no parameter"
        moving = ", ".join(self.moving) or "none"
        return f"<Invariants {self.problem}: identifiable {identifiable}; moving {moving}>"


def invariants(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    estimator: Estimator | None = None,
    *,
    hold: Mapping[str, float] | Sequence[str] | None = None,
    level: float = 0.95,
    families: Sequence[Family] | None = None,
) -> Invariants:
    """Estimate what these experiments determine of parameters that are not identifiable.

    Parameters
    ----------
    problem : its unknown parameters have finite bounds: they end the curves.
    experiments : each with its load case.
    estimator : called with the problem, the held parameters known in it, and the experiments:
        ``lambda p, e: casid.instrumental_variables(p, e, instruments)``. Default `casid.identify`.
    hold : the parameter to hold of each family, by name or with the value. Without a value it is
        held where a fit of all parameters at once happens to end; without a name the first that
        lets all others lie inside their bounds is.
    level : of the intervals, each for its own choice.
    families : from an earlier call with the same model and load cases (`unidentifiable_families`).

    Returns
    -------
    Invariants
        Everything is determined, and nothing held, where the problem is identifiable.

    Raises
    ------
    IdentifiabilityError
        If a family has no closed form or no finite bounds, two families share a parameter, or no
        choice lies inside the bounds.
    DataError, ModelError, SolveError
        As the estimator.

    Notes
    -----
    Intervals hold the truth at the stated level or more if the truth is inside the bounds. That the
    ends of a curve are uncertain themselves is not counted.
    """
    from casid.data.arguments import in_si
    from casid.identification.identify import identify

    problem, chosen = in_si(problem, experiments)
    found = tuple(unidentifiable_families(problem.model, chosen) if families is None else families)
    _refuse_entangled(found)
    run = estimator or identify
    refusals: list[str] = []
    named = isinstance(hold, Mapping)
    start = _point(problem.model, chosen) if found and not named else {}
    for held in _choices(problem.model, found, hold, start):
        model = _started(problem.model.with_known(**held), start)
        try:
            result = run(replace(problem, model=model, truth={}), chosen)
        except SolveError as error:
            if not found:
                raise
            refusals.append(f"{_held(held)}: {error}")
            continue
        stuck = _at_bounds(result, {n for f in found for n in f.moved})
        if not stuck:
            return _report(problem, chosen, found, held, result, level)
        refusals.append(f"{_held(held)}: {', '.join(stuck)} at a bound")
    raise IdentifiabilityError(
        f"{problem.name}: no choice leaves all parameters inside their bounds "
        f"({'; '.join(refusals)}). Widen the bounds, or name a value: hold={{'name': value}}"
    )


def _refuse_entangled(found: Sequence[Family]) -> None:
    for i, f in enumerate(found):
        if not f.is_closed:
            raise IdentifiabilityError(
                f"no closed form of the family along {f.free} for {', '.join(f.unsolved)}; give "
                f"one of {', '.join(f.moved)} a known value"
            )
        for g in found[:i]:
            shared = [n for n in f.moved if n in g.moved]
            if shared:
                raise IdentifiabilityError(
                    f"{', '.join(shared)} move along two families, a surface and no curve; give "
                    f"one of {', '.join(dict.fromkeys((*f.moved, *g.moved)))} a known value and "
                    "try again"
                )


def _choices(
    model: Model,
    found: Sequence[Family],
    hold: Mapping[str, float] | Sequence[str] | None,
    start: Mapping[str, float],
) -> list[dict[str, float]]:
    """Values to hold, one parameter a family, in the order in which they are tried."""
    if not found:
        return [{}]
    values = dict(hold) if isinstance(hold, Mapping) else {}
    names = list(values) if isinstance(hold, Mapping) else list(hold or ())
    options: list[list[str]] = []
    for f in found:
        bounded = [n for n in f.moved if _is_bounded(model, n)]
        named = [n for n in names if n in f.moved]
        if len(named) > 1 or (names and not named):
            raise IdentifiabilityError(
                f"hold: name one parameter of each family, here one of {', '.join(f.moved)}"
            )
        if not (named or bounded) or (named and named[0] not in bounded):
            raise IdentifiabilityError(
                f"{', '.join(named or f.moved)}: without finite bounds the family has no end; give "
                "lower= and upper= where the parameter is declared"
            )
        options.append(named or sorted(bounded, key=lambda n: n != f.free))
    length = max(map(len, options))
    rows = [[o[min(i, len(o) - 1)] for o in options] for i in range(length)]
    starts = {n: float(p.start) for n, p in model.parameters.items()} | dict(start) | values
    return [{n: starts[n] for n in row} for row in rows]


def _point(model: Model, experiments: Sequence[Experiment]) -> dict[str, float]:
    """Some point of the curves inside the bounds: all are fitted at once, wherever that ends."""
    from casid.estimation.simulation.fit import FitSettings, fit_model

    try:
        fit = fit_model(
            model,
            experiments,
            FitSettings(starts=1, substeps=1, solver=Solver(max_iterations=50)),
            check_rank=False,
            throw=False,
        )
    except CasidError:
        return {}
    held = fit.solution.active
    return {n: fit.values[n] for n in model.parameters if n in fit.values and n not in held}


def _started(model: Model, start: Mapping[str, float]) -> Model:
    """The model with start values for what is still unknown, so that one optimum is stayed at."""
    out = model.copy()
    for n, value in start.items():
        p = out.parameters[n]
        if not p.is_known:
            out.parameters[n] = replace(p, start=value)
    return out


def _is_bounded(model: Model, name: str) -> bool:
    p = model.parameters[name]
    return bool(np.isfinite(p.lower) and np.isfinite(p.upper))


def _held(values: Mapping[str, float]) -> str:
    return ", ".join(f"{n} = {v:.4g}" for n, v in values.items())


def _estimate(result: Any) -> Estimate:
    """The `Estimate` inside what an estimator gave."""
    while not isinstance(result, Estimate):
        result = result.estimate
    return result


def _at_bounds(result: Any, moved: set[str]) -> list[str]:
    e = _estimate(result)
    return [p.name for p in e.parameters if p.name in moved and p.bound]


def _report(
    problem: Problem,
    experiments: Sequence[Experiment],
    found: Sequence[Family],
    held: Mapping[str, float],
    result: Any,
    level: float,
) -> Invariants:
    e = _estimate(result)
    model = problem.model
    free = [n for n in e.covariance_names if n in model.parameters]
    index = [e.covariance_names.index(n) for n in free]
    covariance = e.covariance[np.ix_(index, index)]
    values = {p.name: p.value for p in e.parameters} | dict(held)
    values |= {p.name.split("(")[0]: p.value for p in e.initial_states}
    values |= {f"{n}_{word(x.name)}": float(v) for x in experiments for n, v in x.known.items()}
    bounds = {n: (p.lower, p.upper) for n, p in model.parameters.items() if not p.is_known}
    along = []
    for f in found:
        name = next(n for n in held if n in f.moved)
        along.append(along_family(f, values, free, covariance, bounds, held=name, level=level))
    moving: dict[str, Moving] = {}
    for a, f in zip(along, found, strict=True):
        for n in f.moved:
            moving[n] = Moving(
                name=n,
                unit=model.parameters[n].unit,
                interval=a.intervals[n],
                range=a.ranges[n],
                slope=a.slopes[n],
                spread=a.spread(n),
                held=a.held,
                ends=a.stopped_by,
            )
    identifiable = {
        p.name: p for p in e.parameters if p.name in free and not p.known and p.name not in moving
    }
    return Invariants(
        problem=problem.name,
        identifiable=identifiable,
        moving={n: moving[n] for n in model.parameters if n in moving},
        combinations=_combinations(found, values, free, covariance),
        held=held,
        along=tuple(along),
        estimate=result,
        level=level,
    )


def _combinations(
    found: Sequence[Family], values: Mapping[str, float], free: Sequence[str], covariance: Any
) -> tuple[Estimated, ...]:
    """Invariant expressions with their standard errors to first order."""
    import sympy

    if not found:
        return ()
    out = []
    for expression in joint_invariants(found)[0]:
        e = sympy.sympify(expression)
        numbers = {s: values.get(s.name) for s in e.free_symbols}
        if any(v is None for v in numbers.values()):
            continue
        slope = np.array(
            [float(sympy.diff(e, sympy.Symbol(n)).xreplace(_floats(numbers))) for n in free]
        )
        error = float(np.sqrt(max(slope @ covariance @ slope, 0.0)))
        out.append(Estimated(str(e), float(e.xreplace(_floats(numbers))), "", std_error=error))
    return tuple(out)


def _floats(numbers: Mapping[Any, Any]) -> dict[Any, Any]:
    import sympy

    return {s: sympy.Float(v) for s, v in numbers.items()}


def _width(level: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(0.5 + level / 2))
