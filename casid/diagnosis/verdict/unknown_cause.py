"""The cause of kind "unknown": a remainder that no effect of the catalogue explains.

It is described instead of being given the name of the nearest effect: a single named cause that
leaves a good part of the misfit is listed among the alternatives only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from casid.arrays import TINY
from casid.diagnosis.search.comparison.alternatives import is_imitator
from casid.diagnosis.thresholds import JUDGING, ROUNDS
from casid.diagnosis.verdict.cause import Alternative, Cause
from casid.diagnosis.verdict.not_accepted import Refused
from casid.diagnosis.verdict.remainder import Remaining
from casid.diagnosis.verdict.tested_remainder import Remainder
from casid.diagnosis.verdict.unnamed_alternatives import UnnamedAlternative
from casid.model.effects.effect import OF_SAMPLES
from casid.model.effects.names import ANYWHERE, unknown_place


def with_the_unnamed_alternative(
    causes: Sequence[Cause], rival: UnnamedAlternative, remainder: Remainder | None = None
) -> list[Cause]:
    """The causes with an unnamed function among the alternatives of the first, or before them.

    Parameters
    ----------
    remainder : the description of the whole misfit, where the function is better: the named
        causes are then listed among the alternatives only.
    """
    named = [c for c in causes if c.kind not in OF_SAMPLES]
    others = [c for c in causes if c not in named]
    if not rival.is_better:
        first = named[0]
        with_it = replace(first, alternatives=(*first.alternatives, rival.alternative()))
        return [with_it if c is first else c for c in causes]
    why = f"{rival.function}, which is no effect of the catalogue, explains more"
    alternatives = tuple(Alternative(c.kind, c.where, c.p_value, why) for c in named)
    found = remainder.unexplained if remainder is not None else None
    cause = Cause(
        kind="unknown",
        where=rival.place,
        p_value=min(c.p_value for c in named),
        parameters=(),
        alternatives=alternatives,
        share=sum(c.share for c in named),
        sentence=f"an unidentified term in {rival.place}: {rival.function} explains it better than "
        "any effect of the catalogue",
        description=found.sentence if found is not None else "",
    )
    return [cause, *others]


def with_a_doubt(causes: Sequence[Cause], failing: str) -> list[Cause]:
    """The causes, beside the first of which stands what is unknown where they fail.

    Two laws that fit alike in the range that was fitted differ beyond it.

    Parameters
    ----------
    failing : how the model with them fails in what was held out; empty where it does not.
    """
    named = next((c for c in causes if c.kind not in OF_SAMPLES), None)
    if not failing or named is None or named.kind == "unknown":
        return list(causes)
    other = Alternative("unknown", named.where, 1.0, failing, has_reason=True)
    doubtful = replace(named, alternatives=(*named.alternatives, other))
    return [doubtful if c is named else c for c in causes]


def with_the_unknown(
    causes: Sequence[Cause],
    remainder: Remainder,
    remaining: Remaining | None,
    refused: Refused = (),
    *,
    is_disturbed: bool = False,
) -> list[Cause]:
    """The causes with one of kind "unknown", where the remainder is too large for a named cause.

    Parameters
    ----------
    is_disturbed : the causes were found together with a random disturbance, and stay named: its
        variance, and so the share that they leave, is uncertain where a record has few periods.
    refused : candidates that were significant but not adopted, and why, the best first: where
        nothing is named, the nearest of the catalogue.
    """
    found = remainder.unexplained
    assert found is not None
    share = remaining.unexplained if remaining is not None else 1.0
    named = [c for c in causes if c.kind not in OF_SAMPLES]
    if named and (is_disturbed or share < JUDGING.doubtful):
        return list(causes)
    where = found.where or (named[0].where if named else ANYWHERE)
    alternatives: tuple[Alternative, ...] = ()
    others = list(causes)
    if len(named) == 1 and named[0].kind != "unknown":
        nearest = named[0]
        others.remove(nearest)
        why = (
            f"the nearest effect of the catalogue: it explains {100 * (1 - share):.0f} % of the "
            "excess misfit, and the remainder is not noise"
        )
        alternatives = (
            Alternative(nearest.kind, nearest.where, nearest.p_value, why, nearest.description),
            *(a for a in nearest.alternatives if a.kind != "unknown"),  # as near as the nearest
        )
        unknown = _unknown(where, remainder, alternatives, share=nearest.share)
        return [unknown, *others]
    if not named:
        alternatives = tuple(_nearest(refused))
    return [*others, _unknown(where, remainder, alternatives, share=share)]


def _nearest(refused: Refused) -> Iterator[Alternative]:
    """Named effects that explain much of what was fitted, and what speaks against each."""
    keys: set[tuple[str, str]] = set()
    for c, why in refused:
        is_new = c.effect.key not in keys and c.effect.kind != "unknown" and not is_imitator(c)
        if is_new and len(keys) < ROUNDS.rivals:
            keys.add(c.effect.key)
            text = f"significant and of a similar effect, but {why.text}"
            kind, where, description = c.effect.kind, c.effect.where, c.effect.description
            yield Alternative(kind, where, 1.0, text, description, has_reason=True)


def _unknown(
    where: str, remainder: Remainder, alternatives: tuple[Alternative, ...], *, share: float
) -> Cause:
    assert remainder.unexplained is not None
    return Cause(
        kind="unknown",
        where=where,
        p_value=max(remainder.p_value, TINY),
        parameters=(),
        alternatives=alternatives,
        share=share,
        sentence=f"an unidentified term in {unknown_place(where)}: no effect of the catalogue "
        "explains it",
        description=remainder.unexplained.sentence,
    )
