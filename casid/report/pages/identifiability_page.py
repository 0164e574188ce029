"""The page of an assessment: the answer, what is identifiable instead, and the remedies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from casid.identifiability.assessment import Answer, Assessment
from casid.report.figures.identifiability import figures
from casid.report.figures.look import visible_text
from casid.report.pages.estimate_parts import notice, provenance
from casid.report.pages.markup import (
    Html,
    bullets,
    element,
    join,
    mapping_table,
    paragraph,
    safe,
    table,
)
from casid.report.pages.numbers import number_text, value_text
from casid.report.pages.page import Page
from casid.report.texts.assessment import family_lines, group_words, verdict_words

_LISTED = 60  # fixing sets in the table


def assessment_page(assessment: Assessment) -> str:
    """The assessment as one self-contained HTML page."""
    a = assessment
    page = Page(figures(a))
    page.section("", _banner(a), _cards(a), notice(a.notes, ()))
    page.section("Parameters", _parameters(a), _advice(a))
    page.section("Identifiable combinations", _groups(a), _families(a))
    page.section("Remedies", _fixing(a), _exclusions(a), _further(a))
    page.section("States", _states(a))
    page.section("Unknown inputs", _classes(a))
    page.section("Poorer excitation", _excitation(a))
    page.section(
        "What these records give",
        page.figure("errors"),
        _practical(a),
        page.figure("correlations"),
        page.figure("profiles"),
        _profiles(a),
        _orders(a),
    )
    page.section("What the answer rests on", paragraph(a.certainty), _facts(a))
    page.section("Provenance", *provenance((), {}, a.versions))
    page.section("References", bullets(_sources(a)))
    return page.text(f"Identifiability of {visible_text(a.name)}", "Identifiability", a.name)


def _banner(a: Assessment) -> Html:
    if a.answer.is_partial:
        word, look = "partial", "undecided"
    elif a.is_identifiable:
        word, look = "identifiable", "adequate"
    else:
        word, look = "not identifiable", "deficient"
    return element(
        "div",
        element("p", element("b", word) + safe(f"rank {a.rank} of {a.unknowns}"), class_="word")
        + element("p", a.sentence, class_="sentence"),
        class_=f"banner {look}",
        role="status",
    )


def _cards(a: Assessment) -> Html:
    identifiable = sum(v == "identifiable" for v in a.parameters.values())
    seen = sum(v == "observable" for v in a.states.values())
    bound = a.answer.error_bound
    sure = "a proof" if bound == 0.0 else f"error probability below {bound:.1e}"
    cards = [
        ("Rank", f"{a.rank} of {a.unknowns}", "partial" if a.answer.is_partial else sure),
        ("Parameters", f"{identifiable} of {len(a.parameters)}", "identifiable"),
        ("Initial states", f"{seen} of {len(a.states)}", "observable"),
    ]
    if a.fixing is not None and a.fixing.size:
        many = "" if a.fixing.is_count_exact else "at least "
        cards.append(
            (
                "To be known",
                f"{a.fixing.size}",
                f"in {many}{a.fixing.count} minimal choice{'' if a.fixing.count == 1 else 's'}",
            )
        )
    return element(
        "dl",
        join(
            element(
                "div",
                element("dt", title) + element("dd", value) + element("dd", rest, class_="rest"),
                class_="card",
            )
            for title, value, rest in cards
        ),
        class_="cards",
    )


def _parameters(a: Assessment) -> Html:
    group = {n: g for g in a.confounded_groups for n in g}
    rows: list[tuple[str, ...]] = []
    expected = {r.name: r for r in a.practical.parameters} if a.practical else {}
    for name in a.parameters:
        partners = [n for n in group.get(name, ()) if n != name]
        row = expected.get(name)
        error = "\u2013"
        if row is not None and a.parameters[name] == "identifiable":
            error = number_text(row.std_error)
        rows.append(
            (
                element("code", name),
                a.units.get(name, ""),
                verdict_words(a, name),
                ", ".join(partners),
                error,
            )
        )
    header = ["parameter", "unit", "verdict", "confounded with", "expected std. error"]
    shown = [i for i in range(5) if i in (0, 2) or any(r[i] not in ("", "\u2013") for r in rows)]
    return table(
        "Structural and practical verdict, parameter by parameter",
        [header[i] for i in shown],
        [[r[i] for i in shown] for r in rows],
        numbers=(shown.index(4),) if 4 in shown else (),
    )


def _advice(a: Assessment) -> Html | str:
    remedy = a.remedy()
    if not remedy:
        return ""
    text = remedy[0].upper() + remedy[1:] + "."
    return element("div", element("h3", "Remedy") + paragraph(text), class_="advice")


def _groups(a: Assessment) -> Html:
    return bullets([group_words(g) for g in a.confounded_groups])


def _families(a: Assessment) -> Html:
    parts = []
    for name, words in family_lines(a):
        lines = join(element("p", element("code", line)) for line in words)
        parts.append(element("div", element("h3", f"Moving {name}") + lines, class_="cause"))
    if parts:
        parts.insert(
            0,
            paragraph(
                "All values on such a curve give the same outputs; what stays the same along all "
                "curves of a group is what the data determine. Primes mark new values."
            ),
        )
    return join(parts)


def _fixing(a: Assessment) -> Html:
    f = a.fixing
    if f is None or not f.size:
        return Html("")
    names = list(a.parameters)
    rows = [
        (", ".join(s), ", ".join(n for n in names if n not in set(s))) for s in f.sets[:_LISTED]
    ]
    many = f"{f.count}" if f.is_count_exact else f"at least {f.count}"
    shown = "" if len(rows) == f.count else f"; the first {len(rows)} are shown"
    return table(
        f"Minimal fixing sets ({many}{shown}): once known, all others are identifiable",
        ("known", "then identifiable"),
        rows,
    )


def _exclusions(a: Assessment) -> Html:
    if not any(e.count for e in a.exclusions):
        return Html("")
    rows = [(str(e.size), str(e.total), str(e.count)) for e in a.exclusions]
    return table(
        "Sets of parameters that are not identifiable although all others are known",
        ("size", "sets", "not identifiable"),
        rows,
        numbers=(0, 1, 2),
    )


def _further(a: Assessment) -> Html:
    parts: list[str] = []
    r = a.replicas
    if r is not None:
        rows = [(str(k), str(d)) for k, d in enumerate(r.deficiencies, 1)]
        header = ("replicas", "deficiency of the parameters")
        parts.append(table("The same experiment, repeated", header, rows, numbers=(0, 1)))
        parts.append(paragraph(r.conclusion[0].upper() + r.conclusion[1:] + "."))
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
        parts.append(
            table(
                "What each candidate does alone",
                ("candidate", "cost", "gives", "still missing"),
                singles,
                numbers=(1,),
            )
        )
        parts += [paragraph(line.strip()) for line in a.remedies.conclusion]
    return join(parts)


def _states(a: Assessment) -> Html:
    return table(
        "Initial states",
        ("state", "verdict"),
        [(element("code", x), v.replace("_", " ")) for x, v in a.states.items()],
    )


def _classes(a: Assessment) -> Html:
    if not a.by_class:
        return Html("")
    shared = (
        f"Shared by all experiments: {', '.join(a.shared_inputs)}."
        if a.shared_inputs
        else ("Every experiment has its own." if len(a.experiments) > 1 else "")
    )
    return (
        paragraph(f"Unknown: {', '.join(a.unknown_inputs)}. {shared}")
        + _answers("The class of the unknown input changes the verdict", a.by_class)
        + bullets(a.eliminated)
    )


def _excitation(a: Assessment) -> Html:
    if not a.by_excitation:
        return Html("")
    return _answers("Ranks with known inputs that do less than they could", a.by_excitation)


def _answers(caption: str, answers: Mapping[str, Answer]) -> Html:
    rows = [
        (
            label,
            "\u2013" if v.rank is None else f"{v.rank} of {v.unknowns}",
            v.note if v.rank is None else ", ".join(v.not_identifiable) or "none",
        )
        for label, v in answers.items()
    ]
    return table(caption, ("inputs", "rank", "not identifiable"), rows)


def _practical(a: Assessment) -> Html:
    p = a.practical
    if p is None:
        return Html("")
    rows = [
        (
            element("code", r.name),
            r.unit,
            value_text(r.value),
            number_text(r.std_error) if math.isfinite(r.std_error) else "\u2013",
            "\u2013"
            if r.relative is None or not math.isfinite(r.relative)
            else f"{100 * r.relative:.3g} %",
            "\u2013" if r.correlation is None else f"{r.correlation:+.3f} {r.partner}",
            r.verdict + (f": {r.note}" if r.note else ""),
        )
        for r in p.rows
    ]
    errors = table(
        f"Expected errors from {', '.join(p.records)} ({p.samples} samples)",
        ("", "unit", "value", "std. error", "relative", "correlated", "with these records"),
        rows,
        numbers=(2, 3, 4),
    )
    weakest = bullets([f"weakest: {d}" for d in p.weakest[:3]])
    return errors + weakest + paragraph(f"What the error bar assumes: {p.assumes}.")


def _profiles(a: Assessment) -> Html:
    if a.profiles is None:
        return Html("")
    rows = [
        (
            element("code", q.name),
            q.unit,
            value_text(q.best),
            number_text(q.lower),
            number_text(q.upper),
            q.kind,
        )
        for q in a.profiles
    ]
    return table(
        f"Profile likelihood, {100 * a.profiles.confidence:g} % intervals",
        ("parameter", "unit", "best", "lower", "upper", "kind"),
        rows,
        numbers=(2, 3, 4),
    )


def _orders(a: Assessment) -> Html:
    parts: list[str] = []
    for e in a.excitations:
        rows = [
            (element("code", c.name), c.unit, str(c), number_text(c.rms))
            for c in e.signals.channels
        ]
        parts.append(
            table(
                f"Excitation orders in {e.record}",
                ("channel", "unit", "order", "rms"),
                rows,
                numbers=(3,),
            )
        )
        parts.append(bullets([*(str(r) for r in e.references), *([e.note] if e.note else [])]))
    return join(parts)


def _facts(a: Assessment) -> Html:
    facts: dict[str, str] = {
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
