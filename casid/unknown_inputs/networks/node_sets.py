"""The node sets of a target and its sensors: Definitions 3.1 and 4.1-4.3 of Linder (2017)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.presentation import Presented
from casid.unknown_inputs.networks.graph import downstream, upstream
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import Edge, Node, as_nodes, edge_label, labels, node_label


@dataclass(frozen=True, slots=True)
class NodeSets(Presented):
    """Which node is what to the target j, each set in the order of the network.

    Attributes
    ----------
    target : j.
    N : predictor inputs, the nodes with a module into j.
    S, U : observable nodes and the others (Definition 3.1).
    K, A : observable predictor inputs; the other observable nodes but j.
    sU, Ut : unobservable predictor inputs; the remaining unobservable nodes (Definition 4.1).
    D, I, O : direct observations of sU (4.6), indirect ones (4.7), and the rest of A.
    upstream, downstream : unobservable node -> observable nodes with a path to it, from it.
    """

    target: Node
    N: tuple[Node, ...]
    S: tuple[Node, ...]
    U: tuple[Node, ...]
    K: tuple[Node, ...]
    A: tuple[Node, ...]
    sU: tuple[Node, ...]
    Ut: tuple[Node, ...]
    D: tuple[Node, ...]
    I: tuple[Node, ...]  # noqa: E741 - the thesis's symbol
    O: tuple[Node, ...]  # noqa: E741
    upstream: dict[Node, tuple[Node, ...]]
    downstream: dict[Node, tuple[Node, ...]]

    def __repr__(self) -> str:
        return (
            f"<NodeSets of {node_label(self.target)}: K {labels(self.K)}; sU {labels(self.sU)}; "
            f"D {labels(self.D)}; I {labels(self.I)}>"
        )


@names_wrong_types(ModelError)
def node_sets(
    network: Network,
    target: Node,
    *,
    sensors: Iterable[Node] | None = None,
    known: Collection[Edge] = (),
    direct: Iterable[Node] | None = None,
    indirect: Iterable[Node] | None = None,
) -> NodeSets:
    """Sort the nodes by what they are to the target.

    Parameters
    ----------
    sensors : observable nodes; by default the network's measured ones.
    known : modules (to, from) whose transfer function is known: what makes a node a direct one.
    direct, indirect : the nodes to be used as such, if not all that qualify. Those that qualify
        and are not named are put among the remaining observable nodes O.

    Raises
    ------
    ModelError
        If the target is no observable node, or a node is claimed to be direct or indirect and is
        not, or both.

    Example
    -------
    >>> import casid
    >>> import sympy
    >>> q = sympy.Symbol("q")
    >>> modules = {(2, 1): 0.5 / q, (3, 2): 0.8 / q, (3, 1): 0.3 / q}
    >>> network = casid.dynamic_network(modules, excitations=[1], measured=[1, 3], Ts=1.0)
    >>> casid.node_sets(network, 3).sU  # w2 is in the equation of w3 and has no sensor
    (2,)
    """
    S = network.with_sensors(sensors).measured if sensors is not None else network.measured
    _refuse_target(network, target, S)
    N = network.sources(target)
    U = tuple(n for n in network.nodes if n not in S)
    K = tuple(n for n in S if n in N)
    A = tuple(n for n in S if n not in N and n != target)
    sU = tuple(n for n in U if n in N)
    refused = {n: _not_direct(network, n, sU, known) for n in A}
    qualified = tuple(n for n in A if not refused[n])
    named_direct = qualified if direct is None else as_nodes(direct)
    claimed = as_nodes(indirect) if indirect is not None else None
    _refuse_both(named_direct if direct is not None else (), claimed or ())
    _refuse_not_direct(named_direct, refused, sU)
    D = tuple(n for n in A if n in named_direct and n not in (claimed or ()))
    reached = tuple(n for n in A if n not in D and any((n, k) in network.modules for k in sU))
    _refuse_not_indirect(claimed or (), reached, sU)
    indirect_nodes = reached if claimed is None else tuple(n for n in reached if n in claimed)
    return NodeSets(
        target=target,
        N=N,
        S=S,
        U=U,
        K=K,
        A=A,
        sU=sU,
        Ut=tuple(n for n in U if n not in sU),
        D=D,
        I=indirect_nodes,
        O=tuple(n for n in A if n not in D and n not in indirect_nodes),
        upstream={u: tuple(n for n in upstream(network, u) if n in S) for u in U},
        downstream={u: tuple(n for n in downstream(network, u) if n in S) for u in U},
    )


def sets_for(
    network: Network, target: Node, sets: NodeSets | None, known: Collection[Edge] = ()
) -> NodeSets:
    """The sets given, or those of the network.

    Raises
    ------
    ModelError
        If the given ones are of another target, or of other sensors or modules.
    """
    own = node_sets(network, target, known=known)
    if sets is None:
        return own
    for what in ("target", "N", "S"):
        if getattr(sets, what) != getattr(own, what):
            raise ModelError(
                f"sets= has {what} = {getattr(sets, what)!r}, where {network.name} has "
                f"{getattr(own, what)!r} for {node_label(target)}; make them with node_sets of the "
                "same network, target and sensors"
            )
    return sets


def with_observations(sets: NodeSets, chosen: Collection[Node]) -> NodeSets:
    """The sets with only the chosen nodes left in D and I; the others join O."""
    D, I = (tuple(n for n in part if n in chosen) for part in (sets.D, sets.I))  # noqa: E741
    O = tuple(n for n in sets.A if n not in D and n not in I)  # noqa: E741
    return replace(sets, D=D, I=I, O=O)


@dataclass(frozen=True, slots=True)
class SignalMapping:
    """Table 4.1: a signal of the transfer-function model and what it is in the network."""

    signal: str
    meaning: str
    elements: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.signal:<5}{self.meaning:<34}{', '.join(self.elements) or 'none'}"


def signal_table(network: Network, sets: NodeSets) -> tuple[SignalMapping, ...]:
    """Table 4.1 for this network: y_O, y_I, y_D, u_K, u_I, u_D, u_A in nodes and excitations.

    u_I and u_D are elements of w_sU: those with a module into a direct observation are u_D.
    """

    def deltas(nodes: tuple[Node, ...]) -> tuple[str, ...]:
        return tuple(f"delta_{n}" for n in nodes if n in network.excitations)

    def names(nodes: Iterable[Node]) -> tuple[str, ...]:
        return tuple(node_label(n) for n in nodes)

    reached = tuple(k for k in sets.sU if any((n, k) in network.modules for n in sets.D))
    rest = tuple(k for k in sets.sU if k not in reached)
    return (
        SignalMapping("y_O", "output", names([sets.target])),
        SignalMapping("y_I", "indirect input measurements", names(sets.I)),
        SignalMapping("y_D", "direct input measurements", names(sets.D) + deltas(sets.D)),
        SignalMapping("u_K", "known inputs", names(sets.K) + deltas((sets.target,))),
        SignalMapping("u_I", "inputs measured indirectly", names(rest)),
        SignalMapping("u_D", "inputs measured directly", names(reached)),
        SignalMapping(
            "u_A", "additional known signals", names(sets.O) + deltas(sets.Ut) + deltas(sets.I)
        ),
    )


def _refuse_target(network: Network, target: Node, S: tuple[Node, ...]) -> None:
    if target not in network.nodes:
        raise ModelError(
            f"{network.name} has no node {target!r}; its nodes are {labels(network.nodes)}"
        )
    if target not in S:
        raise ModelError(
            f"the target {node_label(target)} has no sensor; choose one among {labels(S)}, or add "
            "a sensor to it"
        )


def _refuse_both(direct: Iterable[Node], indirect: Iterable[Node]) -> None:
    both = tuple(n for n in direct if n in set(indirect))
    if both:
        raise ModelError(
            f"{labels(both)} is named both direct and indirect; a node whose modules from the "
            "unknown inputs are known is direct, any other indirect: name it in one of them"
        )


def _refuse_not_direct(
    named: Iterable[Node], refused: Mapping[Node, str], sU: tuple[Node, ...]
) -> None:
    """Refuse named direct nodes that are not additional (in A), or are refused for a reason."""
    for n in named:
        if n not in refused or refused[n]:
            additional = tuple(refused)
            why = refused.get(n, f"it is not among the additional nodes {labels(additional)}")
            raise ModelError(f"{node_label(n)} is no direct observation of {labels(sU)}: {why}")


def _refuse_not_indirect(
    claimed: Iterable[Node], reached: tuple[Node, ...], sU: tuple[Node, ...]
) -> None:
    for n in claimed:
        if n not in reached:
            raise ModelError(
                f"{node_label(n)} is no indirect observation: none of {labels(sU)} has a module "
                f"into it, or it is not observable and additional. Those that are: "
                f"{labels(reached)}"
            )


def _not_direct(network: Network, n: Node, sU: tuple[Node, ...], known: Collection[Edge]) -> str:
    """Why a node is no direct observation by Definition 4.2; empty if it is one."""
    sources = network.sources(n)
    inside = [k for k in sources if k in sU]
    outside = [k for k in sources if k not in sU]
    if not inside:
        return "no unknown predictor input has a module into it"
    if outside:
        return f"{edge_label((n, outside[0]))} adds {node_label(outside[0])} as well"
    unknown = [edge_label((n, k)) for k in inside if (n, k) not in known]
    return f"{', '.join(unknown)} is not known; name it in known= if it is" if unknown else ""
