"""A measured input that repeats rounded readings is wrong by up to half a step, uniformly."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.estimation.simulation.records.signals import rounding_of

RNG = np.random.default_rng(5)
T = np.arange(4000) * 0.5
SLOW = np.cumsum(0.02 * RNG.standard_normal(len(T)))
STEP = 0.1


def test_the_error_of_a_rounded_reading_is_uniform_within_a_step():
    rounded = STEP * np.round(SLOW / STEP)
    assert rounding_of(rounded) == pytest.approx(STEP / np.sqrt(12), rel=1e-6)
    # of 4000 draws of a uniform variable, whose squares scatter by 0.9 of their mean, alike in runs
    assert np.std(rounded - SLOW) == pytest.approx(rounding_of(rounded), rel=0.1)


def turned(rate: float) -> np.ndarray:
    """A rudder that its gear turns from one angle to another, at a rate in each sample."""
    wanted = np.repeat(RNG.choice([-20.0, -15.0, -10.0, 10.0, 15.0, 20.0], len(T) // 40), 40)
    rudder = np.zeros(len(T))
    for k in range(1, len(T)):
        rudder[k] = rudder[k - 1] + np.clip(wanted[k] - rudder[k - 1], -rate, rate)
    return rudder


@pytest.mark.parametrize(
    "values",
    [
        SLOW,  # every reading another one
        STEP * np.round((SLOW + 0.2 * RNG.standard_normal(len(T))) / STEP),  # noisier than a step
        np.repeat(RNG.choice([-1.0, 0.0, 1.0], len(T) // 20), 20),  # a command of three levels
        np.repeat(RNG.integers(0, 40, len(T) // 20) * STEP, 20),  # one of forty, that jumps
        turned(2.5),  # from level to level by equal steps
        turned(5.0) + 1e-15 * RNG.standard_normal(len(T)),  # nine levels, added up
        np.zeros(len(T)),
    ],
    ids=["not rounded", "noisy", "three levels", "jumps", "a rate", "nine levels", "constant"],
)
def test_commands_and_noisy_channels_have_none(values):
    assert rounding_of(values) == 0.0


def turning(*, quadratic: float = 0.0, seed: int = 3) -> casid.Record:
    """A ship under an autopilot, T r' + r = K delta - d_2 |r| r; the rudder read to 0.1 degrees."""
    rng = np.random.default_rng(seed)
    degree, Ts, K, lag = np.pi / 180, 0.5, 0.18, 22.0
    heading = rate = rudder = course = 0.0
    rows = []
    for k in range(2400):
        if k % 240 == 0:
            course = degree * rng.choice([-20, -10, 0, 10, 20])
        wanted = np.clip(1.2 * (course - heading) - 14 * rate, -25 * degree, 25 * degree)
        rudder += np.clip(wanted - rudder, -2 * degree, 2 * degree)
        rows.append((0.1 * degree * np.round(10 * rudder / degree), heading, rate))
        for _ in range(10):
            change = (K * rudder - rate - quadratic * abs(rate) * rate) / lag
            heading, rate = heading + Ts / 10 * rate, rate + Ts / 10 * change
    read, true, turn = np.array(rows).T
    return casid.Record(
        {
            "rudder": read,
            "heading": true + 0.1 * degree * rng.standard_normal(len(true)),
            "rate": turn + 0.02 * degree * rng.standard_normal(len(true)),
        },
        {"rudder": "rad", "heading": "rad", "rate": "rad/s"},
        Ts=Ts,
    )


def nomoto() -> casid.Problem:
    m = casid.Model("nomoto")
    heading, rate = m.state("psi", "rad"), m.state("r", "rad/s")
    rudder = m.input("rudder", "rad", hold="zoh")
    K = m.parameter("K", "1/s", start=0.1, lower=1e-3, upper=2.0)
    lag = m.parameter("T", "s", start=10.0, lower=0.5, upper=300.0)
    m.derivative(heading, rate)
    m.balance(rate, "turning", inertia=lag, terms=[K * rudder, -rate])
    m.output("heading", heading, "rad")
    m.output("rate", rate, "rad/s")
    return casid.Problem("nomoto", m)


@pytest.mark.slow
def test_the_rounding_of_a_rudder_is_no_dry_friction():
    """On course it rests at an angle that is read as zero, as if friction held the ship."""
    found = casid.diagnose(nomoto(), turning(seed=4), advise=False)
    assert not found.causes
    assert found.noise["rudder"] == "white input noise 504 µrad"  # 0.1 degrees over sqrt(12)


@pytest.mark.slow
def test_beside_it_a_cause_has_its_size():
    found = casid.diagnose(nomoto(), turning(quadratic=40.0), advise=False)
    assert [c.kind for c in found.causes] == ["quadratic_damping"]
    size = found.causes[0].parameters[0]
    assert abs(size.value - 40.0) < 3 * size.std_error
    assert size.std_error < 2.0
