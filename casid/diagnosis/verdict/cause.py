"""Causes, their alternatives and the ranking of candidates, as a diagnosis reports them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from casid.data.files import plain_fields
from casid.estimation.estimate import Estimated
from casid.model.effects.effect import LATE
from casid.model.effects.names import effect_words
from casid.model.units import parse_unit, si_unit

Verdict = Literal["adequate", "deficient", "undecided"]


@dataclass(frozen=True, slots=True)
class Alternative:
    """A kind that this record cannot reject against the named one."""

    kind: str
    where: str
    p_value: float
    why: str
    description: str = ""  # what it is like where the catalogue has no name: kind "unknown"
    has_reason: bool = False  # `why` says for what it was refused, or that nothing does
    is_same_term: bool = False  # of the equations: no record of the model's channels separates them

    @property
    def name(self) -> str:
        """Kind and place; what has no name, with its description."""
        like = f" ({self.description})" if self.kind == "unknown" and self.description else ""
        return f"{self.kind} in {self.where}{like}"

    @property
    def words(self) -> str:
        """The effect in words."""
        if self.kind == "unknown" and self.description:
            what = self.description.removeprefix("a term ")
            like = f" {what}" if what != self.description else f" ({what})"
            return f"{effect_words(self.kind, self.where)}{like}"
        return effect_words(self.kind, self.where, description=self.description)

    @property
    def is_as_likely(self) -> bool:
        """True where no test speaks for the named one: a p-value of at least one half."""
        return self.p_value >= 0.5

    def to_json(self) -> dict[str, Any]:
        """The fields as `diagnosis.json` holds them."""
        return plain_fields(self, leave_out=("has_reason", "is_same_term"))


_SHARES = ("scale", "gain", "saturated", "rate_limited", "exponent")
"""Begin the names of parameters of a channel that have no unit, whatever the channel has."""


@dataclass(frozen=True, slots=True)
class Cause:
    """An effect that the data require and the model lacked."""

    kind: str
    where: str
    p_value: float  # family-wise
    parameters: tuple[Estimated, ...]
    alternatives: tuple[Alternative, ...] = ()
    share: float = 0.0  # of the misfit removed, 0..1
    sentence: str = ""
    description: str = ""  # what is known of it where the catalogue has no name: kind "unknown"
    by_record: Mapping[str, Mapping[str, Estimated]] = field(default_factory=dict, hash=False)
    # record -> parameter -> value; empty where one value explains all records
    shape: str = ""  # of the effect, where several of a kind share the place

    @property
    def key(self) -> tuple[str, str]:
        """Kind and place as the ranking has them, with the shape (`Effect.key`)."""
        return self.kind, f"{self.where}: {self.shape}" if self.shape else self.where

    @property
    def tied(self) -> tuple[str, ...]:
        """Name and place of everything that it may be, where the record does not determine which.

        Empty where it is determined but for its variant, and of what has no name.
        """
        if not self.alternatives or self.kind == "unknown":
            return ()
        own = f"{self.kind} in {self.where}"
        names = tuple(dict.fromkeys((own, *(a.name for a in self.alternatives))))
        return names if len(names) > 1 else ()

    @property
    def is_inseparable(self) -> bool:
        """True where all that it may be is one term of the equations: no record separates that."""
        return bool(self.alternatives) and all(a.is_same_term for a in self.alternatives)

    @property
    def words(self) -> str:
        """The effect in words."""
        return effect_words(self.kind, self.where, description=self.description)

    def in_units(self, units: Mapping[str, str]) -> Cause:
        """The cause with its parameters in the units that `units` has for them.

        What is no parameter of a model (the limit of clipped samples) has the channel's unit; the
        times of a delay and of a step are seconds, also where the channel is a pulse width, and a
        share and the error of a gain have no unit, also where the channel has ppm.
        """
        channel = None if self.kind in LATE else units.get(self.where)

        def converted(p: Estimated) -> Estimated:
            """A parameter in its declared unit, or in that of the channel it acts on."""
            shares = ("share", *(f"{what}_{self.where}" for what in _SHARES))
            is_ratio = p.unit == "1" and p.name in shares
            if is_ratio or (p.name in ("time", "end") and p.unit == "s"):
                return p
            if p.name not in units and channel is not None and si_unit(channel) == p.unit:
                return p if parse_unit(channel).offset else p.in_unit(channel)
            return p.in_unit(units.get(p.name, p.unit))

        return replace(
            self,
            parameters=tuple(converted(p) for p in self.parameters),
            by_record={
                record: {n: converted(p) for n, p in values.items()}
                for record, values in self.by_record.items()
            },
        )

    def to_json(self) -> dict[str, Any]:
        """The fields as `diagnosis.json` holds them."""
        return {
            "kind": self.kind,
            "where": self.where,
            "p_value": self.p_value,
            "parameters": {p.name: _as_json(p) for p in self.parameters},
            "alternatives": [a.to_json() for a in self.alternatives],
            "share": self.share,
            "sentence": self.sentence,
            "description": self.description,
            "by_record": {
                record: {n: _as_json(p) for n, p in values.items()}
                for record, values in self.by_record.items()
            },
        }

    def __repr__(self) -> str:
        sizes = ", ".join(f"{p!r}"[1:-1] for p in self.parameters)
        return f"<Cause {self.kind} in {self.where}: {sizes or 'no size'}>"


@dataclass(frozen=True, slots=True)
class Doubts:
    """What contradicts the model although no effect of the catalogue explains it.

    Attributes
    ----------
    is_more_than_noise : the test of the remainder finds that it is no noise.
    disagreements : a sentence for each parameter on which the records disagree, the worst first.
    bounds : parameters that the fit holds at a bound, where they decide the verdict; in words.
    poor : outputs that the model explains next to nothing of, each with its fit.
    held_out : how what was held out contradicts a model that leaves noise of what was fitted.
    """

    is_more_than_noise: bool = False
    disagreements: tuple[str, ...] = ()
    bounds: Mapping[str, str] = field(default_factory=dict, hash=False)
    poor: tuple[str, ...] = ()
    held_out: str = ""

    @property
    def said(self) -> str:
        """The doubts in words; empty where nothing contradicts the model."""
        said = []
        if self.is_more_than_noise:
            said.append("the remainder is not random")
        if self.disagreements:
            said.append(self.worst)
        if self.poor:
            said.append(f"the model explains next to nothing of {', '.join(self.poor)}")
        return ", and ".join(said)

    @property
    def worst(self) -> str:
        """On what the records disagree most, without the numbers; empty where on nothing."""
        return self.disagreements[0].partition(" (")[0] if self.disagreements else ""


NO_DOUBTS = Doubts()


@dataclass(frozen=True, slots=True)
class Ranked:
    """One candidate of the catalogue as the first round saw it."""

    kind: str
    where: str
    p_value: float  # of this candidate alone
    adjusted: float  # family-wise
    gain: float | None  # fall of the criterion after a refit, None where it was not refitted
    status: str  # "named", "cannot be rejected", "rejected", "not significant", "invisible"
    why: str = ""
    law: str = ""  # that it is called by (`law_of`)

    @property
    def words(self) -> str:
        """The effect in words."""
        return effect_words(self.kind, self.where, description=self.law)


def _as_json(p: Estimated) -> dict[str, Any]:
    """A size as `diagnosis.json` has it, with its interval where that is not the normal one."""
    whole = p.to_json()
    kept = ["value", "std_error", "unit", *(("interval", "interval_kind") if p.ends else ())]
    return {name: whole[name] for name in kept}
