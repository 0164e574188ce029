"""Loops of modules that have direct terms."""

from __future__ import annotations

from casid.errors import ModelError
from casid.unknown_inputs.networks.equations import NodeEquations
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import Edge, Node
from casid.unknown_inputs.networks.principal_minors import direct_graph
from casid.unknown_inputs.networks.well_posedness import direct_terms


def algebraic_loops(network: Network | NodeEquations, most: int = 100) -> list[tuple[Node, ...]]:
    """Loops of modules with direct terms, each as its nodes in order of the signal; at most `most`.

    Parameters
    ----------
    network : a network, or symbolic equations after an elimination: elimination by measurement
        makes loops of its own, and where they are algebraic, direct prediction-error estimates may
        be biased (Linder 2017, section 4.3.1). Improper modules count. A symbol that stands for a
        whole module is taken to have a direct term.

    Raises
    ------
    ModelError
        If the equations are numbers, which do not show direct terms.
    """
    import networkx as nx

    if isinstance(network, Network):
        edges = list(direct_terms(network.modules))
    else:
        edges = _direct_edges(network)
    found = []
    for cycle in nx.simple_cycles(direct_graph(edges)):
        found.append(tuple(cycle))
        if len(found) == most:
            break
    return sorted(found, key=len)


def _direct_edges(equations: NodeEquations) -> list[Edge]:
    if equations.field.name != "symbolic":
        raise ModelError(
            f"{equations!r} does not show direct terms; eliminate without at= and omega="
        )
    return [
        (to, source)
        for to in equations.nodes
        for source in equations.G[to]
        if not equations.module(to, source).is_strictly_proper
    ]
