"""Two models whose information has a closed form, with records to excite them."""

from __future__ import annotations

import numpy as np

import casid

TS = 0.1


def integrator(*, start: tuple[float, float] = (2.0, -3.0), unit: float = 1.0) -> casid.Model:
    """x' = unit (a u + b w): its output is linear in a and b, and RK4 is exact for held inputs."""
    m = casid.Model("integrator")
    x = m.state("x", "m", initial=0.0)
    u = m.input("u", "m/s", hold="zoh", known=True)
    w = m.input("w", "m/s", hold="zoh", known=True)
    a, b = m.parameter("a", "1", start=start[0]), m.parameter("b", "1", start=start[1])
    m.derivative(x, unit * (a * u + b * w))
    m.output("y", x, "m")
    return m


def inputs(N: int = 200, *, seed: int = 4, w: float = 1.0, name: str = "r") -> casid.Record:
    """White u and w; no output is measured."""
    rng = np.random.default_rng(seed)
    return casid.Record(
        {"u": rng.standard_normal(N), "w": w * rng.standard_normal(N)},
        {"u": "m/s", "w": "m/s"},
        Ts=TS,
        name=name,
    )


def regressor(record: casid.Record) -> np.ndarray:
    """(N, 2) integrals of u and w: what the output of `integrator` is linear in."""
    steps = TS * np.column_stack([record["u"], record["w"]])
    return np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)[:-1]])


def decay(*, T: float = 4.0, x0: float = 1.0, gains: int = 1) -> tuple[casid.Model, casid.Record]:
    """y = g1 ... gn x, x' = -p x from a known start, over T seconds without input."""
    m = casid.Model("decay")
    x = m.state("x", "m", initial=x0)
    p = m.parameter("p", "1/s", start=0.5, lower=0.0, upper=20.0)
    y = x
    for i in range(gains):
        y = m.parameter(f"g{i + 1}", "1", start=2.0, lower=0.1, upper=50.0) * y
    m.derivative(x, -p * x)
    m.output("y", y, "m")
    N = round(T / TS)
    return m, casid.Record({"clock": np.zeros(N)}, {"clock": "s"}, Ts=TS, name="decay")
