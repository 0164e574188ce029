"""A network simulated, and signals passed through its transfer functions."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Integral
from typing import Any

import numpy as np

from casid.algebra.rational import Rational
from casid.arrays import Array
from casid.data.record import Record
from casid.errors import DataError, ModelError
from casid.linear.state_space import StateSpace
from casid.model.quantities import count_text
from casid.unknown_inputs.networks.dynamics import network_states, refuse_unstable
from casid.unknown_inputs.networks.network import Network, Signal
from casid.unknown_inputs.networks.nodes import Node, node_label


def simulate_network(
    network: Network,
    N: int,
    *,
    seed: int | np.random.Generator = 0,
    settle: int | None = None,
    excitations: Mapping[Node, Array] | None = None,
) -> Record:
    """Simulate a discrete network in its steady state.

    Parameters
    ----------
    N : samples.
    seed : of excitations, disturbances and sensor noise; all Gaussian.
    settle : samples simulated first and dropped; by default as many as the slowest mode needs to
        decay to 1e-8, at most 100 000.
    excitations : node -> (N,) delta_j of one's own, a recorded or designed reference, instead of
        drawn ones; also of nodes that are not among the network's excitations. While the network
        settles it runs on its own last samples, repeated backward in time, as a periodic signal
        does; where the reference started from rest, settle = 0 says so. The draws of other signals
        are the same as without it.

    Returns
    -------
    Record with w1, w2 ... (or the nodes' own names), the sensors' noise included for measured
    nodes; delta_j of excited and tau_j of disturbed nodes.

    Raises
    ------
    ModelError
        If the network is in continuous time, not stable, or a parameter has no value.
    DataError
        If N or settle is no number of samples, or an excitation is of no node, of another length
        or not finite.
    """
    N = _samples(N, "N", least=1)
    own = {n: _given(network, n, x, N) for n, x in _mapping(excitations).items()}
    refuse_continuous(network, "simulated sample by sample")
    refuse_unstable(network)
    states = network_states(network)
    rng = np.random.default_rng(seed)
    if settle is None:
        settle = _settling_samples(states)
    total = N + _samples(settle, "settle", least=0)
    deltas = {n: _drawn(s, total, rng) for n, s in network.excitations.items()}
    deltas |= {n: x[np.arange(-settle, N) % N] for n, x in own.items()}
    taus = {n: _drawn(s, total, rng) for n, s in network.disturbances.items()}
    external = np.zeros((total, len(network.nodes)))
    for i, n in enumerate(network.nodes):
        external[:, i] = deltas.get(n, 0.0) + taus.get(n, 0.0)
    channels = _readings(network, states, external, rng, settle)
    channels |= {f"delta_{n}": d[settle:] for n, d in deltas.items()}
    channels |= {f"tau_{n}": t[settle:] for n, t in taus.items()}
    return Record(
        channels,
        dict.fromkeys(channels, "1"),
        Ts=network.Ts or 1.0,
        name=network.name,
        provenance=(f"{network.name}, simulated",),
    )


def _settling_samples(states: StateSpace) -> int:
    """Samples in which the slowest mode decays to 1e-8, at most 100 000."""
    slowest = max((abs(r.value) for r in states.poles()), default=0.0)
    return min(int(np.log(1e-8) / np.log(max(slowest, 1e-3))) + 1, 100_000)


def _readings(
    network: Network, states: StateSpace, external: Array, rng: np.random.Generator, settle: int
) -> dict[str, Array]:
    """The nodes as their sensors read them, the first `settle` samples left out."""
    from scipy.signal import dlsim

    system = (states.A, states.B, states.C, states.D, 1.0)
    w = dlsim(system, external)[1] if len(states.A) else external @ states.D.T
    channels = {}
    for i, n in enumerate(network.nodes):
        noise = network.sensor_noise.get(n, 0.0)
        read = w[:, i] + np.sqrt(noise) * rng.standard_normal(len(w)) if noise else w[:, i]
        channels[node_label(n)] = read[settle:]
    return channels


def filtered(g: Rational, x: Array) -> Array:
    """(N,) a signal through a proper discrete transfer function, from rest.

    Raises
    ------
    ModelError
        If the function is improper, in continuous time, or holds parameters without a value.
    """
    from scipy.signal import lfilter

    if g.is_zero:
        return np.zeros_like(x)
    if g.variable == "s":
        raise ModelError(f"{g} is in continuous time; sample it first (control.sample_system)")
    if not g.is_proper:
        ahead = count_text(-g.relative_degree, "sample")
        raise ModelError(f"{g} needs {ahead} of the future; delay it by as many")
    if g.parameters:
        raise ModelError(f"{g} holds {', '.join(g.parameters)} without a value; substitute them")
    below = [float(c) for c in g.denominator]
    above = [float(c) for c in g.numerator]
    above = [0.0] * (len(below) - len(above)) + above
    return np.asarray(lfilter(above, below, x), dtype=np.float64)


def signal_of(signals: Record | Mapping[str, Array], name: str) -> Array:
    """A channel of a record or of a mapping.

    Raises
    ------
    DataError
        If there is none of that name.
    """
    channels = signals.channels if isinstance(signals, Record) else signals
    if name not in channels:
        raise DataError(
            f"no signal {name!r}; there are {', '.join(channels)}. Rename the channel that is it, "
            "or choose a predictor that does not need it"
        )
    return np.asarray(channels[name], dtype=np.float64)


def refuse_continuous(network: Network, what: str) -> None:
    """Refuse a network in s.

    Raises
    ------
    ModelError
        With the remedy.
    """
    if network.variable == "s":
        raise ModelError(
            f"{network.name} is in continuous time and cannot be {what}; sample its modules first "
            "(control.sample_system)"
        )


def _samples(given: Any, what: str, least: int) -> int:
    if isinstance(given, bool) or not isinstance(given, Integral) or given < least:
        shown = f"a {type(given).__name__}" if isinstance(given, Mapping) else repr(given)
        raise DataError(
            f"{what} is {shown}; give a number of samples >= {least}"
            + (", and signals of one's own as excitations={node: (N,) array}" * (what == "N"))
        )
    return int(given)


def _mapping(given: Any) -> Mapping[Node, Any]:
    if given is not None and not isinstance(given, Mapping):
        raise DataError(
            f"excitations is a {type(given).__name__}; give a mapping {{node: (N,) array}}"
        )
    return given or {}


def _given(network: Network, node: Node, x: Any, N: int) -> Array:
    if node not in network.nodes:
        raise DataError(
            f"excitations names {node!r}, which is no node of {network.name}; choose among "
            f"{', '.join(map(repr, network.nodes))}"
        )
    values = np.asarray(x, dtype=float)
    if values.shape != (N,):
        raise DataError(
            f"the excitation of {node_label(node)} has the shape {values.shape}, N = {N}; give "
            f"({N},) samples, or N = {values.size}"
        )
    if not np.all(np.isfinite(values)):
        k = int(np.flatnonzero(~np.isfinite(values))[0])
        raise DataError(
            f"the excitation of {node_label(node)} is not finite at k = {k}; cut or fill it there"
        )
    return values


def _drawn(signal: Signal, N: int, rng: np.random.Generator) -> Array:
    return filtered(signal.model, np.sqrt(signal.variance) * rng.standard_normal(N))
