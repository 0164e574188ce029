"""Which external signals reach a node past the others, and which of them confound an output.

    P_j = {n : F_jn delta_n != 0},  R_j = {n : F_jn tau_n != 0}         (Linder 2017, section 3.3)

A disturbance in R of the output and of one of its inputs correlates the equation error with that
input: a confounder.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from casid.errors import ModelError
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import NodeEquations
from casid.unknown_inputs.networks.graph import path_past
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import Node, as_nodes, labels, node_label, path_text
from casid.unknown_inputs.networks.random_equations import random_equations


@dataclass(frozen=True, slots=True)
class Confounder:
    """A disturbance that enters the output's equation error and an input alike.

    Attributes
    ----------
    node : whose tau it is.
    output : whose equation error it is in.
    inputs : the inputs that it is in, too.
    to_output, to_inputs : how it gets there past the kept nodes, as nodes of the network; empty
        where the equations were not made by immersion alone.
    """

    node: Node
    output: Node
    inputs: tuple[Node, ...]
    to_output: tuple[Node, ...] = ()
    to_inputs: tuple[tuple[Node, ...], ...] = ()

    def __str__(self) -> str:
        text = f"tau_{self.node} confounds {node_label(self.output)} and {labels(self.inputs)}"
        paths = [p for p in (self.to_output, *self.to_inputs) if len(p) > 1]
        return text + (f" ({'; '.join(path_text(p) for p in paths)})" if paths else "")


def disturbances_in(network: Network, equations: NodeEquations, node: Node) -> tuple[Node, ...]:
    """R_j: the nodes whose tau is in the equation of `node`."""
    return tuple(n for n in network.nodes if n in equations.F[node] and n in network.disturbances)


def excitations_in(network: Network, equations: NodeEquations, node: Node) -> tuple[Node, ...]:
    """P_j: the nodes whose delta is in the equation of `node`."""
    return tuple(n for n in network.nodes if n in equations.F[node] and n in network.excitations)


def confounders_in(
    network: Network, equations: NodeEquations, output: Node, inputs: Iterable[Node] | None = None
) -> tuple[Confounder, ...]:
    """The confounders of equations made by any elimination.

    Parameters
    ----------
    output : whose equation error is looked at.
    inputs : nodes in that equation; by default all of them.
    """
    chosen = tuple(equations.G[output]) if inputs is None else as_nodes(inputs)
    own = disturbances_in(network, equations, output)
    found = []
    for n in own:
        hit = tuple(k for k in equations.nodes if k in chosen and n in equations.F[k])
        if hit:
            found.append(Confounder(n, output, hit))
    return tuple(found)


def confounders(network: Network, output: Node, inputs: Iterable[Node]) -> tuple[Confounder, ...]:
    """The confounders of an output and its predictor inputs, all other nodes immersed.

    Whether a signal arrives is decided exactly (`random_equations`), so that what cancels is
    not counted; how it arrives is given as paths past the kept nodes.

    Parameters
    ----------
    network : its nodes, modules and sensors.
    output, inputs : the node and its predictor inputs.

    Raises
    ------
    ModelError
        If the output is among its inputs.
    """
    chosen = tuple(dict.fromkeys(as_nodes(inputs)))
    if output in chosen:
        raise ModelError(
            f"{node_label(output)} cannot be its own predictor input; take it out of the inputs"
        )
    kept = (output, *chosen)
    equations = immerse(random_equations(network, 31), kept)
    return tuple(
        Confounder(
            c.node,
            output,
            c.inputs,
            _arrival(network, c.node, output, kept),
            tuple(_arrival(network, c.node, k, kept) for k in c.inputs),
        )
        for c in confounders_in(network, equations, output, chosen)
    )


def _arrival(
    network: Network, source: Node, goal: Node, kept: tuple[Node, ...]
) -> tuple[Node, ...]:
    if source == goal:
        return (goal,)
    return path_past(network, source, goal, blocked=kept)
