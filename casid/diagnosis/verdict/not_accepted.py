"""Effects that were significant but refused for their errors: each has one statement.

Where such an effect is an alternative of a cause, its line says why it was not accepted. Where it
is named nowhere, a note says so. Never both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from casid.diagnosis.search.candidates import Candidate, name_of
from casid.diagnosis.search.refusals import Refusal
from casid.diagnosis.verdict.cause import Alternative, Cause
from casid.model.effects.effect import Effect

Refused = Sequence[tuple[Candidate, Refusal]]
"""Candidates, and why each was refused."""

NOT_ACCEPTED = "is significant but was not accepted"
"""What a note says of an effect that was refused; its name stands before it."""

_Identity = tuple[str, str, str]  # kind, place and description

_UNDER_THE_NOISE = "explains the misfit better under the noise model"


def with_refusal_reasons(causes: Sequence[Cause], refused: Refused) -> list[Cause]:
    """The causes with every alternative once, those that were refused with the reason."""
    reasons = {i: why.text for c, why in refused for i in _identities(c.effect)}
    return [replace(c, alternatives=tuple(_alternatives(c, reasons))) for c in causes]


def refusal_notes(refused: Refused, causes: Sequence[Cause] = ()) -> list[str]:
    """A note on each refused effect that is no cause and no alternative, with the last reason."""
    named = {_identity(c) for c in causes}
    named |= {_identity(a) for c in causes for a in c.alternatives}
    reasons = {name_of(c.effect): why for c, why in refused if not named & _identities(c.effect)}
    return [f"{words} {NOT_ACCEPTED}: {why.text}" for words, why in reasons.items()]


def _alternatives(cause: Cause, reasons: dict[_Identity, str]) -> Iterator[Alternative]:
    seen: set[_Identity] = set()
    for a in cause.alternatives:
        shown = (a.kind, a.words, a.description)
        if shown in seen:
            continue
        seen.add(shown)
        reason = "" if a.has_reason else reasons.get(_identity(a), "")
        yield replace(a, why=_with_reason(a.why, reason)) if reason else a


def _with_reason(why: str, reason: str) -> str:
    """Why a rival cannot be rejected by its gain, and what speaks against it."""
    why = why.replace("explains the misfit better", _UNDER_THE_NOISE)
    return f"{why}, but was not accepted: {reason}"


def _identity(x: Cause | Alternative) -> _Identity:
    return x.kind, x.where, x.description


def _identities(effect: Effect) -> set[_Identity]:
    """Identities of an effect in causes, alternatives and the table of scores."""
    kind, key = effect.key
    return {(kind, effect.where, effect.description), (kind, key, "")}
