"""Clipping: equal samples at an end of a channel's range that are no rest of the motion.

Chance, or a coarse converter, would not repeat the end that often; and the fitted motion goes on
beyond it, or the channel runs into the end and out of it at its usual speed.
"""

from __future__ import annotations

import numpy as np
import pytest

from casid.diagnosis.evidence.recording_faults.plateaus import find_plateaus
from casid.diagnosis.thresholds import CLIPPING

Array = np.ndarray

ALPHA = 0.001
NOISE = 0.05


def motion(seed: int = 0, N: int = 3000) -> Array:
    """A sum of incommensurate sines of unit size: it comes near its ends at many heights."""
    t = 0.01 * np.arange(N)
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 3)
    parts = [np.sin(w * t + p) for w, p in zip((2.1, 5.3, 9.7), phase, strict=True)]
    return np.sqrt(2 / 3) * np.sum(parts, axis=0)


def noisy(seed: int, y: Array) -> Array:
    return y + NOISE * np.random.default_rng(100 + seed).standard_normal(len(y))


def find(measured: Array, simulated: Array, used: Array | None = None):
    used = np.ones(len(measured), dtype=bool) if used is None else used
    return find_plateaus("y", [measured], [simulated], [used], ALPHA)


def rounded(y: Array, step: float) -> Array:
    return step * np.round(y / step)


def test_a_clipped_channel_is_found_with_limit_samples_and_what_was_cut_off():
    """Continuous values: every sample at the limit is one of the plateau, and none besides."""
    y = motion()
    full = noisy(0, y)
    found = find(np.minimum(full, 1.2), y)
    assert found is not None
    assert (found.lower, found.upper, found.limit) == (None, 1.2, 1.2)
    cut = full >= 1.2
    assert np.array_equal(found.masks[0], cut)
    assert found.count == cut.sum()
    assert found.p_value < 1e-12
    # sum (y - 1.2)^2 over the samples cut off, where the motion is beyond the limit
    assert found.energy == pytest.approx(np.sum(np.maximum(y[cut] - 1.2, 0) ** 2))


def test_both_ends_may_be_cut_at_limits_of_their_own():
    y = motion()
    full = noisy(0, y)
    found = find(np.clip(full, -1.5, 1.2), y)
    assert found is not None
    assert (found.lower, found.upper) == (-1.5, 1.2)
    assert found.limit == 1.5
    assert np.array_equal(found.masks[0], (full >= 1.2) | (full <= -1.5))
    below = find(np.maximum(full, -1.2), y)
    assert below is not None
    assert (below.lower, below.upper, below.limit) == (-1.2, None, 1.2)


@pytest.mark.parametrize("step", [0.0, 0.01, 0.05, 0.2], ids=lambda s: f"step {s:g}")
def test_a_channel_that_is_not_clipped_has_no_plateaus_however_coarse_it_is(step):
    """A converter repeats all values; those at its ends are then no exception."""
    for seed in range(20):
        y = motion(seed)
        measured = noisy(seed, y)
        assert find(rounded(measured, step) if step else measured, y) is None


@pytest.mark.parametrize("step", [0.01, 0.02])
def test_a_coarse_channel_is_clipped_where_its_end_repeats_more_than_what_is_next_to_it(step):
    y = motion()
    full = rounded(noisy(0, y), step)
    found = find(np.minimum(full, 1.2), y)
    assert found is not None
    assert found.upper == pytest.approx(1.2)
    assert np.array_equal(found.masks[0], full >= 1.2 - 1e-9)


def resting(N: int = 3000, step: float = 0.002) -> Array:
    """A slide between its ends, at rest on each for a while: the motion slows down before."""
    t = 0.01 * np.arange(N)
    return rounded(np.tanh(2.5 * np.sin(1.3 * t + 0.4)), step)


def test_a_channel_at_rest_at_its_end_has_no_plateau():
    """One value repeats exactly there, but it is reached and left slowly, and simulated alike."""
    y = resting()
    assert np.sum(y == y.max()) > 100
    assert find(y, y) is None
    # Nor where the simulation rests a little further out, by a gain or a bias that is wrong.
    assert find(y, y + 0.1) is None
    assert find(y, np.where(np.abs(y) == y.max(), 1.1 * y, y)) is None


def test_a_body_that_hits_its_stop_at_speed_and_leaves_it_slowly_is_at_rest():
    """It runs into the limit, but not out of it."""
    since = (0.01 * np.arange(3000)) % 3.0
    start = np.where(since < 1.0, since, 1.0)  # at constant speed onto the stop
    y = np.where(since < 2.0, start, 1.0 - (since - 2.0) ** 2)  # off it from rest
    y = rounded(y + 1e-4 * np.random.default_rng(1).standard_normal(3000) * (y < 1.0), 1e-4)
    y = np.minimum(y, 1.0)
    assert np.sum(y == 1.0) > 900
    assert find(y, y) is None


def overshoot() -> Array:
    """The answer of an encoder's axis to a step: it turns once, some counts above where it ends."""
    t = 0.005 * np.arange(200)
    return 95.8 * (1 - np.exp(-3.0 * t) * np.cos(6.0 * t))


def test_a_counter_whose_motion_turns_is_not_clipped_however_far_a_wrong_model_goes():
    """Near its turn a parabola stays on one count for long, and on each further one for less."""
    y = np.round(overshoot())
    assert np.sum(y == y.max()) > 10
    assert find(y, 1.2 * overshoot()) is None


def test_a_counter_that_is_cut_off_at_half_its_overshoot_is_clipped():
    y = np.round(overshoot())
    limit = np.round(95.8 + 0.5 * (y.max() - 95.8))
    found = find(np.minimum(y, limit), overshoot())
    assert found is not None
    assert found.upper == limit


def test_a_channel_that_keeps_its_speed_up_to_its_end_is_clipped_whatever_the_simulation():
    """No motion goes at full speed into a rest and at full speed out of it.

    The simulation of a model that lacks something may well stay below the limit.
    """
    y = motion()
    full = noisy(0, y)
    found = find(np.minimum(full, 1.2), np.minimum(y, 1.1))
    assert found is not None
    assert found.upper == 1.2
    assert found.energy == 0.0  # nothing is cut off of that simulation


def test_a_motion_of_another_size_is_no_plateau_without_ties():
    """The simulation goes beyond the record's end everywhere: that is a scale and no limit."""
    y = motion()
    assert find(noisy(0, y), 1.5 * y) is None


def test_samples_that_are_not_used_neither_count_nor_are_marked():
    y = motion()
    full = noisy(0, y)
    used = full < 1.2
    assert find(np.minimum(full, 1.2), y, used) is None
    used[:] = np.arange(len(y)) < 2000
    found = find(np.minimum(full, 1.2), y, used)
    assert found is not None
    assert np.array_equal(found.masks[0], used & (full >= 1.2))


def test_one_limit_is_sought_in_all_records_together():
    y = [motion(1), motion(2)]
    full = [noisy(1, y[0]), noisy(2, y[1])]
    limit = 1.4
    found = find_plateaus(
        "y",
        [np.minimum(x, limit) for x in full],
        y,
        [np.ones(len(x), dtype=bool) for x in y],
        ALPHA,
    )
    assert found is not None
    assert found.upper == limit
    for mask, x in zip(found.masks, full, strict=True):
        assert np.array_equal(mask, x >= limit)


@pytest.mark.parametrize("step", [0.0, 1e-5, 1e-3], ids=lambda s: f"step {s:g}")
def test_two_equal_samples_are_a_limit_only_in_a_channel_without_other_repetitions(step):
    """Of 3000 values without any a given one repeats by chance once in 3000 records.

    In steps of 1e-5 over 5 units some nine pairs are equal: the end is one by chance in 300. In
    shorter records it is more often than once in a thousand, the level of the test.
    """
    y = motion()
    full = noisy(0, y)
    full = rounded(full, step) if step else full
    limit = float(np.sort(full)[-2])
    found = find(np.minimum(full, limit), y + 0.2)
    assert (found is None) == (step > 0.0)
    if found is not None:
        assert found.count == 2
    assert find(np.minimum(full, limit)[-900:], y[-900:] + 0.2) is None


@pytest.mark.parametrize("values", [np.zeros(200), np.arange(30.0)], ids=["constant", "short"])
def test_a_channel_without_motion_or_with_few_samples_is_not_judged(values):
    assert find(values, values) is None


def test_a_simulation_that_diverged_tells_nothing():
    y = motion()
    assert find(np.minimum(noisy(0, y), 1.2), np.full(len(y), np.inf)) is None


@pytest.mark.parametrize("fault", [10.0, -4.0, 8.5e4])
def test_a_value_for_a_fault_is_no_limit_of_the_motion(fault):
    """It stands alone, further from its neighbours than any sample of the motion."""
    y = motion()
    measured = noisy(1, y)
    measured[[200, 700, 1300, 1900, 2600]] = fault
    assert find(measured, y) is None


def test_a_motion_that_jumps_to_its_limit_for_some_samples_is_cut_off():
    """The jumps are no larger than those of the motion by far, and the limit holds for a while."""
    y = 2.0 * np.sign(np.sin(2 * np.pi * np.arange(3000) / 100)) + 0.1 * motion()
    cut = np.minimum(noisy(1, y), 1.2)
    found = find(cut, y)
    assert found is not None
    assert found.upper == pytest.approx(1.2)


def counted_speed(seed: int, N: int = 400) -> tuple[Array, Array]:
    """Counts a sample of a motor that runs up, by a disc with uneven slots: true, and counted.

    Steady speed gives two counts again and again, of one half of the disc and of the other.
    """
    k, rng = np.arange(N), np.random.default_rng(seed)
    speed = (75.0 + rng.uniform()) * (1.0 - np.exp(-k / 12.0))
    angle = np.cumsum(speed + np.where(k % 2 == 0, 2.1, -2.1)) + 0.1 * rng.standard_normal(N)
    return speed, np.diff(np.floor(angle), prepend=0.0)


def test_levels_of_a_counted_channel_that_repeat_unevenly_are_no_limit():
    """The levels next to its top repeat as much, or not at all: they are no Poisson numbers.

    The top is run into and out of at full speed, by the other half of the disc: ties alone decide.
    """
    often = 0
    for seed in range(20):
        speed, counts = counted_speed(seed)
        often += np.sum(counts == counts.max()) > 2 * CLIPPING.fewest
        assert find(counts, speed) is None
    assert often > 10


def test_a_counted_channel_is_clipped_where_its_top_repeats_far_more_than_any_level_below():
    """Counts of a motion over many levels, of a counter that goes no further."""
    y = motion()
    counts = np.round(60 * noisy(0, y))
    found = find(np.minimum(counts, 70.0), 60 * y)
    assert found is not None
    assert found.upper == 70.0
    assert np.array_equal(found.masks[0], counts >= 70.0)


def standstill(dead: float, noise_seed: int) -> tuple[Array, Array]:
    """Counts of a motor's position that stands, is driven from 0.4 s on, and answers late.

    Beside it least squares of the model without a dead time, q = q_0 + a e(t) + K f(t), with both
    initial states free: its error is one slow wave all over the record.
    """
    t, tau = 0.005 * np.arange(320), 0.13

    def driven(after: float) -> Array:
        s = np.maximum(t - after, 0.0)
        return s - tau * (1.0 - np.exp(-s / tau))

    rng = np.random.default_rng(noise_seed)
    q = np.round(2000.0 * driven(0.4 + dead) + 0.1 * rng.standard_normal(len(t)) * (t > 0.4 + dead))
    columns = np.column_stack([np.ones_like(t), tau * (1.0 - np.exp(-t / tau)), driven(0.4)])
    return q, columns @ np.linalg.lstsq(columns, q, rcond=None)[0]


@pytest.mark.parametrize("dead", [0.02, 0.03, 0.04])
def test_a_standstill_before_a_step_is_no_limit_where_the_model_errs_as_much_elsewhere(dead):
    """The slow error of a model is one error in the whole standstill, not one a sample."""
    for seed in range(3):
        q, simulated = standstill(dead, seed)
        rest = q == q.min()
        assert rest.sum() > 80
        beyond = (q.min() - simulated)[rest]  # of the lower end
        error = np.std(beyond) / np.sqrt(rest.sum())
        assert abs(beyond.mean()) > 4 * error  # it would be, of independent errors
        assert find(q, simulated) is None
        assert find(-q, -simulated) is None


def test_a_smooth_motion_that_creeps_beyond_its_limit_is_clipped_by_what_the_model_says():
    """No speed at the limit, a model with a slow error: the motion beyond is far more than that."""
    t = 0.01 * np.arange(4000)
    y = np.sin(0.9 * t) + 0.02 * np.sin(0.07 * t)
    slow = 0.01 * np.sin(2.3 * t + 1.0)
    limit = 0.93
    found = find(np.minimum(y, limit), y + slow)
    assert found is not None
    assert found.upper == limit
    assert np.array_equal(found.masks[0], y >= limit)


def creeping(seed: int) -> Array:
    """A level that goes through one slow wave: it comes to its limit once and stays beyond."""
    rng = np.random.default_rng(seed)
    return np.cos(0.0015 * np.arange(4000)) + NOISE * rng.standard_normal(4000)


def test_readings_that_lose_their_noise_at_a_limit_are_cut_off_however_slow_the_motion():
    """One stay beyond the limit is one error of the simulation, but no rest takes the noise."""
    for seed in range(5):
        level, simulated = creeping(seed), np.cos(0.0015 * np.arange(4000))
        found = find(np.maximum(level, -0.6), simulated)
        assert found is not None
        assert found.lower == -0.6
        assert np.array_equal(found.masks[0], level <= -0.6)
        # Without noise it may rest there, as a float on the ground does.
        still = np.maximum(np.cos(0.0015 * np.arange(4000)), -0.6)
        assert find(still, np.where(still > -0.6, still, still - 0.1)) is None


def dips(seed: int) -> Array:
    """A pressure that is struck to either side ten times, by up to 400 steps of its converter."""
    rng, k, y = np.random.default_rng(seed), np.arange(3000), np.zeros(3000)
    for centre in np.linspace(150, 2850, 10) + rng.uniform(-20, 20, 10):
        size = 400.0 * rng.uniform(0.1, 1.0) * rng.choice([-1.0, 1.0])
        y += size * np.exp(-((k - centre) ** 2) / 2 / 29.0**2)
    return y


def read_in_steps(seed: int) -> Array:
    """Readings with noise of half a step, rounded to whole ones."""
    return np.round(dips(seed) + 0.5 * np.random.default_rng(1000 + seed).standard_normal(3000))


def test_a_motion_that_turns_once_at_its_end_is_seldom_clipped_whatever_noise_rounds_alike():
    """The end of the record is reached once, where the motion turns, and passed nowhere else.

    So its readings lie closer there than next to it, by a share of records that is a hundred times
    the level (ties alone: 5 %); that the motion turned shows, beside the noise. Both ends at the
    level 0.001: of 500 records one, and five or more in 0.4 % of such tests. The model goes too
    far by a fifth.
    """
    found = [find(read_in_steps(seed), 1.2 * dips(seed)) for seed in range(500)]
    assert sum(cut is not None for cut in found) <= 4


def test_what_is_cut_off_by_a_tenth_is_clipped_in_spite_of_noise_and_rounding():
    """The motion ran into the limit at many times its noise: chance rounds no such run alike."""
    for seed in range(20):
        y = read_in_steps(seed)
        limit = np.round(0.9 * y.max())
        found = find(np.minimum(y, limit), dips(seed))
        assert found is not None
        assert found.upper == limit
