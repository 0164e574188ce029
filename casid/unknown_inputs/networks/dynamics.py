"""The network as one dynamic system: state space from external signals to nodes, and its poles."""

from __future__ import annotations

import numpy as np

from casid.algebra.realisation import matrices
from casid.algebra.transfer_matrix import RationalMatrix
from casid.arrays import Array
from casid.errors import ModelError
from casid.linear.state_space import StateSpace
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import edge_label, node_label


def network_states(network: Network) -> StateSpace:
    """The state space from delta + tau of every node to the nodes: (I - G)^-1.

    Every row of modules is realised, then the network closed. Inputs and outputs are in the order
    of the nodes.

    Raises
    ------
    ModelError
        If parameters have no value.
    """
    if network.parameters:
        raise ModelError(
            f"{network.name}: its dynamics need a value for {', '.join(network.parameters)}; give "
            "them with network.substitute({name: value})"
        )
    L = len(network.nodes)
    place = {n: i for i, n in enumerate(network.nodes)}
    parts = []
    D0 = np.zeros((L, L))
    for n in network.nodes:
        sources = network.sources(n)
        if sources:
            row = RationalMatrix((tuple(network.module(n, k) for k in sources),))
            a, b, c, d = matrices(row)
            wide = np.zeros((len(a), L))
            columns = [place[k] for k in sources]
            wide[:, columns] = b
            D0[place[n], columns] = d[0]
            parts.append((place[n], a, wide, c))
    order = sum(len(a) for _, a, _, _ in parts)
    A0, B0, C0 = np.zeros((order, order)), np.zeros((order, L)), np.zeros((L, order))
    start = 0
    for i, a, b, c in parts:
        stop = start + len(a)
        A0[start:stop, start:stop], B0[start:stop], C0[i, start:stop] = a, b, c[0]
        start = stop
    closed: Array = np.asarray(np.linalg.inv(np.eye(L) - D0))  # w = C0 x + D0 w + e
    return StateSpace(
        A0 + B0 @ closed @ C0,
        B0 @ closed,
        closed @ C0,
        closed,
        tuple(node_label(n) for n in network.nodes),
        0.0 if network.variable == "s" else network.Ts,
    )


def is_stable(network: Network) -> bool:
    """Assumption 2.1 (b): whether every mode of (I - G)^-1 is stable."""
    return all(r.is_stable for r in network_states(network).poles())


def stability_text(network: Network) -> str:
    """The stability of (I - G)^-1 in one line."""
    poles = network_states(network).poles()
    if not poles:
        return "(I - G)^-1 is static"
    bad = [r for r in poles if not r.is_stable]
    if bad:
        return f"(I - G)^-1 is UNSTABLE: {len(bad)} of {len(poles)} poles, such as {bad[0]}"
    size = f"spectral radius {abs(poles[0].value):.4g}"
    if network.variable == "s":
        size = f"slowest pole {max(poles, key=lambda r: r.value.real)}"
    return f"(I - G)^-1 is stable, {len(poles)} states, {size}"


def refuse_unstable(network: Network) -> None:
    """Refuse a network whose (I - G)^-1 is not stable.

    Raises
    ------
    ModelError
        With the pole, and the unstable modules.
    """
    bad = [r for r in network_states(network).poles() if not r.is_stable]
    if bad:
        own = [edge_label(e) for e, g in network.modules.items() if not g.is_stable]
        raise ModelError(
            f"{network.name}: (I - G)^-1 is not stable, pole {bad[0]}"
            + (f"; unstable modules are {', '.join(own)}" if own else "; every module is stable")
            + ". Its signals have no stationary moments: lower a loop gain"
        )
