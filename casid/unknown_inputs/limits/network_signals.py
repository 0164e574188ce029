"""The signals of a dynamic network: nodes, external signals, and sensor readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.linear.filters import as_filter
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.networks.dynamics import network_states, refuse_unstable
from casid.unknown_inputs.networks.network import Network
from casid.unknown_inputs.networks.nodes import node_label

Array = NDArray[np.complex128]


@names_wrong_types(ModelError)
def network_signals(network: Network) -> LinearSignals:
    """The nodes of a network as signals of its externals.

    Signals are the nodes by their labels (w1, w2, ..), and the reading of a noisy sensor,
    "measured w2". Externals are "delta w2", "tau w2" and "noise w2": white, each with its
    variance, ahead of its own noise model.

    Raises
    ------
    ModelError
        If the network has parameters without values, is of continuous time, or is not stable.
    """
    if network.variable == "s":
        raise ModelError(
            f"{network.name} is of continuous time, asymptotics are of sampled signals; give its "
            "modules in q"
        )
    refuse_unstable(network)
    states = network_states(network)
    Ts = network.Ts or 1.0
    label = {n: node_label(n) for n in network.nodes}
    entering = []  # (column, filter) of each external
    variances: dict[str, float] = {}
    for kind, signals in (("delta", network.excitations), ("tau", network.disturbances)):
        for node, signal in signals.items():
            name = f"{kind} {label[node]}"
            variances[name] = float(signal.variance)
            column = network.nodes.index(node)
            entering.append((column, as_filter(signal.model, f"noise model of {name}")))
    noisy = [n for n in network.measured if network.sensor_noise.get(n, 0.0) > 0]
    variances |= {f"noise {label[n]}": network.sensor_noise[n] for n in noisy}
    nodes = tuple(label[n] for n in network.nodes)

    def response(z: Array) -> Array:
        """(F, nodes, sources) responses of the nodes to all noise sources."""
        own = states.response(z)
        made = np.zeros((len(z), len(nodes), len(variances)), dtype=complex)
        for k, (column, model) in enumerate(entering):
            made[:, :, k] = own[:, :, column] * model(z)[:, None]
        return made

    delay = len(states.A) + max((model.reach for _, model in entering), default=0) + 1
    system = LinearSignals.of_response(nodes, response, variances, Ts=Ts, longest_delay=delay)
    return system.with_signals(
        {f"measured {label[n]}": {label[n]: 1.0, f"noise {label[n]}": 1.0} for n in noisy}
    )
