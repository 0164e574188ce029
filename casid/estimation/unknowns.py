"""The scalar unknowns of a criterion over several experiments, and which are in each experiment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError, SolveError, nearest
from casid.model.model import Model

T = TypeVar("T")

_SMALLEST = 1e-3  # of the declared start, the scale of a parameter


@dataclass(frozen=True, slots=True)
class Variable:
    """One scalar unknown of the NLP and where it comes from."""

    name: str
    source: str  # the parameter or state
    start: float
    lower: float
    upper: float
    scale: float
    is_inner: bool = False  # a state at an inner node of multiple shooting


class Unknowns:
    """Names, starts, bounds and scales of the unknowns of a criterion.

    Parameters
    ----------
    model : its parameters without a value are unknown.
    experiments : name and known values of each; a parameter known in all of them is no unknown.
    own : parameters that every experiment has for itself.
    start : start values by variable name, over the model's own.

    Raises
    ------
    ModelError
        If `own` names no parameter.
    """

    def __init__(
        self,
        model: Model,
        experiments: Sequence[tuple[str, Mapping[str, float]]],
        own: Sequence[str] | str = (),
        start: Mapping[str, float] | None = None,
    ) -> None:
        self.model, self.experiments = model, list(experiments)
        self._given = dict(start or {})
        own = (own,) if isinstance(own, str) else own
        for name in own:
            model.parameter_named(name)
        self.free = [
            p.name
            for p in model.parameters.values()
            if not p.is_known and not all(p.name in known for _, known in experiments)
        ]
        self.own = [f for f in self.free if f in own]
        self.variables: list[Variable] = []
        self._shared: dict[str, int] = {}

    def add(
        self,
        name: str,
        source: str,
        start: float,
        bounds: tuple[float, float],
        scale: float,
        *,
        clip: bool = False,
        is_inner: bool = False,
    ) -> int:
        """A new unknown, started where the user says or else at `start`; returns its place.

        Raises
        ------
        SolveError
            If the start is outside the bounds and not to be clipped.
        """
        lower, upper = bounds
        start = self.given(name, start)
        if clip:
            start = float(np.clip(start, lower, upper))
        elif not lower <= start <= upper:
            if source in self.model.declared_units:
                start, lower, upper = (self.model.shown(source, v) for v in (start, lower, upper))
            raise SolveError(
                f"start {name} = {start:g} lies outside its bounds [{lower:g}, {upper:g}]; "
                "move the start inside or widen the bounds"
            )
        start = float(start)
        self.variables.append(Variable(name, source, start, lower, upper, scale, is_inner))
        return len(self.variables) - 1

    def keep_near(self, places: Array, values: Array) -> None:
        """Bound n unknowns to the ranges of columns (N, n), each wider by its width on either side.

        Parameters
        ----------
        places : (n,) of the unknowns among the variables; -1 for a column that bounds none.
        """
        low, high = values.min(axis=0).tolist(), values.max(axis=0).tolist()
        for i, a, b in zip(places.tolist(), low, high, strict=True):
            if i >= 0 and np.isfinite(b - a) and b > a:
                v = self.variables[i]
                lower, upper = max(v.lower, 2 * a - b), min(v.upper, 2 * b - a)
                self.variables[i] = replace(v, lower=lower, upper=upper)

    def is_given(self, name: str) -> bool:
        """Whether the user gave a start value for an unknown."""
        return name in self._given

    def given(self, name: str, start: float) -> float:
        """The start value that was given for an unknown, or else `start`."""
        return self._given.get(name, start)

    def add_shared(self) -> None:
        """The parameters that all experiments have in common."""
        for name in self.free:
            if name not in self.own:
                self._shared[name] = self._add_parameter(name, "")

    def share(self, name: str, place: int) -> None:
        """Another unknown that all experiments have in common, by its place."""
        self._shared[name] = place

    def label(self, experiment: int) -> str:
        """Suffix that marks the unknowns of one experiment among several."""
        return f"@{self.experiments[experiment][0]}" if len(self.experiments) > 1 else ""

    @property
    def startable(self) -> list[str]:
        """What a start may name: free parameters and initial states, by record where of one."""
        labels = [self.label(e) for e in range(len(self.experiments))]
        own = [f"{name}{label}" for name in self.own for label in labels]
        initial = [name for name, s in self.model.states.items() if s.initial is None]
        states = [f"{name}(0){label}" for label in labels for name in initial]
        return list(dict.fromkeys([*self.free, *own, *states]))

    def add_own(self, experiment: int, *, clip: bool = False) -> dict[str, int]:
        """An experiment's own parameters; returns name -> place of all that are unknown in it."""
        known = self.experiments[experiment][1]
        places = dict(self._shared)
        for name in self.own:
            if name not in known:
                places[name] = self._add_parameter(name, self.label(experiment), clip=clip)
        return {name: place for name, place in places.items() if name not in known}

    def _add_parameter(self, name: str, label: str, *, clip: bool = False) -> int:
        p = self.model.parameters[name]
        s = self._given.get(f"{name}{label}", self._given.get(name, p.start))
        # One that a fit has taken to its bound at zero is not as small as that.
        scale = max(abs(s), _SMALLEST * abs(p.start)) or 1.0
        return self.add(f"{name}{label}", name, s, (p.lower, p.upper), scale, clip=clip)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables."""
        return tuple(v.name for v in self.variables)

    @property
    def start(self) -> Array:
        """(n,) start values."""
        return np.array([v.start for v in self.variables])

    def parameters(self, x: Array, experiment: int, places: Iterable[int]) -> dict[str, float]:
        """All parameters of the model at `x` (n,); `places` of the free ones, -1 where known."""
        values = self.model.nominal_values
        values.update(self.experiments[experiment][1])
        values.update({n: float(x[i]) for n, i in zip(self.free, places, strict=False) if i >= 0})
        return values

    def initial_state(self, x: Array, places: Iterable[int]) -> Array:
        """Initial state (nx,) at `x` (n,); `places` of the states, -1 where known."""
        return np.array(
            [
                x[i] if i >= 0 else state.nominal
                for state, i in zip(self.model.states.values(), places, strict=True)
            ],
            dtype=float,
        )


def refuse_strangers(model: Model, names: Sequence[str], given: Mapping[str, float]) -> None:
    """Refuse a start for what is no variable, which would be ignored.

    Raises
    ------
    ModelError
        With the names that there are, and the nearest.
    """
    for name in given:
        if name in names:
            continue
        what = f"{model.name}: start names {name!r}, "
        if name in model.parameters:
            known = "known" if model.parameters[name].is_known else "known in all records"
            raise ModelError(
                f"{what}which is {known}: leave it out, or estimate it, "
                f"model.with_unknown({name!r}), and take it out of the experiments' values"
            )
        like = (f"{name}(", f"{name}@")  # x(0), x(0)@run
        near = [n for n in names if f"({name})" in n or n.startswith(like)]  # var(y)
        hint = f"; did you mean {near[0]!r}?" if near else nearest(name, names, is_listed=True)
        raise ModelError(
            f"{what}which is not a variable; there are {', '.join(names)}"
            + (hint or "; leave it out")
        )


class LastPoints(Generic[T]):
    """Results at the last points, kept: a search returns to where it was or began."""

    def __init__(self, count: int = 3) -> None:
        self._count = count
        self._kept: list[tuple[tuple[object, ...], T]] = []

    def __call__(self, given: Sequence[object], compute: Callable[[], T]) -> T:
        """The result of `compute()` for what is `given`, arrays compared by their values."""
        key = tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in given)
        for known, found in self._kept:
            if known == key:
                return found
        found = compute()
        self._kept = [(key, found), *self._kept[: self._count - 1]]
        return found


class LastOf(Generic[T]):
    """The last result for each experiment.

    Solver, scores and reports evaluate a criterion at the same point, one after the other.
    """

    def __init__(self) -> None:
        self._kept: dict[int, LastPoints[T]] = {}

    def __call__(self, x: Array, experiment: int, compute: Callable[[Array, int], T]) -> T:
        """The result of `compute(x, experiment)`, computed once at an unchanged point."""
        last = self._kept.setdefault(experiment, LastPoints(1))
        return last((np.asarray(x, dtype=float),), lambda: compute(x, experiment))

    def clear(self) -> None:
        """Forget every point."""
        self._kept.clear()
