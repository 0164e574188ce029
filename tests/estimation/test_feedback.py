"""In closed loop a sensor's noise moves what follows it, and that is no delay of the sensor."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.estimation.feedback import inputs_without_feedthrough, one_sample_late, slope
from casid.estimation.noise.input_feedback import follows

TS = 0.01


def drive() -> casid.Model:
    m = casid.Model("drive")
    u, v = m.input("u", "N", hold="zoh", known=True), m.state("v", "m/s")
    mass = m.parameter("m", "kg", start=200.0, lower=10.0)
    m.balance(v, "force", inertia=mass, terms=[u, -m.parameter("d", "N s/m", start=30.0) * v])
    m.output("speed", v, "m/s")
    m.output("acceleration", m.der(v), "m/s^2")
    return m


def controlled(seed: int) -> casid.Record:
    """300 v' + 60 v = u, exact between samples; u = 4000 (r - y), y with noise of 5 mm/s."""
    rng = np.random.default_rng(seed)
    decay = np.exp(-60.0 / 300.0 * TS)
    v, speed, accel, command = 0.0, [], [], []
    for k in range(3000):
        speed.append(v + 0.005 * rng.standard_normal())
        command.append(4000.0 * (np.sin(0.3 * k * TS) - speed[-1]))
        accel.append((command[-1] - 60.0 * v) / 300.0 + 0.05 * rng.standard_normal())
        v = decay * v + (1 - decay) * command[-1] / 60.0
    channels = {"u": np.array(command), "speed": np.array(speed), "acceleration": np.array(accel)}
    return casid.Record(channels, {"u": "N", "speed": "m/s", "acceleration": "m/s^2"}, Ts=TS)


def test_a_slope_of_what_came_before_is_exact_for_parabolas_and_knows_nothing_that_follows():
    t = TS * np.arange(50)
    assert slope(3 * t**2 - t, TS, backward=True)[2:] == pytest.approx(6 * t[2:] - 1)
    assert slope(2 * t, TS, backward=True) == pytest.approx(np.full(50, 2.0))
    changed = np.where(np.arange(50) > 20, 7.0, t)
    assert slope(changed, TS, backward=True)[:21] == pytest.approx(slope(t, TS, backward=True)[:21])


def test_an_output_feels_an_input_late_that_acts_through_states_alone():
    assert inputs_without_feedthrough(drive(), "speed") == ["u"]
    assert inputs_without_feedthrough(drive(), "acceleration") == []
    assert one_sample_late(np.array([1.0, 2.0, 3.0])).tolist() == [1.0, 1.0, 2.0]


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_noise_that_the_command_is_made_of_is_no_delay_of_its_sensor(seed: int):
    """Made of the next sample, the slope of the speed goes with the noise by 13 mm/s^2 a mm/s."""
    found = casid.diagnose(casid.Problem("drive", drive()), controlled(seed), advise=False)
    assert found.verdict == "adequate"


def loop(seed: int, gain: float) -> tuple[np.ndarray, np.ndarray]:
    """A first-order disturbance, and an input of its own that answers it with some gain."""
    rng = np.random.default_rng(seed)
    w, u, own = np.zeros(2000), np.zeros(2000), np.repeat(rng.choice([-1.0, 1.0], 40), 50)
    for k in range(1, 2000):
        w[k] = 0.9 * w[k - 1] + rng.standard_normal()
        u[k] = own[k] - gain * w[k - 1]
    return w, u


def test_an_input_that_answers_a_disturbance_follows_it_and_another_does_not():
    """One in 10^4 of the latter is said to. That a disturbance follows an input is no matter."""
    assert all(follows([loop(s, 0.1)]) for s in range(10))
    assert not any(follows([loop(s, 0.0)]) for s in range(50))
    after = [
        np.convolve(u, [0.0, 0.5, 0.5])[: len(u)] for _, u in (loop(s, 0.0) for s in range(10))
    ]
    inputs = [loop(s, 0.0)[1] for s in range(10)]
    noise = np.random.default_rng(7).standard_normal((10, 2000))
    assert not any(follows([(e + v, u)]) for e, v, u in zip(after, noise, inputs, strict=True))


def test_white_noise_in_a_loop_is_no_bias_and_not_warned_of():
    """The input is as exact as ever, and the noise of a sample is new to it (Ljung 1999, 13.4)."""
    record = controlled(3).without("acceleration")
    m = casid.Model("drive")
    u, v = m.input("u", "N", hold="zoh", known=True), m.state("v", "m/s")
    mass = m.parameter("m", "kg", start=200.0, lower=10.0)
    m.balance(v, "force", inertia=mass, terms=[u, -m.parameter("d", "N s/m", start=30.0) * v])
    m.output("speed", v, "m/s")
    found = casid.identify(m, record, intervals="quick")
    assert not any("follows the residual" in w for w in found.warnings)
    for name, true in (("m", 300.0), ("d", 60.0)):
        p = found.parameter(name)
        assert abs(p.value - true) < 3.5 * p.std_error
