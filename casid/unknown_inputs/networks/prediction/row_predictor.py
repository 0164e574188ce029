"""The predictor that a row of equations is."""

from __future__ import annotations

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.unknown_inputs.networks.equations import NodeEquations
from casid.unknown_inputs.networks.network import Network, Signal
from casid.unknown_inputs.networks.nodes import Node, labels, node_label
from casid.unknown_inputs.networks.prediction.node_predictor import NodePredictor


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
    filters = {n: equations.filter(target, n) for n in equations.externals(target)}
    return predictor_of(network, target, kind, row, filters, use_excitations=use_excitations)


def predictor_of(
    network: Network,
    target: Node,
    kind: str,
    row: dict[Node, Rational],
    filters: dict[Node, Rational],
    *,
    use_excitations: bool,
) -> NodePredictor:
    """The predictor of modules by node, and of filters of delta + tau by node."""
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
