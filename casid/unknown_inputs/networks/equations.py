"""The equations of a network over a field: w = G w + F (delta + tau), kept sparse.

The field is chosen: rational functions of q and of the modules' symbols (sympy), exact fractions at
one rational q, or complex numbers at many frequencies at once. Whatever is done with equations is
done with + - * / alone, so that each algorithm is written once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.presentation import Presented
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import Node, edge_label, node_label

Element: TypeAlias = Any  # a member of the field
Row: TypeAlias = dict[Node, Element]


@dataclass(frozen=True, slots=True)
class Field:
    """Arithmetic of the entries of equations.

    Attributes
    ----------
    name : "symbolic", "exact", "frequencies" or "modular".
    one : its unit.
    is_zero : whether an element vanishes; over frequencies nothing computed counts as zero.
    read : a `Rational` as an element.
    back : an element as a `Rational`, where there is one.
    """

    name: str
    one: Element
    is_zero: Callable[[Element], bool]
    read: Callable[[Rational], Element]
    back: Callable[[Element], Any]


@dataclass(frozen=True, slots=True, eq=False)
class NodeEquations(Presented):
    """w_i = sum_k G[i][k] w_k + sum_n F[i][n] (delta_n + tau_n) for the nodes that are left.

    Attributes
    ----------
    nodes : the nodes that have an equation, in the order of the network.
    G, F : row by row, only what is not zero. Columns of F are nodes of the whole network.
    eliminated : nodes that no longer occur.
    field : what the entries are.
    """

    nodes: tuple[Node, ...]
    G: Mapping[Node, Row]
    F: Mapping[Node, Row]
    eliminated: tuple[Node, ...]
    field: Field

    def module(self, to: Node, source: Node) -> Any:
        """The entry of G as a user reads it: `Rational`, Fraction or (F,) array; 0 where none."""
        return self._read(self.G, to, source)

    def filter(self, to: Node, external: Node) -> Any:
        """The entry of F: how delta + tau of node `external` reaches node `to`."""
        return self._read(self.F, to, external)

    def externals(self, node: Node) -> tuple[Node, ...]:
        """Nodes whose delta and tau reach `node` past the other nodes that are left."""
        return tuple(self.F[node])

    def _read(self, rows: Mapping[Node, Row], to: Node, source: Node) -> Any:
        if to not in rows:
            raise ModelError(
                f"{node_label(to)} has no equation any more; left are "
                f"{', '.join(node_label(n) for n in self.nodes)}"
            )
        found = rows[to].get(source)
        return self.field.back(self.field.one - self.field.one if found is None else found)

    def __repr__(self) -> str:
        return (
            f"<NodeEquations of {len(self.nodes)} nodes, {len(self.eliminated)} eliminated, "
            f"{self.field.name}>"
        )


def node_equations(
    network: Network, *, at: Any = None, omega: Any = None, values: Mapping[str, Any] | None = None
) -> NodeEquations:
    """The equations of a network over a field.

    Parameters
    ----------
    at : None for rational functions of q and symbols, whose size grows fast with what is eliminated
        (seconds for fifteen nodes out of twenty); an int or Fraction for exact numbers at that
        q; an array of complex numbers for those points of the plane of q (or s) at once.
    omega : (F,) frequencies [rad/s] instead ([rad/sample] without a sample time).
    values : numbers for parameters, which exact and complex fields need.

    Raises
    ------
    ModelError
        If a parameter lacks its number, or the point is a pole of a module.
    """
    return equations_over(network, _field(network, at, omega, values))


def equations_over(network: Network, field: Field) -> NodeEquations:
    """The equations of a network over a field of one's own."""
    G: dict[Node, Row] = {n: {} for n in network.nodes}
    for (to, source), g in network.modules.items():
        try:
            entry = field.read(g)
        except ModelError as reason:
            raise ModelError(f"module {edge_label((to, source))}: {reason}") from reason
        if not field.is_zero(entry):
            G[to][source] = entry
    F = {n: {n: field.one} for n in network.nodes}
    return NodeEquations(network.nodes, G, F, (), field)


def ordered(network_nodes: Iterable[Node], chosen: Iterable[Node]) -> tuple[Node, ...]:
    """The chosen nodes in the order of the network."""
    wanted = set(chosen)
    return tuple(n for n in network_nodes if n in wanted)


def _field(network: Network, at: Any, omega: Any, values: Mapping[str, Any] | None) -> Field:
    given = values or {}
    if omega is not None:
        w = np.ravel(np.asarray(omega, dtype=float))
        at = 1j * w if network.variable == "s" else np.exp(1j * w * (network.Ts or 1.0))
    if at is None:
        return _symbolic(network, given)
    if isinstance(at, int | Fraction):
        return _exact(Fraction(at), given)
    points = np.ravel(np.asarray(at, dtype=complex))
    return Field(
        "frequencies",
        np.ones(points.size, complex),
        lambda x: False,
        lambda g: g.substitute(given).response(points),
        lambda x: x,
    )


def _exact(q: Fraction, values: Mapping[str, Any]) -> Field:
    def read(g: Rational) -> Fraction:
        """The value of a transfer function at q, as a fraction."""
        g = g.substitute(values)
        if g.parameters:
            raise ModelError(
                f"{g} has no number at q = {q}: give a value for {', '.join(g.parameters)}"
            )
        return Fraction(g.at(q))

    return Field("exact", Fraction(1), lambda x: x == 0, read, lambda x: x)


def _symbolic(network: Network, values: Mapping[str, Any]) -> Field:
    import sympy

    from casid.algebra.rational import rational

    letter = network.variable or "q"
    names = sorted({n for g in network.modules.values() for n in g.substitute(values).parameters})
    if letter in names:
        raise ModelError(f"a parameter is called {letter!r} as the shift is; give it another name")
    K = sympy.QQ.frac_field(*sympy.symbols([letter, *names]))

    def read(g: Rational) -> Any:
        """The transfer function as an element of the field of its parameters."""
        g = g.substitute(values)
        try:
            return K.from_sympy(g.expression(sympy.Symbol(letter)))
        except sympy.CoercionFailed:
            raise ModelError(
                f"{g} is not rational in its parameters; give values for them"
            ) from None

    def back(x: Any) -> Any:
        return rational(K.to_sympy(x), variable=letter, Ts=network.Ts or None)

    return Field("symbolic", K.one, lambda x: not x, read, back)
