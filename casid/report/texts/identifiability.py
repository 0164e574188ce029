"""What records can determine and what discretisation biases, as documents."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from casid.identifiability.records.practical_result import UNDETERMINED, Practical, Row
from casid.identifiability.remedies.sensor_subsets import SensorSubsets
from casid.identifiability.symbolic.observability_matrix import ObservabilityMatrix
from casid.identifiability.symbolic.reduced_form import ReducedForm
from casid.linear.sampled.discretisation_bias import BiasTable
from casid.model.units import difference_from_si, from_si
from casid.report.document import Code, Document, Labelled, Table
from casid.report.numbers import number_text, value_text

WIDEST = 110
"""A matrix with longer lines is written entry by entry."""


def practical_document(found: Practical) -> Document:
    """Expected errors of every parameter and initial state, and the weakest combinations."""
    parts: list[str | Labelled | Table] = [
        practical_table(found),
        f"  {RELATIVE}",
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
        for name, sd in noise.sd.items():
            unit = noise.unit[name]
            size = f"{float(difference_from_si(sd, unit)):.3g} {unit}".removesuffix(" 1")
            parts.append(("noise", f"{name} {size} ({noise.source[name]})"))
    else:
        text = (
            f"{next(iter(noise.source.values()))}; the errors are relative to each other only. "
            "Give noise={output: standard deviation} to have them judged"
        )
        parts.append(("noise", text))
    parts.append(f"  The error bars assume {found.assumes}")
    return Document(
        f"Practical identifiability of {found.problem} from {', '.join(found.records)} "
        f"({found.samples} samples)",
        parts,
        label=15,
    )


RELATIVE = (
    "relative: the standard error over the value; of an initial state, over the rms of the state "
    "in the records where that is more"
)
"""What a column of `practical_table` has."""


def practical_table(found: Practical) -> Table:
    """Expected errors, one row a parameter or initial state."""
    return Table(
        ("", "unit", "value", "std. error", "relative", "correlated", "with these records"),
        [_cells(r) for r in found.rows],
        numbers=(2, 3, 4),
        caption=f"Expected errors from {', '.join(found.records)} ({found.samples} samples)",
    )


def _cells(row: Row) -> tuple[str, ...]:
    def percent(share: float | None) -> str:
        return "--" if share is None or not math.isfinite(share) else f"{100 * share:.3g} %"

    close = "--" if row.correlation is None else f"{row.correlation:+.3f} {row.partner}"
    unit = row.declared or row.unit
    size = float(difference_from_si(row.std_error, unit))
    error = number_text(size) if math.isfinite(size) else "--"
    is_long = row.verdict == UNDETERMINED and row.note.count(",") > 1
    note = "only in combination, see below" if is_long else row.note
    verdict = f"{row.verdict}: {note}" if note else row.verdict
    value = value_text(float(from_si(row.value, unit)))
    return Code(row.name), unit, value, error, percent(row.relative), close, verdict


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


def subsets_document(found: SensorSubsets) -> Document:
    """Every subset of the outputs, the sufficient ones marked."""
    n = len(found.parameters)
    rows = [
        (
            "*" if s in found.cheapest else "+" if s in found.minimal else "",
            f"{s.cost:g}",
            str(s.rank),
            str(s.deficiency),
            f"{len(s.identifiable)} of {n}",
            ", ".join(s.outputs),
        )
        for s in found.subsets
    ]
    head = ("", "cost", "rank", "deficiency", "identifiable", "outputs")
    notes = ["* the cheapest as informative as all outputs, + other minimal ones"]
    if found.error_bound:
        notes.append(f"probability that any row is wrong: below {found.error_bound:.1e}")
    if not found.is_certified:
        notes.append("special values: later derivatives might raise a deficient rank")
    return Document(
        f"{found.name}: {len(found.subsets)} subsets of outputs, {found.unknowns} unknowns, "
        f"{n} of them parameters",
        [Table(head, rows, numbers=(1, 2, 3, 4), widths=(1, 6, 6, 12, 14), indent=0), *notes],
    )


def observability_document(found: ObservabilityMatrix) -> Document:
    """The matrix under its columns."""
    m, n = found.matrix.shape
    title = f"Extended observability matrix of {found.system}: {m} x {n}, rank {found.rank()}"
    return _matrix_document(title, found.matrix, found.row_names, found.columns)


def reduced_document(found: ReducedForm) -> Document:
    """The form under its columns."""
    title = f"Row-reduced observability matrix of {found.system}, rank {found.rank}"
    return _matrix_document(title, found.matrix, found.row_names, found.columns)


def _matrix_document(
    title: str, matrix: Any, rows: Sequence[str], columns: Sequence[str]
) -> Document:
    """A labelled matrix in aligned columns; where that is too wide, its entries one by one."""
    cells = [[name, *map(str, matrix.row(i))] for i, name in enumerate(rows)]
    table = Table(["", *columns], cells, numbers=range(1, len(columns) + 1), indent=0)
    if max(map(len, table.lines())) <= WIDEST:
        return Document(title, [table])
    entries = [
        (f"{row}, {column}", cell)
        for row, *found in cells
        for column, cell in zip(columns, found, strict=True)
        if cell != "0"
    ]
    width = max((len(label) for label, _ in entries), default=0)
    note = "(row, column: entry; all others are 0)"
    return Document(title, [note, *entries], label=width + 2)
