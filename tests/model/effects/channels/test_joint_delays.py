"""Measured inputs that one instrument records late are late by one time."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.model.effects.channels.delays import delays_of_records
from casid.model.effects.effect import Sizes

TS, N, LATE = 0.05, 1200, 4  # s, samples, samples


def float_in_waves() -> casid.Problem:
    """A float that waves and their rate move, of 2 rad/s and the damping 0.15."""
    m = casid.Model("float")
    eta, rate = m.input("wave", "m"), m.input("wave_rate", "m/s")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    m.derivative(x, v)
    mass = m.parameter("m", "kg", start=80.0, lower=1.0)
    c = m.parameter("c", "N s/m", start=30.0, lower=0.0)
    k = m.constant("k", 400.0, "N/m")
    m.balance(v, "heave", inertia=mass, terms=[-k * (x - eta), -c * (v - rate)])
    m.output("heave", x, "m")
    return casid.Problem("float", m)


def record(seed: int) -> casid.Record:
    """The waves as they act, by Runge-Kutta, and as they are recorded 0.2 s later."""
    rng = np.random.default_rng(seed)
    w, phase = rng.uniform(0.5, 3.0, 25), rng.uniform(0.0, 6.28, 25)

    def wave(t: np.ndarray | float) -> np.ndarray:
        return 0.06 * np.sin(np.multiply.outer(t, w) + phase).sum(-1)

    def rate(t: np.ndarray | float) -> np.ndarray:
        return 0.06 * (w * np.cos(np.multiply.outer(t, w) + phase)).sum(-1)

    def slope(t: float, s: np.ndarray) -> np.ndarray:
        return np.array([s[1], (-400.0 * (s[0] - wave(t)) - 60.0 * (s[1] - rate(t))) / 100.0])

    s, x = np.array([0.0, 0.0]), np.empty(N)
    for k in range(N):
        t, x[k] = k * TS, s[0]
        a = slope(t, s)
        b = slope(t + TS / 2, s + TS / 2 * a)
        c = slope(t + TS / 2, s + TS / 2 * b)
        s = s + TS / 6 * (a + 2 * b + 2 * c + slope(t + TS, s + TS * c))
    seen = TS * (np.arange(N) - LATE)
    channels = {"wave": wave(seen), "wave_rate": rate(seen), "heave": x}
    for name in channels:
        channels[name] = channels[name] + 2e-3 * rng.standard_normal(N)
    return casid.Record(channels, {"wave": "m", "wave_rate": "m/s", "heave": "m"}, Ts=TS)


def test_all_measured_inputs_are_a_candidate_together():
    model = float_in_waves().model
    found = [e.where for e in delays_of_records(model, Sizes({}, {}, (0.0, 60.0), 1.0))]
    assert found == ["heave", "wave", "wave_rate", "wave, wave_rate"]
    both = casid.time_delay(model, ["wave", "wave_rate"], 1.0).extend(model)
    again = [e.where for e in delays_of_records(both, Sizes({}, {}, (0.0, 60.0), 1.0))]
    assert again == ["heave"]
    with pytest.raises(casid.ModelError, match="heave is no measured input"):
        casid.time_delay(model, ["wave", "heave"], 1.0)


@pytest.mark.slow
def test_a_late_record_of_waves_and_their_rate_is_one_delay():
    """Of one of them alone a longer delay was named, and a lag beside it."""
    found = casid.diagnose(float_in_waves(), record(1), advise=False)
    (cause,) = found.causes
    assert cause.kind == "time_delay"
    places = {cause.where, *(a.where for a in cause.alternatives)}
    assert "wave, wave_rate" in places
    (delay,) = cause.parameters
    assert delay.std_error is not None
    assert abs(delay.value - LATE * TS) < 4 * delay.std_error + 0.1 * TS
