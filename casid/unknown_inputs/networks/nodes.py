"""Names of nodes and modules, and how they are written."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeAlias

Node: TypeAlias = Any  # any hashable name: 1, "engine"
Edge: TypeAlias = tuple[Node, Node]  # (to, from), as the subscripts of G_jk


def as_nodes(chosen: Any) -> tuple[Node, ...]:
    """Nodes given one by one, or a single one: a text is one node, not its characters."""
    if isinstance(chosen, str) or not isinstance(chosen, Iterable):
        return (chosen,)
    return tuple(chosen)


def node_label(node: Node) -> str:
    """ "w2" for the node 2, "engine" for the node "engine"."""
    return node if isinstance(node, str) else f"w{node}"


def edge_label(edge: Edge) -> str:
    """ "G25" for a module from 5 to 2; "G[10,3]" or "G[wheel,engine]" where that is ambiguous."""
    to, source = (str(n) for n in edge)
    return f"G{to}{source}" if len(to) == len(source) == 1 else f"G[{to},{source}]"


def labels(nodes: Iterable[Node]) -> str:
    """ "w1, w3" ; "none" of nothing."""
    return ", ".join(node_label(n) for n in nodes) or "none"


def path_text(path: Iterable[Node]) -> str:
    """ "w1 -> w2 -> w5"."""
    return " -> ".join(node_label(n) for n in path)
