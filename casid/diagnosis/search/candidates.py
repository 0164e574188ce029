"""Candidates for what is missing: effects as refitted, as compared and as adopted."""

from __future__ import annotations

from dataclasses import dataclass

from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.evidence.score_tests import Score
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.effect import Effect
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One effect, refitted together with everything else."""

    effect: Effect
    names: tuple[str, ...]
    model: Model
    fit: Fit
    gain: float  # (1) in `refitting`
    cost: float  # k log N
    wald: float  # robust z of the first parameter
    score: Score | None = None

    @property
    def merit(self) -> float:
        """What candidates are ranked by."""
        return self.gain - self.cost


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A candidate compared with the chosen one."""

    candidate: Candidate
    p_value: float  # that the chosen one is better by chance (Vuong 1989)


@dataclass(frozen=True, slots=True, eq=False)
class Adopted:
    """An effect adopted in one round, with what that round saw."""

    candidate: Candidate
    p_value: float
    rivals: tuple[Rival, ...]
    before: Weighted | None = None  # the model that it was adopted into


def null_values(candidate: Candidate) -> dict[str, float]:
    """The values of an effect's parameters at which it does nothing."""
    effect = candidate.effect
    starts = [1e9 if effect.test == "clip" else p.start for p in effect.parameters]
    return dict(zip(candidate.names, starts, strict=True))


def found_values(candidate: Candidate) -> dict[str, float]:
    """What an effect's parameters were found to be, by its own names for them."""
    values = candidate.fit.values
    return {
        p.name: values[name]
        for p, name in zip(candidate.effect.parameters, candidate.names, strict=True)
        if name in values
    }
