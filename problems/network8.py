"""The eight-node network of Linder (2017), Example 3.2, with the modules of Table 6.1.

Node 2 is of interest; nodes 5, 6 and 8 have no sensor. Every node has a disturbance tau, node 6 a
known excitation delta_6 as well; all are white, of unit variance and independent.

    from problems.network8 import network, simulate
    record = simulate(seed=1)
    record["w2"], record["delta_6"]

`symbolic()` is the network of Example 3.2, in which nothing is known of a module but that it is
there. Table 6.1 prints G18, which the network does not have, and lacks G17: the column is G17.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from casid.algebra.rational import Rational
from casid.data.record import Record
from casid.unknown_inputs.networks.network import Network, dynamic_network

TARGET = 2
MEASURED = (1, 2, 3, 4, 7)

# (to, from): beta, alpha of G = beta q^-1 / (1 - alpha q^-1), Table 6.1.
TABLE_6_1: dict[tuple[int, int], tuple[float, float]] = {
    (1, 2): (0.07, 0.11),
    (1, 7): (0.20, 0.92),
    (2, 1): (0.19, 0.91),
    (2, 3): (0.18, 0.53),
    (2, 5): (0.20, 0.89),
    (3, 6): (0.17, 0.77),
    (4, 1): (0.16, 0.93),
    (4, 5): (0.17, 0.75),
    (5, 2): (0.11, 0.41),
    (5, 8): (0.17, 0.93),
    (7, 6): (0.18, 0.89),
    (8, 6): (0.21, 0.61),
    (8, 7): (0.19, 0.92),
}


def table_network(measured: tuple[int, ...] = MEASURED) -> Network:
    """The network with the modules of Table 6.1, one sample a second."""
    q = Rational.shift(Ts=1.0)
    return dynamic_network(
        {edge: beta / (q - alpha) for edge, (beta, alpha) in TABLE_6_1.items()},
        excitations=(6,),
        measured=measured,
        name="network8",
    )


def symbolic(measured: tuple[int, ...] = MEASURED) -> Network:
    """The same network with a symbol for each module: G12, G17, ..."""
    import casadi as ca

    return dynamic_network(
        {(to, source): ca.SX.sym(f"G{to}{source}") for to, source in TABLE_6_1},
        excitations=(6,),
        measured=measured,
        name="network8",
    )


network = table_network()


def simulate(
    seed: int,
    N: int = 1000,
    *,
    excitation: float = 1.0,
    disturbance: float = 1.0,
    variances: dict[int, float] | None = None,
    settle: int = 1000,
) -> Record:
    """Simulate the network, sample by sample, from its difference equations.

    Parameters
    ----------
    seed : of the random numbers.
    N : samples; the first `settle` are simulated and dropped, since the slowest mode is 0.954^t.
    excitation : standard deviation of delta_6.
    disturbance : standard deviation of every tau; 0 gives noise-free signals.
    variances : node -> variance of its tau, instead of `disturbance` squared.

    Returns
    -------
    Record with w1 ... w8, delta_6 and tau_1 ... tau_8, Ts = 1 s. What a sensor would give is w1,
    w2, w3, w4, w7; the other signals are there for comparison.
    """
    rng = np.random.default_rng(seed)
    total = N + settle
    spread = np.full(8, disturbance)
    for node, variance in (variances or {}).items():
        spread[node - 1] = np.sqrt(variance)
    tau = spread * rng.standard_normal((total, 8))
    delta = excitation * rng.standard_normal(total)
    external = tau.copy()
    external[:, 5] += delta
    w = _run(external)[settle:]
    channels = {f"w{i + 1}": w[:, i] for i in range(8)}
    channels["delta_6"] = delta[settle:]
    channels |= {f"tau_{i + 1}": tau[settle:, i] for i in range(8)}
    return Record(channels, dict.fromkeys(channels, "1"), Ts=1.0, name=f"network8-{seed}")


def _run(external: NDArray[np.float64]) -> NDArray[np.float64]:
    """w of (N, 8) external signals: each module keeps its output x+ = alpha x + beta w_from."""
    edges = list(TABLE_6_1)
    beta, alpha = np.array([TABLE_6_1[edge] for edge in edges]).T
    source = np.array([k - 1 for _, k in edges])
    into = np.zeros((8, len(edges)))
    into[[to - 1 for to, _ in edges], range(len(edges))] = 1.0
    x = np.zeros(len(edges))
    w = np.empty_like(external)
    for t, entering in enumerate(external):
        w[t] = into @ x + entering
        x = alpha * x + beta * w[t, source]
    return w
