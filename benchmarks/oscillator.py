"""The shared task: one record of a mass-spring-damper, its start, and what a contender reports.

    m x'' + d x' + d_2 |x'| x' + k x = F                                                       (1)

F is joined by straight lines between samples, x is measured with white noise. Every contender
minimises the sum of squares of x - x_simulated over m, d, d_2, k, x(0) and x'(0), simulated with
one Runge-Kutta 4 step a sample, from the same start.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path

import numpy as np

N, TS = 30_000, 0.01  # samples, sample time [s]
TRUE = {"m": 2.0, "d": 1.2, "d_2": 0.8, "k": 50.0}  # kg, N s/m, N s^2/m^2, N/m
START = {"m": 1.2, "d": 2.0, "d_2": 1.5, "k": 32.0}  # off by factors of 1.6 to 1.9
NOISE = 0.01  # standard deviation of the position's noise [m]
SUBSTEPS = 4  # of the simulation that makes the record; the contenders use 1


def write_record(path: Path, *, seed: int = 1) -> None:
    """Simulate (1) and save the force `F` (N,) [N] and the position `x` (N,) [m]."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.normal(0.0, 20.0, N // 50), 50)  # a new level every 0.5 s
    force = np.convolve(steps, np.ones(20) / 20, mode="same")
    m, d, d_2, k = TRUE.values()
    h = TS / SUBSTEPS

    def acceleration(x: float, v: float, f: float) -> float:
        return (f - d * v - d_2 * abs(v) * v - k * x) / m

    x, v = 0.3, -0.5
    position = np.empty(N)
    forces = force.tolist()
    for i in range(N):
        position[i] = x
        left, slope = forces[i], (forces[min(i + 1, N - 1)] - forces[i]) / SUBSTEPS
        for j in range(SUBSTEPS):
            f0, f1, f2 = (left + slope * (j + c) for c in (0.0, 0.5, 1.0))
            a1 = acceleration(x, v, f0)
            v2 = v + h / 2 * a1
            a2 = acceleration(x + h / 2 * v, v2, f1)
            v3 = v + h / 2 * a2
            a3 = acceleration(x + h / 2 * v2, v3, f1)
            v4 = v + h * a3
            a4 = acceleration(x + h * v3, v4, f2)
            x += h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    np.save(path, np.stack([force, position + NOISE * rng.standard_normal(N)]))


def read_record() -> tuple[np.ndarray, np.ndarray]:
    """Force (N,) and position (N,) of the record named on the command line."""
    force, position = np.load(sys.argv[1])
    return force, position


def start_position(position: np.ndarray) -> float:
    """Where x(0) starts: the median of the first five samples; x'(0) starts at zero."""
    return float(np.median(position[:5]))


def report(sum_of_squares: float, values: dict[str, float]) -> None:
    """Print the result and the peak memory [MB] of this process as one line of JSON."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    megabytes = peak / (1e6 if sys.platform == "darwin" else 1e6 / 1024)
    result = {"sum_of_squares": sum_of_squares, "values": values, "megabytes": megabytes}
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    write_record(Path(sys.argv[1]))
