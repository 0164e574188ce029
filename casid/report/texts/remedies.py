"""A comparison of remedies, and a table in text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.comparison import Comparison

LONGEST = 60
"""Characters of a formula that is printed; longer ones are counted instead."""


def columns(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table: the first column to the left, the others to the right."""
    widths = [max(len(r[i]) for r in [head, *rows]) for i in range(len(head))]

    def line(cells: Sequence[str]) -> str:
        rest = (f"{c:>{w}}" for c, w in zip(cells[1:], widths[1:], strict=True))
        return "  " + "  ".join([f"{cells[0]:<{widths[0]}}", *rest]).rstrip()

    return [line(head), "  " + "  ".join("-" * w for w in widths), *(line(r) for r in rows)]


def shown(value: Any) -> str:
    """A number to five digits, or a formula; a long formula is told by its size."""
    if isinstance(value, float | int):
        if math.isinf(value):
            return "never"
        return "0" if abs(value) < 1e-12 else f"{value:.5g}"
    text = str(value)
    return text if len(text) <= LONGEST else f"({value.count_ops()} operations)"


def comparison_text(comparison: Comparison) -> str:
    """The whole comparison: a table for each coefficient, the choice, the reason."""
    what = ", ".join(comparison.unknown)
    head = f"Remedies for the unknown input {what}" if what else "Estimators, every input measured"
    lines = [f"{head}, N = {comparison.N:g} samples"]
    for name in comparison.parameters:
        lines += ["", f"{name}", *_of_parameter(comparison, name)]
        if not comparison.is_symbolic:
            choice = comparison.best(name)
            if choice is None:
                lines.append(f"  no remedy estimates {name}")
            else:
                lines.append(f"  best: {choice.remedy} ({choice.why})")
            if what:
                lines.append(f"  {comparison.cost_of_neglecting(name)}")
    told = dict.fromkeys((r.name.rpartition(", ")[0] or r.name, r.remark)
                         for r in comparison.rows if r.remark)  # fmt: skip
    lines += ["", *(f"{name}: {remark}" for name, remark in told)] if told else []
    noted = [(r.name, n) for r in comparison.rows if r.result for n in r.result.notes]
    lines += ["", *(f"note on {name}: {note}" for name, note in noted)] if noted else []
    refused = [r for r in comparison.rows if r.result is None]
    lines += ["", *(f"not possible: {r.name}: {r.refused}" for r in refused)] if refused else []
    return "\n".join(lines)


def asymptotics_text(limit: Asymptotics) -> str:
    """The coefficients of one estimator, its residual variance and notes."""
    head = ["coefficient", "limit", "bias", "N x variance"]
    rows = []
    for name in limit.names:
        known = name in limit.truth
        cells = (limit[name], limit.bias(name) if known else "--", limit.variance(name))
        rows.append([name, *(shown(c) for c in cells)])
    lines = [limit.method, *columns(head, rows)]
    lines += [f"  residual variance {shown(limit.residual_variance)}"]
    return "\n".join([*lines, *(f"  note: {n}" for n in limit.notes)])


def _of_parameter(comparison: Comparison, name: str) -> list[str]:
    wanted = comparison.accuracy.get(name)
    N, letters = comparison.N, comparison.is_symbolic
    head = ["remedy", "limit", "bias", "N x variance"]
    if not letters:
        head += [f"s.e. at {N:g}", f"AMSE at {N:g}", "AMSE at 1"]
        head += [f"N for {wanted:g}"] if wanted is not None else []
    rows = []
    for row in comparison.rows:
        if row.result is None or not row.estimates(name):
            continue
        r = row.result
        cells = [r[name], r.bias(name) if letters else row.bias(name), r.variance(name)]
        if not letters:
            cells += [r.std_error(name, N), r.amse(name, N), r.amse(name)]
            if wanted is not None:
                samples = r.samples_for(name, wanted)
                cells.append(float(math.ceil(samples)) if math.isfinite(samples) else samples)
        rows.append([row.name, *map(shown, cells)])
    return columns(head, rows)
