"""What is missing passes for a disturbance, and is named all the same; a disturbance is not.

A block heats a plate, both temperatures are measured (a simulator of its own, Runge-Kutta 4).
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

import casid

N, Ts, NOISE = 1200, 5.0, 0.05  # samples, s, K


def heated_plate() -> casid.Problem:
    m = casid.Model("heated plate")
    T1, T2 = m.state("T1", "K"), m.state("T2", "K")
    P = m.input("power", "W", hold="zoh", known=True)
    C1 = m.parameter("C1", "J/K", start=250.0, lower=1.0)
    C2 = m.parameter("C2", "J/K", start=700.0, lower=1.0)
    G12 = m.parameter("G12", "W/K", start=5.0, lower=0.0)
    G2 = m.parameter("G2", "W/K", start=2.0, lower=0.0)
    m.balance(T1, "block", inertia=C1, terms=[P, -G12 * (T1 - T2)])
    m.balance(T2, "plate", inertia=C2, terms=[G12 * (T1 - T2), -G2 * T2])
    m.output("T1", T1, "K")
    m.output("T2", T2, "K")
    return casid.Problem("heated plate", m)


def record(seed: int, drag: float, draught: float) -> casid.Record:
    """`drag` [W/K^2] is missing in the model; `draught` [W] is random, of one minute's memory."""
    rng = np.random.default_rng(seed)
    power = np.repeat(rng.uniform(0, 100, N), 30)[:N]
    memory, force = np.exp(-Ts / 60.0), np.zeros(N)
    for k in range(1, N):
        step = np.sqrt(1 - memory**2) * rng.standard_normal()
        force[k] = memory * force[k - 1] + draught * step
    y, T = np.empty((N, 2)), np.zeros(2)
    for k in range(N):
        y[k] = T

        def rate(T: np.ndarray, k: int = k) -> np.ndarray:
            q = 6.0 * (T[0] - T[1])
            loss = 2.5 * T[1] + drag * T[1] * abs(T[1])
            return np.array([(power[k] - q) / 300.0, (q - loss + force[k]) / 800.0])

        k1 = rate(T)
        k2 = rate(T + Ts / 2 * k1)
        k3 = rate(T + Ts / 2 * k2)
        T = T + Ts / 6 * (k1 + 2 * k2 + 2 * k3 + rate(T + Ts * k3))
    y += NOISE * rng.standard_normal(y.shape)
    channels = {"power": power, "T1": y[:, 0], "T2": y[:, 1]}
    return casid.Record(channels, {"power": "W", "T1": "K", "T2": "K"}, Ts=Ts, name="run")


@functools.cache
def diagnosed(seed: int, drag: float = 0.0, draught: float = 0.0) -> casid.Diagnosis:
    data = casid.Experiment(record(seed, drag, draught), {}, "run")
    return casid.diagnose(heated_plate(), data, advise=False, starts=1)


def noise_of(d: casid.Diagnosis, output: str) -> float:
    """From "white output noise 0.0502 K"."""
    return float(d.noise[output].split()[3])


def test_a_large_effect_is_named_and_leaves_the_sensors_noise():
    """The linear model errs by ten times the noise, with all the colours of a disturbance."""
    d = diagnosed(1, drag=0.2)
    assert d.fitted["baseline_rmse"]["T2"] > 5 * NOISE
    (cause,) = d.causes
    assert cause.where == "plate"  # T2^2 and T2 |T2| are one here
    (size,) = cause.parameters
    assert size.value == pytest.approx(0.2, abs=4 * size.std_error)
    for output in ("T1", "T2"):
        assert noise_of(d, output) == pytest.approx(NOISE, rel=0.1)


def test_a_coloured_disturbance_is_none():
    """A draught of ten times the noise: it has a place and a size, and nothing is missing."""
    d = diagnosed(2, draught=10.0)
    assert d.fitted["baseline_rmse"]["T2"] > 5 * NOISE
    assert d.verdict == "adequate"
    (found,) = [each for each in d.disturbances if each.share > 0.5]
    assert found.where == "plate"
    assert 5.0 < found.std < 20.0  # some 30 independent swings, the slowest the parameters take
    assert found.bandwidth is not None
    for output in ("T1", "T2"):
        assert noise_of(d, output) == pytest.approx(NOISE, rel=0.15)
