"""Random networks: masses with springs and dampers, thermal nodes with conductances.

A network is a tree of two to four nodes drawn anew for every record; the hidden element may act at
any node or along any branch. The system is simulated by NumPy, the problem states the same network
to casid as its builder would.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import casid
from tests.support.park.signals import coloured, daily, steps, sunshine
from tests.support.park.simulator import Input, Output, Place, System

KINDS = ("random_mechanical", "random_thermal")

Branch = tuple[int, int]


def network(kind: str, rng: np.random.Generator) -> tuple[System, casid.Problem]:
    """A network of a kind and the problem that states it."""
    n = int(rng.integers(2, 5))
    branches = [(int(rng.integers(0, i)), i) for i in range(1, n)]
    return (_masses if kind == KINDS[0] else _nodes)(n, branches, rng)


def _even(rng: np.random.Generator, low: float, high: float) -> float:
    """Even in the logarithm, three digits."""
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")


def _masses(
    n: int, branches: Sequence[Branch], rng: np.random.Generator
) -> tuple[System, casid.Problem]:
    """Positions x_i, velocities v_i; node 0 hangs on the ground; a force on one of the masses."""
    mass = [_even(rng, 0.5, 2.0) for _ in range(n)]
    links = [(None, 0), *branches]
    theta: dict[str, float] = {}
    for i in range(len(links)):
        theta[f"k{i}"] = _even(rng, 100.0, 400.0)
        theta[f"d{i}"] = _even(rng, 0.5, 2.0)
    driven = int(rng.integers(n))

    def rate(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
        force = [f[i] + (u[0] if i == driven else 0.0) for i in range(n)]
        for i, (a, b) in enumerate(links):
            q, v = (x[b], x[n + b]) if a is None else (x[b] - x[a], x[n + b] - x[n + a])
            pull = p[f"k{i}"] * q + p[f"d{i}"] * v
            force[b] = force[b] - pull
            if a is not None:
                force[a] = force[a] + pull
        return [*(x[n + i] for i in range(n)), *(force[i] / mass[i] for i in range(n))]

    places = [Place(f"mass{i}", {i: 1.0}, {n + i: 1.0}, {i: 1.0}) for i in range(n)]
    for i, (a, b) in enumerate(links[1:], 1):
        assert a is not None
        names = (f"v{b}-v{a}", f"v{a}-v{b}", f"mass{b}-mass{a}", f"mass{a}-mass{b}", f"x{b}-x{a}")
        motion = ({n + b: 1.0, n + a: -1.0}, {b: 1.0, a: -1.0})
        places.append(Place(f"link{i}", {b: 1.0, a: -1.0}, *motion, spring=f"k{i}", also=names))
    seen = sorted({0, n - 1})
    system = System(
        KINDS[0],
        "random mechanical",
        Ts=0.01,
        N=3000,
        theta=theta,
        start={f"x{i}": (0.0, 0.005) for i in range(n)} | {f"v{i}": (0.0, 0.05) for i in range(n)},
        inputs=(Input("force", "N", steps(-5.0, 5.0, (0.05, 0.6)), hold="zoh"),),
        outputs=tuple(Output(f"position{i}", "m", 5e-4) for i in seen),
        rate=rate,
        sensors=lambda x, dx, u, p: [x[i] for i in seen],
        places=tuple(places),
        beside=(Input("temperature", "K", coloured(5.0, 3.0, 295.0)),),
    )
    m = casid.Model("masses")
    push = m.input("force", "N", hold="zoh", known=True)
    x = [m.state(f"x{i}", "m") for i in range(n)]
    v = [m.state(f"v{i}", "m/s") for i in range(n)]
    terms: list[list[Any]] = [[push] if i == driven else [] for i in range(n)]
    for i, (a, b) in enumerate(links):
        k = m.parameter(f"k{i}", "N/m", start=theta[f"k{i}"], lower=1.0, upper=1e4)
        d = m.parameter(f"d{i}", "N s/m", start=theta[f"d{i}"], lower=0.0, upper=100.0)
        pull = k * x[b] + d * v[b] if a is None else k * (x[b] - x[a]) + d * (v[b] - v[a])
        terms[b].append(-pull)
        if a is not None:
            terms[a].append(pull)
    for i in range(n):
        m.derivative(x[i], v[i])
        m.balance(v[i], f"mass{i}", inertia=m.constant(f"M{i}", mass[i], "kg"), terms=terms[i])
    for i in seen:
        m.output(f"position{i}", x[i], "m")
    return system, casid.Problem("masses", m, recorded={"temperature": "K"})


def _nodes(
    n: int, branches: Sequence[Branch], rng: np.random.Generator
) -> tuple[System, casid.Problem]:
    """Temperatures T_i; node n - 1 loses heat to the weather; a heater at one of the nodes."""
    theta = {f"C{i}": _even(rng, 1e6, 1e7) for i in range(n)}
    theta |= {f"G{i}": _even(rng, 50.0, 300.0) for i in range(len(branches))} | {"H": 80.0}
    heated = int(rng.integers(n))

    def rate(x: Any, u: Any, p: Any, f: Any) -> Sequence[Any]:
        heat = [f[i] + (u[0] if i == heated else 0.0) for i in range(n)]
        for i, (a, b) in enumerate(branches):
            flow = p[f"G{i}"] * (x[b] - x[a])
            heat[a], heat[b] = heat[a] + flow, heat[b] - flow
        heat[n - 1] = heat[n - 1] - p["H"] * (x[n - 1] - u[1])
        return [heat[i] / p[f"C{i}"] for i in range(n)]

    places = [
        Place(f"node{i}", {i: 1.0}, {i: 1.0}, operating=293.0, one_way=True) for i in range(n)
    ]
    for i, (a, b) in enumerate(branches):
        names = (f"T{b}-T{a}", f"T{a}-T{b}", f"node{b}-node{a}", f"node{a}-node{b}")
        difference = {b: 1.0, a: -1.0}
        places.append(Place(f"branch{i}", difference, difference, also=names, one_way=True))
    system = System(
        KINDS[1],
        "random thermal",
        Ts=300.0,
        N=2400,
        theta=theta,
        start={f"T{i}": (293.0, 1.0) for i in range(n)},
        inputs=(
            Input("heater", "W", steps(0.0, 3500.0, (3600.0, 20000.0)), hold="zoh"),
            Input("outdoor", "K", daily(4.0, 278.0, 2.0, 15000.0), sd=0.1),
        ),
        outputs=tuple(Output(f"temperature{i}", "K", 0.05) for i in range(n)),
        rate=rate,
        sensors=lambda x, dx, u, p: [x[i] for i in range(n)],
        places=tuple(places),
        beside=(Input("sun", "W/m^2", sunshine(600.0, 3000.0)),),
        more={"without": ("cubic_damping", "coulomb_friction")},
    )
    m = casid.Model("thermal nodes")
    heater, outdoor = m.input("heater", "W", hold="zoh", known=True), m.input("outdoor", "K")
    T = [m.state(f"T{i}", "K", start=293.0) for i in range(n)]
    terms: list[list[Any]] = [[heater] if i == heated else [] for i in range(n)]
    for i, (a, b) in enumerate(branches):
        G = m.parameter(f"G{i}", "W/K", start=theta[f"G{i}"], lower=1.0, upper=1e4)
        terms[a].append(G * (T[b] - T[a]))
        terms[b].append(-G * (T[b] - T[a]))
    terms[n - 1].append(
        -m.parameter("H", "W/K", start=80.0, lower=1.0, upper=1e4) * (T[n - 1] - outdoor)
    )
    for i in range(n):
        C = m.parameter(f"C{i}", "J/K", start=theta[f"C{i}"], lower=1e5, upper=1e9)
        m.balance(T[i], f"node{i}", inertia=C, terms=terms[i], unit="W")
        m.output(f"temperature{i}", T[i], "K")
    return system, casid.Problem("thermal nodes", m, recorded={"sun": "W/m^2"})
