"""Well-posedness: principal minors of lim (I - G(z)), and the algebraic loops behind them.

A minor of a set of nodes is the product of the minors of the strongly connected parts of the graph
of direct terms on that set, so only nodes that share an algebraic loop are looked at together.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from fractions import Fraction
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from casid.errors import ModelError
from casid.networks.network import Edge, Network, Node, edge_label, labels

if TYPE_CHECKING:
    import networkx

    from casid.networks.equations import NodeEquations

_ALL_MINORS = 14  # nodes of one algebraic loop up to which every minor is computed
_SAMPLED = 2000  # subsets looked at in a larger one


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
        If the equations are numbers, in which direct terms cannot be seen.
    """
    import networkx as nx

    edges = direct_terms(network) if isinstance(network, Network) else _direct_edges(network)
    found = []
    for cycle in nx.simple_cycles(_direct_graph(edges)):
        found.append(tuple(cycle))
        if len(found) == most:
            break
    return sorted(found, key=len)


def direct_terms(network: Network) -> dict[Edge, Any]:
    """lim G_jk at infinity of every module that has a direct term."""
    return {edge: g.direct for edge, g in network.modules.items() if not g.is_strictly_proper}


def _direct_edges(equations: NodeEquations) -> list[Edge]:
    if equations.field.name != "symbolic":
        raise ModelError(
            f"direct terms cannot be seen in {equations!r}; eliminate without at= and omega="
        )
    return [
        (to, source)
        for to in equations.nodes
        for source in equations.G[to]
        if not equations.module(to, source).is_strictly_proper
    ]


def refuse_ill_posed(network: Network) -> None:
    """Assumption 2.1 (a): every principal minor of lim (I - G) is nonzero.

    Loops of up to 14 nodes are decided. Of larger ones, the minors of simple loops, of the whole
    and of 2000 random subsets are looked at.

    Raises
    ------
    ModelError
        Which names the nodes of the smallest minor found to vanish, and the loop.
    """
    import networkx as nx

    terms = direct_terms(network)
    if not terms:
        return
    numbers = _numbers(terms)
    for part in nx.strongly_connected_components(_direct_graph(terms)):
        if len(part) > 1:
            bad = _vanishing(sorted(part, key=network.nodes.index), numbers)
            if bad:
                raise ModelError(_told(network, bad))


def _told(network: Network, nodes: tuple[Node, ...]) -> str:
    import networkx as nx

    terms = direct_terms(network)
    inside = {e: g for e, g in terms.items() if e[0] in nodes and e[1] in nodes}
    cycle = max(nx.simple_cycles(_direct_graph(inside)), key=len)
    modules = ", ".join(
        f"{edge_label((b, a))} = {terms[b, a]}"
        for a, b in zip(cycle, cycle[1:] + cycle[:1], strict=True)
    )
    return (
        f"{network.name} is ill-posed: the principal minor of lim (I - G) of the nodes "
        f"{labels(nodes)} is zero. They are an algebraic loop through the direct terms {modules}; "
        "put a delay into one of these modules, or correct a gain"
    )


def _direct_graph(terms: Iterable[Edge]) -> networkx.DiGraph[Any]:
    import networkx as nx

    graph: networkx.DiGraph[Any] = nx.DiGraph()
    graph.add_edges_from((source, to) for to, source in terms)
    return graph


def _numbers(terms: Mapping[Edge, Any]) -> dict[Edge, Fraction]:
    """Direct terms with random rationals for symbols: a minor that vanishes there vanishes."""
    names = sorted({str(x) for c in terms.values() for x in getattr(c, "free_symbols", ())})
    rng = np.random.default_rng(20)
    draws = {n: Fraction(int(rng.integers(1, 10**9)), 10**9 + 7) for n in names}
    return {edge: c if isinstance(c, Fraction) else _value(c, draws) for edge, c in terms.items()}


def _value(c: Any, draws: Mapping[str, Fraction]) -> Fraction:
    import sympy

    at = {
        x: sympy.Rational(draws[str(x)].numerator, draws[str(x)].denominator)
        for x in c.free_symbols
    }
    number = c.subs(at)
    if number.is_Rational:
        return Fraction(int(number.p), int(number.q))
    return Fraction(repr(float(number)))


def _vanishing(nodes: list[Node], terms: Mapping[Edge, Fraction]) -> tuple[Node, ...]:
    for subset in _subsets(nodes):
        matrix = [
            [Fraction(i == k) - terms.get((i, k), Fraction(0)) for k in subset] for i in subset
        ]
        if _determinant(matrix) == 0:
            return subset
    return ()


def _subsets(nodes: list[Node]) -> Iterator[tuple[Node, ...]]:
    n = len(nodes)
    if n <= _ALL_MINORS:
        for size in range(2, n + 1):
            yield from combinations(nodes, size)
        return
    for size in (2, 3) if n <= 60 else (2,):
        yield from combinations(nodes, size)
    rng = np.random.default_rng(21)
    for size in rng.integers(2, n, _SAMPLED):
        if size <= 25:
            yield tuple(nodes[i] for i in sorted(rng.choice(n, size, replace=False)))
    yield tuple(nodes)


def _determinant(matrix: list[list[Fraction]]) -> Fraction:
    work, value = [row[:] for row in matrix], Fraction(1)
    for k in range(len(work)):
        pivot = next((i for i in range(k, len(work)) if work[i][k] != 0), None)
        if pivot is None:
            return Fraction(0)
        if pivot != k:
            work[k], work[pivot] = work[pivot], work[k]
            value = -value
        value *= work[k][k]
        for i in range(k + 1, len(work)):
            if work[i][k] != 0:
                factor = work[i][k] / work[k][k]
                work[i] = [a - factor * b for a, b in zip(work[i], work[k], strict=True)]
    return value
