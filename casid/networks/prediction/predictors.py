"""The predictors of a node, class by class: (6.1)-(6.11) of Linder (2017)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

from casid.errors import ModelError
from casid.networks.elimination import immerse
from casid.networks.equations import NodeEquations, node_equations
from casid.networks.indirect_equations import indirect_equations
from casid.networks.network import Edge, Network, Node, Signal, labels, node_label
from casid.networks.node_sets import NodeSets, node_sets
from casid.networks.prediction.node_predictor import NodePredictor
from casid.networks.simulation import refuse_continuous
from casid.transfer.rational import Rational
from casid.transfer.reading import rational

ALL_INPUTS, NEGLECT = "all inputs known", "neglect"
IMMERSED, IMMERSED_ALL, INDIRECT = "immersed", "immersed, all measured", "indirect"


def row_predictor(
    network: Network,
    equations: NodeEquations,
    target: Node,
    kind: str,
    *,
    use_excitations: bool = True,
) -> NodePredictor:
    """The predictor that a row of equations is: its nodes and known delta predict, tau is left.

    Parameters
    ----------
    equations : symbolic ones, in which every node but `target` in its row is measured.
    use_excitations : False: every delta but that of the target itself counts as a disturbance.

    Raises
    ------
    ModelError
        If the row holds a node that is not measured.
    """
    row = {k: equations.module(target, k) for k in equations.G[target]}
    hidden = [k for k in row if k not in network.measured]
    if hidden:
        raise ModelError(
            f"the equation of {node_label(target)} still holds {labels(hidden)}, which no sensor "
            "measures; eliminate it (immerse, indirect_equations), or measure it"
        )
    return _of_row(
        network, target, kind, row, _filters(equations, target), use_excitations=use_excitations
    )


def all_inputs(network: Network, target: Node, *, use_excitations: bool = True) -> NodePredictor:
    """(6.1): as if every node with a module into the target were measured; its error is tau_j.

    A reference that no predictor without it can beat; sensor noise is not counted.
    """
    row = {k: network.module(target, k) for k in network.sources(target)}
    quiet = network.with_sensors(network.nodes)
    return _of_row(
        _without_sensor_noise(quiet),
        target,
        ALL_INPUTS,
        row,
        {target: rational(1)},
        use_excitations=use_excitations,
    )


def neglecting(network: Network, sets: NodeSets) -> NodePredictor:
    """(6.2)-(6.3): modules from measured nodes and delta_j; what other nodes send is the error."""
    target = sets.target
    row = {k: network.module(target, k) for k in sets.K}
    # w_sU by the externals of the whole network: every other node immersed in it.
    error: dict[Node, Rational] = {target: rational(1)}
    for u in sets.sU:
        alone = immerse(node_equations(network), [u])
        for n in alone.externals(u):
            term = network.module(target, u) * alone.filter(u, n)
            error[n] = error[n] + term if n in error else term
    return _of_row(network, target, NEGLECT, row, error, use_excitations=False)


def immersed(
    network: Network,
    sets: NodeSets,
    *,
    inputs: Iterable[Node] | None = None,
    use_excitations: bool = True,
) -> NodePredictor:
    """(6.5)-(6.6): all nodes but the target and `inputs` immersed (default K, predictor inputs).

    Example 3.4 with K = {1, 3}; Example 3.7 with all measured nodes.
    """
    chosen = sets.K if inputs is None else tuple(inputs)
    every = set(chosen) == set(sets.S) - {sets.target}
    found = immerse(node_equations(network), [sets.target, *chosen])
    kind = IMMERSED_ALL if every and inputs is not None else IMMERSED
    return row_predictor(network, found, sets.target, kind, use_excitations=use_excitations)


def indirect(network: Network, sets: NodeSets, *, use_excitations: bool = True) -> NodePredictor:
    """(4.24) and (6.11) corrected: unmeasured inputs eliminated by nodes that feel them."""
    found = indirect_equations(network, sets)
    return row_predictor(network, found, sets.target, INDIRECT, use_excitations=use_excitations)


@dataclass(frozen=True, slots=True, eq=False)
class PredictorTable:
    """The predictors of one node beside each other.

    Attributes
    ----------
    predictors : in the order of the classes.
    refused : class -> why it does not exist here.
    """

    target: Node
    predictors: tuple[NodePredictor, ...]
    refused: tuple[tuple[str, str], ...] = ()

    def __getitem__(self, kind: str) -> NodePredictor:
        for p in self.predictors:
            if p.kind == kind:
                return p
        why = dict(self.refused).get(
            kind, f"there are {', '.join(p.kind for p in self.predictors)}"
        )
        raise ModelError(f"no predictor {kind!r}: {why}")

    def __str__(self) -> str:
        lines = [f"Predictors of {node_label(self.target)}: exact variance of the one-step error"]
        lines.append(f"  {'predictor':<24}{'uses':<34}{'plain':>10}{'+ own past':>12}")
        for p in self.predictors:
            r = p.row()
            lines.append(
                f"  {r['predictor']:<24}{r['uses']:<34}{r['error variance']:>10.4g}"
                f"{r['with its own past']:>12.4g}" + (f"   {r['remark']}" if r["remark"] else "")
            )
        lines += [f"  {kind:<24}does not exist: {why}" for kind, why in self.refused]
        return "\n".join(lines)


def compare_predictors(
    network: Network,
    target: Node,
    *,
    sensors: Iterable[Node] | None = None,
    known: Collection[Edge] = (),
    use_excitations: bool = True,
) -> PredictorTable:
    """All classes of predictors for one node, with the exact variance of each error.

    Parameters
    ----------
    sensors : measured nodes; by default the network's own.
    known : modules whose transfer function is known, for direct measurements.
    use_excitations : False: known delta are not used.

    Raises
    ------
    ModelError
        If the network is continuous, unstable, or the target is not measured.
    """
    refuse_continuous(network, "predicted one step ahead")
    if sensors is not None:
        network = network.with_sensors(sensors)
    sets = node_sets(network, target, known=known)
    makers: tuple[tuple[str, Callable[[], NodePredictor]], ...] = (
        (ALL_INPUTS, lambda: all_inputs(network, target, use_excitations=use_excitations)),
        (NEGLECT, lambda: neglecting(network, sets)),
        (IMMERSED, lambda: immersed(network, sets, use_excitations=use_excitations)),
        (
            IMMERSED_ALL,
            lambda: immersed(
                network, sets, inputs=(*sets.K, *sets.A), use_excitations=use_excitations
            ),
        ),
        (INDIRECT, lambda: indirect(network, sets, use_excitations=use_excitations)),
    )
    found, refused = [], []
    for kind, make in makers:
        try:
            found.append(make())
        except ModelError as why:
            refused.append((kind, str(why)))
    return PredictorTable(target, tuple(found), tuple(refused))


# -- inside ----------------------------------------------------------------------------------------


def _filters(equations: NodeEquations, target: Node) -> dict[Node, Rational]:
    return {n: equations.filter(target, n) for n in equations.externals(target)}


def _of_row(
    network: Network,
    target: Node,
    kind: str,
    row: dict[Node, Rational],
    filters: dict[Node, Rational],
    *,
    use_excitations: bool,
) -> NodePredictor:
    excitations, error, sources = {}, {}, {}
    for n, f in filters.items():
        if n in network.disturbances:
            error[f"tau_{n}"], sources[f"tau_{n}"] = f, network.disturbances[n]
        if n not in network.excitations:
            continue
        if use_excitations or n == target:
            excitations[n] = f
        else:
            error[f"delta_{n}"], sources[f"delta_{n}"] = f, network.excitations[n]
    for k, g in row.items():
        if network.sensor_noise.get(k, 0.0) > 0:
            error[f"sensor_{k}"] = -g
            sources[f"sensor_{k}"] = Signal(network.sensor_noise[k])
    kept = {k: g for k, g in row.items() if not g.is_zero}
    return NodePredictor(network, target, kind, kept, excitations, error, sources)


def _without_sensor_noise(network: Network) -> Network:
    from casid.networks.network import dynamic_network

    return dynamic_network(
        network.modules,
        nodes=network.nodes,
        excitations=network.excitations,
        disturbances=network.disturbances,
        Ts=network.Ts if network.variable == "q" else None,
        name=network.name,
    )
