"""A diagnosis and its parts as documents: what `print` and notebooks show."""

from __future__ import annotations

import math
from collections.abc import Iterator

from casid.diagnosis.advice.isolability import Isolability
from casid.diagnosis.advice.next_experiment import Advice
from casid.diagnosis.calibration.calibration import Calibration
from casid.diagnosis.diagnosis import Cause, Diagnosis
from casid.diagnosis.facts import Facts
from casid.estimation.estimate import Estimated
from casid.model.effects.names import effect_words
from casid.model.quantities import count_text, instant_text, p_statement, shortened
from casid.report.document import Code, Document, Identifier, Labelled, Table, labelled
from casid.report.numbers import in_readable_unit, interval_text, number_text

_LISTED = 5  # of what the page has in full
_REFUSED = 3  # effects that were significant but not accepted
_PAIRS = 12  # of causes that are hardest to separate
_NEVER = 1e6  # beyond it, an energy means never


def diagnosis_document(diagnosis: Diagnosis) -> Document:
    """Verdict, causes, gain and what else there is, one line each."""
    d = diagnosis
    parts: list[str | Labelled | Table] = [f"  {d.sentence}"]
    for i, c in enumerate(d.causes, 1):
        parts += _cause(i, c)
    parts += [("remainder", line) for c in d.remainders for line in _remainder(c)]
    parts += [("disturbance", each.sentence) for each in d.disturbances]
    parts += [_gain(d)] if Facts.of(d).changes else []
    if d.remaining is not None:
        parts.append(("remains", d.remaining.sentence))
    if d.unexplained is not None:
        parts += labelled("unknown", d.unexplained.sentences)
    parts += [("moved", line) for line in _moved(d)]
    if d.isolability is not None:
        # Of causes that act alike here, those that a named one is among; the page has them all.
        # The size of the misfit may separate them all the same: rivals stand beside their cause.
        named = {(c.kind, c.where) for c in d.causes}
        groups = [g for g in d.isolability.groups if named & set(g)]
        for group in groups:
            words = [d.isolability.words(key) for key in group]
            parts.append(("nearly alike", shortened(words, _LISTED)))
    parts += [("noise", f"{k}: {v}") for k, v in d.noise.items()]
    for is_structural, record in ((True, "any record of these channels"), (False, "this record")):
        names = [i.words for i in d.undetectable if i.is_structural == is_structural]
        if names:
            parts.append(("undetectable", f"in {record}: {shortened(names, _LISTED)}"))
    if d.calibration is not None:
        parts += labelled("false alarms", (d.calibration.sentence, *d.calibration.notes))
    parts += [("note", n) for n in _notes(d)]
    parts.append(("advice", d.advice))
    if d.proposals and not d.advice.startswith("To separate") and d.proposals[0].is_feasible:
        parts.append(("next", d.proposals[0].description))
    return Document(f"Diagnosis of {d.problem}: {d.verdict}", parts)


def _notes(d: Diagnosis) -> Iterator[str]:
    """The notes, of effects that were not accepted the first few."""
    refused = d.not_accepted
    yield from (n for n in d.notes if n not in refused[_REFUSED:])
    if len(refused) > _REFUSED:
        others = count_text(len(refused) - _REFUSED, "other effect")
        yield f"{others} likewise: the report and diagnosis.json have all notes"


def _gain(d: Diagnosis) -> Table:
    rows = []
    for c, texts, unit in Facts.of(d).change_texts():
        rows.append((c.part, f"{c.output} [{unit}]" if unit else c.output, *texts))
    head = ("rms error", "output", "before", "after", "noise floor")
    return Table(head, rows, numbers=(2, 3, 4), widths=(22, 14, 12, 12, 13))


def _cause(i: int, c: Cause) -> Iterator[str]:
    values = ", ".join(_value(p) for p in c.parameters)
    like = c.description.partition(". ")[0].rstrip(".")  # the whole stands under "unknown"
    if c.kind == "time_delay" and c.words != effect_words(c.kind, c.where):
        like = ""  # the words say it
    yield (
        f"  {i}. {'one of: ' if c.tied else ''}{c.words} [{c.kind}] "
        f"({p_statement(c.p_value, '.1e')})"
        + (f": {like}" if like else "")
        + (f"{';' if like else ':'} {values}" if values else "")
    )
    for record, found in c.by_record.items():
        yield f"     {record}: " + ", ".join(_value(p) for p in found.values())
    for a in c.alternatives:
        against = "" if a.is_as_likely else f" ({p_statement(a.p_value)} against the named one)"
        yield f"     or {a.words} [{a.kind}]{against}: {a.why}"


def _remainder(c: Cause) -> Iterator[str]:
    like = f" ({c.description.rstrip('.')})" if c.kind == "unknown" and c.description else ""
    values = "".join(f"{_value(p)}, " for p in c.parameters)
    p = p_statement(c.p_value, ".1e")
    yield f"{c.words}{like}: {values}{100 * c.share:.2g} % of the misfit, {p}"


def _value(p: Estimated) -> str:
    """A parameter with its error; an instant as its sample time resolves it."""
    if p.resolution is not None:
        return f"{p.name} = {instant_text(p.value, p.resolution)}"
    p = in_readable_unit(p)
    error = f" +- {p.std_error:.2g}" if p.std_error is not None else ""
    unit = f" {p.unit}" if p.unit != "1" else ""
    between = f"{interval_text(p)}; " if p.interval_kind == "one-sided" else ""
    why = f" ({between}{p.note})" if p.note and p.std_error is None else ""
    return f"{p.name} = {_digits(p)}{error}{unit}{why}"


def _digits(p: Estimated) -> str:
    """A value to the second digit of its error, four digits at least and nine at most.

    A time without an error is an instant, which four digits may not separate from others.
    """
    digits = 4
    if p.std_error and p.value:
        digits += max(0, math.floor(math.log10(abs(p.value) / p.std_error)) - 2)
    elif p.unit == "s" and abs(p.value) >= 1e3:
        digits = math.floor(math.log10(abs(p.value))) + 3
    return f"{p.value:.{min(digits, 9)}g}"


def _moved(d: Diagnosis) -> Iterator[str]:
    for m in d.moved[:_LISTED]:
        far = "" if m.shift is None else f", by {abs(m.shift):.3g} standard errors"
        unit = f" {m.unit}" if m.unit != "1" else ""
        before, after = _apart(m.before, m.after)
        yield f"{m.name} from {before} to {after}{unit}{far}"
    if len(d.moved) > _LISTED:
        yield f"and {len(d.moved) - _LISTED} more"


def _apart(a: float, b: float) -> tuple[str, str]:
    """Two values to the second digit of their difference, four digits at least and nine at most."""
    largest, apart = max(abs(a), abs(b)), abs(a - b)
    digits = 4
    if 0.0 < apart < largest < math.inf:
        digits = max(4, math.floor(math.log10(largest)) - math.floor(math.log10(apart)) + 2)
    return f"{a:.{min(digits, 9)}g}", f"{b:.{min(digits, 9)}g}"


def isolability_document(found: Isolability) -> Document:
    """The pairs of causes that are hardest to separate, and groups that act nearly alike."""
    return Document(
        f"Hardest to distinguish: energy for a margin of {found.margin:g} BIC with probability "
        f"{found.power:g}",
        [
            pairs_table(found),
            *(f"  nearly alike: {', '.join(found.words(k) for k in g)}" for g in found.groups),
        ],
    )


def pairs_table(found: Isolability, *, in_words: bool = False) -> Table:
    """The pairs of causes that are hardest to distinguish, the hardest first."""

    def named(kind: str, where: str) -> tuple[str, ...]:
        words = effect_in_words(kind, where, found.laws.get((kind, where), ""))
        return words if in_words else effect_name(kind, where)

    rows = [
        (
            named(*p.first),
            named(*p.second),
            f"{p.cosine:+.3f}",
            number_text(p.energy) if p.energy < _NEVER else "never",
        )
        for p in found.pairs[:_PAIRS]
    ]
    return Table(
        ("cause", "or", "cosine", "energy needed"),
        rows,
        numbers=(2, 3),
        widths=(40, 40, 8, 15),
        caption="Hardest to distinguish. Energy: of the misfit, in units of the noise, at which "
        f"the right one wins by {found.margin:g} units of BIC with probability {found.power:g}",
    )


def effect_name(kind: str, where: str) -> tuple[str, ...]:
    """An effect and its place, as code."""
    return Code(kind), " in ", Code(where)


def effect_in_words(kind: str, where: str, description: str = "") -> tuple[str, ...]:
    """An effect and its place in words, and its identifier."""
    return effect_words(kind, where, description=description), " ", Identifier(kind)


def advice_document(advice: Advice) -> Document:
    """Experiments that separate the tied causes, beside the same record again."""
    rows = [
        (
            p.name,
            f"{p.cosine:.3f}",
            *(_number(x) for x in (p.energy_needed, p.gain_factor, p.record_length)),
        )
        for p in (advice.now, *advice.proposals)
    ]
    head = ("experiment", "cosine", "energy needed", "gain", "seconds")
    return Document(
        f"To separate {' / '.join(advice.words or [effect_words(*k) for k in advice.tied])}",
        [
            Table(head, rows, numbers=(1, 2, 3, 4), widths=(26, 8, 15, 8, 10)),
            f"  {advice.sentence}",
        ],
    )


def calibration_document(found: Calibration) -> Document:
    """The false alarms counted, and what is to be known of them."""
    notes = [("note", note) for note in found.notes]
    title = f"Calibration of {found.problem} (seed {found.seed})"
    return Document(title, [f"  {found.sentence}.", *notes])


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "never"
