"""The open set: what is left when no effect of the catalogue explains more.

What is left is tested in kind (`residual_tests`). Where it depends on states and inputs, or changes
in time, something is missing that has no name here. It is then described instead of being called by
the name of its nearest relative: a single named cause that leaves a good part of the misfit stands
among the alternatives only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from casid.arrays import TINY
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.evidence.residual_tests import DISTURBANCE, NOISE
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.residual_check import tested_residual
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import JUDGING, ROUNDS
from casid.diagnosis.unexplained.description import Unexplained, unexplained
from casid.diagnosis.verdict.cause import Alternative, Cause
from casid.diagnosis.verdict.remainder import Remaining
from casid.diagnosis.verdict.unnamed_rivals import OpenRival
from casid.model.effects.effect import OF_SAMPLES


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """The test of what is left, and its description where that is more than noise."""

    p_value: float
    level: float
    unexplained: Unexplained | None = None


def what_is_left(at: Weighted, search: Search, adopted: Sequence[Adopted]) -> Left:
    """Test the residual of the last model; describe it where it is deterministic or changes."""
    level = (2 if adopted else 1) * ROUNDS.residual_share * search.alpha
    tests = tested_residual(at, search, level)
    if tests.verdict in (NOISE, DISTURBANCE) and not (at.is_hidden and not adopted):
        return Left(tests.adjusted, level)
    search.progress("describe what is left unexplained")
    told = _description(at, search, level)
    return Left(tests.adjusted, level, told)


def described(start: Weighted, search: Search, level: float, p_value: float) -> Left:
    """All that the model as it is leaves, described: what was named explains it worse."""
    search.progress("describe what no effect of the catalogue explains as well")
    told = _description(start, search, level)
    return Left(p_value, level, told)


def _description(at: Weighted, search: Search, level: float) -> Unexplained | None:
    """What a model leaves, in words and figures, if it is anything."""
    of = search.weighing
    told = unexplained(at, of.experiments, search.recorded, alpha=level, seed=of.seed)
    return told if told.is_something else None


def with_the_open_rival(
    causes: Sequence[Cause], rival: OpenRival, left: Left | None = None
) -> list[Cause]:
    """The causes with a function of no name among the alternatives of the first, or before them.

    Parameters
    ----------
    left : the description of the whole, where the function is better: what was named then stands
        among the alternatives only.
    """
    named = [c for c in causes if c.kind not in OF_SAMPLES]
    others = [c for c in causes if c not in named]
    if not rival.is_better:
        first = named[0]
        with_it = replace(first, alternatives=(*first.alternatives, rival.alternative()))
        return [with_it if c is first else c for c in causes]
    why = f"{rival.function}, which is no effect of the catalogue, explains more"
    alternatives = tuple(Alternative(c.kind, c.where, c.p_value, why) for c in named)
    found = left.unexplained if left is not None else None
    cause = Cause(
        kind="unknown",
        where=rival.place,
        p_value=min(c.p_value for c in named),
        parameters=(),
        alternatives=alternatives,
        share=sum(c.share for c in named),
        sentence=f"{rival.place} lacks something that no effect of the catalogue explains as well "
        f"as {rival.function} does",
        description=found.sentence if found is not None else "",
    )
    return [cause, *others]


def with_the_unknown(
    causes: Sequence[Cause], left: Left, remaining: Remaining | None
) -> list[Cause]:
    """The causes with one of kind "unknown", where what is left is too much for a name to hold."""
    found = left.unexplained
    assert found is not None
    share = remaining.unexplained if remaining is not None else 1.0
    named = [c for c in causes if c.kind not in OF_SAMPLES]
    if named and share < JUDGING.doubtful:
        return list(causes)
    where = found.where or (named[0].where if named else "model")
    alternatives: tuple[Alternative, ...] = ()
    others = list(causes)
    if len(named) == 1 and named[0].kind != "unknown":
        nearest = named[0]
        others.remove(nearest)
        why = (
            f"the nearest of the catalogue: it explains {100 * (1 - share):.0f} % of the excess "
            "misfit, and what it leaves is no noise"
        )
        alternatives = (Alternative(nearest.kind, nearest.where, nearest.p_value, why),)
        unknown = _unknown(where, left, alternatives, share=nearest.share)
        return [unknown, *others]
    return [*others, _unknown(where, left, alternatives, share=share)]


def _unknown(
    where: str, left: Left, alternatives: tuple[Alternative, ...], *, share: float
) -> Cause:
    assert left.unexplained is not None
    return Cause(
        kind="unknown",
        where=where,
        p_value=max(left.p_value, TINY),
        parameters=(),
        alternatives=alternatives,
        share=share,
        sentence=f"{where} lacks something that no effect of the catalogue explains",
        description=left.unexplained.sentence,
    )
