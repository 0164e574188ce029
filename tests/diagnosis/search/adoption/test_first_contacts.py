"""Where a command with play stands in it when a record begins."""

from __future__ import annotations

import numpy as np
import pytest

import casid

TS, N, GAP, TAU, AREA = 2.0, 500, 0.04, 6.0, 0.35


def tank() -> casid.Model:
    """A level under the flow through a valve that follows its command with a lag."""
    m = casid.Model("tank behind a valve")
    h, v = m.state("h", "m", start=0.8), m.state("v", "1", start=0.4)
    u = m.input("u", "1", hold="zoh", known=True)
    area = m.constant("A", AREA, "m^2")
    k = m.parameter("k", "m^3/s", start=4e-3, lower=1e-4, upper=0.1)
    out = m.parameter("g", "m^2/s", start=1.2e-3, lower=1e-5, upper=0.1)
    tau = m.parameter("tau", "s", start=5.0, lower=0.5, upper=60.0)
    m.derivative(v, (u - v) / tau)
    m.balance(h, "volume", inertia=area, terms=[k * v, -out * h])
    m.output("level", h, "m")
    m.output("flow", k * v, "m^3/s")
    return m


def measured(begins: float) -> casid.Record:
    """By NumPy, a twentieth of a sample at a time; the stem `begins` gaps beside the command."""
    rng = np.random.default_rng(3)
    steps = np.repeat(rng.uniform(0.25, 0.55, N // 25), 25)
    u = steps + 0.03 * np.sin(2 * np.pi * np.arange(N) / 60)
    h, v, stem, y = 0.8, u[0] + begins * GAP, u[0] + begins * GAP, np.empty((N, 2))
    for i in range(N):
        stem = min(max(stem, u[i] - GAP), u[i] + GAP)
        y[i] = h, 5e-3 * v
        for _ in range(20):
            h += TS / 20 * (5e-3 * v - 1.5e-3 * h) / AREA
            v = stem + (v - stem) * np.exp(-TS / 20 / TAU)
    y += rng.standard_normal((N, 2)) * [2e-3, 1e-5]
    units = {"u": "1", "level": "m", "flow": "m^3/s"}
    return casid.Record({"u": u, "level": y[:, 0], "flow": y[:, 1]}, units, Ts=TS)


@pytest.mark.slow
def test_a_valve_that_begins_at_a_contact_lacks_nothing_but_its_play():
    """Begun in the middle instead, the play leaves errors that look like a change of tau."""
    found = casid.diagnose(casid.Problem("tank", tank()), measured(-1.0), starts=1, advise=False)
    (play,) = found.causes
    assert (play.kind, play.where) == ("backlash", "u")
    (gap,) = play.parameters
    assert abs(gap.value - GAP) < 3 * gap.std_error < 0.05 * GAP
    assert not found.disturbances
