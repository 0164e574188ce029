"""Whether the residual of an extended model is more than noise: what ends the search."""

from __future__ import annotations

from casid.diagnosis.evidence.residual.residual_tests import (
    DISTURBANCE,
    NOISE,
    ResidualTests,
    residual_tests,
)
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import ROUNDS
from casid.estimation.simulation.minimization import Fit


def is_more_than_noise(at: Weighted, search: Search) -> bool:
    """True if the residual depends on states and inputs, or changes in time."""
    tests = tested_residual(at, search, ROUNDS.residual_share * search.alpha)
    return tests.verdict not in (NOISE, DISTURBANCE)


def is_noise_alone(at: Weighted, search: Search) -> bool:
    """True if the residual is noise, of no more than sensors and inputs have."""
    return not at.noise_absorbs_misfit and not is_more_than_noise(at, search)


def leaves_more(search: Search, at: Weighted, other: Fit) -> bool:
    """True if another fit leaves more than noise where a model as it is leaves noise alone.

    A name is worth a little of the errors, and no remainder that further effects would imitate.
    """
    if not is_noise_alone(at, search):
        return False
    return not is_noise_alone(search.weighing.weigh(other.criterion.model, other, rounds=1), search)


def tested_residual(at: Weighted, search: Search, level: float) -> ResidualTests:
    """Tests of the residual at a level; those of the last model are kept."""
    memory = search.memory
    if memory.tested is None or memory.tested[0] is not at:
        of = search.weighing
        found = residual_tests(at, of.experiments, search.recorded, alpha=level, seed=of.seed)
        memory.tested = at, found
    return memory.tested[1].at_level(level)
