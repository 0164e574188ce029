"""Well-posedness: principal minors of lim (I - G(z)), and the algebraic loops behind them."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from casid.errors import ModelError
from casid.unknown_inputs.networks.network import Edge, Network, Node, edge_label, labels
from casid.unknown_inputs.networks.principal_minors import direct_graph, vanishing_minor

if TYPE_CHECKING:
    from casid.unknown_inputs.networks.equations import NodeEquations


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
    for cycle in nx.simple_cycles(direct_graph(edges)):
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

    How far this is decided for large algebraic loops: `principal_minors`.

    Raises
    ------
    ModelError
        Which names the nodes of the smallest minor found to vanish, and the loop.
    """
    terms = direct_terms(network)
    bad = vanishing_minor(_numbers(terms)) if terms else ()
    if bad:
        raise ModelError(_told(network, tuple(n for n in network.nodes if n in bad)))


def _told(network: Network, nodes: tuple[Node, ...]) -> str:
    import networkx as nx

    terms = direct_terms(network)
    inside = {e: g for e, g in terms.items() if e[0] in nodes and e[1] in nodes}
    cycle = next(iter(nx.simple_cycles(direct_graph(inside))))
    modules = ", ".join(
        f"{edge_label((b, a))} = {terms[b, a]}"
        for a, b in zip(cycle, cycle[1:] + cycle[:1], strict=True)
    )
    return (
        f"{network.name} is ill-posed: the principal minor of lim (I - G) of the nodes "
        f"{labels(nodes)} is zero. They are an algebraic loop through the direct terms {modules}; "
        "put a delay into one of these modules, or correct a gain"
    )


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
