"""What it costs to estimate beside noise on an input, or beside a force that nobody measures.

    python -m benchmarks.noise [--repeats N]

30 000 samples of two masses on springs (four unknown parameters, both positions measured), and of
one mass with drag that grows with the square of its speed (nonlinear, three). `casid.identify`, one
start, normal intervals, in CPU seconds of one process after a first run that compiles: the plain
simulation error, errors in variables, and the prediction error with a force of the first order.
Exit status 1 when one takes more than five times the simulation error of its system.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from scipy.signal import cont2discrete, lfilter

import casid
from casid.estimation.simulation.fit import FitSettings

N, TS = 30_000, 0.01  # samples, sample time [s]
SPRING, DAMPER, SECOND, GROUND = 400.0, 1.5, 2.0, 2.0  # N/m, N s/m, kg, N s/m
FIXED = 150.0  # stiffness to ground [N/m]
DRAG = 0.8  # N s^2/m^2
CORNER = 0.97  # pole of the force that nobody measures, per sample
MOST = 5.0


def force(rng: np.random.Generator) -> np.ndarray:
    """(N,) a new level every 0.6 s [N]."""
    return np.repeat(10 * rng.standard_normal(N // 60), 60)


def unseen(rng: np.random.Generator) -> np.ndarray:
    """(N,) a force of the first order, of 1 N."""
    return lfilter([np.sqrt(1 - CORNER**2)], [1.0, -CORNER], rng.standard_normal(N))


def two_masses() -> casid.Model:
    """A mass on a spring to ground, a second one on a spring to the first."""
    m = casid.Model("two masses")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    X, V = m.state("X", "m"), m.state("V", "m/s")
    F = m.input("F", "N", hold="zoh")
    k, d = m.parameter("k", "N/m", start=370.0), m.parameter("d", "N s/m", start=1.0)
    M = m.parameter("M", "kg", start=1.9, lower=0.1)
    ground = m.parameter("d_g", "N s/m", start=1.5)
    between = [k * (X - x), d * (V - v)]
    m.derivative(x, v)
    m.derivative(X, V)
    terms = [F, *between, -m.constant("k_g", FIXED, "N/m") * x, -ground * v]
    m.balance(v, "first", inertia=m.constant("m", 1.0, "kg"), terms=terms, unit="N")
    m.balance(V, "second", inertia=M, terms=[-term for term in between], unit="N")
    m.output("x", x, "m")
    m.output("X", X, "m")
    return m


def two_positions(F: np.ndarray, f: np.ndarray) -> np.ndarray:
    """(N, 2) of both masses, free of noise; the sampled system by SciPy."""
    a = np.array(
        [
            [0, 1, 0, 0],
            [-SPRING - FIXED, -DAMPER - GROUND, SPRING, DAMPER],
            [0, 0, 0, 1],
            [SPRING / SECOND, DAMPER / SECOND, -SPRING / SECOND, -DAMPER / SECOND],
        ]
    )
    b, c = np.eye(4)[:, [1]], np.eye(4)[[0, 2]]
    A, B, *_ = cont2discrete((a, b, c, np.zeros((2, 1))), TS)
    state, out = np.zeros(4), np.empty((N, 2))
    for i, now in enumerate(F + f):
        out[i] = c @ state
        state = A @ state + B[:, 0] * now
    return out


def with_drag(known: bool = True) -> casid.Model:
    """One mass on a spring, with drag, and a force without noise unless it is not `known`."""
    m = casid.Model("mass with drag")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=known)
    k, M = m.parameter("k", "N/m", start=45.0), m.parameter("M", "kg", start=1.8, lower=0.1)
    d = m.parameter("d_2", "N s^2/m^2", start=0.5)
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[F, -k * x, -d * v * ca.fabs(v)], unit="N")
    m.output("x", x, "m")
    return m


def dragged(F: np.ndarray, f: np.ndarray) -> np.ndarray:
    """(N, 1) the position of one mass, by steps at the middle of four parts of a sample."""
    x = v = 0.0
    out, h = np.empty((N, 1)), TS / 4
    for i, now in enumerate((F + f).tolist()):
        out[i] = x
        for _ in range(4):
            middle = v + h / 2 * (now - 50.0 * x - DRAG * v * abs(v)) / 2.0
            at = x + h / 2 * v
            x += h * middle
            v += h * (now - 50.0 * at - DRAG * middle * abs(middle)) / 2.0
    return out


def record(y: np.ndarray, F: np.ndarray, rng: np.random.Generator) -> casid.Record:
    """Positions with noise of 2 mm."""
    names = ("x", "X")[: y.shape[1]]
    noisy = y + 0.002 * rng.standard_normal(y.shape)
    channels = {"F": F, **dict(zip(names, noisy.T, strict=True))}
    return casid.Record(channels, {"F": "N", **dict.fromkeys(names, "m")}, TS)


def seconds(
    model: Callable[[], casid.Model], of: casid.Record, repeats: int, **options: Any
) -> float:
    """Median CPU time of an estimate, after one that compiles."""
    times = []
    for _ in range(repeats + 1):
        began = time.process_time()
        casid.identify(model(), of, settings=FitSettings(starts=1), intervals="quick", **options)
        times.append(time.process_time() - began)
    return statistics.median(times[1:])


def main() -> int:
    """Print the times with their ratios."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    rng = np.random.default_rng(1)
    F, f, nothing = force(rng), unseen(rng), np.zeros(N)
    cases = {
        "two masses": [
            ("simulation error", two_masses, record(two_positions(F, nothing), F, rng), {}),
            (
                "noise of 1 N on the force",
                two_masses,
                record(two_positions(F, nothing), F + rng.standard_normal(N), rng),
                {},
            ),
            (
                "unmeasured force",
                two_masses,
                record(two_positions(F, f), F, rng),
                {"disturbances": "first:first"},
            ),
        ],
        "mass with drag": [
            ("simulation error", with_drag, record(dragged(F, nothing), F, rng), {}),
            (
                "noise of 1 N on the force",
                partial(with_drag, known=False),
                record(dragged(F, nothing), F + rng.standard_normal(N), rng),
                {},
            ),
            (
                "unmeasured force",
                with_drag,
                record(dragged(F, f), F, rng),
                {"disturbances": "force:first"},
            ),
        ],
    }
    met = True
    for system, rows in cases.items():
        plain = None
        for name, model, of, options in rows:
            taken = seconds(model, of, repeats, **options)
            plain = plain or taken
            met &= taken <= MOST * plain
            print(f"{system:<16}{name:<28}{taken:7.2f} s {taken / plain:6.1f}", flush=True)
    print(f"at most {MOST:g} times the simulation error: {'met' if met else 'missed'}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
