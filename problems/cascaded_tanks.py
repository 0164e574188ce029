"""Cascaded tanks: a pump fills an upper tank, which empties into a lower one, which empties.

    x_1' = k_4 u - k x_1,    x_2' = k x_1 - k x_2,    y = x_2                                 (1)

Levels in volts of the lower tank's sensor, outflows in proportion to the level: the law that a
linear model has, where Torricelli has the square root. Benchmark of Schoukens, Mattsson, Wigren
and Noel (Workshop on Nonlinear System Identification Benchmarks, Brussels 2016): a sample in 4 s,
the pump's voltage held, levels that overflow at 10 V, and an initial state that nobody knows.

The level of the upper tank is not measured, and its scale is not identifiable: its unit is what it
gives to the lower tank. The tanks are taken as alike. With an outlet each, k_1 and k_3, the best
linear fit has k_1 = k_3 all the same, where the two do the same and the fit is singular
(`tanks_model(alike=False)` is for laws that keep them apart). There is no constant in the output: a
bias of -7 V would serve as a tangent to the square root, and hide the law.
"""

from __future__ import annotations

import math

import numpy as np

import casid


def tanks_model(*, alike: bool = True) -> casid.Model:
    """(1), or with an outlet for each tank: k_1 of the upper and k_3 of the lower."""
    m = casid.Model("cascaded tanks")
    x_1 = m.state("x_1", "V", start=5.0, lower=0.0)
    x_2 = m.state("x_2", "V", start=5.0, lower=0.0)
    u = m.input("u", "V", hold="zoh", known=True)
    k_4 = m.parameter("k_4", "1/s", start=0.03, lower=1e-5, upper=1.0)
    if alike:
        k_1 = k_3 = m.parameter("k", "1/s", start=0.015, lower=1e-5, upper=1.0)
    else:
        k_1 = m.parameter("k_1", "1/s", start=0.03, lower=1e-5, upper=1.0)
        k_3 = m.parameter("k_3", "1/s", start=0.015, lower=1e-5, upper=1.0)
    m.balance(x_1, "upper tank", inertia=1, terms=[k_4 * u, -k_1 * x_1], unit="V/s")
    m.balance(x_2, "lower tank", inertia=1, terms=[k_1 * x_1, -k_3 * x_2], unit="V/s")
    m.output("y", x_2, "V")
    return m


def simulate(
    *,
    N: int = 1024,
    k: float = 0.05,
    k_4: float = 0.042,
    power: float = 0.5,
    brim: float = 10.0,
    noise: float = 0.02,
    seed: int = 7,
) -> casid.Record:
    """A pump whose voltage takes a new value every 25 samples on average; white noise [V].

    Outflows are k x_ref (x / x_ref)^`power` with x_ref = 1 V. A tank cannot hold more than `brim`
    [V]; half of what the upper one spills falls into the lower one.
    """
    Ts, substeps = 4.0, 8
    h = Ts / substeps
    rng = np.random.default_rng(seed)
    moves = rng.uniform(size=N) < 1 / 25
    u = rng.uniform(0.5, 5.5, 1 + int(moves.sum()))[np.cumsum(moves)]

    def rates(upper: float, lower: float, pump: float) -> tuple[float, float]:
        out_1, out_2 = k * max(upper, 0.0) ** power, k * max(lower, 0.0) ** power
        first = k_4 * pump - out_1
        spilt = first if upper >= brim and first > 0.0 else 0.0
        second = out_1 + 0.5 * spilt - out_2
        return first - spilt, 0.0 if lower >= brim and second > 0.0 else second

    upper, lower, measured = 5.0, 5.0, np.empty(N)
    for i, pump in enumerate(u.tolist()):
        measured[i] = lower
        for _ in range(substeps):
            a, b = rates(upper, lower, pump)
            c, d = rates(upper + h / 2 * a, lower + h / 2 * b, pump)
            # A tank that fills in the middle of a step is full at its end.
            upper, lower = min(upper + h * c, brim), min(lower + h * d, brim)
    measured += noise * rng.standard_normal(N)
    if math.isfinite(brim):
        np.minimum(measured, brim, out=measured)
    return casid.Record(
        {"u": u, "y": measured},
        {"u": "V", "y": "V"},
        Ts=Ts,
        name="example",
        provenance=(f"simulated by problems/cascaded_tanks.py, seed {seed}",),
    )


def example() -> list[casid.Experiment]:
    """An hour of two tanks that empty by Torricelli's law and overflow."""
    return [casid.Experiment(simulate(), {}, "example")]


def draw(seed: int) -> list[casid.Experiment]:
    """An hour of (1), with brims out of reach and noise from this seed."""
    linear = simulate(k=0.015, k_4=0.03, power=1.0, brim=math.inf, seed=seed)
    return [casid.Experiment(linear, {}, "drawn")]


problem = casid.Problem(
    name="cascaded_tanks",
    model=tanks_model(),
    channels={"u": "u_V:V", "y": "y_V:V"},
    time="t_s",
    example=example,
    simulate=draw,
    truth={"k": 0.015, "k_4": 0.03},
    description="Two tanks in cascade, filled by a pump; level of the lower one, in volts.",
    references=(
        "M. Schoukens, P. Mattsson, T. Wigren, J.-P. Noel, Cascaded tanks benchmark combining soft "
        "and hard nonlinearities, Workshop on Nonlinear System Identification Benchmarks, Brussels "
        "2016",
    ),
)
