"""The white noise of an input is bounded by the error with which past and outputs foretell it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.noise.noise_floor import floor_error, white_floor
from casid.estimation.simulation.input_noise import foreseen_noise as module
from casid.estimation.simulation.input_noise.foreseen_noise import foreseen_noise
from casid.estimation.simulation.records.signals import Signals

N = 4000


def in_a_loop(seed: int, sensor: float, own: float) -> Signals:
    """y' = u - y under a PD controller of the noisy y; u is recorded with noise `own`."""
    rng = np.random.default_rng(seed)
    wanted = np.repeat(rng.uniform(-1, 1, N // 100), 100)
    y = before = 0.0
    u, out = np.zeros(N), np.zeros(N)
    for k in range(N):
        out[k] = y + sensor * rng.standard_normal()
        u[k] = 4.0 * (wanted[k] - out[k]) - 3.0 * (out[k] - before)
        before = out[k]
        y = u[k] + (y - u[k]) * np.exp(-0.02)
    u += own * rng.standard_normal(N)
    used = np.ones((N, 1), dtype=bool)
    return Signals("loop", 0.02 * np.arange(N), u[:, None], out[:, None], used, 0.02, {})


def test_what_a_controller_makes_of_a_sensor_s_noise_is_no_noise_of_the_input() -> None:
    """The spectrum near Nyquist has (4 + 6)^2 / 2 times the power of the sensor's noise."""
    d = in_a_loop(1, sensor=0.01, own=0.0)
    assert white_floor([d.u[:, 0]]) > 0.03
    assert input_noise_floor([d], ["u"])["u"] < 0.1 * 0.03


def test_a_bound_is_computed_once_for_the_records_that_it_is_of(monkeypatch) -> None:
    """Whatever arrays hold them, and anew for others or when more than `kept` have come since."""
    computed = []
    compute = module._foreseen
    monkeypatch.setattr(module, "_known", {})
    monkeypatch.setattr(module, "FORESEEN", replace(module.FORESEEN, kept=2))
    monkeypatch.setattr(module, "_foreseen", lambda *a: computed.append(1) or compute(*a))
    loops = [in_a_loop(seed, sensor=0.01, own=0.0) for seed in (1, 2, 3)]

    def bound(d: Signals) -> float:
        return foreseen_noise([d.u[:, 0].copy()], [d.y], [d.used])

    first = bound(loops[0])
    assert bound(loops[0]) == first
    assert len(computed) == 1
    assert bound(loops[1]) != first
    assert bound(loops[2]) != first
    assert len(computed) == 3
    assert bound(loops[0]) == first
    assert len(computed) == 4


def test_noise_of_the_input_s_own_sensor_is_below_the_bound() -> None:
    """Six past values have that noise as well: no prediction is better than the noise itself.

    What a sensor's noise leaves in the bound where the input's hides which of both it was is of the
    size of the input's own.
    """
    for own in (0.003, 0.01, 0.03):
        bound = input_noise_floor([in_a_loop(2, sensor=0.01, own=own)], ["u"])["u"]
        assert own * (1 - 4 / np.sqrt(2 * N)) < bound < 2.5 * own


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_an_input_that_nothing_foretells_has_the_bound_of_its_spectrum(pole: float) -> None:
    rng = np.random.default_rng(3)
    u = rng.standard_normal(N)
    for k in range(1, N):
        u[k] += pole * u[k - 1]
    y = np.cumsum(np.append(0.0, u[:-1])) + rng.standard_normal(N)
    used = np.ones((N, 1), dtype=bool)
    d = Signals("open", np.arange(N) * 1.0, u[:, None], y[:, None], used, 1.0, {})
    floor = white_floor([u])
    assert input_noise_floor([d], ["u"])["u"] == pytest.approx(floor, rel=2 * floor_error([N]))


def test_an_output_that_is_the_input_s_own_channel_foretells_nothing() -> None:
    d = in_a_loop(4, sensor=0.01, own=0.01)
    copied = replace(d, y=-3.0 * d.u)
    assert input_noise_floor([copied], ["u"])["u"] > 0.01


def test_a_record_in_which_the_input_rests_is_taken_together_with_the_others() -> None:
    """A coast-down beside a run under power: no output is the channel of an input that rests."""
    d = in_a_loop(7, sensor=0.01, own=0.0)
    coasting = np.exp(-0.02 * np.arange(N))[:, None]
    signals = [d, replace(d, u=np.zeros((N, 1)), y=coasting)]
    assert input_noise_floor(signals, ["u"])["u"] < 0.1 * 0.03


def test_missing_samples_and_short_records_are_left_out() -> None:
    d = in_a_loop(5, sensor=0.01, own=0.01)
    spoilt = d.y.copy()
    gone = np.zeros((N, 1), dtype=bool)
    gone[25::50] = True
    spoilt[gone] = 1e6
    bound = foreseen_noise([d.u[:, 0]], [spoilt], [~gone])
    assert bound == pytest.approx(foreseen_noise([d.u[:, 0]], [d.y], [d.used]), rel=0.1)
    assert foreseen_noise([d.u[:100, 0]], [d.y[:100]], [d.used[:100]]) == np.inf


def test_misfit_of_a_loop_is_no_noise_of_its_exact_input() -> None:
    """A drag that the model lacks: least squares is not corrected for noise that is not there."""
    rng = np.random.default_rng(6)
    m = casid.Model("loop")
    y = m.state("y", "m/s")
    u = m.input("u", "N", hold="zoh")
    b = m.parameter("b", "N s/m", start=0.8, lower=0.0)
    m.balance(y, "force", inertia=m.constant("M", 1.0, "kg"), terms=[u, -b * y])
    m.output("speed", y, "m/s")
    d = in_a_loop(6, sensor=0.01, own=0.0)
    speed = d.y[:, 0] + 0.02 * np.convolve(rng.standard_normal(N), np.ones(20), "same") / 4
    record = casid.Record({"u": d.u[:, 0], "speed": speed}, {"u": "N", "speed": "m/s"}, Ts=0.02)
    estimate = casid.identify(casid.Problem("loop", m, starts=1), record)
    assert "without the bias of input noise" not in estimate.method
