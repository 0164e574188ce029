"""A cooling jacket whose water renews it within minutes or hours, under a random flow of heat."""

from __future__ import annotations

import numpy as np

import casid

TS, SAMPLES = 20.0, 1000  # s
WATER, VOLUME, UA, COLD = 4.18e6, 0.05, 420.0, 288.0  # J/(m^3 K), m^3, W/K, K
FORCE, MEMORY, OUTPUT = 120.0, 400.0, 0.05  # W, s, K


def model() -> casid.Model:
    """Unknown are the volume and what the walls conduct; the flow multiplies the state."""
    m = casid.Model("jacket")
    T = m.state("T", "K", start=310.0)
    q, hot = (
        m.input(name, unit, hold="zoh", known=True) for name, unit in (("q", "m^3/s"), ("hot", "K"))
    )
    V = m.parameter("V", "m^3", start=0.05, lower=0.01, upper=1.0)
    ua = m.parameter("UA", "W/K", start=400.0, lower=10.0, upper=5e3)
    water, cold = m.constant("w", WATER, "J/(m^3 K)"), m.constant("Tc", COLD, "K")
    m.balance(T, "heat", inertia=V * water, terms=[q * water * (cold - T), ua * (hot - T)])
    m.output("T", T, "K")
    return m


def record(seed: int, samples: int = SAMPLES) -> casid.Record:
    """Ten Euler steps a sample; the heat keeps its size over each, and has a memory of 20."""
    rng = np.random.default_rng(seed)
    q = np.repeat(np.exp(rng.uniform(np.log(0.6), np.log(20.0), samples // 40)), 40) / 6e4
    hot = np.repeat(rng.uniform(330.0, 345.0, samples // 50), 50)
    share = np.exp(-TS / MEMORY)
    x, force, out = 310.0, 0.0, np.empty(samples)
    for i in range(samples):
        out[i] = x
        for _ in range(10):
            heat = q[i] * WATER * (COLD - x) + UA * (hot[i] - x) + force
            x += TS / 10 * heat / (VOLUME * WATER)
        force = share * force + FORCE * np.sqrt(1 - share**2) * rng.standard_normal()
    return casid.Record(
        {"q": q, "hot": hot, "T": out + OUTPUT * rng.standard_normal(samples)},
        {"q": "m^3/s", "hot": "K", "T": "K"},
        Ts=TS,
    )
