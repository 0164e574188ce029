"""The open set: what is left when no effect of the catalogue explains more.

What is left is tested in kind (`residual_tests`). Where it depends on states and inputs, or changes
in time, something is missing that has no name here. It is then described instead of being called by
the name of its nearest relative: a single named cause that leaves a good part of the misfit stands
among the alternatives only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from casid.diagnosis.evidence.residual_tests import DISTURBANCE, NOISE, residual_tests
from casid.diagnosis.remaining import Remaining
from casid.diagnosis.result import Alternative, Cause
from casid.diagnosis.search import Adopted, Search, Weighted
from casid.diagnosis.unknown.unexplained import Unexplained, unexplained

SHARE = 0.2
"""Of the false-alarm rate, for the test of what is left where nothing was named: it comes on top of
the search's. Where something was, the verdict stands already, and the rate is twice as large."""

DOUBTFUL = 0.15
"""Share of the excess misfit left, above which the one cause named is not the cause (heuristic)."""


@dataclass(frozen=True, slots=True, eq=False)
class Left:
    """The test of what is left, and its description where that is more than noise."""

    p_value: float
    level: float
    unexplained: Unexplained | None = None


def is_more_than_noise(at: Weighted, search: Search) -> bool:
    """True if the residual depends on states and inputs, or changes in time."""
    tests = residual_tests(at, search.experiments, alpha=SHARE * search.alpha, seed=search.seed)
    return tests.verdict not in (NOISE, DISTURBANCE)


def what_is_left(at: Weighted, search: Search, adopted: Sequence[Adopted]) -> Left:
    """Test the residual of the last model; describe it where it is deterministic or changes."""
    level = (2 if adopted else 1) * SHARE * search.alpha
    tests = residual_tests(at, search.experiments, alpha=level, seed=search.seed)
    if tests.verdict in (NOISE, DISTURBANCE) and not (at.is_hidden and not adopted):
        return Left(tests.adjusted, level)
    search.progress("describe what is left unexplained")
    told = unexplained(at, search.experiments, search.recorded, alpha=level, seed=search.seed)
    return Left(tests.adjusted, level, told if told.is_something else None)


def with_the_unknown(
    causes: Sequence[Cause], left: Left, remaining: Remaining | None
) -> list[Cause]:
    """The causes with one of kind "unknown", where what is left is too much for a name to hold."""
    found = left.unexplained
    assert found is not None
    share = remaining.unexplained if remaining is not None else 1.0
    named = [c for c in causes if c.kind not in ("outliers", "saturation")]
    if named and share < DOUBTFUL:
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
        p_value=max(left.p_value, 1e-300),
        parameters=(),
        alternatives=alternatives,
        share=share,
        sentence=f"{where} lacks something that no effect of the catalogue explains",
        description=left.unexplained.sentence,
    )
