"""A vessel that is heated, and loses heat, under a slow random flow of heat; without casid.

C T' = P - k T + w,    k from its instant on by a share more
"""

from __future__ import annotations

import numpy as np

import casid

TS, N = 10.0, 1500
LOSS, CAPACITY, NOISE, MEMORY = 10.0, 4e3, 0.02, 300.0  # W/K, J/K, K, s
SETS_IN = 9300.0  # s


def vessel() -> casid.Problem:
    m = casid.Model("heated vessel")
    T = m.state("T", "K")
    P = m.input("P", "W", hold="zoh", known=True)
    k = m.parameter("k", "W/K", start=8.0, lower=0.1, upper=100.0)
    C = m.parameter("C", "J/K", start=5e3, lower=100.0, upper=1e6)
    m.balance(T, "heat", inertia=C, terms=[P, -k * T])
    m.output("temperature", T, "K")
    return casid.Problem("heated vessel", m)


def changed_vessel(seed: int, share: float, flow: float) -> casid.Record:
    """Its loss larger by a share from `SETS_IN` on, under a random flow of `flow` [W] rms."""
    rng, parts = np.random.default_rng(seed), 10
    h = TS / parts
    kept = np.exp(-h / MEMORY)
    P = np.repeat(rng.choice([50.0, 150.0, 250.0], N // 50 + 1), 50)[:N]
    T, w, shown = 15.0, 0.0, np.empty(N)
    for i in range(N):
        shown[i] = T
        for part in range(parts):
            loss = LOSS * (1 + share * (i * TS + part * h >= SETS_IN))
            T += h / CAPACITY * (P[i] - loss * T + w)
            w = kept * w + flow * np.sqrt(1 - kept**2) * rng.standard_normal()
    temperature = shown + NOISE * rng.standard_normal(N)
    return casid.Record({"P": P, "temperature": temperature}, {"P": "W", "temperature": "K"}, Ts=TS)
