"""Paths and loops of a network: who acts on whom, and past which nodes."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any

from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import Edge, Node

if TYPE_CHECKING:
    import networkx


def graph_of(network: Network) -> networkx.DiGraph[Any]:
    """The directed graph of the modules, with an edge from k to j for G_jk."""
    import networkx as nx

    graph: networkx.DiGraph[Any] = nx.DiGraph()
    graph.add_nodes_from(network.nodes)
    graph.add_edges_from((source, to) for to, source in network.modules)
    return graph


def upstream(network: Network, node: Node) -> tuple[Node, ...]:
    """Nodes with a path to `node`, in the order of the network."""
    import networkx as nx

    found = nx.ancestors(graph_of(network), node)
    return tuple(n for n in network.nodes if n in found)


def downstream(network: Network, node: Node) -> tuple[Node, ...]:
    """Nodes with a path from `node`, in the order of the network."""
    import networkx as nx

    found = nx.descendants(graph_of(network), node)
    return tuple(n for n in network.nodes if n in found)


def path_past(
    network: Network,
    start: Node,
    goal: Node,
    blocked: Collection[Node] = (),
    without: Iterable[Edge] = (),
) -> tuple[Node, ...]:
    """A shortest path of one module or more from `start` to `goal`; () if there is none.

    Parameters
    ----------
    start, goal : the same node for a loop.
    blocked : nodes the path may not pass between its ends.
    without : modules (to, from) it may not use.
    """
    readers = network_readers(network)
    barred = set(without)
    stop = set(blocked) | {start}
    trail: dict[Node, Node] = {}
    front = [start]
    while front:
        later = []
        for node in front:
            for reader in readers[node]:
                if (reader, node) in barred:
                    continue
                if reader == goal:
                    return _trail(trail, start, node) + (goal,)
                if reader not in stop:
                    stop.add(reader)
                    trail[reader] = node
                    later.append(reader)
        front = later
    return ()


def network_readers(network: Network) -> dict[Node, list[Node]]:
    """node -> the nodes it acts on by one module."""
    readers: dict[Node, list[Node]] = {n: [] for n in network.nodes}
    for to, source in network.modules:
        readers[source].append(to)
    return readers


def _trail(trail: dict[Node, Node], start: Node, node: Node) -> tuple[Node, ...]:
    path = [node]
    while path[-1] != start:
        path.append(trail[path[-1]])
    return tuple(reversed(path))
