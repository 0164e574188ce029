"""Hypotheses: what the system may be, and which of them an experiment is to separate.

A hypothesis is the nominal model, or that with a cause of a certain size. A comparison takes one
for the truth and another for a rival whose parameters and initial state are fitted. The rival is
linearised at the values that imitate the truth best: by Danskin's theorem the derivative of

    min_theta sum_k |y_k(u) - h_k(u, theta)|^2 / sigma^2                                       (1)

in the input u needs the minimiser alone, not how it moves (Atkinson and Fedorov 1975: T-optimality;
Kuczewski 2006 for dynamic systems).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from casid.arrays import Array
from casid.errors import DataError, ModelError, nearest
from casid.experiment_design.setup import Nominal, held
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import ON_THE_CLOCK, Effect, Sizes
from casid.model.effects.user_effects import user_effects
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A model with values of all its parameters, SI.

    Attributes
    ----------
    acting : the direct model, its inputs what acts on the system: where no unknown input was
        eliminated the model itself.
    free : parameters that are estimated where it is a rival.
    held : of these, the ones that a fit leaves at a bound, which take up no misfit.
    """

    name: str
    model: Model
    acting: Model
    values: Mapping[str, float]
    free: tuple[str, ...]
    held: tuple[str, ...] = ()

    @property
    def moving(self) -> tuple[str, ...]:
        """Free parameters that no bound holds."""
        return tuple(n for n in self.free if n not in self.held)

    @property
    def driven_by(self) -> list[str]:
        """Measured channels that stand for inputs, unknown inputs being eliminated."""
        return [n for n in self.model.inputs if n not in self.acting.inputs]

    @property
    def vector(self) -> Array:
        """(np,) of the parameters, in the order of the model's."""
        return np.array([self.values[n] for n in self.model.parameters])

    @property
    def free_states(self) -> list[str]:
        """States whose initial value is estimated."""
        return [n for n, s in self.model.states.items() if s.initial is None]

    def at(self, values: Mapping[str, float], held: Sequence[str] = ()) -> Hypothesis:
        """The hypothesis at other values of some parameters, some of them at a bound."""
        return replace(self, values={**self.values, **values}, held=tuple(held))


class Comparison(NamedTuple):
    """A truth and a rival that is fitted to it, by their places; None: no truth, an estimate."""

    truth: int | None
    rival: int


def nominal_hypothesis(nominal: Nominal, designed: Sequence[str], hold: str) -> Hypothesis:
    """The model without any cause."""
    model = held(nominal.model, designed, hold)
    acting = held(nominal.acting, designed, hold)
    return Hypothesis("the model", model, acting, dict(nominal.values), nominal.free)


def with_cause(base: Hypothesis, effect: Effect, sizes: Mapping[str, float]) -> Hypothesis:
    """The model with a cause in it.

    Parameters
    ----------
    sizes : parameter of the effect -> value, SI; the others keep their start. Without any, the
        cause has its null value.

    Raises
    ------
    ModelError
        If the cause is not in the equations.
    """
    known = {p.name for p in effect.parameters}
    wrong = [n for n in sizes if n not in known]
    if wrong:
        raise DataError(
            f"size of {name_of(effect)}: it has no parameter {wrong[0]!r}{nearest(wrong[0], known)}"
        )
    model, names = effect.extended(base.model, starts=sizes)
    if model.stages or effect.test == "clip" or effect.is_on_the_clock:
        raise ModelError(
            f"{name_of(effect)} is no term of the equations but acts on samples or at an instant; "
            "a design needs derivatives in it, and takes causes in balances, in outputs and in "
            "parameters"
        )
    values = {**base.values, **{n: float(model.parameters[n].start) for n in names}}
    free = [n for n in names if not model.parameters[n].is_known]
    acting = model
    if base.driven_by:
        designed = [n for n, e in base.acting.inputs.items() if n not in base.model.inputs]
        hold = {base.acting.inputs[n].hold for n in designed}
        acting = held(model.direct(), designed, hold.pop())
    return Hypothesis(name_of(effect), model, acting, values, (*base.free, *free))


def name_of(effect: Effect) -> str:
    """Kind and place in words."""
    return f"{effect.kind} in {effect.key[1]}"


def effect_of(nominal: Nominal, cause: str | Effect, sizes: Sizes) -> Effect:
    """The effect that a caller names, as `kind` or `kind@where`, or gives.

    Raises
    ------
    DataError
        If this model has no such effect, or it has several.
    """
    if isinstance(cause, Effect):
        return cause
    kind, _, where = cause.partition("@")
    own = user_effects(nominal.model, nominal.effects)
    every = catalogue(nominal.model, sizes, {}, extra=own)
    # What sets in at an instant of a record is no cause that a design separates from another.
    every = [e for e in every if e.kind in ON_THE_CLOCK or not e.is_on_the_clock]
    kinds = [e for e in every if e.kind == kind]
    if not kinds:
        raise DataError(
            f"{nominal.name} has no effect {kind!r}{nearest(kind, {e.kind for e in every})}"
        )
    places = list(dict.fromkeys(e.key[1] for e in kinds))
    if where and where not in places:
        raise DataError(f"{kind} does not act in {where!r}; it acts in {', '.join(places)}")
    if not where and len(places) > 1:
        written = [f"{kind}@{p}" for p in places]
        several = " or ".join(f'"{w}"' if " " in w else w for w in written)
        raise DataError(f"{kind} may act in {', '.join(places)}; write {several}")
    return next(e for e in kinds if e.key[1] == (where or places[0]))
