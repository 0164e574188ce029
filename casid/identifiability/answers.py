"""Answers side by side: one a class of unknown inputs, one a poorer excitation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from casid.errors import CasidError
from casid.identifiability.assessment import ELIMINATED_ZERO, Answer, StateVerdict, Verdict
from casid.identifiability.equations.system import System
from casid.identifiability.inputs.input_classes import (
    Exosystem,
    as_exosystem,
    as_harmonic,
    as_polynomial,
    as_zero,
    with_input_class,
)
from casid.identifiability.question import Assumptions, Question, eliminated, prepared
from casid.identifiability.rank.observability import observability
from casid.identifiability.rank.rank_result import Observability


def answer_of(label: str, result: Observability, original: Sequence[System]) -> Answer:
    """Verdicts by name; states that only the assumed inputs have are not listed."""
    undecided = result.is_partial

    def of_parameter(is_identifiable: bool) -> Verdict:
        return "identifiable" if is_identifiable else "unknown" if undecided else "not_identifiable"

    def of_state(is_observable: bool) -> StateVerdict:
        return "observable" if is_observable else "unknown" if undecided else "not_observable"

    states: dict[str, StateVerdict] = {}
    count: dict[str, int] = {}
    for system, verdict in zip(original, result.observable, strict=True):
        count[system.name] = count.get(system.name, 0) + 1
        label_ = system.name + (f"#{count[system.name]}" if count[system.name] > 1 else "")
        for x in system.states:
            if x in verdict:
                states[x if len(original) == 1 else f"{x}@{label_}"] = of_state(verdict[x])
    return Answer(
        label=label,
        rank=result.rank,
        unknowns=result.unknowns,
        parameters={p: of_parameter(v) for p, v in result.identifiable.items()},
        states=states,
        deficiency=None if undecided else result.deficiency,
        error_bound=result.error_bound,
        is_partial=undecided,
    )


def _try(
    label: str, make: Callable[[], Sequence[System]], original: Sequence[System], **options: Any
) -> Answer:
    try:
        return answer_of(label, observability(make(), **options), original)
    except CasidError as error:
        return Answer(label, None, None, {}, {}, note=str(error))


def by_class(
    systems: Sequence[System],
    arbitrary: Answer,
    degrees: Sequence[int],
    exosystems: Mapping[str, Exosystem],
    **options: Any,
) -> dict[str, Answer]:
    """One answer a class of unknown inputs, arbitrary ones first."""
    if not any(s.unknown_inputs for s in systems):
        return {}

    def each(change: Callable[[System], System]) -> Callable[[], list[System]]:
        """Makes the systems with a change of every one that has unknown inputs."""

        def make() -> list[System]:
            once = {id(s): change(s) if s.unknown_inputs else s for s in systems}
            return [once[id(s)] for s in systems]

        return make

    table = {"arbitrary": arbitrary}
    for degree in degrees:
        label = f"polynomial_{degree}"
        change = each(lambda s, d=degree: as_polynomial(s, d))  # type: ignore[misc]
        table[label] = _try(label, change, systems, **options)
    table["harmonic"] = _try("harmonic", each(as_harmonic), systems, **options)
    for name, source in exosystems.items():
        driven = each(lambda s, e=source: as_exosystem(s, e))  # type: ignore[misc]
        table[name] = _try(name, driven, systems, **options)
    table["zero"] = _try("zero", each(as_zero), systems, **options)
    return table


def by_excitation(
    question: Question, systems: Sequence[System], assuming: Assumptions, **options: Any
) -> dict[str, Answer]:
    """Answers for poorer known inputs: all zero or constant, and their unknown sources zero.

    An input that is a function of the states carries no information although it moves: with the
    unknown input of the direct model at zero, the output it was eliminated with is one (Linder
    2017, section 7.3.1).
    """
    known = tuple(dict.fromkeys(u for s in systems for u in s.inputs))
    table: dict[str, Answer] = {}

    def poorer(kind: str) -> Callable[[], list[System]]:
        """Makes the systems with their unknown inputs in a poorer class, eliminated."""

        def make() -> list[System]:
            once = {id(s): with_input_class(s, dict.fromkeys(s.inputs, kind)) for s in systems}
            return list(eliminated([once[id(s)] for s in systems])[0])

        return make

    if known:
        for kind, label in (("zero", "zero"), ("constant", "constant")):
            name = f"{', '.join(known)} {label}"
            table[name] = _try(name, poorer(kind), systems, **options)
    if question.model is not None and question.model.eliminated_units:

        def direct() -> list[System]:
            read = prepared(question.translated(generic=assuming.generic, direct=True), assuming)
            once = {id(s): as_zero(s) for s in read}
            return [once[id(s)] for s in read]

        gone = ", ".join(question.model.eliminated_units)
        name = f"{gone} {ELIMINATED_ZERO}"
        table[name] = _try(name, direct, systems, **options)
    return table
