"""A second-order system on a fixed grid: excitation, integration steps, trajectories."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

Array = np.ndarray[Any, np.dtype[np.floating[Any]]]

State = tuple[float, ...]
Inner = Callable[[float, float, float, State], tuple[float, State]]

PRE_ROLL = 3.0  # seconds simulated before t = 0: the record starts in motion, a delay has a past


@dataclass(frozen=True, slots=True)
class Motion:
    """A noise-free trajectory on the integration grid."""

    t: Array
    x: Array
    v: Array
    a: Array
    u: Array  # input of the linear refit, same grid (empty if there is none)


@dataclass(frozen=True, slots=True)
class Telegraph:
    """Piecewise constant, normal levels, exponential holds; jumps lie on a grid, 0.01 s or more."""

    jumps: Array
    levels: Array

    @classmethod
    def draw(
        cls, rng: np.random.Generator, sd: float, hold: float, duration: float, grid: float = 0.01
    ) -> Telegraph:
        n = int(4 * (duration + PRE_ROLL) / hold) + 20
        holds = np.maximum(0.1, np.round(np.round(rng.exponential(hold, n) / grid) * grid, 2))
        levels = rng.standard_normal(n)
        return cls(np.round(np.cumsum(holds) - holds[0] - PRE_ROLL, 2), sd * levels)

    def __call__(self, t: Array) -> Array:
        i = np.searchsorted(self.jumps, np.asarray(t) + 1e-10, side="right") - 1
        out: Array = self.levels[np.maximum(i, 0)]
        return out

    def lagged(self, steps: Steps, lag: float) -> Array:
        """The exact response of 1 / (lag s + 1) at start, middle and end of each step."""
        level = np.repeat(self(steps.times[1]), 2)  # constant within a step: jumps lie on nodes
        decay = math.exp(-0.5 * steps.h / lag)
        y = lfilter([1.0 - decay], [1.0, -decay], level)
        y = np.concatenate(([0.0], y))
        return np.stack([y[0:-1:2], y[1::2], y[2::2]])


@dataclass(frozen=True, slots=True)
class Waves:
    """A sum of cosines with random frequencies and phases: band-limited, smooth, no edges."""

    mean: float
    amplitude: Array
    omega: Array
    phase: Array

    @classmethod
    def draw(
        cls, rng: np.random.Generator, sd: float, low: float, high: float, n: int, mean: float = 0.0
    ) -> Waves:
        omega, phase = 2 * np.pi * rng.uniform(low, high, n), rng.uniform(0.0, 2 * np.pi, n)
        return cls(mean, np.full(n, sd * math.sqrt(2.0 / n)), omega, phase)

    def __call__(self, t: Array) -> Array:
        out = np.full(np.shape(t), self.mean)
        for a, w, p in zip(self.amplitude, self.omega, self.phase, strict=True):
            out += a * np.cos(w * t + p)
        return out


def sample_times(duration: float, Ts: float) -> Array:
    ratio = Ts / 0.01
    if abs(ratio - round(ratio)) > 1e-9 or round(ratio) < 1:
        raise ValueError(f"Ts={Ts!r}: choose a multiple of 0.01 s")
    return np.arange(int(round(duration / Ts)) + 1) * Ts


class Runaway(ValueError):
    """The trajectory, or a coefficient on its way, left the admissible range."""


class Steps:
    """Start, middle and end of each integration step; a jump at a node belongs to the next step."""

    def __init__(self, h: float, duration: float, before: float = PRE_ROLL) -> None:
        n = int(round((duration + before) / h))
        self.h = h
        self.nodes: Array = np.arange(n + 1) * h - before
        start = self.nodes[:-1]
        self.times: Array = np.stack([start + 1e-9, start + 0.5 * h, start + h - 1e-9])


def integrate(
    c: Array,
    k: Array,
    d: Array,
    inertia: Array,
    torque: Callable[[float, float], float],
    h: float,
    x: float,
    v: float,
    bound: float = 5.0,
) -> tuple[Array, Array, Array]:
    """Classical Runge-Kutta for inertia * a = c - k x - d v + torque(x, v).

    The coefficients are (3, n): at start, middle and end of each step. Returns x, v, a at the n + 1
    nodes. Scalar floats in a plain loop: numpy's overhead on two states would cost ten times more.
    """
    half, sixth = 0.5 * h, h / 6.0
    w = 1.0 / inertia
    rows = zip(*(r.tolist() for r in (*c, *k, *d, *w)), strict=True)
    xs, vs, accs = [x], [v], []
    for c0, c1, c2, k0, k1, k2, d0, d1, d2, w0, w1, w2 in rows:
        a1 = (c0 - k0 * x - d0 * v + torque(x, v)) * w0
        xx, v2 = x + half * v, v + half * a1
        a2 = (c1 - k1 * xx - d1 * v2 + torque(xx, v2)) * w1
        xx, v3 = x + half * v2, v + half * a2
        a3 = (c1 - k1 * xx - d1 * v3 + torque(xx, v3)) * w1
        xx, v4 = x + h * v3, v + h * a3
        a4 = (c2 - k2 * xx - d2 * v4 + torque(xx, v4)) * w2
        x += sixth * (v + 2.0 * (v2 + v3) + v4)
        v += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        if not -bound < x < bound:
            raise Runaway(f"|x| exceeded {bound:g}: choose a smaller `size`")
        xs.append(x)
        vs.append(v)
        accs.append(a1)
    accs.append((c2 - k2 * x - d2 * v + torque(x, v)) * w2)
    return np.array(xs), np.array(vs), np.array(accs)


def integrate_with(
    c: Array,
    k: Array,
    d: Array,
    inertia: Array,
    torque: Callable[[float, float], float],
    inner: tuple[int, Inner],
    h: float,
    bound: float = 5.0,
) -> tuple[Array, Array, Array]:
    """As `integrate`, from rest, for a torque with states of its own."""
    n, law = inner
    rows = zip(*(r.tolist() for r in (*c, *k, *d, *(1.0 / inertia))), strict=True)
    state: State = (0.0,) * (2 + n)
    xs, vs, accs = [0.0], [0.0], []

    def slope(s: State, c: float, k: float, d: float, w: float) -> State:
        x, v, z = s[0], s[1], s[2:]
        force, _ = law(x, v, 0.0, z)
        a = (c - k * x - d * v + torque(x, v) + force) * w
        return (v, a, *law(x, v, a, z)[1])

    def step(s: State, by: float, f: State) -> State:
        return tuple(si + by * fi for si, fi in zip(s, f, strict=True))

    for c0, c1, c2, k0, k1, k2, d0, d1, d2, w0, w1, w2 in rows:
        f1 = slope(state, c0, k0, d0, w0)
        f2 = slope(step(state, 0.5 * h, f1), c1, k1, d1, w1)
        f3 = slope(step(state, 0.5 * h, f2), c1, k1, d1, w1)
        f4 = slope(step(state, h, f3), c2, k2, d2, w2)
        mean = tuple(p + 2 * (q + r) + s for p, q, r, s in zip(f1, f2, f3, f4, strict=True))
        state = step(state, h / 6.0, mean)
        if not -bound < state[0] < bound:
            raise Runaway(f"|x| exceeded {bound:g}: choose a smaller `size`")
        xs.append(state[0])
        vs.append(state[1])
        accs.append(f1[1])
    accs.append(slope(state, c2, k2, d2, w2)[1])
    return np.array(xs), np.array(vs), np.array(accs)
