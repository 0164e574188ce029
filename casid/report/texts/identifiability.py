"""What records can determine and what discretisation biases, as documents."""

from __future__ import annotations

import math

from casid.identifiability.records.practical_result import UNDETERMINED, Practical, Row
from casid.linear.discretisation_bias import BiasTable
from casid.report.document import Document, Labelled, Table


def practical_document(found: Practical) -> Document:
    """Expected errors of every parameter and initial state, and the weakest combinations."""
    head = ("", "unit", "value", "std. error", "relative", "correlated", "with this record")
    parts: list[str | Labelled | Table] = [
        Table(head, [_cells(r) for r in found.rows]),
        (
            "sensitivities",
            f"rank {found.rank} of {found.unknowns}, condition {found.condition:.3g}",
        ),
        *(("weakest", str(d)) for d in found.weakest[:2]),
    ]
    if found.undetermined:
        parts.append(("not seen", found.undetermined))
    noise = found.noise
    if noise.is_absolute:
        parts += [("noise", f"{n} {sd:.3g} ({noise.source[n]})") for n, sd in noise.sd.items()]
    else:
        text = (
            f"{next(iter(noise.source.values()))}; the errors are relative to each other only. "
            "Give noise={output: standard deviation} to have them judged"
        )
        parts.append(("noise", text))
    parts.append(f"  What the error bar assumes: {found.assumes}")
    return Document(
        f"Practical identifiability of {found.problem} from {', '.join(found.records)} "
        f"({found.samples} samples)",
        parts,
        label=15,
    )


def _cells(row: Row) -> tuple[str, ...]:
    def percent(share: float | None) -> str:
        return "--" if share is None or not math.isfinite(share) else f"{100 * share:.3g} %"

    close = "--" if row.correlation is None else f"{row.correlation:+.3f} {row.partner}"
    error = f"{row.std_error:.3g}" if math.isfinite(row.std_error) else "--"
    is_long = row.verdict == UNDETERMINED and row.note.count(",") > 1
    note = "only in combination, see below" if is_long else row.note
    verdict = f"{row.verdict}: {note}" if note else row.verdict
    return row.name, row.unit, f"{row.value:.5g}", error, percent(row.relative), close, verdict


def bias_document(found: BiasTable) -> Document:
    """Relative bias of every free parameter by sample time and method."""
    rows = [
        (
            f"{row.Ts:.4g}",
            row.method,
            f"{row.scale:.3e}",
            *(f"{row.bias[n]:+.3e}" for n in found.free),
        )
        for row in found.rows
    ]
    head = ("Ts [s]", "method", "(w T)^2/12", *found.free)
    n = len(found.free)
    numbers, widths = (0, *range(2, n + 3)), (10, 9, 12, *[12] * n)
    return Document(
        f"Relative bias of the regression of {found.output}; truth: {found.truth}",
        [Table(head, rows, numbers=numbers, widths=widths)],
    )
