"""An assessment as a document: the answer first, then what it rests on, and remedies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from casid.identifiability.assessment import Answer, Assessment
from casid.identifiability.combinations.family import Family
from casid.model.quantities import shortened
from casid.report.document import Document, labelled

_LISTED = 12  # fixing sets


def assessment_document(assessment: Assessment) -> Document:
    """The answer, what it rests on, what is confounded, remedies, and what records give."""
    a = assessment
    sections: tuple[tuple[str, Sequence[str]], ...] = (
        ("parameters", _verdicts(a.parameters, a)),
        ("states", _states(a.states)),
        ("confounded", [group_words(g) for g in a.confounded_groups]),
        ("equivalent", [line for _, lines in family_lines(a) for line in lines]),
        ("remedies", _remedies(a)),
        ("unknown", _classes(a)),
        ("inputs", [f"with {_answer(k, v)}" for k, v in a.by_excitation.items()]),
        ("records", [line for e in a.excitations for line in str(e).splitlines()]),
        ("expected", str(a.practical).splitlines() if a.practical else []),
        ("profiles", str(a.profiles).splitlines() if a.profiles else []),
        ("notes", a.notes),
    )
    return Document(
        f"Identifiability of {a.name}: rank {a.rank} of {a.unknowns}",
        [
            f"  {a.sentence}",
            f"  {a.certainty}",
            *(line for title, texts in sections for line in labelled(title, texts)),
        ],
        label=12,
        width=98,
    )


def verdict_words(a: Assessment, name: str) -> str:
    """Structural and practical verdict of a parameter together: never, not so, or how well."""
    verdict = a.parameters.get(name, "unknown")
    if verdict == "not_identifiable":
        return "structurally unidentifiable"
    if verdict == "unknown":
        return "undecided"
    if name in a.unexcited:
        acting = dict.fromkeys(r.unknown for e in a.excitations for r in e.references)
        return f"identifiable, but {', '.join(acting)} does not act in these records"
    if a.practical is None:
        return "identifiable"
    row = next((r for r in a.practical.parameters if r.name == name), None)
    if row is None or row.verdict in ("well determined", "seen, not judged"):
        return "identifiable"
    return f"identifiable, but not with these records: {row.verdict}"


def _verdicts(verdicts: Mapping[str, str], a: Assessment) -> list[str]:
    by_word: dict[str, list[str]] = {}
    for name in verdicts:
        by_word.setdefault(verdict_words(a, name), []).append(name)
    return [f"{word}: {shortened(names)}" for word, names in by_word.items()]


def _states(states: Mapping[str, str]) -> list[str]:
    by_word: dict[str, list[str]] = {}
    for name, verdict in states.items():
        by_word.setdefault(verdict.replace("_", " "), []).append(name)
    return [f"{word}: {shortened(names)}" for word, names in by_word.items()]


def group_words(group: Sequence[str]) -> str:
    """What a confounded group means."""
    if len(group) == 1:
        return f"{group[0]} can have any value, whatever the other parameters are"
    return f"{', '.join(group)} can be traded for each other"


def family_lines(a: Assessment) -> list[tuple[str, list[str]]]:
    """What moves, and lines about it: a curve each, then groups that move along several curves."""
    alone = {f.free for f in a.families if _moves_elsewhere(f, a)}
    out = []
    for f in a.families:
        if len(f.moved) > 1 or not f.is_closed:
            lines = str(f).splitlines()
            if f.free in alone:
                lines = [x.replace("invariants:", "on this curve alone, unchanged:") for x in lines]
            out.append((f.free, lines))
    for found in a.identifiable_combinations:
        if alone & set(found.group) and found.combinations:
            more = "" if found.is_complete else ", and more"
            names = ", ".join(found.group)
            combinations = ", ".join(map(str, found.combinations))
            words = f"identifiable combinations of {names}: {combinations}{more}"
            out.append((names, [words]))
    return out


def _moves_elsewhere(f: Family, a: Assessment) -> bool:
    """True if an invariant of this family may change along another one."""
    group = next((g for g in a.confounded_groups if f.free in g), ())
    if sum(other.free in group for other in a.families) > 1:
        return True
    kept = [
        c
        for found in a.identifiable_combinations
        if f.free in found.group
        for c in found.combinations
    ]
    return not set(f.invariants) <= set(kept)


def _remedies(a: Assessment) -> list[str]:
    if a.is_identifiable:
        return []
    lines = [a.remedy()] if a.remedy() else []
    if a.fixing is not None and 1 < a.fixing.count:
        shown = ["{" + ", ".join(s) + "}" for s in a.fixing.sets[:_LISTED]]
        more = f", ... ({a.fixing.count} in all)" if a.fixing.count > len(shown) else ""
        lines.append(f"minimal fixing sets: {', '.join(shown)}{more}")
    lines += exclusion_lines(a)
    if a.replicas is not None:
        lines += str(a.replicas).splitlines()
    if a.remedies is not None:
        lines += str(a.remedies).splitlines()
    return lines


def exclusion_lines(a: Assessment) -> list[str]:
    """How many sets of each size are not identifiable although all others are known."""
    counted = [f"{e.count} of {e.total} of size {e.size}" for e in a.exclusions if e.count]
    if not counted:
        return []
    return [f"sets not identifiable with all others known: {', '.join(counted)}"]


def _classes(a: Assessment) -> list[str]:
    if not a.by_class:
        return []
    lines = [f"inputs {', '.join(a.unknown_inputs)}"]
    lines += [_answer(k, v) for k, v in a.by_class.items()]
    return lines + list(a.eliminated)


def _answer(label: str, answer: Answer) -> str:
    if answer.rank is None:
        return f"{label}: no answer, {answer.note}"
    lost = answer.not_identifiable
    verdict = f"not identifiable: {', '.join(lost)}" if lost else "all parameters identifiable"
    return f"{label}: rank {answer.rank} of {answer.unknowns}, {verdict}"
