"""A tank of hot water in two layers, whose draws last a sample, and whose flow meter is noisy."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

import casid

TS, SAMPLES = 300.0, 800  # s
CW, TOP, BOTTOM = 4.186e6, 0.12, 0.18  # J/(m^3 K), m^3
COP, UA_TOP, UA_BOTTOM, MIXING = 3.0, 2.5, 3.0, 12.0
OUTPUT, FLOW = 0.05, 0.25 / 60e3  # noise: degC, m^3/s


def model() -> casid.Model:
    """Unknown are the heat pump's yield, two losses, and the mixing of the layers."""
    m = casid.Model("tank")
    top, bottom = m.state("top", "degC"), m.state("bottom", "degC")
    power = m.input("power", "W", hold="zoh", known=True)
    flow = m.input("flow", "m^3/s", hold="zoh")
    room, cold = m.constant("room", 20.0, "degC"), m.constant("cold", 10.0, "degC")
    cw, V, W = (m.constant(*c) for c in _CONSTANTS)
    yields = m.parameter("COP", "1", start=2.5, lower=0.5)
    lost = [m.parameter(f"UA_{n}", "W/K", start=2.0, lower=0.0) for n in ("top", "bottom")]
    mixing = m.parameter("k", "W/K", start=5.0, lower=0.0) * (top - bottom)
    terms = [yields * power, cw * flow * (bottom - top), -lost[0] * (top - room), -mixing]
    m.balance(top, "upper", inertia=cw * V, terms=terms)
    terms = [cw * flow * (cold - bottom), -lost[1] * (bottom - room), mixing]
    m.balance(bottom, "lower", inertia=cw * W, terms=terms)
    m.output("T_top", top, "degC")
    m.output("T_bottom", bottom, "degC")
    return m


_CONSTANTS = (("cw", CW, "J/(m^3 K)"), ("V", TOP, "m^3"), ("W", BOTTOM, "m^3"))
TRUTH = {"COP": COP, "UA_top": UA_TOP, "UA_bottom": UA_BOTTOM, "k": MIXING}


def record(seed: int, samples: int = SAMPLES) -> casid.Record:
    """Exact while power and flow stay as they are; one sample of eight has a draw."""
    rng = np.random.default_rng(seed)
    drawn = rng.random(samples) < 0.12
    flow = np.where(drawn, rng.uniform(0.5, 7.0, samples), 0.0) / 60e3
    x, is_on = np.array([50.0, 35.0]), False
    y, power = np.empty((samples, 2)), np.empty(samples)
    heat = CW * np.array([TOP, BOTTOM])
    for i in range(samples):
        y[i] = x + OUTPUT * rng.standard_normal(2)
        is_on = y[i, 0] < 46.0 or (is_on and y[i, 0] < 54.0)
        power[i] = 1500.0 if is_on else 0.0
        by_flow = CW * flow[i]
        a = [
            [-by_flow - UA_TOP - MIXING, by_flow + MIXING],
            [MIXING, -by_flow - UA_BOTTOM - MIXING],
        ]
        b = [COP * power[i] + UA_TOP * 20.0, by_flow * 10.0 + UA_BOTTOM * 20.0]
        whole = np.zeros((3, 3))
        whole[:2, :2], whole[:2, 2] = np.array(a) / heat[:, None], np.array(b) / heat
        x = (expm(whole * TS) @ [*x, 1.0])[:2]
    y += 273.15
    noisy = flow + FLOW * rng.standard_normal(samples)
    columns = {"power": power, "flow": noisy, "T_top": y[:, 0], "T_bottom": y[:, 1]}
    units = {"power": "W", "flow": "m^3/s", "T_top": "K", "T_bottom": "K"}
    return casid.Record(columns, units, Ts=TS)
