"""A sensor whose unit was mistaken has a gain far from one, which is found and named as such."""

from __future__ import annotations

import math

import numpy as np
import pytest

import casid
from casid.diagnosis.verdict.wrong_units import said_of_gain, unit_mistaken
from casid.estimation.estimate import Estimated


def swinging(*, factor: float, seed: int = 2) -> casid.Record:
    """A lever, theta'' = 3 u - 9 theta - 0.8 theta'; its rate is recorded times a factor."""
    rng = np.random.default_rng(seed)
    n, h, steps = 300, 0.05, 5
    u = np.repeat(rng.uniform(-1, 1, n // 20), 20)
    theta = rate = 0.0
    out = np.empty((n, 2))
    for i, torque in enumerate(u):
        out[i] = theta, rate
        for _ in range(steps):  # the midpoint rule
            middle = rate + 0.5 * h / steps * (3 * torque - 9 * theta - 0.8 * rate)
            position = theta + 0.5 * h / steps * rate
            rate += h / steps * (3 * torque - 9 * position - 0.8 * middle)
            theta += h / steps * middle
    out += np.array([0.002, 0.005]) * rng.standard_normal(out.shape)
    columns = {"u": u, "theta": out[:, 0], "rate": factor * out[:, 1]}
    return casid.Record(columns, {"u": "1", "theta": "rad", "rate": "rad/s"}, Ts=h)


def lever() -> casid.Problem:
    m = casid.Model("lever")
    u = m.input("u", "1", hold="zoh", known=True)
    theta, w = m.state("theta", "rad"), m.state("w", "rad/s")
    b = m.parameter("b", "1/s^2", start=2.0, lower=0.0)
    k = m.parameter("k", "1/s^2", start=6.0, lower=0.1, upper=100.0)
    d = m.parameter("d", "1/s", start=0.5, lower=0.0, upper=100.0)
    m.derivative(theta, w)
    m.balance(w, "torque", inertia=1, terms=[b * u, -k * theta, -d * w], unit="rad/s^2")
    m.output("theta", theta, "rad")
    m.output("rate", w, "rad/s")
    return casid.Problem("lever", m, starts=1)


def test_a_rate_in_the_wrong_unit_is_named_with_its_unit() -> None:
    found = casid.diagnose(lever(), swinging(factor=180 / math.pi), max_causes=1, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("sensor_scale", "rate")
    assert 1 + cause.parameters[0].value == pytest.approx(180 / math.pi, rel=0.01)
    assert "as if deg/s had been read as rad/s, a factor of 57.3" in found.sentence


@pytest.mark.slow
def test_so_is_one_that_reads_a_small_part_of_it() -> None:
    """Beside a free gain of the input an angle that reads too much is the same."""
    found = casid.diagnose(lever(), swinging(factor=math.pi / 180), max_causes=1, advise=False)
    (cause,) = found.causes
    rest = {"theta": 180 / math.pi, "rate": math.pi / 180}
    assert cause.kind == "sensor_scale"
    assert 1 + cause.parameters[0].value == pytest.approx(rest[cause.where], rel=0.01)


@pytest.mark.parametrize(
    ("scale", "unit", "words"),
    [
        (2.597, "m/s", "as if km/h had been read as m/s, a factor of 3.6"),
        (-0.999, "m", "as if m had been read as mm, a factor of 0.001"),
        (0.03, "rad", ""),  # a sensor's own gain
        (2.6, "K", ""),
    ],
)
def test_only_ratios_of_units_are_called_so(scale: float, unit: str, words: str) -> None:
    assert unit_mistaken(Estimated("scale", scale, "1"), unit) == words


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (-0.81, "as if it showed 0.19 times what it measures: no unit that is often mistaken"),
        (2.7, "as if it showed 3.7 times what it measures"),
        (180 / math.pi - 1, "as if deg had been read as rad"),
        (-1.9, ""),  # a wrong sign, and a calibration that is off by a tenth
        (0.3, ""),
    ],
)
def test_a_gain_that_no_sensor_has_may_be_the_models_own_scale(scale: float, words: str) -> None:
    said = said_of_gain(Estimated("scale", scale, "1"), "rad")
    assert words in said
    assert bool(said) == bool(words)
    # About another reading than zero it is no unit.
    about = said_of_gain(Estimated("scale", scale, "1"), "rad", is_about_zero=False)
    assert "had been read as" not in about
    assert bool(about) == bool(words)
