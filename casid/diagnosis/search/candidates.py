"""Candidates for what is missing: effects as refitted, as compared and as adopted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from casid.arrays import TINY
from casid.diagnosis.evidence.scores.score_tests import Score
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.errors import ModelError
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.effect import Effect
from casid.model.effects.names import effect_words
from casid.model.effects.same_terms import is_same_term
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One effect, refitted together with everything else."""

    effect: Effect
    names: tuple[str, ...]
    model: Model
    fit: Fit
    gain: float  # (1) in `joint_refit`
    cost: float  # k log N
    wald: float  # robust z of the first parameter
    score: Score | None = None
    of_windows: int = 0  # initial states that its own states have in windows, each but the first
    of_inputs: float = 0.0  # what noise of the inputs alone gives to its criterion

    @property
    def unknowns(self) -> float:
        """k: what it costs, with the states in which its own ones begin in every window."""
        return self.effect.cost + self.of_windows

    @property
    def merit(self) -> float:
        """The number that candidates are ranked by: gain less cost."""
        return self.gain - self.cost


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A candidate compared with the chosen one."""

    candidate: Candidate
    p_value: float  # that the chosen one is better by chance (Vuong 1989)


@dataclass(frozen=True, slots=True, eq=False)
class Adopted:
    """An effect adopted in one round, with what that round saw.

    Attributes
    ----------
    before : the model that it was adopted into.
    is_alarm : True if it was the first, significant by itself under noise that is known.
    share : of the misfit that all adopted effects removed.
    near : what explains nearly as much, where the noise model absorbed misfit.
    rounding : variable -> what a standard deviation of the speed within which dry friction
        reverses moves its estimate by.
    shifts : the same of what instants are not known to, one for each of them.
    instant_errors : standard errors of its instants [s].
    """

    candidate: Candidate
    p_value: float
    rivals: tuple[Rival, ...]
    before: Weighted | None = None
    is_alarm: bool = False
    share: float = 0.0
    near: tuple[Candidate, ...] = ()
    rounding: Mapping[str, float] = field(default_factory=dict)
    shifts: tuple[Mapping[str, float], ...] = ()
    instant_errors: tuple[float, ...] = ()

    def is_same_term(self, effect: Effect) -> bool:
        """True of an effect that no record separates from this one: one term of the equations."""
        return self.before is not None and is_same_term(
            self.before.model, self.candidate.effect, effect
        )

    @property
    def rivals_and_near_ones(self) -> tuple[Candidate, ...]:
        """Rivals and what explains nearly as much, the most likely first."""
        rivals = tuple(r.candidate for r in self.rivals)
        known = {c.effect.key for c in rivals}
        return (*rivals, *(c for c in self.near if c.effect.key not in known))


def as_placed(adopted: Sequence[Adopted], placed: Sequence[Candidate]) -> list[Adopted]:
    """The same causes, each with its candidate as another model has it."""
    return [replace(a, candidate=c) for a, c in zip(adopted, placed, strict=True)]


def null_values(candidate: Candidate) -> dict[str, float]:
    """The values of an effect's parameters at which it does nothing."""
    effect, nowhere = candidate.effect, 1 / TINY  # the limit of a clipping that cuts off nothing
    starts = [nowhere if effect.test == "clip" else p.start for p in effect.parameters]
    return dict(zip(candidate.names, starts, strict=True))


def taken_out(model: Model, null: Mapping[str, float]) -> Model:
    """A copy of `model` with effects at their null values, whatever bounds the search gave them."""
    new = model.copy()
    for name, value in null.items():
        p = new.parameters[name]
        new.parameters[name] = replace(
            p, value=value, lower=min(p.lower, value), upper=max(p.upper, value)
        )
    return new


def extended_by(model: Model, candidates: Sequence[Candidate]) -> tuple[Model, list[Candidate]]:
    """A model with several effects, and the candidates with their names in it."""
    placed = []
    for c in candidates:
        model, names = c.effect.extended(model, starts=found_values(c))
        placed.append(replace(c, names=names))
    return model, [replace(c, model=model) for c in placed]


def is_needed(model: Model, others: Sequence[Candidate]) -> bool:
    """True of a cause without which the others cannot be: one of them acts on what it adds.

    A further input that turns out to lag, say. It has no rivals, whose models would lack the input.
    """
    try:
        extended_by(model, others)
    except ModelError:
        return True
    return False


def name_of(effect: Effect) -> str:
    """Kind and place in words, as notes have them."""
    return effect_words(*effect.key, description=effect.description)


def found_values(candidate: Candidate) -> dict[str, float]:
    """Estimated parameters of an effect, by its own names for them."""
    values = candidate.fit.values
    return {
        p.name: values[name]
        for p, name in zip(candidate.effect.parameters, candidate.names, strict=True)
        if name in values
    }


def values_by_new_names(
    placed: Sequence[Candidate], before: Sequence[Candidate]
) -> dict[str, float]:
    """Estimated parameters of effects, by their new names."""
    return {
        new: c.fit.values[old]
        for p, c in zip(placed, before, strict=True)
        for new, old in zip(p.names, c.names, strict=True)
        if old in c.fit.values
    }
