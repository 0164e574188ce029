"""How well instants of changes are known, and where the whole records have them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

import casid
from casid.arrays import Array
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.scores.score_tests import scan_pairs
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.search.instants.instant_errors import moved_in_time, with_instant_errors
from casid.diagnosis.search.rounds import Search
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.clock_effects import at_instant, gain_step
from casid.model.effects.parameter_effects import parameter_jump
from tests.diagnosis.search.instants.test_temporary_changes import (
    BEGIN,
    END,
    NOISE,
    TS,
    N,
    leak,
    record,
)

ONCE = FitSettings(starts=1)


def fitted(begin: float, end: float) -> tuple[Adopted, Fit]:
    """The leak that is larger for a while, between two instants."""
    return jumped(record(leaks=0.3), begin, 0.3, end)


def jumped(
    of: casid.Record, begin: float, size: float, end: float | None = None
) -> tuple[Adopted, Fit]:
    """A leak that is larger from an instant on, or for a while."""
    model = leak().model
    effect = parameter_jump(model, "k", begin, end)
    extended, names = effect.extended(model, starts={"jump_k": size})
    data, weights = [casid.Experiment(of, {}, "run")], np.array([1 / NOISE])
    fit = fit_model(
        extended, data, FitSettings(starts=1), weights=weights, check_rank=False, throw=False
    )
    return Adopted(Candidate(effect, names, extended, fit, 0.0, 0.0, 9.0), 0.0, ()), fit


def instants(cause: Adopted) -> tuple[float, float]:
    effect = cause.candidate.effect
    assert effect.variant is not None
    assert effect.end is not None
    return effect.variant, effect.end


@pytest.fixture(scope="module")
def best() -> tuple[Adopted, Fit]:
    """With the instants where the record has them: two Gauss-Newton steps from the true ones."""
    cause, fit = fitted(BEGIN, END)
    for _ in range(2):
        (moved,) = moved_in_time(leak().model, [cause], fit) or (cause.candidate,)
        cause, fit = fitted(*instants(replace(cause, candidate=moved)))
    return cause, fit


def test_an_instant_is_as_uncertain_as_its_profile_says(best: tuple[Adopted, Fit]):
    """Later by a quarter of a sample, all else fitted again: S rises by (t / sd)^2, both ways.

    The mean of both sides is without the slope that the noise of one record gives.
    """
    cause, fit = best
    (known,) = with_instant_errors(Attempts(), [cause], fit)
    later = 0.25 * TS
    for i, error in enumerate(known.instant_errors):
        sides = []
        for side in (later, -later):
            shifted = list(instants(cause))
            shifted[i] += side
            sides.append(fitted(*shifted)[1].solution.value)
        alone = later / np.sqrt(2 * (np.mean(sides) - fit.solution.value))
        # Beside the other instant it is known less well, by what they have in common.
        assert 0.9 * alone <= error <= 1.3 * alone


def test_the_sizes_move_with_the_instants(best: tuple[Adopted, Fit]):
    cause, fit = best
    (known,) = with_instant_errors(Attempts(), [cause], fit)
    begin, end = instants(cause)
    other = fitted(begin + 0.5 * TS, end)[1]
    assert len(known.shifts) == 2
    added = np.hypot(*(shift["jump_k"] for shift in known.shifts))
    per_second = (other.values["jump_k"] - fit.values["jump_k"]) / (0.5 * TS)
    # One of the two instants gives at least its own part.
    assert added > 0.5 * abs(per_second) * known.instant_errors[0]


def test_instants_move_to_where_the_records_have_them():
    """From two and from three samples away, in one step for all but what is not linear."""
    cause, fit = fitted(BEGIN + 0.2, END - 0.3)
    (moved,) = moved_in_time(leak().model, [cause], fit) or ()
    (known,) = with_instant_errors(Attempts(), [cause], fit)
    for now, true, error in zip(
        (moved.effect.variant, moved.effect.end),
        (BEGIN, END),
        known.instant_errors,
        strict=True,
    ):
        assert now == pytest.approx(true, abs=4 * error + 0.05)


def test_a_disturbance_keeps_no_instant_away_from_where_the_records_have_it():
    """Placed four samples late, a leak seems to leave a disturbance; at its instants, none."""
    away = 0.4
    model, split = leak().model, split_records([casid.Experiment(record(leaks=0.3))], 0.0)
    base = fit_model(model, split.fitted, ONCE)
    weighing = Weighing(split.fitted).with_disturbances()
    at, units = weighing.weigh(model, base), base.criterion.weights
    refine = Refinement(Search(weighing, {}), split, ONCE, units, at, base)
    cause, fit = fitted(BEGIN + away, END + away)
    beside = weighing.weigh(fit.criterion.model, fit)
    assert beside.noise.source_sd["volume"] > 0.01  # m/s
    found = Adoption((cause,), beside, beside.fit)
    moved = refine.with_likelier_instants(found)
    assert moved.at.noise.source_sd["volume"] == pytest.approx(0.0, abs=1e-4)
    assert instants(moved.adopted[0]) == pytest.approx((BEGIN, END), abs=0.05)


@pytest.mark.parametrize("placed", [30.0, 33.0, 38.0])
def test_a_leak_of_an_empty_store_may_set_in_at_any_time_until_it_is_filled(placed: float):
    """Empty from 28 to 40 s: the slope there tells nothing, S(t) that it is any time between."""
    cause, fit = jumped(emptied(at=32.0), placed, 0.3)
    (known,) = with_instant_errors(Attempts(), [cause], fit)
    (error,) = known.instant_errors
    furthest = max(placed - 28.0, 40.0 - placed)
    assert 0.8 * furthest < 1.96 * error < 1.4 * furthest


def emptied(at: float) -> casid.Record:
    """100 s of dh/dt = q - k h without inflow from 20 to 40 s; k larger from an instant on."""
    rng = np.random.default_rng(7)
    q = np.repeat(rng.uniform(0.2, 1.0, N // 20), 20)
    q[200:400] = 0.0
    return leaking(q, at, 0.9, rng.standard_normal(N))


def leaking(q: Array, at: float, k_after: float, noise: Array) -> casid.Record:
    """dh/dt = q - k h, sampled exactly; k is 0.6 before an instant, and the level has noise."""
    level, h = np.empty(N), 1.0
    for i, inflow in enumerate(q):
        level[i] = h
        k = k_after if i * TS >= at - 1e-9 else 0.6
        h = inflow / k + (h - inflow / k) * np.exp(-k * TS)
    level += NOISE * noise
    return casid.Record({"q": q, "level": level}, {"q": "m/s", "level": "m"}, Ts=TS, name="run")


@pytest.mark.slow
@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_instants_are_where_their_intervals_say_whatever_the_noise_remembers(memory: float):
    """40 records: 95 % of the intervals hold the instant, within the binomial interval of 99 %."""
    held = [is_held(seed, memory) for seed in range(40)]
    assert binom.cdf(sum(held), len(held), 0.95) > 0.005


def is_held(seed: int, memory: float) -> bool:
    rng = np.random.default_rng(seed)
    q = np.repeat(rng.uniform(0.0, 1.0, N // 20), 20)
    at = round(rng.uniform(20.0, 70.0), 1)
    noise = lfilter([np.sqrt(1 - memory**2)], [1.0, -memory], rng.standard_normal(N + 200))[200:]
    of, true = leaking(q, at, 0.7, noise), at
    nearby = [jumped(of, true + late, 0.1) for late in (-2.0, -0.5, 0.0, 0.5, 2.0)]
    cause, fit = min(nearby, key=lambda found: found[1].solution.value)
    for _ in range(3):
        (moved,) = moved_in_time(leak().model, [cause], fit) or (None,)
        if moved is None:
            break
        cause, fit = jumped(of, moved.effect.variant, 0.1)
    (known,) = with_instant_errors(Attempts(), [cause], fit)
    return abs(cause.candidate.effect.variant - true) <= 1.96 * known.instant_errors[0]


def test_what_sets_in_at_no_instant_stays_as_it_is(best: tuple[Adopted, Fit]):
    _, fit = best
    assert moved_in_time(leak().model, [], fit) is None
    assert with_instant_errors(Attempts(), [], fit) == ()


def stopped(begin: float, end: float) -> tuple[Adopted, Fit]:
    """A pump that gives nothing for a while, whatever it is told, between two instants."""
    rng = np.random.default_rng(6)
    q = np.repeat(rng.uniform(0.5, 1.0, N // 20), 20)
    level, h = np.empty(N), 1.0
    for i, told in enumerate(q):
        level[i] = h
        inflow = 0.0 if BEGIN <= i * TS < END else told
        h = inflow / 0.6 + (h - inflow / 0.6) * np.exp(-0.6 * TS)
    level += NOISE * rng.standard_normal(N)
    of = casid.Record({"q": q, "level": level}, {"q": "m/s", "level": "m"}, Ts=TS)
    model = leak().model
    effect = gain_step(model, "q", begin, end)
    extended, names = effect.extended(model, starts={"gain_q": -0.9})
    fit = fit_model(extended, [casid.Experiment(of)], ONCE, weights=np.array([1 / NOISE]))
    return Adopted(Candidate(effect, names, extended, fit, 0.0, 0.0, 9.0), 0.0, ()), fit


def test_an_input_that_fails_does_so_at_the_instants_that_leave_least():
    """Seconds beside them, too: under a gain of -1 another gain of the input changes nothing."""
    cause, fit = stopped(BEGIN + 2.0, END - 2.0)
    effect, own = cause.candidate.effect, cause.candidate.names[0]
    moments = [[at + late for late in (-2.0, 0.0, 2.0)] for at in (BEGIN, END)]
    steps = [[at_instant(effect, fit.criterion.model, t) for t in side] for side in moments]
    left = scan_pairs(fit, own, *steps)
    assert np.unravel_index(np.argmin(left), left.shape) == (1, 1)


def test_the_instants_at_which_an_input_fails_are_as_uncertain_as_their_profile_says():
    """Half of what they are where the gain itself scales their signatures."""
    begin, end = BEGIN, END
    cause, fit = stopped(begin, end)
    (known,) = with_instant_errors(Attempts(), [cause], fit)
    later = 0.25 * TS
    sides = [stopped(begin + side, end)[1].solution.value for side in (later, -later)]
    alone = later / np.sqrt(2 * (np.mean(sides) - fit.solution.value))
    assert 0.9 * alone <= known.instant_errors[0] <= 1.3 * alone
