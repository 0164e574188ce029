"""Excitations: steps at random, filtered noise, sums of sines."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from tests.support.park.simulator import Array, Signal


def steps(low: float, high: float, dwell: tuple[float, float]) -> Signal:
    """Levels held for a time drawn between two [s]."""

    def signal(rng: np.random.Generator, N: int, Ts: float) -> Array:
        out: list[float] = []
        while len(out) < N:
            held = max(1, round(rng.uniform(*dwell) / Ts))
            out += [float(rng.uniform(low, high))] * held
        return np.array(out[:N])

    return signal


def coloured(rms: float, tau: float, mean: float = 0.0) -> Signal:
    """Noise behind two lags of time constant tau [s]."""

    def signal(rng: np.random.Generator, N: int, Ts: float) -> Array:
        a, before = float(np.exp(-Ts / tau)), int(10 * tau / Ts) + 1
        once = lfilter([1 - a], [1, -a], rng.standard_normal(N + before))
        y = lfilter([1 - a], [1, -a], once)[before:]
        return np.asarray(mean + rms * (y - y.mean()) / y.std(), dtype=np.float64)

    return signal


def sines(rms: float, low: float, high: float, count: int = 25, mean: float = 0.0) -> Signal:
    """Sines of equal amplitude and random phase between two frequencies [Hz]."""

    def signal(rng: np.random.Generator, N: int, Ts: float) -> Array:
        t = Ts * np.arange(N)
        f = rng.uniform(low, high, count)
        phase = rng.uniform(0, 2 * np.pi, count)
        y = np.sin(2 * np.pi * t[:, None] * f + phase).sum(axis=1)
        return np.asarray(mean + rms * y / np.sqrt(count / 2), dtype=np.float64)

    return signal


def daily(rms: float, mean: float, colour: float, tau: float) -> Signal:
    """A day's sine with weather on it."""
    weather = coloured(colour, tau)

    def signal(rng: np.random.Generator, N: int, Ts: float) -> Array:
        t = Ts * np.arange(N)
        day = np.sqrt(2) * rms * np.sin(2 * np.pi * t / 86400 + rng.uniform(0, 6.3))
        return np.asarray(mean + day + weather(rng, N, Ts), dtype=np.float64)

    return signal


def sunshine(peak: float, tau: float) -> Signal:
    """Half of a day's sine, with clouds."""

    def signal(rng: np.random.Generator, N: int, Ts: float) -> Array:
        t = Ts * np.arange(N)
        day = np.maximum(np.sin(2 * np.pi * t / 86400 + rng.uniform(0, 6.3)), 0.0)
        clouds = np.clip(0.6 + coloured(0.35, tau)(rng, N, Ts), 0.05, 1.0)
        return np.asarray(peak * day * clouds, dtype=np.float64)

    return signal
