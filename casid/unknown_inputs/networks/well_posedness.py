"""Well-posedness: principal minors of lim (I - G(z))."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.unknown_inputs.networks.nodes import Edge, Node, edge_label, labels
from casid.unknown_inputs.networks.principal_minors import direct_graph, vanishing_minor


def direct_terms(modules: Mapping[Edge, Rational]) -> dict[Edge, Any]:
    """lim G_jk at infinity of every module that has a direct term."""
    return {edge: g.direct for edge, g in modules.items() if not g.is_strictly_proper}


def require_well_posed(
    nodes: tuple[Node, ...], modules: Mapping[Edge, Rational], name: str
) -> None:
    """Assumption 2.1 (a): every principal minor of lim (I - G) is nonzero.

    How far this is decided for large algebraic loops: `principal_minors`.

    Raises
    ------
    ModelError
        Which names the nodes of the smallest minor found to vanish, and the loop.
    """
    terms = direct_terms(modules)
    bad = vanishing_minor(_numbers(terms)) if terms else ()
    if bad:
        raise ModelError(_refusal(terms, tuple(n for n in nodes if n in bad), name))


def _refusal(terms: Mapping[Edge, Any], nodes: tuple[Node, ...], name: str) -> str:
    import networkx as nx

    inside = {e: g for e, g in terms.items() if e[0] in nodes and e[1] in nodes}
    cycle = next(iter(nx.simple_cycles(direct_graph(inside))))
    modules = ", ".join(
        f"{edge_label((b, a))} = {terms[b, a]}"
        for a, b in zip(cycle, cycle[1:] + cycle[:1], strict=True)
    )
    return (
        f"{name} is ill-posed: the principal minor of lim (I - G) of the nodes "
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
