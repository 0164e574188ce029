"""A left inverse of the modules from unknown to measured nodes, over any field: (4.22)."""

from __future__ import annotations

from collections.abc import Sequence

from casid.algebra.elimination import row_echelon
from casid.errors import ModelError
from casid.unknown_inputs.networks.equations import Element, Field, NodeEquations
from casid.unknown_inputs.networks.nodes import Edge, Node, labels


def recovery_filters(
    equations: NodeEquations, unknown: Sequence[Node], measured: Sequence[Node]
) -> dict[Edge, Element]:
    """f with f G = I of (4.22), from the first rows of `measured` that suffice.

    Returns
    -------
    (unknown, measured) -> element of the field.

    Raises
    ------
    ModelError
        If G lacks full column rank: the unknown nodes that cannot be recovered are named.
    """
    rows, pivots = _reduced(equations, unknown, measured)
    lost = _undetermined(equations, unknown, rows, pivots)
    if lost:
        raise ModelError(
            f"{labels(lost)} cannot be recovered from {labels(measured)}: the modules from "
            f"{labels(unknown)} to them have rank {len(pivots)} of {len(unknown)}. Measure another "
            "node that they act on, or leave them to immersion"
        )
    n = len(unknown)
    return {
        (u, m): rows[i][n + k]
        for i, u in enumerate(unknown)
        for k, m in enumerate(measured)
        if usable(equations.field, rows[i][n + k])
    }


def _undetermined(
    equations: NodeEquations,
    unknown: Sequence[Node],
    rows: list[list[Element]],
    pivots: dict[Node, Node],
) -> list[Node]:
    """Unknown nodes whose value no combination of measured ones determines."""
    lost = {u: k for k, u in enumerate(unknown) if u not in pivots}
    mixed = {
        u
        for i, u in enumerate(pivots)
        if any(usable(equations.field, rows[i][k]) for k in lost.values())
    }
    return [u for u in unknown if u in lost or u in mixed]


def recoverable(
    equations: NodeEquations, unknown: Sequence[Node], measured: Sequence[Node]
) -> tuple[tuple[Node, ...], tuple[Node, ...]]:
    """The first unknown nodes that measured ones determine, and the measured nodes that do."""
    _, pivots = _reduced(equations, unknown, measured)
    return tuple(pivots), tuple(m for m in measured if m in pivots.values())


def usable(field: Field, x: Element) -> bool:
    """Not zero; over frequencies, where rounding leaves no exact zero, not zero everywhere."""
    if field.name == "frequencies":
        return bool(abs(x).max() > 1e-12)
    return not field.is_zero(x)


def _reduced(
    equations: NodeEquations, unknown: Sequence[Node], measured: Sequence[Node]
) -> tuple[list[list[Element]], dict[Node, Node]]:
    """[G | I] in reduced echelon form, and which measured node was the pivot of which unknown."""
    field = equations.field
    zero = field.one - field.one
    rows = [
        [equations.G[m].get(u, zero) for u in unknown]
        + [field.one if k == i else zero for k in range(len(measured))]
        for i, m in enumerate(measured)
    ]
    found = row_echelon(rows, columns=len(unknown), is_zero=lambda x: not usable(field, x))
    pivots = {unknown[k]: measured[found.origin[i]] for i, k in enumerate(found.pivots)}
    return found.rows, pivots
