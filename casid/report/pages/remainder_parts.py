"""Parts of the page of a diagnosis: the remainder, and parameters that moved."""

from __future__ import annotations

from casid.diagnosis.diagnosis import Diagnosis
from casid.estimation.estimate import Estimated
from casid.report.pages.markup import Html, element, join, paragraph, safe, table
from casid.report.pages.numbers import change_text, number_text, p_text, plus_minus


def gain_table(d: Diagnosis) -> Html:
    """Rms errors before and after beside the noise floor."""
    units = d.output_units
    rows = []
    for part, numbers in (("fitted", d.fitted), ("held out", d.held_out)):
        for output, before in numbers.get("baseline_rmse", {}).items():
            after = numbers.get("extended_rmse", {}).get(output)
            floor = numbers.get("noise_floor", {}).get(output)
            rows.append(
                (
                    part,
                    output,
                    units.get(output, ""),
                    number_text(before),
                    "\u2013" if after is None else number_text(after),
                    "\u2013" if after is None else change_text(before, after),
                    "\u2013" if floor is None else number_text(floor),
                )
            )
    if not rows:
        return Html("")
    return table(
        "Root mean square simulation error",
        ("part", "output", "unit", "before", "after", "change", "noise floor"),
        rows,
        numbers=(3, 4, 5, 6),
    )


def remaining_part(d: Diagnosis) -> Html:
    """What each cause explains of the misfit, and what none does."""
    r = d.remaining
    if r is None:
        return Html("")
    parts = [paragraph(r.sentence)]
    if r.p_value is not None:
        test = r.test or "test of the remainder"
        parts.append(element("p", f"{test}: p {p_text(r.p_value)}", class_="facts"))
    if r.explained:
        rows = [
            (element("code", e.kind), element("code", e.where), _share(e.share))
            for e in r.explained
        ]
        rows.append((safe("unexplained"), safe(""), _share(r.unexplained)))
        parts.append(
            table("Share of the excess misfit", ("cause", "where", "share"), rows, numbers=(2,))
        )
    if r.over_floor:
        parts.append(
            table(
                "RMS error of the remainder, in units of the noise floor",
                ("output", "error over floor"),
                [(output, number_text(ratio)) for output, ratio in r.over_floor.items()],
                numbers=(1,),
            )
        )
    return join(parts)


def moved_part(d: Diagnosis) -> Html:
    """Parameters that the missing causes had biased."""
    if not d.moved:
        return Html("")
    rows = []
    for m in d.moved:
        before, after = (
            plus_minus(Estimated(m.name, value, m.unit, std_error=error))
            for value, error in ((m.before, m.std_error_before), (m.after, m.std_error_after))
        )
        shift = "\u2013" if m.shift is None else f"{m.shift:+.1f}"
        rows.append((m.name, m.unit, before, after, number_text(m.bias), shift))
    return table(
        "Estimates without and with the named causes. Bias: what leaving them out had added; "
        "moved: in standard errors of the estimate after",
        ("parameter", "unit", "before", "after", "bias removed", "moved"),
        rows,
        numbers=(2, 3, 4, 5),
    )


def _share(share: float) -> str:
    return f"{100 * share:.1f} %"
