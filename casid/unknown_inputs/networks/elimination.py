"""Immersion: nodes eliminated by their own equations, a Schur complement taken node by node.

    G_imm = G_RR + G_RZ (I - G_ZZ)^-1 G_ZR,   F = [I, G_RZ (I - G_ZZ)^-1],

then every row is divided by one minus its diagonal entry (normalisation): (3.21), (3.38).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.unknown_inputs.networks.equations import (
    Element,
    Field,
    NodeEquations,
    Row,
    node_equations,
)
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import Node, as_nodes, labels


@names_wrong_types(ModelError)
def immerse(network: Network | NodeEquations, keep: Iterable[Node], **field: Any) -> NodeEquations:
    """The network of the nodes in `keep`, all others immersed.

    Parameters
    ----------
    network : a network, or equations from which something is eliminated already.
    keep : nodes whose equations are kept.
    field : `at`, `omega`, `values` of `node_equations`, for a network.

    Raises
    ------
    ModelError
        If a node has no equation, or I - G_ZZ of the eliminated nodes Z is singular.

    Notes
    -----
    Rational functions of many symbols grow fast: a network of six nodes with a symbol for a module
    between every two takes 10 to 20 s to immerse. Give numbers for symbols (`values`), or evaluate
    at a point (`at`) or at frequencies (`omega`).

    Example
    -------
    >>> import casid
    >>> import sympy
    >>> q = sympy.Symbol("q")
    >>> modules = {(2, 1): 0.5 / q, (3, 2): 0.8 / q, (3, 1): 0.3 / q}
    >>> network = casid.dynamic_network(modules, excitations=[1], measured=[1, 3], Ts=1.0)
    >>> print(casid.immerse(network, [1, 3]))
    <NodeEquations of 2 nodes, 1 eliminated, symbolic>
      w1 = e_1
      w3 = ((0.3 q + 0.4) / q^2) w1 + e_3 + (0.8 / q) e_2
      e = delta + tau
    """
    equations = node_equations(network, **field) if isinstance(network, Network) else network
    kept = set(as_nodes(keep))
    strange = kept - set(equations.nodes)
    if strange:
        raise ModelError(
            f"{labels(sorted(strange, key=str))} cannot be kept: no equation of that name; there "
            f"are {labels(equations.nodes)}"
        )
    work = Rows(equations)
    work.eliminate(n for n in equations.nodes if n not in kept)
    return work.finished(equations)


class Rows:
    """Equations being worked on: sparse rows of G and F, and who refers to whom."""

    def __init__(self, equations: NodeEquations) -> None:
        self.field: Field = equations.field
        self.G: dict[Node, Row] = {n: dict(row) for n, row in equations.G.items()}
        self.F: dict[Node, Row] = {n: dict(row) for n, row in equations.F.items()}
        self.readers: dict[Node, set[Node]] = {}
        for n, row in self.G.items():
            for k in row:
                self.readers.setdefault(k, set()).add(n)

    def eliminate(self, nodes: Iterable[Node]) -> None:
        """Every node by its own equation, the one with the least fill-in first."""
        left = list(nodes)
        while left:
            left.sort(key=self._cost, reverse=True)
            chosen = next((n for n in reversed(left) if not self._is_stuck(n)), None)
            if chosen is None:
                raise ModelError(
                    f"the equations of {labels(left)} cannot be solved for these nodes: I - G of "
                    "them is singular at every q. Keep one of them"
                )
            left.remove(chosen)
            self._eliminate(chosen)

    def substitute(self, reader: Node, node: Node, G: Row, F: Row) -> None:
        """w_node = G w + F e put into the row of `reader`."""
        own = self.G[reader].pop(node, None)
        if own is None:
            return
        self.readers[node].discard(reader)
        self._add(self.G[reader], G, own, reader)
        self._add(self.F[reader], F, own, None)

    def replace(self, node: Node, G: Row, F: Row) -> None:
        """Another equation for `node`."""
        for k in self.G[node]:
            self.readers[k].discard(node)
        self.G[node], self.F[node] = dict(G), dict(F)
        for k in G:
            self.readers.setdefault(k, set()).add(node)

    def drop(self, nodes: Iterable[Node]) -> None:
        """Forget the equations of nodes that no other equation holds any more."""
        for n in nodes:
            for k in self.G.pop(n):
                self.readers[k].discard(n)
            self.F.pop(n)

    def finished(self, equations: NodeEquations) -> NodeEquations:
        """Rows normalised, as a value."""
        for n in self.G:
            self._normalise(n)
        nodes = tuple(n for n in equations.nodes if n in self.G)
        gone = tuple(n for n in equations.nodes if n not in self.G)
        return NodeEquations(
            nodes,
            {n: self.G[n] for n in nodes},
            {n: self.F[n] for n in nodes},
            equations.eliminated + gone,
            self.field,
        )

    def _normalise(self, n: Node) -> None:
        own = self.G[n].pop(n, None)
        if own is None:
            return
        self.readers[n].discard(n)
        rest = self.field.one - own
        if self.field.is_zero(rest):
            raise ModelError(
                f"the equation of {labels([n])} no longer holds {labels([n])} after elimination: "
                "its loop gain is one at every q. Keep another node as well"
            )
        for row in (self.G[n], self.F[n]):
            for k in row:
                row[k] = row[k] / rest

    def _eliminate(self, z: Node) -> None:
        row, external = self.G.pop(z), self.F.pop(z)
        for k in row:
            self.readers[k].discard(z)
        own = row.pop(z, None)
        factor = None if own is None else self.field.one / (self.field.one - own)
        for reader in tuple(self.readers.pop(z, ())):
            if reader != z:
                own_factor = self.G[reader].pop(z)
                scale = own_factor if factor is None else own_factor * factor
                self._add(self.G[reader], row, scale, reader)
                self._add(self.F[reader], external, scale, None)

    def _add(self, row: Row, other: Row, scale: Element, reader: Node | None) -> None:
        is_zero = self.field.is_zero
        for k, value in other.items():
            term = scale * value
            if k not in row:
                row[k] = term
                if reader is not None:
                    self.readers.setdefault(k, set()).add(reader)
                continue
            total = row[k] + term
            if is_zero(total):
                del row[k]
                if reader is not None:
                    self.readers[k].discard(reader)
            else:
                row[k] = total

    def _cost(self, n: Node) -> int:
        return len(self.readers.get(n, ())) * (len(self.G[n]) + len(self.F[n]))

    def _is_stuck(self, n: Node) -> bool:
        own = self.G[n].get(n)
        return own is not None and self.field.is_zero(self.field.one - own)
