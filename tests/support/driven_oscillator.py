"""A body on a spring that a recorded force drives, and what is simulated of it."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

import casid
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.effect import Sizes

TS = 0.02
N = 700
T = TS * np.arange(N)
M, D, K = 2.0, 1.5, 50.0
COMMAND = np.repeat(np.random.default_rng(4).standard_normal(N // 14), 14)
SIZES = Sizes({"x": 0.1, "v": 1.0}, {}, (0.0, N * TS), 0.1, TS)


def oscillator(kind: str = "foh", known: bool = True) -> casid.Model:
    m = casid.Model("oscillator")
    x, v = m.state("x", "m", initial=0.0), m.state("v", "m/s", initial=0.0)
    force = m.input("force", "N", hold=kind, known=known)
    k = m.parameter("k", "N/m", start=K)
    m.derivative(x, v)
    m.balance(v, "force balance", inertia=M, terms=[-k * x, -D * v, force])
    m.output("position", x, "m")
    return m


def criterion_of(model, force=COMMAND, y=None) -> SimulationError:
    y = np.zeros(len(force)) if y is None else y
    record = casid.Record({"force": force, "position": y}, {"force": "N", "position": "m"}, Ts=TS)
    return SimulationError(model, [casid.Experiment(record, {}, "r")], weights=np.ones(1))


def at(criterion, **values: float) -> np.ndarray:
    return np.array([values.get(v.name, v.start) for v in criterion.variables])


def positions(model, force=COMMAND, **values: float) -> np.ndarray:
    criterion = criterion_of(model, force)
    return criterion.simulate(at(criterion, **values), 0)[0][:, 0]


def moved_late(given: np.ndarray, share: float, kind: str) -> np.ndarray:
    """Position and speed (N, 2), exact, from rest: matrix exponentials between the input's corners.

    Parameters
    ----------
    given : (N + 2,) force that acts before, at and after each sample; its corners come so late.
    share : of a sample time, by which they are late.
    """
    A = np.zeros((4, 4))  # x, v, the force and its slope
    A[:2, :3] = [[0.0, 1.0, 0.0], [-K / M, -D / M, 1 / M]]
    A[2, 3] = 1.0
    first, second = expm(A * share * TS), expm(A * (1 - share) * TS)
    state, out = np.zeros(2), np.empty((len(given) - 2, 2))
    for k in range(len(out)):
        out[k] = state
        before, now, after = given[k : k + 3]
        if kind == "zoh":
            state = (first @ [*state, before, 0.0])[:2]
            state = (second @ [*state, now, 0.0])[:2]
        else:
            rise = now - before
            state = (first @ [*state, before + (1 - share) * rise, rise / TS])[:2]
            state = (second @ [*state, now, (after - now) / TS])[:2]
    return out
