"""Recursive elimination: unknown nodes step by step, until the target's equation holds none.

Eliminating an unknown node by a measurement adds whatever else acts on the measured node.
Those of them that nobody observes are eliminated in the next step, by measurements further out
(Linder 2017, section 4.3.1 and Figure 4.2); with every step the model grows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from casid.algebra.rational import Rational
from casid.algebra.realisation import mcmillan_degree
from casid.algebra.transfer_matrix import RationalMatrix
from casid.argument_types import names_wrong_types
from casid.deprecation import renamed
from casid.model.quantities import count_text
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import NodeEquations, node_equations
from casid.unknown_inputs.networks.indirect_equations import eliminate_by_measurement
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.node_recovery import recoverable
from casid.unknown_inputs.networks.node_sets import node_sets
from casid.unknown_inputs.networks.nodes import Node, labels, node_label


@dataclass(frozen=True, slots=True)
class EliminationStep:
    """The target's equation after one step.

    Attributes
    ----------
    number : 0 before anything is eliminated.
    eliminated : unknown nodes gone in this step.
    by : measured nodes that stand for them; empty in the last step if the rest is immersed.
    inputs : measured nodes in the target's equation.
    unobserved : unknown nodes still in it.
    externals : nodes whose delta and tau are in it.
    involved : nodes whose own equation was used, the target among them.
    degree : McMillan degree of the row of modules; None where symbols have no value.
    """

    number: int
    eliminated: tuple[Node, ...]
    by: tuple[Node, ...]
    inputs: tuple[Node, ...]
    unobserved: tuple[Node, ...]
    externals: tuple[Node, ...]
    involved: tuple[Node, ...]
    degree: int | None


@dataclass(frozen=True, slots=True, eq=False)
class RecursiveElimination:
    """The steps, and the equations after the last.

    Attributes
    ----------
    target : j.
    steps : step 0 is the target's own equation.
    immersed : unknown nodes that no free measurement was left for.
    equations : of all nodes that are left.
    """

    target: Node
    steps: tuple[EliminationStep, ...]
    immersed: tuple[Node, ...]
    equations: NodeEquations
    rings = renamed("rings", "steps")

    def __repr__(self) -> str:
        last = self.steps[-1]
        return (
            f"<RecursiveElimination towards {node_label(self.target)}: "
            f"{count_text(last.number, 'step')}, inputs {labels(last.inputs)}>"
        )

    def __str__(self) -> str:
        lines = [f"Recursive elimination towards {node_label(self.target)}"]
        for step in self.steps:
            degree = "symbolic" if step.degree is None else f"degree {step.degree}"
            by = f" by {labels(step.by)}" if step.by else " immersed" if step.eliminated else ""
            lines.append(
                f"  {step.number}  {labels(step.eliminated)}{by}: inputs {labels(step.inputs)}; "
                f"unobserved {labels(step.unobserved)}; {len(step.involved)} nodes involved, "
                f"{degree}"
            )
        if self.immersed:
            lines.append(
                f"  {labels(self.immersed)}: no remaining measurement determines them; a sensor on "
                "a node that they act on would"
            )
        return "\n".join(lines)


@names_wrong_types()
def eliminate_recursively(
    network: Network, target: Node, *, sensors: Iterable[Node] | None = None
) -> RecursiveElimination:
    """Eliminate unknown nodes by measurements, step by step, and immerse the rest at the end.

    Every additional observable node is used once. The field is that of rational functions.

    Parameters
    ----------
    network, target : the network and its node j.
    sensors : measured nodes to use, by default all.

    Raises
    ------
    ModelError
        If the target is not observable.
    """
    sets = node_sets(network, target, sensors=sensors)
    equations = node_equations(network)
    involved, free = [target], list(sets.A)
    steps = [_step(network, equations, target, 0, (), (), involved, sets.S)]
    while True:
        unknown = tuple(k for k in equations.nodes if k in equations.G[target] and k in sets.U)
        usable = [m for m in free if any(u in equations.G[m] for u in unknown)]
        chosen, by = recoverable(equations, unknown, usable)
        if not chosen:
            break
        equations = eliminate_by_measurement(equations, chosen, by)
        involved += by
        free = [m for m in free if m not in by]
        steps.append(_step(network, equations, target, len(steps), chosen, by, involved, sets.S))
    left = tuple(n for n in equations.nodes if n in sets.U)
    needed = _needed(equations, target, left)
    if left:
        equations = immerse(equations, [n for n in equations.nodes if n not in left])
    if needed:
        involved += needed
        steps.append(_step(network, equations, target, len(steps), needed, (), involved, sets.S))
    return RecursiveElimination(target, tuple(steps), needed, equations)


def _needed(equations: NodeEquations, target: Node, left: tuple[Node, ...]) -> tuple[Node, ...]:
    """The unknown nodes that immersion has to go through for the target's row."""
    found: list[Node] = []
    front = [target]
    while front:
        row = equations.G[front.pop()]
        new = [k for k in left if k in row and k not in found]
        found += new
        front += new
    return tuple(n for n in left if n in found)


def _step(
    network: Network,
    equations: NodeEquations,
    target: Node,
    number: int,
    eliminated: tuple[Node, ...],
    by: tuple[Node, ...],
    involved: list[Node],
    S: tuple[Node, ...],
) -> EliminationStep:
    row = equations.G[target]
    outside = (*network.excitations, *network.disturbances)
    return EliminationStep(
        number,
        eliminated,
        by,
        tuple(k for k in network.nodes if k in row and k in S),
        tuple(k for k in network.nodes if k in row and k not in S),
        tuple(k for k in network.nodes if k in equations.F[target] and k in outside),
        tuple(n for n in network.nodes if n in involved),
        _degree([equations.module(target, k) for k in row]),
    )


def _degree(row: list[Rational]) -> int | None:
    if not row or any(g.parameters for g in row):
        return None if row else 0
    return mcmillan_degree(RationalMatrix((tuple(row),)))
