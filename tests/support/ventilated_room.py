"""A room whose supply of air is noisy, and multiplies how much worse its air is than outside."""

from __future__ import annotations

import numpy as np

import casid

EACH, LEAK = 0.0185 / 3600, 15.0 / 3600  # m^3/s that a person breathes out, and of the leak
OUTSIDE, VOLUME, NOISE = 425e-6, 60.0, 12.0  # share of CO2, m^3, m^3/h of the recorded supply


def model() -> casid.Model:
    """Unknown are the leak and what each person breathes out."""
    m = casid.Model("room")
    c = m.state("c", "1", start=5e-4)
    supply = m.input("supply", "m^3/h", hold="zoh")
    people = m.input("people", "1", hold="zoh", known=True)
    outside, volume = m.constant("outside", OUTSIDE, "1"), m.constant("V", VOLUME, "m^3")
    each = m.parameter("each", "m^3/h", start=0.02, lower=0.0)
    leak = m.parameter("leak", "m^3/h", start=10.0, lower=0.0)
    terms = [supply * (outside - c), leak * (outside - c), people * each]
    m.balance(c, "room", inertia=volume, terms=terms)
    m.output("c", c, "1")
    return m


def record(seed: int) -> casid.Record:
    """A day at a sample a minute, exact while supply and people stay as they are."""
    rng = np.random.default_rng(seed)
    people = np.repeat(rng.integers(0, 7, 24), 60).astype(float)
    people[:480] = people[-300:] = 0.0
    supply = np.repeat(rng.choice([25.0, 70.0, 120.0, 200.0], 12), 120)
    y, x = np.empty(1440), 450e-6
    for i in range(1440):
        y[i] = x
        flow = supply[i] / 3600 + LEAK
        end = OUTSIDE + people[i] * EACH / flow
        x = end + (x - end) * np.exp(-60.0 * flow / VOLUME)
    columns = {"c": y + 2e-6 * rng.standard_normal(1440), "people": people}
    columns["supply"] = (supply + NOISE * rng.standard_normal(1440)) / 3600
    return casid.Record(columns, {"c": "1", "people": "1", "supply": "m^3/s"}, Ts=60.0)
