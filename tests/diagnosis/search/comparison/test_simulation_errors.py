"""An extension is adopted only if it lowers the errors, whatever its likelihood says."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import casid
from casid.diagnosis.search.comparison.simulation_errors import (
    SimulationErrors,
    Soundness,
    growth_by_disturbance,
    is_as_good_held_out,
    is_predicted,
    on_common_samples,
    simulation_errors,
    why_much_worse,
    why_not_adopted,
)
from casid.diagnosis.thresholds import FORESIGHT, GROWTH, ROUNDS
from casid.estimation.holdout import Split, degrees_of_freedom, split_records
from casid.estimation.simulation.fit import fit_model
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.channels.delays import time_delay
from problems import roll_decay

N = 400
RNG = np.random.default_rng(3)
NOISE = RNG.standard_normal((3, N, 1))
SWING = np.sin(0.1 * np.arange(N))[:, None]


def errors(fitted: float, continued: float, restarted: float) -> SimulationErrors:
    """The same noise in every model, and a swing of the sizes given that a model leaves."""
    sizes = (fitted, continued, restarted)
    return SimulationErrors(*(e + size * SWING for e, size in zip(NOISE, sizes, strict=True)))


BEFORE = errors(1.0, 1.0, 1.0)


def test_an_extension_that_lowers_all_three_errors_is_adopted():
    assert not why_not_adopted(BEFORE, errors(0.1, 0.1, 0.1))


@pytest.mark.parametrize(("continued", "is_as_good"), [(0.9, True), (1.04, True), (1.1, False)])
def test_a_held_out_error_may_rise_by_a_tenth_of_what_that_of_the_fitted_part_falls(
    continued: float, is_as_good: bool
) -> None:
    """The swing's squares fall by 0.99 where it was fitted; 1.04^2 is 0.08 more than one."""
    assert is_as_good_held_out(BEFORE, errors(0.1, continued, 1.0)) is is_as_good


@pytest.mark.parametrize(
    ("after", "why", "error"),
    [
        ((1.1, 0.1, 0.1), "does not lower the error of the fitted part", "fitted"),
        ((0.1, 1.3, 0.99), "makes the held-out error worse", "held-out"),
        ((0.1, 0.99, 1.3), "from an initial state of its own", "held-out"),
    ],
)
@pytest.mark.parametrize("is_alarm", [False, True])
def test_an_error_that_grows_by_more_than_others_fall_refuses_it(after, why, error, is_alarm):
    refusal = why_not_adopted(BEFORE, errors(*after), is_alarm=is_alarm)
    assert why in refusal.text
    assert refusal.error == error


def test_a_held_out_error_that_grows_is_made_up_for_by_the_other_if_it_falls_by_more():
    """Alone of noise 1 and a swing of 5, squares are 13.5 N; of 6 and 0.1, 19 N and 1.005 N."""
    before = errors(5.0, 5.0, 5.0)
    assert not why_not_adopted(before, errors(0.1, 6.0, 0.1))
    assert not why_not_adopted(before, errors(0.1, 0.1, 6.0))
    assert why_not_adopted(before, errors(0.1, 6.0, 4.9))


@pytest.mark.parametrize(("share", "is_adopted"), [(0.5, True), (2.0, False)])
def test_a_rise_that_is_small_beside_the_gain_in_the_fit_is_none(share, is_adopted):
    """A motion that has died away: half the rise that counts as none, and twice as much."""
    swing = np.where(np.arange(N)[:, None] % 2, 1.0, -1.0)
    fitted, held, quiet = 10.0 * swing, 10.0 * swing, 1e-3 * swing
    rise = np.sqrt(1e-6 + share * ROUNDS.overfit * 100.0) * swing
    before, after = (
        SimulationErrors(fitted, held, quiet),
        SimulationErrors(0.0 * swing, 0.9 * held, rise),
    )
    assert bool(why_not_adopted(before, after)) is not is_adopted


def test_a_gain_that_may_be_chance_is_enough_for_an_effect_that_is_significant_by_itself():
    """A swing of 0.02 beside noise of 1, at right angles to it: it adds 0.08 +- 0.56 to 400."""
    noise = NOISE[0]
    swing = SWING - noise * float(np.sum(noise * SWING) / np.sum(noise**2))
    before = SimulationErrors(*(noise + 0.02 * swing,) * 3)
    after = SimulationErrors(noise, noise, noise)
    refusal = why_not_adopted(before, after)
    assert "may be chance" in refusal.text
    assert refusal.error == "held-out"
    assert not why_not_adopted(before, after, is_alarm=True)


def test_a_simulation_that_diverges_is_refused():
    wild = SimulationErrors(*(np.full((N, 1), np.inf) for _ in range(3)))
    refusal = why_not_adopted(BEFORE, wild)
    assert "diverges" in refusal.text
    assert refusal.error == "fitted"


def test_where_nothing_was_held_out_the_fitted_error_decides():
    none = np.zeros((0, 1))
    before, after = (SimulationErrors(NOISE[0] + size * SWING, none, none) for size in (1.0, 0.1))
    assert not why_not_adopted(before, after)
    assert "fitted part" in why_not_adopted(after, before).text


def white(size: float) -> SimulationErrors:
    """White errors of `size`, of which sums of N squares have N degrees of freedom."""
    return SimulationErrors(*(size * e for e in NOISE))


@pytest.mark.parametrize(("left", "is_foreseen"), [(0.45, True), (0.55, False)])
def test_causes_that_take_most_of_every_held_out_error_away_are_no_disturbance(left, is_foreseen):
    """`left` of the error is 0.2 and 0.3 of its squares; at least half of the lines count."""
    assert FORESIGHT.left == 0.25
    assert is_predicted(white(1.0), white(left)) is is_foreseen
    only_one = SimulationErrors(left * NOISE[0], left * NOISE[1], NOISE[2])
    assert not is_predicted(white(1.0), only_one)


def test_one_slow_wave_in_what_was_held_out_is_too_little_to_refuse_a_disturbance():
    """A single half wave has some two degrees of freedom: F(2, 2) of ten has p = 0.09."""
    slow = np.sin(np.pi * np.arange(N) / N)[:, None]
    before = SimulationErrors(slow, slow, slow)
    after = SimulationErrors(*(np.sqrt(0.1) * e for e in (slow, slow, slow)))
    assert degrees_of_freedom(slow) < 4.0
    assert not is_predicted(before, after)


@functools.cache
def decay() -> tuple[Fit, Split]:
    """A linear decay with noise, and its fit."""
    record = roll_decay.simulate(duration=60.0, B_2=0.0, C_3=0.0).decimate(5)
    split = split_records([casid.Experiment(record)], 0.3)
    return fit_model(roll_decay.decay_model(), split.fitted, casid.FitSettings(starts=1)), split


def moved(**shares: float) -> Fit:
    """The fit with some of its values times a factor."""
    fit, _ = decay()
    factors = np.array([shares.get(name, 1.0) for name in fit.criterion.names])
    return replace(fit, solution=replace(fit.solution, x=fit.x * factors))


def test_models_are_compared_on_the_samples_that_all_of_them_count():
    """A lag leaves out what shows the time before the record; a delay leaves out less of it."""
    delay, lag = errors(1.0, 1.0, 1.0), errors(1.0, 1.0, 1.0)
    delay.fitted[:3], lag.fitted[:9], lag.restarted[:5] = np.nan, np.nan, np.nan
    first, second = on_common_samples(delay, lag)
    assert first.square == pytest.approx(second.square)
    assert first.held_out_square == pytest.approx(second.held_out_square)
    assert np.isnan(first.fitted).sum() == 9
    assert np.isnan(first.restarted).sum() == 5
    assert lag.square < delay.square  # as each counts


def test_a_model_that_simulates_worse_than_the_one_it_extends_is_not_sound():
    """A stiffness that is 2 % off shifts the swing by half a period within the record."""
    fit, split = decay()
    is_sound = Soundness(fit, split)
    assert is_sound(fit)
    assert is_sound(moved(C_1=1 + 1e-6))
    assert not is_sound(moved(C_1=1.02))
    assert not is_sound(moved(B_1=-1e4))  # diverges
    assert not is_sound(moved(B_1=-np.inf))  # breaks down: no number at all


def test_under_a_disturbance_neither_part_may_be_simulated_much_worse():
    fit, split = decay()
    assert not why_much_worse(fit, moved(C_1=1 + 1e-6), split)
    refusal = why_much_worse(fit, moved(C_1=1.02), split)
    assert refusal.text == "it makes the fitted error much worse"
    assert refusal.error == "fitted"


def test_right_parameters_lie_as_far_from_least_squares_as_its_confidence_region_reaches():
    """S / S_LS of a line through slow errors, of which there are some thirty in 3000 samples.

    (1) of `growth_by_disturbance` counts every line of the spectrum alike, and slow errors have
    most where a parabola has all: it is too little in one of thirty at most, and a tenth of the
    error, whatever the record, in more than one of ten.
    """
    rng, N = np.random.default_rng(8), 3000
    line = np.column_stack([np.ones(N), np.linspace(-1.0, 1.0, N), np.linspace(-1.0, 1.0, N) ** 2])
    a = np.exp(-1 / 60)
    fit: Any = SimpleNamespace(x=np.zeros(3))
    ratios, bounds = [], []
    for _ in range(200):
        noise = lfilter([1.0], [1.0, -a], rng.standard_normal(N + 500))[500:]
        left = noise - line @ np.linalg.lstsq(line, noise, rcond=None)[0]
        ratios.append(np.sum(noise**2) / np.sum(left**2))
        bounds.append(growth_by_disturbance(left[:, None], fit))
    assert np.mean(np.array(ratios) > bounds) < 1 / 30
    assert np.mean(np.array(ratios) > (1 + GROWTH.by_chance) ** 2) > 0.1
    assert max(bounds) <= (1 + GROWTH.by_least_squares) ** 2


def test_samples_that_a_late_sensor_leaves_out_of_the_fit_count_in_no_error():
    """Before a delay has passed, the sensor shows what was before the record: nobody knows that.

    Counted, they refused a delay whose own initial state, free for them, contradicts them.
    """
    fit, split = decay()
    Ts = fit.criterion.data[0].Ts
    late, _ = time_delay(roll_decay.decay_model(), "phi", 1.0).extended(
        roll_decay.decay_model(), starts={"delay_phi": 2.5 * Ts}
    )
    # In a free decay a delay is another initial state: no matter here.
    once = casid.FitSettings(starts=1)
    delayed = fit_model(late, split.fitted, once, start=fit.values, check_rank=False, throw=False)
    left_out = int(np.sum(~delayed.criterion.data[0].used))
    assert left_out >= 3
    errors = simulation_errors(delayed, split, fit.criterion.weights)
    assert int(np.sum(np.isnan(errors.fitted))) == left_out
    assert not np.isnan(simulation_errors(fit, split, fit.criterion.weights).fitted).any()


def test_what_was_held_out_on_another_clock_has_no_say_in_a_change():
    """The errors of one model count there, and those of the other do not (`Split.judges`)."""
    nothing = np.full((N, 1), np.nan)
    none = np.zeros((0, 1))
    before = SimulationErrors(NOISE[0] + SWING, NOISE[1], none)
    after = SimulationErrors(NOISE[0], nothing, none)
    assert not why_not_adopted(before, after)
    assert not why_not_adopted(after, replace(after, fitted=0.9 * NOISE[0]))
    assert is_as_good_held_out(before, after)
    assert not is_predicted(before, after)
    worse = replace(after, continued=2 * NOISE[1])
    assert why_not_adopted(before, worse).error == "held-out"


def test_an_end_that_both_models_count_judges_beside_a_record_that_one_does_not():
    nothing = np.full((N, 1), np.nan)
    none = np.zeros((0, 1))
    before = SimulationErrors(NOISE[0] + SWING, np.vstack([NOISE[1], 9 * NOISE[2]]), none)
    better, worse = (
        SimulationErrors(NOISE[0], np.vstack([size * NOISE[1], nothing]), none)
        for size in (0.5, 1.2)
    )
    assert not why_not_adopted(before, better)
    assert why_not_adopted(before, worse).error == "held-out"
