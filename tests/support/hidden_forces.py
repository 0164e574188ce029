"""A mass on a spring with one more force that the model lacks: records, and the model's fit.

The truth: m = 2 kg, d = 1.5 N s/m, k = 50 N/m under a measured force of random steps, by
Runge-Kutta 4 in plain Python. Forces are functions of position, velocity, a recorded speed and time
that stand in no catalogue, or as if they did not.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.estimation.simulation.fit import FitSettings, fit_model

Force = Callable[[float, float, float, float], float]  # x, v, speed, t -> N

UNITS = {"F": "N", "x": "m", "speed": "m/s"}
RECORDED = {"speed": "m/s"}

FORCES: dict[str, Force] = {
    "none": lambda x, v, s, t: 0.0,
    "cubic spring": lambda x, v, s, t: -10.0 * x**3,
    "quadratic damping": lambda x, v, s, t: -0.3 * abs(v) * v,
    "dry friction": lambda x, v, s, t: -0.1 * math.tanh(v / 0.01),
    "Stribeck": lambda x, v, s, t: (
        -0.15 * math.tanh(v / 0.01) * (0.4 + math.exp(-((v / 0.15) ** 2)))
    ),
    "damping by place": lambda x, v, s, t: -2.0 * abs(x) * v,
    "speed squared": lambda x, v, s, t: 0.1 * s * s,
    "damping by speed": lambda x, v, s, t: -0.4 * (s - 1.0) * v,
    "stiffness drift": lambda x, v, s, t: -0.02 * t * x,
}


def model() -> casid.Model:
    """A mass on a spring and a damper, the position measured."""
    m = casid.Model("mass on a spring")
    x, v = m.state("x_m", "m"), m.state("v_m", "m/s")
    F = m.input("F", "N")
    k = m.parameter("k", "N/m", start=45.0, lower=0.0, upper=500.0)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0, upper=50.0)
    mass = m.parameter("m", "kg", start=2.2, lower=0.1, upper=20.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[-k * x, -d * v, F])
    m.output("x", x, "m")
    return m


def record(
    force: Force, seed: int, *, seconds: float = 40.0, disturbance: float = 0.0
) -> casid.Experiment:
    """Position at 50 Hz with 1 mm of noise; the force measured with 0.02 N."""
    rng = np.random.default_rng(seed)
    Ts, parts = 0.02, 4
    N, h = round(seconds / Ts), Ts / parts
    levels = 5.0 * rng.standard_normal(N)
    F = levels[np.maximum.accumulate(np.where(rng.random(N) < 0.03, np.arange(N), 0))]
    F = np.convolve(F, np.ones(5) / 5, mode="same")
    phase = rng.uniform(0, 2 * np.pi, 4)
    times = Ts * np.arange(N + 1)
    speed = 1.0 + sum(
        0.2 * np.sin(w * times + p) for w, p in zip((0.23, 0.61, 1.1, 1.9), phase, strict=True)
    )
    pushes = disturbance / math.sqrt(Ts) * rng.standard_normal(N)
    path = np.empty((N, 2))
    x = v = 0.0

    def a(x: float, v: float, u: float, s: float, t: float) -> float:
        return (u - 50.0 * x - 1.5 * v + force(x, v, s, t)) / 2.0

    for i in range(N):
        path[i] = x, v
        last = F[min(i + 1, N - 1)]
        for j in range(parts):
            u1, u2, u3 = (F[i] + (last - F[i]) * (j + c) / parts + pushes[i] for c in (0, 0.5, 1))
            s, t = float(speed[i]), Ts * i + j * h
            a1 = a(x, v, u1, s, t)
            x2, v2 = x + h / 2 * v, v + h / 2 * a1
            a2 = a(x2, v2, u2, s, t + h / 2)
            x3, v3 = x + h / 2 * v2, v + h / 2 * a2
            a3 = a(x3, v3, u2, s, t + h / 2)
            x4, v4 = x + h * v3, v + h * a3
            a4 = a(x4, v4, u3, s, t + h)
            x += h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    columns = {
        "F": F + 0.02 * rng.standard_normal(N),
        "x": path[:, 0] + 1e-3 * rng.standard_normal(N),
        "speed": speed[:N],
    }
    return casid.Experiment(casid.Record(columns, UNITS, Ts=Ts, name=f"run {seed}"), {}, f"{seed}")


def weighted(experiments: list[casid.Experiment], m: casid.Model) -> Weighted:
    """The model fitted under its noise."""
    fit = fit_model(m, experiments, FitSettings(starts=1), throw=False)
    return Weighing(experiments, known_noise={"F": 0.02}).weigh(m, fit)


@functools.cache
def fitted(
    kind: str, seed: int, disturbance: float = 0.0
) -> tuple[Weighted, list[casid.Experiment]]:
    """One record of 40 s and the model fitted to it."""
    made = [record(FORCES[kind], seed, disturbance=disturbance)]
    return weighted(made, model()), made
