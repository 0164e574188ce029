"""The report of an assessment: the answer, what is identifiable instead, and the remedies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from casid.identifiability.assessment import Answer, Assessment
from casid.identifiability.records.practical_result import POOR, UNDETERMINED, Row
from casid.model.quantities import percent_text, shortened
from casid.model.units import difference_from_si, from_si
from casid.report.document import (
    Banner,
    Bullets,
    Card,
    Cards,
    Code,
    Document,
    Inline,
    Paragraph,
    Part,
    Section,
    Table,
    figure_parts,
    mapping_table,
)
from casid.report.figures.identifiability import figures
from casid.report.numbers import number_text, value_text
from casid.report.pages.estimate_parts import notice, provenance
from casid.report.texts.assessment import family_lines, group_words, verdict_words
from casid.report.texts.identifiability import RELATIVE, practical_table

_LISTED = 60  # fixing sets in the table
_OPEN = ("", "Parameters", "Identifiable combinations", "Remedies")  # in a notebook


def assessment_report(assessment: Assessment) -> Document:
    """Everything the assessment knows."""
    a = assessment
    figure = figure_parts(figures(a)).get
    sections: dict[str, list[Part]] = {
        "": [_banner(a), Cards(list(_cards(a))), notice(a.notes, ())],
        "Parameters": [_parameters(a), _advice(a)],
        "Identifiable combinations": [
            Bullets([group_words(g) for g in a.confounded_groups]),
            *_families(a),
        ],
        "Remedies": [_fixing(a), _exclusions(a), *_further(a)],
        "States": [_states(a)],
        "Unknown inputs": _classes(a),
        "Poorer excitation": [
            _answers("Rank if known inputs are zero or constant", a.by_excitation)
        ],
        "What these records give": [
            figure("errors"),
            *_practical(a),
            figure("correlations"),
            figure("profiles"),
            _profiles(a),
            *_orders(a),
        ],
        "What the answer rests on": [a.certainty, _facts(a)],
    }
    return Document(
        a.name,
        [
            *(Section(h, parts, is_open=h in _OPEN) for h, parts in sections.items()),
            provenance((), {}, a.versions),
            Section("References", [Bullets(_sources(a))]),
        ],
        kind="Identifiability",
    )


def _banner(a: Assessment) -> Banner:
    if a.answer.is_partial:
        word, look = "partial", "undecided"
    elif a.is_identifiable:
        word, look = "identifiable", "adequate"
    else:
        word, look = "not identifiable", "deficient"
    bound = a.answer.error_bound
    sure = "a proof" if bound == 0.0 else f"error probability below {bound:.1e}"
    beside = f"rank {a.rank} of {a.unknowns}" if a.answer.is_partial else sure
    sentence = f"{a.sentence} {_in_practice(a)}".rstrip()
    if look == "adequate" and _poor(a):
        look = "undecided"
    return Banner(word, beside, sentence, look)


def _expected(a: Assessment) -> list[Row]:
    """The parameters with a relative error to expect of the records, the largest first."""
    if a.practical is None or not a.practical.noise.is_absolute:
        return []
    rows = [
        r
        for r in a.practical.parameters
        if r.relative is not None and a.parameters.get(r.name) == "identifiable"
    ]
    return sorted(rows, key=lambda r: -(r.relative or 0.0))


def _poor(a: Assessment) -> list[str]:
    """Identifiable parameters that these records determine poorly or not at all."""
    rows = a.practical.parameters if a.practical else ()
    bad = {r.name for r in rows if r.verdict in (POOR, UNDETERMINED)}
    return [n for n, v in a.parameters.items() if v == "identifiable" and n in bad]


def _in_practice(a: Assessment) -> str:
    """What these records are expected to determine, in a sentence."""
    poor, expected = _poor(a), _expected(a)
    if poor:
        return f"These records determine {shortened(poor)} poorly."
    if not expected:
        return ""
    worst = expected[0]
    return (
        "With these records and white noise the largest expected standard error is "
        f"{percent_text(100 * (worst.relative or 0.0))} of the value, that of {worst.name}."
    )


def _cards(a: Assessment) -> Iterator[Card]:
    rank = f"{a.rank} of {a.unknowns}"
    yield Card("Rank", rank, rest="partial" if a.answer.is_partial else "parameters and states")
    for title, verdicts, word in (
        ("Parameters", a.parameters, "identifiable"),
        ("Initial states", a.states, "observable"),
    ):
        n = sum(v == word for v in verdicts.values())
        yield Card(title, f"{n} of {len(verdicts)}", rest=word)
    f = a.fixing
    if f is not None and f.size:
        choices = f"minimal choice{'' if f.count == 1 else 's'}"
        many = "" if f.is_count_exact else "at least "
        yield Card("To be known", f"{f.size}", rest=f"in {many}{f.count} {choices}")


def _parameters(a: Assessment) -> Table:
    group = {n: g for g in a.confounded_groups for n in g}
    rows: list[tuple[str, ...]] = []
    expected = {r.name: r for r in a.practical.parameters} if a.practical else {}
    for name in a.parameters:
        partners = [n for n in group.get(name, ()) if n != name]
        row = expected.get(name)
        unit = a.units.get(name, "") if row is None else row.declared or row.unit
        value = error = relative = "\u2013"
        if row is not None and a.parameters[name] == "identifiable":
            value = value_text(float(from_si(row.value, unit)))
            error = f"{float(difference_from_si(row.std_error, unit)):.2g}"
            relative = "\u2013" if row.relative is None else percent_text(100 * row.relative)
        verdict = verdict_words(a, name)
        cells = (Code(name), verdict, ", ".join(partners), value, error, relative, unit)
        rows.append(cells)
    header = ["parameter", "verdict", "confounded with", "value", "expected std. error"]
    header += ["of the value", "unit"]
    shown = [i for i in range(7) if i < 2 or any(r[i] not in ("", "\u2013") for r in rows)]
    return Table(
        [header[i] for i in shown],
        [[r[i] for i in shown] for r in rows],
        numbers=[shown.index(i) for i in (3, 4, 5) if i in shown],
        caption="Structural and practical verdict, parameter by parameter",
    )


def _advice(a: Assessment) -> Section | None:
    remedy = a.remedy()
    return Section("Remedy", [_as_sentence(remedy)], look="advice") if remedy else None


def _as_sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _families(a: Assessment) -> list[Part]:
    families = [
        Section(f"Moving {name}", [Paragraph(Code(line)) for line in words], look="cause")
        for name, words in family_lines(a)
    ]
    if not families:
        return []
    return [
        "All values on such a curve give the same outputs; what stays the same along all curves of "
        "a group is what the data determine. Primes mark new values.",
        *families,
    ]


def _fixing(a: Assessment) -> Table | None:
    f = a.fixing
    if f is None or not f.size:
        return None
    names = list(a.parameters)
    rows = [
        (", ".join(s), ", ".join(n for n in names if n not in set(s))) for s in f.sets[:_LISTED]
    ]
    many = f"{f.count}" if f.is_count_exact else f"at least {f.count}"
    shown = "" if len(rows) == f.count else f"; the first {len(rows)} are shown"
    caption = f"Minimal fixing sets ({many}{shown}): once known, all others are identifiable"
    return Table(("known", "then identifiable"), rows, caption=caption)


def _exclusions(a: Assessment) -> Table | None:
    if not any(e.count for e in a.exclusions):
        return None
    return Table(
        ("size", "sets", "not identifiable"),
        [(str(e.size), str(e.total), str(e.count)) for e in a.exclusions],
        numbers=(0, 1, 2),
        caption="Sets of parameters that are not identifiable although all others are known",
    )


def _further(a: Assessment) -> Iterator[Part]:
    """Repeated experiments, and candidates for what could be measured or known besides."""
    r = a.replicas
    if r is not None:
        yield Table(
            ("replicas", "deficiency of the parameters"),
            [(str(k), str(d)) for k, d in enumerate(r.deficiencies, 1)],
            numbers=(0, 1),
            caption="The same experiment, repeated",
        )
        yield _as_sentence(r.conclusion)
    if a.remedies is not None:
        singles = [
            (
                ", ".join(str(c) for c in e.candidates),
                f"{e.cost:g}",
                ", ".join(e.gained) or "nothing",
                ", ".join(e.missing) or "nothing",
            )
            for e in a.remedies.singles
        ]
        head = ("candidate", "cost", "gives", "still missing")
        yield Table(head, singles, numbers=(1,), caption="What each candidate does alone")
        yield from a.remedies.conclusion


def _states(a: Assessment) -> Table:
    rows = [(Code(x), v.replace("_", " ")) for x, v in a.states.items()]
    return Table(("state", "verdict"), rows, caption="Initial states")


def _classes(a: Assessment) -> list[Part]:
    if not a.by_class:
        return []
    shared = "Every experiment has its own." if len(a.experiments) > 1 else ""
    if a.shared_inputs:
        shared = f"Shared by all experiments: {', '.join(a.shared_inputs)}."
    return [
        f"Unknown: {', '.join(a.unknown_inputs)}. {shared}",
        _answers("The class of the unknown input changes the verdict", a.by_class),
        Bullets(a.eliminated),
    ]


def _answers(caption: str, answers: Mapping[str, Answer]) -> Table:
    rows = [
        (
            label,
            "\u2013" if v.rank is None else f"{v.rank} of {v.unknowns}",
            v.note if v.rank is None else ", ".join(v.not_identifiable) or "none",
        )
        for label, v in answers.items()
    ]
    return Table(("inputs", "rank", "not identifiable"), rows, caption=caption)


def _practical(a: Assessment) -> list[Part]:
    p = a.practical
    if p is None:
        return []
    return [
        practical_table(p),
        f"{RELATIVE.capitalize()}.",
        Bullets([f"weakest: {d}" for d in p.weakest[:3]]),
        f"The error bars assume {p.assumes}.",
    ]


def _profiles(a: Assessment) -> Table | None:
    if a.profiles is None:
        return None
    rows = []
    for q in a.profiles:
        best, lower, upper = q.shown
        ends = (number_text(lower), number_text(upper))
        rows.append((Code(q.name), q.shown_unit, value_text(best), *ends, q.kind))
    head = ("parameter", "unit", "best", "lower", "upper", "kind")
    caption = f"Profile likelihood, {100 * a.profiles.confidence:g} % intervals"
    return Table(head, rows, numbers=(2, 3, 4), caption=caption)


def _orders(a: Assessment) -> Iterator[Part]:
    head = ("channel", "unit", "order", "rms")
    for e in a.excitations:
        rows = [
            (Code(c.name), c.shown_unit, str(c), number_text(c.shown(c.rms)))
            for c in e.signals.channels
        ]
        yield Table(head, rows, numbers=(3,), caption=f"Excitation orders in {e.record}")
        notes: list[Inline] = [str(r) for r in e.references]
        yield Bullets([*notes, *([e.note] if e.note else [])])


def _facts(a: Assessment) -> Table:
    facts = {
        "experiments": ", ".join(a.experiments),
        "highest derivative needed": ", ".join(map(str, a.orders)),
        "random points": str(a.points),
        "time": f"{1000 * a.seconds:.3g} ms",
    }
    return mapping_table(facts, ("what", "value"))


def _sources(a: Assessment) -> Sequence[str]:
    found: list[Any] = [*a.sources]
    for part in (a.practical, a.profiles):
        found += list(getattr(part, "sources", ()))
    for e in a.excitations:
        found += list(e.sources)
    return tuple(dict.fromkeys(found))
