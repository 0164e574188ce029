"""Voyages of a fleet by a simulator of their own: nothing here is casid's.

    phi'' = -(B + d_2 |p|) p - C phi + K_delta delta + K_r r + b + w,   p = phi'              (1)

with inputs that are straight between samples, integrated by Runge-Kutta steps an eighth of a sample
long. A cause is a constant moment b (a load that shifted), damping by drag d_2, a bias of the gyro
(it drifted) or a delay of its channel. Its size is set by lambda, the squared length of what it
changes in the outputs, in units of their noise and off what the parameters and initial states could
change as well (finite differences): the noncentrality of the best test. Seas are moments w with
Bretschneider's spectrum (ITTC 1978), its peak about the roll frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

N, TS, STEPS = 600, 0.5, 8
NOISE = {"roll": 1e-3, "gyro": 1e-3}
CAUSES = {
    "load": ("offset", "torque"),
    "drag": ("quadratic_damping", "torque"),
    "gyro": ("sensor_bias", "gyro"),
    "late": ("time_delay", "gyro"),
}
"""Cause -> kind and place that a diagnosis has for it."""

DISTURBED, CAUSED = 0.2, 0.05
LAMBDA = (60.0, 3000.0)
SEA = (1e-4, 1e-2)
"""Range of the root mean square of w [rad/s^2]: from noise-like to half of the rudder's moment."""


@dataclass(frozen=True, slots=True)
class Voyage:
    """One record to be.

    Attributes
    ----------
    day : since the first voyage.
    cause : a name of `CAUSES`, or empty; `size` of it, and `strength`, its lambda without seas.
    run : number of the stretch of voyages with this cause, -1 of none.
    sea : root mean square of w.
    """

    ship: int
    number: int
    day: int
    seed: int
    cause: str = ""
    strength: float = 0.0
    size: float = 0.0
    run: int = -1
    sea: float = 0.0

    @property
    def name(self) -> str:
        """Of its file, with ship and date."""
        date = np.datetime64("2024-01-01") + np.timedelta64(self.day, "D")
        return f"ship{self.ship:02d}_{date}.parquet"


def plan(records: int, ships: int, seed: int) -> list[Voyage]:
    """Which voyage has which cause: half of those with one in stretches of three to six.

    Every ship has as many voyages as any other, two weeks apart or so.
    """
    rng = np.random.default_rng((seed, 1))
    each = records // ships
    voyages = [
        [
            Voyage(s, n, 14 * n + int(rng.integers(0, 10)), int(rng.integers(2**31)))
            for n in range(each)
        ]
        for s in range(ships)
    ]
    left, run = round(CAUSED * records), 0
    while left > 0:
        ship, cause = int(rng.integers(ships)), str(rng.choice(list(CAUSES)))
        length = min(left, int(rng.integers(3, 7))) if run % 4 == 0 else 1
        first = int(rng.integers(1, max(each - length, 1) + 1))
        stretch = range(first, min(first + length, each))
        near = range(max(first - 2, 0), min(stretch.stop + 2, each))
        if any(voyages[ship][n].cause for n in near):
            continue
        strength = float(np.exp(rng.uniform(*np.log(LAMBDA))))
        for n in stretch:
            voyages[ship][n] = replace(voyages[ship][n], cause=cause, strength=strength, run=run)
        left, run = left - len(stretch), run + 1
    flat = [v for own in voyages for v in own]
    rough = rng.permutation(len(flat))[: round(DISTURBED * len(flat))]
    for i in rough:
        flat[i] = replace(flat[i], sea=float(np.exp(rng.uniform(*np.log(SEA)))))
    return flat


def parameters(ship: int, seed: int) -> dict[str, float]:
    """C, B, K_delta and K_r of one ship: a few percent about those of the class."""
    rng = np.random.default_rng((seed, 2, ship))
    middle = {"C": 0.36, "B": 0.06, "K_delta": -0.02, "K_r": -0.25}
    return {n: v * float(np.exp(0.04 * rng.standard_normal())) for n, v in middle.items()}


def inputs(rng: np.random.Generator) -> tuple[Array, Array]:
    """Rudder [rad], turned at a few degrees a second every ten seconds, and yaw rate [rad/s]."""
    orders = rng.choice([-0.35, -0.17, 0.0, 0.17, 0.35], N // 20 + 2)
    wanted = np.repeat(orders, 20)
    kernel = np.exp(-np.arange(20) / 4.0)
    delta = np.convolve(wanted, kernel / kernel.sum())[20 : N + 20]
    r = np.zeros(N)
    for i in range(1, N):
        r[i] = r[i - 1] + TS * (-r[i - 1] / 8.0 - 0.03 * delta[i - 1])
    return delta, r


def sea(rng: np.random.Generator, rms: float) -> Array:
    """w (N,): a sea of Bretschneider's spectrum, w^-5 exp(-1.25 (w_p / w)^4), met at w_p.

    Sines of random frequency and phase, too many for any to be a line of the spectrum.
    """
    t, count = TS * np.arange(N), 300
    peak = rng.uniform(0.4, 0.9)
    w = peak * rng.uniform(0.5, 3.0, count)
    phase = rng.uniform(0.0, 2 * np.pi, count)
    power = (peak / w) ** 5 * np.exp(-1.25 * (peak / w) ** 4)
    size = rms * np.sqrt(2 * power / power.sum())
    return np.asarray(np.cos(np.outer(t, w) + phase) @ size)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What (1) is simulated with; fields of one number or of one a column (m,)."""

    C: Array
    B: Array
    K_delta: Array
    K_r: Array
    b: Array
    d_2: Array
    phi: Array
    p: Array


def simulate(at: Motion, delta: Array, r: Array, w: Array) -> tuple[Array, Array]:
    """(1): roll angle and rate (N, m) of m motions under inputs and moments (N, m)."""
    m = len(at.C)
    phi, p = np.empty((N, m)), np.empty((N, m))
    x, v, h = at.phi.copy(), at.p.copy(), TS / STEPS
    moment = delta * at.K_delta + r * at.K_r + at.b + w

    def rates(x: Array, v: Array, M: Array) -> tuple[Array, Array]:
        return v, -(at.B + at.d_2 * np.abs(v)) * v - at.C * x + M

    for i in range(N):
        phi[i], p[i] = x, v
        if i == N - 1:
            break
        step = (moment[i + 1] - moment[i]) / STEPS
        for k in range(STEPS):
            begin = moment[i] + k * step
            a1, b1 = rates(x, v, begin)
            a2, b2 = rates(x + h / 2 * a1, v + h / 2 * b1, begin + step / 2)
            a3, b3 = rates(x + h / 2 * a2, v + h / 2 * b2, begin + step / 2)
            a4, b4 = rates(x + h * a3, v + h * b3, begin + step)
            x = x + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            v = v + h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
    return phi, p


def outputs(
    columns: Sequence[dict[str, float]], delta: Array, r: Array, w: Array
) -> tuple[Array, Array]:
    """Roll and gyro (N, m) without noise, each column with its own values, causes and inputs."""

    def of(name: str) -> Array:
        return np.array([c.get(name, 0.0) for c in columns])

    names = ("C", "B", "K_delta", "K_r", "load", "drag", "phi", "p")
    phi, p = simulate(Motion(*map(of, names)), delta, r, w)
    t = TS * np.arange(N)
    late = of("late")
    for i in np.flatnonzero(late):
        p[:, i] = CubicSpline(t, p[:, i])(t - late[i])
    return phi, p + of("gyro")


def sizes_of(voyages: Sequence[Voyage], seed: int) -> dict[int, float]:
    """The size of each run's cause, from its lambda by the slope at zero in its first voyage."""
    steps = {"C": 1e-5, "B": 1e-5, "K_delta": 1e-5, "K_r": 1e-5, "phi": 1e-5, "p": 1e-5}
    small = {"load": 1e-5, "drag": 1e-3, "gyro": 1e-5, "late": 1e-3}
    first: dict[int, Voyage] = {}
    for v in voyages:
        if v.cause:
            first.setdefault(v.run, v)
    if not first:
        return {}
    columns: list[dict[str, float]] = []
    drawn: list[Drawn] = []
    for v in first.values():
        own = Drawn.of(v, seed)
        columns += [own.values, {**own.values, v.cause: small[v.cause]}]
        columns += [{**own.values, n: own.values.get(n, 0.0) + h} for n, h in steps.items()]
        drawn += [own] * (2 + len(steps))
    delta, r = (np.column_stack([getattr(d, name) for d in drawn]) for name in ("delta", "r"))
    phi, p = outputs(columns, delta, r, np.zeros_like(delta))
    stacked = np.concatenate([phi / NOISE["roll"], p / NOISE["gyro"]])
    out = {}
    for i, v in enumerate(first.values()):
        block = stacked[:, (2 + len(steps)) * i : (2 + len(steps)) * (i + 1)]
        changed = block[:, 1:] - block[:, :1]
        psi, tangent = changed[:, 0] / small[v.cause], changed[:, 1:]
        q, _ = np.linalg.qr(tangent)
        out[v.run] = float(np.sqrt(v.strength) / np.linalg.norm(psi - q @ (q.T @ psi)))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """What is drawn for one voyage: its ship's values, inputs, sea (N,) and noise (2, N)."""

    values: dict[str, float]
    delta: Array
    r: Array
    w: Array
    noise: Array

    @classmethod
    def of(cls, v: Voyage, seed: int) -> Drawn:
        """From the seed of the voyage."""
        rng = np.random.default_rng(v.seed)
        values = parameters(v.ship, seed) | {"phi": 0.02 * float(rng.standard_normal())}
        delta, r = inputs(rng)
        return cls(values, delta, r, sea(rng, v.sea), rng.standard_normal((2, N)))


def write(voyages: Sequence[Voyage], folder: Path, seed: int) -> list[Voyage]:
    """Write the records that are not there; returns the voyages with the sizes of their causes.

    The size of a cause that lasts is that of its first voyage.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ordered = sorted(voyages, key=lambda v: (v.ship, v.number))
    sizes = sizes_of(ordered, seed)
    out = [replace(v, size=sizes[v.run]) if v.cause else v for v in ordered]
    absent = [v for v in out if not (folder / v.name).exists()]
    for i in range(0, len(absent), TOGETHER):
        _write(absent[i : i + TOGETHER], folder, seed)
    return out


TOGETHER = 500
"""Voyages that are simulated at once."""


def _write(voyages: Sequence[Voyage], folder: Path, seed: int) -> None:
    import pandas as pd

    drawn = [Drawn.of(v, seed) for v in voyages]
    delta, r, w = (np.column_stack([getattr(d, n) for d in drawn]) for n in ("delta", "r", "w"))
    causes = [{v.cause: v.size} if v.cause else {} for v in voyages]
    phi, p = outputs([d.values | c for d, c in zip(drawn, causes, strict=True)], delta, r, w)
    for i, (v, d) in enumerate(zip(voyages, drawn, strict=True)):
        frame = pd.DataFrame(
            {
                "t": TS * np.arange(N),
                "delta": d.delta,
                "r": d.r,
                "roll": phi[:, i] + NOISE["roll"] * d.noise[0],
                "gyro": p[:, i] + NOISE["gyro"] * d.noise[1],
            }
        )
        frame.to_parquet(folder / v.name, index=False)
