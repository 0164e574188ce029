"""Remedies for unknown inputs side by side, as documents."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from casid.report.document import Document, Table
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.comparison import Comparison
from casid.unknown_inputs.option_comparison import UnknownInputComparison

_WIDEST = 110  # characters of a line in a table of options
LONGEST = 60
"""Characters of a formula that is printed; longer ones are counted instead."""


def shown(value: Any) -> str:
    """A number to five digits, or a formula; a long formula is replaced by its size."""
    if isinstance(value, float | int):
        if math.isinf(value):
            return "never"
        return "0" if abs(value) < 1e-12 else f"{value:.5g}"
    text = str(value)
    return text if len(text) <= LONGEST else f"({value.count_ops()} operations)"


def comparison_document(comparison: Comparison) -> Document:
    """The whole comparison: a table for each coefficient, the choice, the reason."""
    what = ", ".join(comparison.unknown)
    head = f"Remedies for the unknown input {what}" if what else "Estimators, every input measured"
    lines: list[str | Table] = []
    for name in comparison.parameters:
        lines += ["", f"{name}", _of_parameter(comparison, name)]
        if not comparison.is_symbolic:
            choice = comparison.best(name)
            if choice is None:
                lines.append(f"  no remedy estimates {name}")
            else:
                lines.append(f"  best: {choice.remedy} ({choice.why})")
            if what:
                lines.append(f"  {comparison.cost_of_neglecting(name)}")
    remarks = dict.fromkeys((r.name.rpartition(", ")[0] or r.name, r.remark)
                         for r in comparison.rows if r.remark)  # fmt: skip
    lines += ["", *(f"{name}: {remark}" for name, remark in remarks)] if remarks else []
    noted = [(r.name, n) for r in comparison.rows if r.result for n in r.result.notes]
    lines += ["", *(f"note on {name}: {note}" for name, note in noted)] if noted else []
    refused = [r for r in comparison.rows if r.result is None]
    lines += ["", *(f"not possible: {r.name}: {r.refused}" for r in refused)] if refused else []
    return Document(f"{head}, N = {comparison.N:g} samples", lines)


def asymptotics_document(limit: Asymptotics) -> Document:
    """The coefficients of one estimator, its residual variance and notes."""
    rows = []
    for name in limit.names:
        bias = limit.bias(name) if name in limit.truth else "--"
        rows.append([name, *(shown(c) for c in (limit[name], bias, limit.variance(name)))])
    return Document(
        limit.method,
        [
            _table(["coefficient", "limit", "bias", "N x variance"], rows),
            f"  residual variance {shown(limit.residual_variance)}",
            *(f"  note: {n}" for n in limit.notes),
        ],
    )


def _of_parameter(comparison: Comparison, name: str) -> Table:
    wanted = comparison.accuracy.get(name)
    N, is_symbolic = comparison.N, comparison.is_symbolic
    head = ["remedy", "limit", "bias", "N x variance"]
    if not is_symbolic:
        head += [f"s.e. at {N:g}", f"AMSE at {N:g}", "AMSE at 1"]
        head += [f"N for {wanted:g}"] if wanted is not None else []
    rows = []
    for row in comparison.rows:
        if row.result is None or not row.estimates(name):
            continue
        r = row.result
        cells = [r[name], r.bias(name) if is_symbolic else row.bias(name), r.variance(name)]
        if not is_symbolic:
            cells += [r.std_error(name, N), r.amse(name, N), r.amse(name)]
            if wanted is not None:
                samples = r.samples_for(name, wanted)
                cells.append(float(math.ceil(samples)) if math.isfinite(samples) else samples)
        rows.append([row.name, *map(shown, cells)])
    return _table(head, rows)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    return Table(head, rows, numbers=range(1, len(head)), is_ruled=True)


def options_document(found: UnknownInputComparison) -> Document:
    """The options for an unknown input: estimates, their errors, and a remark on each."""
    head, rows = found.cells()
    truth = [f"{n} = {found.truth[n]:g}" for n in found.parameters if n in found.truth]
    parts = [f"  truth {', '.join(truth)}"] if found.truth else []
    joined = [i for i, name in enumerate(head) if name == "error"]
    numbers = range(1, len(head))
    table = Table(head, rows, numbers=numbers, indent=0, widest=_WIDEST, joined=joined)
    remarks = [f"({r.letter}) {r.option}: {r.remark}" for r in found.rows]
    title = f"Options for the unknown input {found.unknown} of {found.model}"
    return Document(title, [*parts, "", table, "", *remarks])
