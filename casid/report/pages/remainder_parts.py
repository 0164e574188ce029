"""Parts of the report of a diagnosis: the remainder, and parameters that moved."""

from __future__ import annotations

from casid.diagnosis.diagnosis import Diagnosis
from casid.diagnosis.facts import Facts
from casid.diagnosis.thresholds import JUDGING
from casid.estimation.estimate import Estimated
from casid.model.effects.names import unsaid
from casid.model.quantities import quantity_text
from casid.report.document import Code, Inline, Paragraph, Part, Table
from casid.report.numbers import (
    change_text,
    number_text,
    p_text,
    plus_minus,
    share_text,
)
from casid.report.texts.diagnosis import effect_in_words


def gain_table(d: Diagnosis) -> Table:
    """Rms errors before and after beside the noise floor."""
    rows = []
    for c, texts, unit in Facts.of(d).change_texts():
        before, after, floor = (text or "\u2013" for text in texts)
        change = "\u2013" if c.after is None else change_text(c.before, c.after)
        rows.append((c.part, c.output, unit, before, after, change, floor))
    return Table(
        ("part", "output", "unit", "before", "after", "change", "noise floor"),
        rows,
        numbers=(3, 4, 5, 6),
        caption="Root mean square simulation error",
    )


def remaining_parts(d: Diagnosis) -> list[Part]:
    """What each cause explains of the misfit, and what none does."""
    r = d.remaining
    if r is None:
        return []
    parts: list[Part] = [r.sentence]
    if r.p_value is not None:
        test = r.test or "test of the remainder"
        parts.append(Paragraph(f"{test}: p {p_text(r.p_value)}", look="facts"))
    if r.explained:
        rows: list[tuple[Inline, str]] = [
            *(
                (effect_in_words(e.kind, e.where, e.description), share_text(e.share))
                for e in r.explained
            ),
            ("unexplained", share_text(r.unexplained)),
        ]
        caption = "Share of the excess misfit"
        parts.append(Table(("cause", "share"), rows, numbers=(1,), caption=caption))
    over = [(output, number_text(ratio)) for output, ratio in r.over_floor.items()]
    caption = "RMS error of the remainder, in units of the noise floor"
    return [*parts, Table(("output", "error over floor"), over, numbers=(1,), caption=caption)]


def small_remainders(d: Diagnosis) -> list[Part]:
    """Effects that are significant, but too small a share of the misfit to be causes."""
    if not d.remainders:
        return []
    rows = [
        (
            effect_in_words(c.kind, c.where, c.description),
            share_text(c.share),
            p_text(c.p_value),
            unsaid(c.words, c.description),
        )
        for c in d.remainders
    ]
    caption = (
        "Significant, but of no practical size: each explains less than "
        f"{100 * JUDGING.practical:g} % of the misfit. The extended model has it only where the "
        "size of a cause depends on it"
    )
    head = ("effect", "share of the misfit", "p", "description")
    return [Table(head, rows, numbers=(1, 2), caption=caption)]


def disturbance_parts(d: Diagnosis) -> list[Part]:
    """Random forces that nobody recorded: no deficiency of the model."""
    if not d.disturbances:
        return []
    rows = [
        (
            Code(each.place),
            number_text(each.std),
            each.unit,
            "\u2013" if each.peak is None else quantity_text(each.peak, "Hz"),
            "all frequencies" if each.bandwidth is None else quantity_text(each.bandwidth, "Hz"),
            share_text(each.share),
        )
        for each in d.disturbances
    ]
    head = ("where", "standard deviation", "unit", "peak at", "bandwidth", "share of the residual")
    caption = "Random forces that no function of states, inputs, channels or time explains"
    return [Table(head, rows, numbers=(1, 3, 4, 5), caption=caption)]


def moved_table(d: Diagnosis) -> Table:
    """Parameters that the missing causes had biased."""
    rows = []
    for m in d.moved:
        before, after = (
            plus_minus(Estimated(m.name, value, m.unit, std_error=error))
            for value, error in ((m.before, m.std_error_before), (m.after, m.std_error_after))
        )
        shift = "\u2013" if m.shift is None else f"{m.shift:+.1f}"
        rows.append((m.name, m.unit, before, after, number_text(m.bias), shift))
    return Table(
        ("parameter", "unit", "before", "after", "bias removed", "moved"),
        rows,
        numbers=(2, 3, 4, 5),
        caption="Estimates without and with the named causes. Bias removed: the error that leaving "
        "them out had caused; moved: in standard errors, the larger of those before and after",
    )
