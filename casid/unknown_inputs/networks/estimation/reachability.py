"""Which references reach which nodes of reduced equations, and how many of them independently.

Decided exactly at a rational q: w = (I - G)^-1 F (delta + tau) over the fractions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction

from casid.unknown_inputs.networks.equations import NodeEquations
from casid.unknown_inputs.networks.nodes import Node

Table = list[list[Fraction]]


def closed_loop(equations: NodeEquations, externals: Sequence[Node]) -> dict[Node, Table]:
    """node -> the row of (I - G)^-1 F in the columns of `externals`, as a (1, n) table.

    Parameters
    ----------
    equations : exact ones, from `immerse(network, keep, at=q, values=...)`.
    """
    nodes = equations.nodes
    zero = Fraction(0)
    rows = [
        [Fraction(int(n == k)) - equations.G[n].get(k, zero) for k in nodes]
        + [equations.F[n].get(e, zero) for e in externals]
        for n in nodes
    ]
    reduced, _ = eliminated(rows, len(nodes))
    return {n: [reduced[i][len(nodes) :]] for i, n in enumerate(nodes)}


def rank(table: Table) -> int:
    """Exact rank."""
    return eliminated(table, len(table[0]))[1] if table and table[0] else 0


def eliminated(table: Table, columns: int) -> tuple[Table, int]:
    """Gauss and Jordan on the first `columns`: the reduced table, and how many pivots it has."""
    rows = [list(r) for r in table]
    done = 0
    for c in range(columns):
        found = next((i for i in range(done, len(rows)) if rows[i][c] != 0), None)
        if found is None:
            continue
        rows[done], rows[found] = rows[found], rows[done]
        pivot = rows[done][c]
        rows[done] = [x / pivot for x in rows[done]]
        for i, row in enumerate(rows):
            if i != done and row[c] != 0:
                factor = row[c]
                rows[i] = [x - factor * y for x, y in zip(row, rows[done], strict=True)]
        done += 1
    return rows, done


def independent_references(
    equations: NodeEquations, inputs: Iterable[Node], references: Sequence[Node]
) -> tuple[int, tuple[Node, ...]]:
    """How many inputs the references move independently, and the inputs that none reaches."""
    if not references:
        return 0, tuple(inputs)
    transfer = closed_loop(equations, references)
    rows = {k: transfer[k][0] for k in inputs}
    lost = tuple(k for k, row in rows.items() if not any(row))
    return rank(list(rows.values())), lost
