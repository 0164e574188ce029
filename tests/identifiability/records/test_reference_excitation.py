"""Signals have the excitation orders of the textbook; a sensor may be rich, its cause at rest."""

from __future__ import annotations

import json

import numpy as np
import pytest

import casid
from casid.errors import DataError
from casid.estimation.simulation.integration.simulator import Simulator
from casid.identifiability.records.excitation_order import decorrelation, excitation_orders
from casid.identifiability.records.reference_excitation import record_excitation
from problems import pendulum

N = 600
T = 0.1 * np.arange(N)
TRUE = {name: pendulum.TABLE_7_2[name] for name in ("k", "d", "I_x")}


def record(**channels: np.ndarray) -> casid.Record:
    return casid.Record(channels, dict.fromkeys(channels, "V"), Ts=0.1)


def white(seed: int = 0, n: int = N) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n)


@pytest.mark.parametrize(
    ("values", "order"),
    [
        (np.zeros(N), 0),
        (np.full(N, -3.0), 1),
        (np.sin(T), 2),
        (1.0 + np.sin(T), 3),
        ((-1.0) ** np.arange(N), 1),  # a sinusoid at the Nyquist frequency has one line
        (np.sin(T) + 0.3 * np.cos(2.2 * T + 1.0), 4),
        (sum(np.sin(w * T + w) for w in (1.0, 2.5, 4.0, 7.0)), 8),
        (1e-9 * np.sin(T), 2),  # units do not matter
        (np.tile([1.0, -2.0, 0.5, 0.0, 3.0], N // 5), 5),  # a period of five: five lines
    ],
)
def test_signals_have_the_orders_of_their_spectral_lines(values, order):
    """The order is the number of points at which the spectrum is not zero (Ljung 1999, 13.2)."""
    found = excitation_orders(record(u=values))["u"]
    assert found.order == order
    assert str(found) == f"order {order}"


def test_white_noise_excites_every_order_that_is_looked_at():
    for limit in (1, 5, 40):
        found = excitation_orders(record(u=white()), max_order=limit)["u"]
        assert (found.order, str(found)) == (limit, f"order >= {limit}")


def test_noise_alone_is_of_order_0_and_hides_no_signal_that_stands_out():
    for seed in range(20):
        alone = excitation_orders(record(u=0.1 * white(seed)), noise={"u": 0.1})
        assert alone["u"].order == 0
    values = np.sin(T) + np.sin(3 * T) + 0.05 * white()
    assert excitation_orders(record(u=values))["u"].order == 20
    assert excitation_orders(record(u=values), noise={"u": 0.05})["u"].order == 4


def test_a_record_limits_the_order_it_can_show():
    """n independent columns take n rows: 2 n - 1 samples."""
    short = excitation_orders(record(u=white(n=9)))
    assert (short["u"].order, short["u"].limit) == (5, 5)
    assert "a longer one may show higher orders" in short.note
    assert "5 lags only" in str(short)


def test_samples_that_are_missing_are_left_out():
    values, mask = np.sin(T), np.zeros(N, dtype=bool)
    mask[100:130] = True
    gap = record(u=np.where(mask, 1e6, values)).mark_missing("u", mask)
    assert excitation_orders(gap)["u"].order == 2


def test_channels_that_follow_each_other_excite_less_together():
    """A delay of one sample shares all lags but one; a multiple shares them all."""
    w = white(n=N + 1)
    a, b = w[1:], w[:-1]
    assert excitation_orders(record(a=a, b=b)).joint == 1
    assert excitation_orders(record(a=a, b=-7 * a)).joint == 0
    both = excitation_orders(record(a=a, b=white(9)))
    assert both.joint == both.joint_limit == 20
    assert excitation_orders(record(a=a, b=np.sin(T))).joint == 2


def test_lags_apart_see_through_oversampling():
    """At 600 samples a period, neighbouring lags of slow sinusoids differ by less than noise."""
    t = 0.01 * np.arange(6000)
    slow = np.sin(t) + np.sin(1.5 * t) + 0.01 * white(n=6000)
    near = excitation_orders(record(u=slow), noise={"u": 0.01})
    apart = excitation_orders(record(u=slow), noise={"u": 0.01}, spacing=decorrelation(slow))
    assert near["u"].order < apart["u"].order == 4


def test_refusals_say_what_to_do():
    with pytest.raises(DataError, match="an order and a spacing of at least 1"):
        excitation_orders(record(u=T), max_order=0)
    with pytest.raises(DataError, match="give a standard deviation, or leave it out"):
        excitation_orders(record(u=T), noise={"u": -1.0})
    with pytest.raises(DataError, match="did you mean 'speed'"):
        excitation_orders(record(speed=T), ["sped"])


def problem() -> casid.Problem:
    indirect = pendulum.nonlinear_model().eliminate("a_y", using="accel")
    return casid.Problem("pendulum", indirect, recorded={"ref": "m/s^2"})


def swing(a_y: np.ndarray, *, angle: float, noise: float = 0.0, seed: int = 1) -> casid.Record:
    """The pendulum at any angle, its cart accelerating by `a_y` (N,), from an angle at rest."""
    model = pendulum.nonlinear_model()
    simulator = Simulator(model, 0.01, substeps=10)
    names = simulator.equations.parameters
    p = np.array([TRUE.get(n, model.parameters[n].value) for n in names])
    y = simulator.simulate(a_y[:, None], p, np.array([angle, 0.0])).y
    y = y + noise * np.random.default_rng(seed).standard_normal(y.shape)
    return casid.Record(
        {"gyro": y[:, 0], "accel": y[:, 1], "ref": a_y},
        {"gyro": "rad/s", "accel": "m/s^2", "ref": "m/s^2"},
        Ts=0.01,
        name="swing",
    )


def steps(n: int = 2000) -> np.ndarray:
    """Smooth random accelerations of about 0.5 m/s^2."""
    level = np.repeat(np.random.default_rng(6).uniform(-1, 1, n // 100), 100)
    return np.convolve(level, np.hanning(40) / np.hanning(40).sum(), mode="same")


@pytest.mark.parametrize(("angle", "noise"), [(0.2, 0.0), (1.2, 0.0), (0.2, 0.01), (1.2, 0.01)])
def test_a_free_decay_excites_the_sensor_and_not_the_reference(angle, noise):
    """With a_y = 0 the accelerometer is a function of the states (Linder 2017, 7.3.1)."""
    free = swing(np.zeros(2000), angle=angle, noise=noise)
    at = {**TRUE, "phi(0)": angle, "p(0)": 0.0}
    (found,) = record_excitation(problem(), free, at=at, noise={"accel": noise})
    (a_y,) = found.references
    assert (a_y.unknown, a_y.channel) == ("a_y", "accel")
    assert a_y.channel_order >= 2
    assert a_y.order == 0
    assert not a_y.is_exciting
    assert a_y.share < 0.01
    assert "a_y has order 0 and carries no information" in str(found)
    assert found.signals["ref"].order == 0
    assert found.recorded == ("ref",)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_cart_that_moves_excites_both(noise):
    moved = swing(steps(), angle=0.2, noise=noise)
    at = {**TRUE, "phi(0)": 0.2, "p(0)": 0.0}
    (found,) = record_excitation(problem(), moved, at=at, noise={"accel": noise})
    (a_y,) = found.references
    assert a_y.is_exciting
    assert a_y.order >= 10
    assert found.signals["ref"].order >= 10
    # straight lines between samples move phi by (w Ts)^2 / 12 at most, 4e-4 at 7 rad/s, and the
    # noise of 0.01 that the sensor brings adds its square
    rms = np.sqrt(np.mean(steps() ** 2))
    assert a_y.rms == pytest.approx(rms, rel=0.01)


def test_an_estimate_brings_its_own_errors_along():
    """A free decay tells k, d and I_x up to a factor only, and still no reference appears."""
    known = casid.Problem("pendulum", problem().model.with_known(I_x=TRUE["I_x"]))
    free = swing(np.zeros(2000), angle=0.2, noise=0.01)
    e = casid.identify(known, free)
    (found,) = record_excitation(known, free, at=e, noise={"accel": 0.01})
    assert found.references[0].order == 0


def test_values_that_are_only_starts_are_said_to_be():
    """A wrong stiffness leaves a rest of the motion that looks like an input."""
    free = swing(np.zeros(1000), angle=0.2)
    (found,) = record_excitation(problem(), free)
    assert found.references[0].is_exciting
    assert "pass an estimate" in found.note
    assert found.note in str(found)
    (told,) = record_excitation(problem(), free, at={**TRUE, "phi(0)": 0.2, "p(0)": 0.0})
    assert told.note == ""


def test_a_model_without_eliminated_inputs_has_orders_of_its_inputs_alone():
    m = casid.Model("lag")
    x, u = m.state("x", "m"), m.input("u", "m/s")
    m.derivative(x, u - m.parameter("p", "1/s") * x)
    m.output("y", x, "m")
    r = casid.Record({"u": np.sin(T)}, {"u": "m/s"}, Ts=0.1)
    (found,) = record_excitation(m, r)
    assert found.references == ()
    assert found.signals["u"].order == 2
    json.dumps(found.to_json(), allow_nan=False)
    with pytest.raises(DataError, match="no such channel; it has u, y"):
        record_excitation(m, r, noise={"v": 1.0})
