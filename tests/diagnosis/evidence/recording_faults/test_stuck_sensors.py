"""A sensor stands still where a reading repeats longer than chance allows and then leaps."""

from __future__ import annotations

import numpy as np
import pytest

from casid.diagnosis.evidence.recording_faults.stuck_sensors import Standstills, find_standstills

Array = np.ndarray

N = 2000
STUCK = slice(900, 1000)
NOISE = 0.01


def motion() -> Array:
    return np.sin(2 * np.pi * np.arange(N) / 640)


def found(y: Array, simulated: Array | None = None) -> Standstills | None:
    s = motion() if simulated is None else simulated
    return find_standstills("level", [y], [s], [np.ones(N, dtype=bool)], 0.01)


def reading(rng: np.random.Generator) -> Array:
    return motion() + NOISE * rng.standard_normal(N)


def test_a_reading_that_stays_and_leaps_is_a_standstill():
    y = reading(np.random.default_rng(1))
    y[STUCK] = y[STUCK.start]
    still = found(y)
    assert still is not None
    assert np.array_equal(np.flatnonzero(still.masks[0]), np.arange(900, 1000))
    assert still.count == 100
    # 99 equal neighbours where about one in 2000 would be by chance.
    assert still.p_value < 1e-100
    assert still.size == pytest.approx(np.ptp(motion()[STUCK]), abs=5 * NOISE)


def test_a_sensor_that_dies_in_the_end_leaps_into_its_value():
    y = reading(np.random.default_rng(2))
    y[1700:] = -3.0
    still = found(y)
    assert still is not None
    assert still.count == 300


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_is_none(seed):
    assert found(reading(np.random.default_rng(seed))) is None


def test_what_rests_and_breaks_away_is_none():
    """A slide that sticks: the encoder repeats its value, and goes on from there."""
    q = motion().copy()
    q[STUCK] = q[STUCK.start]
    q[STUCK.stop :] += q[STUCK.start] - q[STUCK.stop]
    assert found(np.round(q / 0.01) * 0.01) is None


def test_a_logger_that_is_slower_than_its_clock_is_none():
    y = np.repeat(reading(np.random.default_rng(3))[::10], 10)
    assert found(y) is None


def test_a_flow_that_is_switched_off_is_none():
    """The simulation stands still there, too."""
    flow = np.where((np.arange(N) // 200) % 2 == 0, 0.0, 1.0)
    y = flow + np.where(flow > 0, NOISE, 0.0) * np.random.default_rng(4).standard_normal(N)
    assert found(y, flow) is None


@pytest.mark.parametrize("step", [0.0, 0.004])
def test_a_sensor_that_dies_in_its_place_stands_still_to_the_end(step):
    y = reading(np.random.default_rng(3))
    y = np.round(y / step) * step if step else y
    y[1700:] = motion()[1700] if not step else y[1700]
    still = found(y)
    assert still is not None
    assert np.array_equal(np.flatnonzero(still.masks[0]), np.arange(1700, N))


def test_what_comes_to_rest_by_friction_has_no_dead_sensor():
    """The model without friction swings on; the encoder repeats the value at which it stuck."""
    swing = np.exp(-np.arange(N) / 700) * motion()
    stuck = swing.copy()
    stuck[1440:] = stuck[1440]  # a turning point
    assert found(np.round(stuck / 0.002) * 0.002, swing) is None
