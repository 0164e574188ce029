"""Records of some heaters: a first-order lag in closed form, none of casid's code in it.

    T y' = K u - y + b,    u a step every few samples

sampled every second; b (an offset) is what an asset may lack.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

PROBLEM = '''"""A heater: T y' = K u - y."""

import os
import time

import numpy as np

import casid

m = casid.Model("heater")
y, u = m.state("y", "K"), m.input("u", "W", hold="zoh")
T = m.parameter("T", "s", start=8.0, lower=0.5, upper=100.0)
K = m.parameter("K", "K/W", start=1.0, lower=0.01, upper=100.0)
m.balance(y, "heat", inertia=T, terms=[-y, K * u], unit="K")
m.output("y", y, "K")


def power(record):
    """What was commanded; some commands never come to an end."""
    first = record["command"][0]
    while first == 111.0:
        time.sleep(0.01)
    if first == 222.0:
        kept = [bytearray(1 << 24) for _ in range(2000)]
    if first == 333.0:
        os.abort()
    return record["command"]


problem = casid.Problem(
    "heater",
    m,
    channels={"y": "y:K", "command": "command:W"},
    derived={"u": casid.Derived("W", {"command": "W"}, power, "as it is")},
    time="t",
    noise={"command": 0.0},
    starts=1,
)
'''

ENDLESS, HUNGRY, CRASHING = 111.0, 222.0, 333.0
"""First commands that the problem does not survive."""


def samples(
    seed: int, *, offset: float = 0.0, gain: float = 2.0, n: int = 200, first: float | None = None
) -> dict[str, np.ndarray]:
    """Time [s], command [W] and temperature [K] with noise of 0.02 K."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.0, 3.0, n // 10 + 1), 10)[:n]
    if first is not None:
        u[0] = first
    a, y = np.exp(-1.0 / 6.0), np.zeros(n)
    for k in range(n - 1):
        y[k + 1] = a * y[k] + (1.0 - a) * (gain * u[k] + offset)
    return {"t": np.arange(n, dtype=float), "command": u, "y": y + 0.02 * rng.standard_normal(n)}


def write_problem(folder: Path) -> Path:
    """The problem's file."""
    path = folder / "heater.py"
    path.write_text(PROBLEM, encoding="utf-8")
    return path


def write_record(path: Path, data: dict[str, np.ndarray]) -> Path:
    """A record as CSV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.column_stack(list(data.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(data), comments="", fmt="%.9g")
    return path


def write_fleet(folder: Path, assets: int = 2, records: int = 4) -> Path:
    """Records `records/<asset>_<number>.csv`; the first asset lacks an offset from number 3 on."""
    for a in range(assets):
        for n in range(1, records + 1):
            offset = 0.1 if a == 0 and n >= 3 else 0.0
            data = samples(100 * a + n, offset=offset, gain=2.0 + 0.1 * a)
            write_record(folder / "records" / f"heater{a}_{n}.csv", data)
    return folder / "records"
