"""Nodes eliminated by what is measured of them: full, partial and complete indirect models.

An unknown node u is written as sum_m f_um (w_m - sum_k G_mk w_k - e_m) over measured nodes m, with
a left inverse f of the modules from unknown to measured nodes (4.22). That is put in the equations
of the other nodes; the measured nodes m themselves keep their own equations, in which u is
eliminated by its own: (4.20)-(4.21), (4.23), (4.32)-(4.34). Remaining unobserved nodes are then
immersed: (4.39)-(4.43).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.unknown_inputs.networks.elimination import Rows, immerse
from casid.unknown_inputs.networks.equations import Element, NodeEquations, Row, node_equations
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.node_recovery import recovery_filters, usable
from casid.unknown_inputs.networks.node_sets import NodeSets
from casid.unknown_inputs.networks.nodes import Edge, Node, as_nodes, edge_label, labels

Filters: TypeAlias = Mapping[Edge, Any]  # (unknown, measured) -> transfer function


def eliminate_by_measurement(
    network: Network | NodeEquations,
    unknown: Sequence[Node],
    measured: Sequence[Node],
    *,
    filters: Filters | None = None,
    **field: Any,
) -> NodeEquations:
    """The equations without `unknown`, which `measured` nodes stand for.

    Parameters
    ----------
    unknown : nodes to be eliminated.
    measured : observable nodes that they act on; the first that suffice are used.
    filters : f of (4.22) by (unknown, measured), if not the left inverse made of those rows.
    field : `at`, `omega`, `values` of `node_equations`, for a network.

    Raises
    ------
    ModelError
        If the modules from unknown to measured nodes lack full column rank (it names the nodes
        that cannot be recovered), or the filters do not invert them.
    """
    equations = node_equations(network, **field) if isinstance(network, Network) else network
    unknown, measured = as_nodes(unknown), as_nodes(measured)
    if not unknown:
        return equations
    f = (
        recovery_filters(equations, unknown, measured)
        if filters is None
        else _checked(equations, unknown, measured, filters)
    )
    used = [m for m in measured if any((u, m) in f for u in unknown)]
    own = immerse(equations, [n for n in equations.nodes if n not in set(unknown)])
    work = Rows(equations)
    for u in unknown:
        G, F = _recovered(equations, u, unknown, used, f)
        for n in equations.nodes:
            if n not in used and n not in unknown:
                work.substitute(n, u, G, F)
    for m in used:
        work.replace(m, own.G[m], own.F[m])
    work.drop(unknown)
    return work.finished(equations)


def partially_eliminated(
    network: Network | NodeEquations, sets: NodeSets, **options: Any
) -> NodeEquations:
    """(4.23): the unobservable predictor inputs eliminated by their observations D and I."""
    return eliminate_by_measurement(network, sets.sU, (*sets.D, *sets.I), **options)


def fully_eliminated(
    network: Network | NodeEquations, sets: NodeSets, **options: Any
) -> NodeEquations:
    """(4.20)-(4.21): every unobservable node eliminated by the additional nodes A."""
    return eliminate_by_measurement(network, sets.U, sets.A, **options)


@names_wrong_types(ModelError)
def indirect_equations(
    network: Network | NodeEquations, sets: NodeSets, **options: Any
) -> NodeEquations:
    """(4.24), (4.41)-(4.43): sU eliminated by D and I, remaining unobserved nodes immersed.

    Its row of the target is the indirect model; with no sU it is the immersed network (3.38). Of
    more observations than unknown inputs the first that suffice are used; which of them leave the
    least error: see `casid.unknown_inputs.networks.prediction.observation_choice`.
    `options` as for `eliminate_by_measurement`.

    Parameters
    ----------
    sets : of the target, with the observations that are to be used (`node_sets`).
    """
    partial = partially_eliminated(network, sets, **options)
    return immerse(partial, [n for n in partial.nodes if n not in sets.Ut])


def _checked(
    equations: NodeEquations, unknown: Sequence[Node], measured: Sequence[Node], filters: Filters
) -> dict[Edge, Element]:
    from casid.algebra.rational import rational

    strange = [e for e in filters if e[0] not in unknown or e[1] not in measured]
    if strange:
        raise ModelError(
            f"the filter {strange[0]!r} is not from a measured node ({labels(measured)}) to an "
            f"unknown one ({labels(unknown)}); name it (unknown, measured)"
        )
    field = equations.field
    f = {edge: field.read(rational(g)) for edge, g in filters.items()}
    for u in unknown:
        for k in unknown:
            total = field.one - field.one
            for m in measured:
                if (u, m) in f and k in equations.G[m]:
                    total = total + f[u, m] * equations.G[m][k]
            rest = total - field.one if u == k else total
            if usable(field, rest):
                raise ModelError(
                    f"the filters are no left inverse: f G has {field.back(total)} in row {u}, "
                    f"column {k}, where (4.22) needs {int(u == k)}. Leave out filters= for one "
                    f"made of {', '.join(edge_label((m, u)) for m in measured)}"
                )
    return f


def _recovered(
    equations: NodeEquations,
    u: Node,
    unknown: Sequence[Node],
    used: Iterable[Node],
    f: Mapping[Edge, Element],
) -> tuple[Row, Row]:
    """w_u = G w + F e from the measured nodes (4.20), (4.32)."""
    G: Row = {}
    F: Row = {}
    for m in used:
        if (u, m) not in f:
            continue
        factor = f[u, m]
        _accumulate(G, m, factor)
        for k, g in equations.G[m].items():
            if k not in unknown:
                _accumulate(G, k, -factor * g)
        for k, g in equations.F[m].items():
            _accumulate(F, k, -factor * g)
    return G, F


def _accumulate(row: Row, k: Node, value: Element) -> None:
    row[k] = row[k] + value if k in row else value
