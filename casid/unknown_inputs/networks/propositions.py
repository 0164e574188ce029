"""When a module survives elimination: Propositions 3.1 and 4.1 as checks that name what fails.

Both are sufficient. Beside the conditions each verdict has the conclusion itself, decided exactly
at random points (`random_equations`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.graph import path_past
from casid.unknown_inputs.networks.indirect_equations import indirect_equations
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.node_recovery import recovery_filters
from casid.unknown_inputs.networks.node_sets import NodeSets
from casid.unknown_inputs.networks.nodes import (
    Edge,
    Node,
    as_nodes,
    edge_label,
    labels,
    node_label,
    path_text,
)
from casid.unknown_inputs.networks.random_equations import random_equations

_SEEDS = (32, 33)  # of the random points at which a conclusion is decided


@dataclass(frozen=True, slots=True)
class Condition:
    """One condition of a proposition.

    Attributes
    ----------
    letter, text : name (a), (b), .. and wording in the proposition.
    violated_by : the path, loop or module that violates it; empty where it holds.
    """

    letter: str
    text: str
    violated_by: str = ""

    @property
    def holds(self) -> bool:
        """Whether nothing violates it."""
        return not self.violated_by

    def __str__(self) -> str:
        end = "holds" if self.holds else f"FAILS: {self.violated_by}"
        return f"({self.letter}) {self.text}: {end}"


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a proposition's conditions hold for a module, and whether its conclusion does.

    Attributes
    ----------
    proposition : its name.
    module : (j, i) of G_ji.
    conditions : each with what violates it.
    conclusion : whether the eliminated network has G_ji unchanged; None if it cannot be formed.
    """

    proposition: str
    module: Edge
    conditions: tuple[Condition, ...]
    conclusion: bool | None

    @property
    def holds(self) -> bool:
        """Whether every condition holds."""
        return all(c.holds for c in self.conditions)

    @property
    def violated(self) -> tuple[Condition, ...]:
        """The conditions that fail."""
        return tuple(c for c in self.conditions if not c.holds)

    def __repr__(self) -> str:
        return f"<{self.proposition} for {edge_label(self.module)}: {_outcome(self.holds)}>"

    def __str__(self) -> str:
        end = {
            True: "is unchanged",
            False: "is CHANGED by the elimination",
            None: "cannot be decided: there is nothing to eliminate with",
        }[self.conclusion]
        return "\n".join(
            [f"{self.proposition} for {edge_label(self.module)}: {_outcome(self.holds)}"]
            + [f"  {c}" for c in self.conditions]
            + [f"  {edge_label(self.module)} {end} (exact, at random q)"]
        )


@names_wrong_types(ModelError)
def proposition_3_1(
    network: Network, target: Node, source: Node, inputs: Iterable[Node] | None = None
) -> Verdict:
    """Whether G_ji is kept when all but the target and its inputs are immersed.

    Parameters
    ----------
    network : its nodes, modules and sensors.
    target, source : j and i.
    inputs : predictor inputs, by default K_j, the measured nodes with a module into j. With other
        inputs the conditions are those of Dankers et al. (2016), Proposition 3.

    Raises
    ------
    ModelError
        If a node is unknown, or the target is among the inputs.
    """
    K = _inputs(network, target, inputs)
    chosen = labels(K)
    member = "" if source in K else f"{node_label(source)} is not among {chosen}"
    path, loop = open_path(network, target, source, K)
    return Verdict(
        "Proposition 3.1",
        (target, source),
        (
            Condition("a", f"{node_label(source)} is among the inputs {chosen}", member),
            Condition(
                "b",
                f"every other path {path_text((source, target))} passes one of {chosen}",
                path_text(path),
            ),
            Condition(
                "c",
                f"every loop through {node_label(target)} passes one of {chosen}",
                path_text(loop),
            ),
        ),
        None if member else _kept_by_immersion(network, target, source, K),
    )


def open_path(
    network: Network, target: Node, source: Node, inputs: Iterable[Node]
) -> tuple[tuple[Node, ...], tuple[Node, ...]]:
    """A path from source to target past the inputs, other than the module, and a loop past them.

    Either is () where every path or loop is blocked.
    """
    blocked = set(as_nodes(inputs)) | {target}
    path = path_past(network, source, target, blocked, without=[(target, source)])
    loop = path_past(network, target, target, blocked)
    return path, loop


@names_wrong_types(ModelError)
def proposition_4_1(network: Network, sets: NodeSets, source: Node) -> Verdict:
    """Whether G_ji is kept when the unknown predictor inputs are eliminated by D and I.

    Parameters
    ----------
    network : its nodes, modules and sensors.
    sets : of the target, with the observations that are to be used (`node_sets`).
    source : i, one of K_j.

    Raises
    ------
    ModelError
        If the source is no observable predictor input of the target.
    """
    if source not in sets.K:
        raise ModelError(
            f"Proposition 4.1 is of modules from observable predictor inputs of "
            f"{node_label(sets.target)}: {labels(sets.K)}; {node_label(source)} is none"
        )
    lost = _unrecovered(network, sets)
    own, j = node_label(source), node_label(sets.target)
    remaining = [(m, u) for m in sets.I for u in sets.Ut]
    return Verdict(
        "Proposition 4.1",
        (sets.target, source),
        (
            Condition("a", f"{labels(sets.sU)} can be recovered from D and I (4.22)", lost),
            Condition("b", "no remaining unknown node acts on I", _there(network, remaining)),
            Condition("c", f"{j} does not act on I", _there(network, _into(sets, sets.target))),
            Condition("d", f"{own} does not act on I", _there(network, _into(sets, source))),
        ),
        None if lost else _kept_by_observation(network, sets, source),
    )


def _into(sets: NodeSets, source: Node) -> list[Edge]:
    return [(m, source) for m in sets.I]


def _there(network: Network, edges: list[Edge]) -> str:
    found = [edge_label(e) for e in edges if e in network.modules]
    return f"{', '.join(found)} is not zero" if found else ""


def _inputs(network: Network, target: Node, inputs: Iterable[Node] | None) -> tuple[Node, ...]:
    if target not in network.nodes:
        raise ModelError(
            f"{network.name} has no node {target!r}; its nodes are {labels(network.nodes)}"
        )
    if inputs is None:
        return tuple(k for k in network.sources(target) if k in network.measured)
    chosen = tuple(dict.fromkeys(as_nodes(inputs)))
    strange = [k for k in chosen if k not in network.nodes or k == target]
    if strange:
        raise ModelError(
            f"{strange[0]!r} cannot be a predictor input of {node_label(target)}; choose other "
            f"nodes among {labels(n for n in network.nodes if n != target)}"
        )
    return tuple(n for n in network.nodes if n in chosen)


def _kept_by_immersion(
    network: Network, target: Node, source: Node, K: tuple[Node, ...]
) -> bool | None:
    return _is_kept(network, (target, source), lambda equations: immerse(equations, (target, *K)))


def _kept_by_observation(network: Network, sets: NodeSets, source: Node) -> bool | None:
    return _is_kept(
        network, (sets.target, source), lambda equations: indirect_equations(equations, sets)
    )


def _is_kept(network: Network, module: Edge, eliminate: Any) -> bool | None:
    to, source = module
    for seed in _SEEDS:
        equations = random_equations(network, seed)
        try:
            after = eliminate(equations)
        except ModelError:  # a loop gain of one at every q: there is no such model
            return None
        if after.G[to].get(source) != equations.G[to].get(source):
            return False
    return True


def _unrecovered(network: Network, sets: NodeSets) -> str:
    try:
        recovery_filters(random_equations(network, _SEEDS[0]), sets.sU, (*sets.D, *sets.I))
    except ModelError as reason:
        return str(reason)
    return ""


def _outcome(holds: bool) -> str:
    return "its conditions hold" if holds else "its conditions fail"
