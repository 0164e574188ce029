"""Which principal minor of I - D vanishes, D sparse and exact.

The minor of a set of nodes is the product of the minors of the strongly connected parts of the
graph on it, so only sets that are strongly connected by themselves are looked at. Each of them,
unless it is all of its part, lies in what is left of the part without some node: a recursion meets
them all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from casid.algebra.modular_integer import PRIME
from casid.unknown_inputs.networks.nodes import Edge, Node

if TYPE_CHECKING:
    import networkx

_MOST = 3000  # sets looked at in one strongly connected part
_SHORT = 4  # nodes of loops that are looked at first


def vanishing_minor(terms: Mapping[Edge, Fraction]) -> tuple[Node, ...]:
    """The nodes of a principal minor of I - D that is zero, a smallest one found; () if none is.

    Computed modulo 2^61 - 1: a zero is found for certain, what is no zero is taken for one with a
    probability of 2^-61. Of a part with more than 3000 strongly connected sets (a dense one of 12
    nodes) only so many are looked at: its short loops first, then the largest sets.

    Parameters
    ----------
    terms : (to, from) -> entry of D; no diagonal.
    """
    import networkx as nx

    graph = direct_graph(terms)
    numbers = {e: c.numerator * pow(c.denominator, -1, PRIME) % PRIME for e, c in terms.items()}
    found: list[frozenset[Node]] = []
    for part in nx.strongly_connected_components(graph):
        if len(part) > 1:
            sets = _connected_sets(graph.subgraph(part))
            found += [s for s in sets if _minor(s, numbers) == 0]
    found.sort(key=len)
    return tuple(found[0]) if found else ()


def direct_graph(edges: Iterable[Edge]) -> networkx.DiGraph[Any]:
    """The graph of modules (to, from), an edge from `from` to `to`."""
    import networkx as nx

    graph: networkx.DiGraph[Any] = nx.DiGraph()
    graph.add_edges_from((source, to) for to, source in edges)
    return graph


def _connected_sets(part: networkx.DiGraph[Any]) -> set[frozenset[Node]]:
    """Sets of two nodes or more that are strongly connected by themselves; at most `_MOST`."""
    import networkx as nx

    whole = frozenset(part.nodes)
    seen = {whole}
    for length in range(2, _SHORT + 1):
        for cycle in nx.simple_cycles(part, length_bound=length):
            seen.add(frozenset(cycle))
            if len(seen) >= _MOST:
                return seen
    done: set[frozenset[Node]] = set()
    front = [whole]
    while front:
        current = front.pop(0)
        if current in done:
            continue
        done.add(current)
        for node in current:
            rest = part.subgraph(current - {node})
            for piece in nx.strongly_connected_components(rest):
                inside = frozenset(piece)
                if len(inside) > 1 and inside not in done:
                    seen.add(inside)
                    front.append(inside)
            if len(seen) >= _MOST:
                return seen
    return seen


def _minor(nodes: frozenset[Node], terms: Mapping[Edge, int]) -> int:
    """The minor of I - D modulo the prime, by sparse elimination."""
    rows = {i: {k: -terms[i, k] % PRIME for k in nodes if (i, k) in terms} | {i: 1} for i in nodes}
    value = 1
    left = list(nodes)
    for k in nodes:
        pivot = min((i for i in left if rows[i].get(k)), key=lambda i: len(rows[i]), default=None)
        if pivot is None:
            return 0
        left.remove(pivot)
        head = rows[pivot][k]
        value = value * head % PRIME  # the sign is of no interest
        inverse = pow(head, -1, PRIME)
        for i in left:
            factor = rows[i].pop(k, 0) * inverse % PRIME
            if factor:
                for m, entry in rows[pivot].items():
                    if m != k:
                        rows[i][m] = (rows[i].get(m, 0) - factor * entry) % PRIME
    return value
