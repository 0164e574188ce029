"""Outliers: silence under normal noise and smooth misfit, and errors found one by one or by many.

With d_k = r_k - (r_{k-1} + r_{k+1}) / 2, white noise of variance sigma^2 has Var(d) = 1.5 sigma^2
and correlations -2/3 and 1/6 at lags 1 and 2; by Isserlis's theorem the mean of the fourth Hermite
polynomial of d over its standard deviation has the variance 24 (1 + 2 (2/3)^4 + 2 (1/6)^4) / N.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import norm

import casid
from casid.diagnosis.evidence import baseline
from casid.diagnosis.evidence.recording_faults.corrupted_samples import (
    above_neighbours,
    act_a_sample_later,
    at_onsets,
    is_tail,
    without_corrupted,
)
from casid.diagnosis.evidence.recording_faults.spikes import (
    find_spikes,
    fourth_moment_deviate,
    from_neighbours,
    starts_apart,
)
from casid.diagnosis.settings import DiagnosisSettings
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import fit_model

Array = np.ndarray

ALPHA = 0.001
"""Of one test in one channel: 1/50 of a false-alarm rate of 5 %."""


def spoilt(seed: int, *, size: float = 4.0, share: float = 0.01, N: int = 6000):
    """Unit white noise with `share` errors of `size` and either sign; no two are neighbours."""
    rng = np.random.default_rng(seed)
    r = rng.standard_normal(N)
    at = 2 + 4 * np.sort(rng.choice(N // 4 - 1, round(share * N), replace=False))
    r[at] += size * rng.choice([-1.0, 1.0], len(at))
    return r, at


def test_a_difference_from_the_neighbours_has_one_and_a_half_variances_and_no_smooth_part():
    N = 200_000
    d = from_neighbours(np.random.default_rng(1).standard_normal(N))[1:-1]
    # Var of a sample variance of d: 2 (1.5)^2 (1 + 2 (4/9 + 1/36)) / N.
    assert d.var() == pytest.approx(1.5, abs=4 * 1.5 * np.sqrt(2 * 1.95 / N))
    rho = [np.mean(d[: N - 2 - m] * d[m : N - 2]) / d.var() for m in (1, 2)]
    assert rho == pytest.approx([-2 / 3, 1 / 6], abs=4 * 2 / np.sqrt(N))
    line = from_neighbours(3.0 + 0.2 * np.arange(100.0))
    assert line == pytest.approx(np.zeros(100), abs=1e-12)


def test_the_fourth_moment_of_normal_noise_is_standard_normal():
    """400 records: mean and variance within four of their standard errors, and the rate at 5 %."""
    z = np.array(
        [
            fourth_moment_deviate(
                from_neighbours(np.random.default_rng(s).standard_normal(4000))[1:-1]
            )
            for s in range(400)
        ]
    )
    assert z.mean() == pytest.approx(0.0, abs=4 / np.sqrt(400))
    assert z.var() == pytest.approx(1.0, abs=4 * np.sqrt(2 / 400))
    # 20 of 400 expected; 33 or more, or 8 or fewer, come with 0.3 % each (binomial).
    assert 8 < np.sum(z > norm.isf(0.05)) < 33


def test_a_short_record_has_large_fourth_moments_as_often_as_their_level_says():
    """8000 records of 600 samples at 0.1 %: 11 by the approximation of (2), 24 are four s.d. more.

    Normal by its variance alone, (1) has 40 of them.
    """
    rng = np.random.default_rng(0)
    d = np.array([from_neighbours(r)[1:-1] for r in rng.standard_normal((8000, 600))])
    assert sum(fourth_moment_deviate(each) > norm.isf(0.001) for each in d) < 24


def test_normal_noise_has_no_outliers_more_often_than_alpha():
    """400 records at 1 %: the Bonferroni bound keeps the rate below it; 12 or more: 0.1 %."""
    found = [
        find_spikes("y", [np.random.default_rng(s).standard_normal(2000)], 0.01) for s in range(400)
    ]
    assert sum(f is not None for f in found) < 12


def test_noise_that_is_not_normal_is_not_taken_for_a_few_errors():
    """Laplace's tails and a size that changes by half show in the fourth moment, too."""
    k = np.arange(6000)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        changing = (1 + 0.5 * np.sin(k / 300)) * rng.standard_normal(6000)
        for r in (rng.laplace(size=6000), changing):
            assert fourth_moment_deviate(from_neighbours(r)[1:-1]) > 5.0
            found = find_spikes("y", [r], ALPHA)
            # Single samples may exceed the normal threshold; the many that are merely large may not
            # be left out.
            assert found is None or found.count <= 5


def test_one_per_cent_of_errors_of_four_standard_deviations_is_found():
    """Hardly one exceeds the threshold for all samples: their number gives them away.

    E(d^4) - 3 Var(d)^2 is 0.01 (4^4 + 2 * 2^4) less 3 (0.24)^2: (1) is about 12 of its standard
    deviations, of which (2) makes 8.5, and 1.1 less in the lowest of twenty draws.
    """
    found, hits, false = [], 0, 0
    for seed in range(20):
        r, at = spoilt(seed)
        assert fourth_moment_deviate(from_neighbours(r)[1:-1]) > 7.0
        spikes = find_spikes("y", [r], ALPHA)
        if spikes is None or spikes.p_value > 1e-6:
            continue  # single ones, or a mixture that cannot be told from a heavy tail
        found.append(spikes)
        hits += int(spikes.masks[0][at].sum())
        false += spikes.count - int(spikes.masks[0][at].sum())
    assert len(found) >= 10
    # Each is larger than what stands beside it by two only: a third is marked, few besides.
    assert hits > len(found) * 60 / 3
    assert false < 0.3 * hits
    assert np.median([s.size for s in found]) == pytest.approx(4.0, rel=0.25)


def test_large_errors_are_all_found_whatever_smooth_misfit_they_stand_on():
    r, at = spoilt(3, size=12.0)
    smooth = lfilter([1.0], [1.0, -1.9, 0.905], np.random.default_rng(5).standard_normal(6000))
    smooth = lfilter(np.ones(40) / 40, [1.0], smooth)
    spikes = find_spikes("y", [r + 10 * smooth / smooth.std()], ALPHA)
    assert spikes is not None
    assert np.flatnonzero(spikes.masks[0]) == pytest.approx(at)
    assert spikes.share == pytest.approx(0.01)
    assert spikes.size == pytest.approx(12.0, rel=0.05)
    # Each height has the variance of d: 60 (144 + 1.5).
    assert spikes.energy == pytest.approx(60 * 145.5, rel=0.1)


def test_a_motion_that_begins_with_the_record_is_no_outlier_in_its_second_sample():
    """The first sample says nothing beside the second: the third shows more than half of it."""
    r = 0.001 * np.random.default_rng(1).standard_normal(2000)
    begins = np.cumsum([0.0, 0.19, *0.257 * 0.763 ** np.arange(1998)])
    assert find_spikes("y", [r + begins], ALPHA) is None
    assert find_spikes("y", [r + begins[::-1]], ALPHA) is None


def test_what_stands_out_of_the_simulation_alone_is_no_outlier_of_the_record():
    """A stiff joint of a poor fit rings for two samples; the record shows nothing there.

    What a sensor adds stands out of the record, whatever the simulation does beside it.
    """
    rng = np.random.default_rng(1)
    rest = np.sin(0.01 * np.arange(2000)) + 0.001 * rng.standard_normal(2000)
    rings, spoilt_there = np.sin(0.01 * np.arange(2000)), rest.copy()
    rings[2] += 0.1
    spoilt_there[[2, 700]] += 0.25
    assert find_spikes("y", [rest - rings], ALPHA) is not None
    assert find_spikes("y", [rest - rings], ALPHA, simulated=[rings]) is None
    spikes = find_spikes("y", [spoilt_there - rings], ALPHA, simulated=[rings])
    assert spikes is not None
    assert np.flatnonzero(spikes.masks[0]) == pytest.approx([2, 700])


@pytest.mark.parametrize("k", [1, 1998])
def test_an_outlier_beside_an_end_of_the_record_is_found(k):
    r = np.random.default_rng(1).standard_normal(2000)
    r[k] += 25.0
    spikes = find_spikes("y", [r], ALPHA)
    assert spikes is not None
    assert np.flatnonzero(spikes.masks[0]) == pytest.approx([k])


def test_a_quantised_record_is_not_free_of_noise():
    """Most differences are zero exactly: their median would make a spike of every step."""
    r = np.round(0.4 * np.random.default_rng(2).standard_normal(4000))
    assert np.median(np.abs(from_neighbours(r))) <= 0.5
    assert find_spikes("y", [r], ALPHA) is None


def test_each_record_is_judged_by_its_own_noise():
    rng = np.random.default_rng(4)
    quiet, loud = rng.standard_normal(2000), 20 * rng.standard_normal(2000)
    assert find_spikes("y", [quiet, loud], ALPHA) is None
    quiet[1000] += 15.0
    spikes = find_spikes("y", [quiet, loud], ALPHA)
    assert spikes is not None
    assert [list(np.flatnonzero(m)) for m in spikes.masks] == [[1000], []]


def test_what_happens_all_the_time_is_no_outlier():
    r, _ = spoilt(6, size=30.0, share=0.08)
    assert find_spikes("y", [r], ALPHA) is None
    assert find_spikes("y", [r], ALPHA, largest_share=0.1) is not None


def test_a_step_of_the_residual_is_no_outlier_whether_it_stays_or_decays():
    """A step shows all of its d on one side, the first sample of a lag half, a spike half on both.

    The sides differ by 1, 1/2 and 0 of d: of 20 and 25 here, with standard deviations sqrt(5/2)/20
    = 0.08 and 0.06 by the noise.
    """
    for seed in range(20):
        r = np.random.default_rng(seed).standard_normal(2000)
        stays, lags = r.copy(), r.copy()
        stays[1200:] += 40.0
        lags[1200:1300] += 100.0 * (1 - 0.5 ** np.arange(1, 101))
        for step in (stays, lags):
            found = find_spikes("y", [step], ALPHA)
            assert found is None or not found.masks[0][1195:1205].any()
        r[300] += 12.0
        found = find_spikes("y", [r], ALPHA)
        assert found is not None
        assert list(np.flatnonzero(found.masks[0])) == [300]


def test_records_too_short_to_judge_have_no_outliers():
    r = np.zeros(19)
    r[9] = 100.0
    assert find_spikes("y", [r], ALPHA) is None


def test_a_fast_response_to_steps_is_no_outlier_and_an_outlier_beside_it_is_one():
    """A peak of one sample after each step of a held input, and errors where nothing steps.

    With 60 steps among 6000 samples, chance puts all 30 errors away from steps (3 samples each).
    """
    rng = np.random.default_rng(7)
    u = np.repeat(rng.normal(size=60), 100)
    r = rng.standard_normal(6000)
    r[100::100] += 8.0 * np.diff(u[::100])
    assert find_spikes("y", [r], ALPHA) is not None
    assert find_spikes("y", [r], ALPHA, inputs=[u[:, None]]) is None
    at = 50 + 200 * np.arange(30)
    r[at] += 12.0
    found = find_spikes("y", [r], ALPHA, inputs=[u[:, None]])
    assert found is not None
    np.testing.assert_array_equal(np.flatnonzero(found.masks[0]), at)
    # Without steps the inputs say nothing.
    smooth = np.sin(0.01 * np.arange(6000))[:, None]
    errors, at = spoilt(3, size=12.0)
    kept = find_spikes("y", [errors], ALPHA, inputs=[smooth])
    assert kept is not None
    np.testing.assert_array_equal(np.flatnonzero(kept.masks[0]), at)


def test_a_first_sample_from_before_the_inputs_acted_stands_alone():
    """400 records of noise at 1 %: the Bonferroni bound keeps the rate below it."""
    noise = [np.random.default_rng(s).standard_normal(300) for s in range(400)]
    assert sum(starts_apart(r, 0.01) for r in noise) < 4
    at_rest, slow = noise[0].copy(), noise[0].copy()
    at_rest[0] -= 20.0
    slow += 20.0 * np.exp(-np.arange(300) / 5.0)
    assert starts_apart(at_rest, ALPHA)
    assert not starts_apart(slow, ALPHA)


def test_a_spike_is_confirmed_by_what_stands_out_of_its_neighbours():
    """Slow misfit of the other sign may all but cancel the error itself; an end has one side."""
    residual = np.array([3.0, -1.0, 0.05, -1.0, -1.0, np.nan, 2.0])
    mask = np.array([True, False, True, False, False, False, True])
    assert above_neighbours(residual, mask) == pytest.approx([4.0, 1.05, 2.0])


def test_samples_on_either_side_of_an_onset_are_beside_it():
    times = 100.0 + 2.0 * np.arange(6)
    assert list(times[at_onsets(times, [105.3, 110.0])]) == [104.0, 106.0, 108.0, 110.0]
    assert not at_onsets(times, []).any()


def test_what_a_jump_explains_makes_no_spikes_of_the_tail_of_noise():
    """Beside two samples of 6 sd the largest of 3000 of noise are a third; alone it is none."""
    r, at = np.random.default_rng(2).standard_normal(3000), np.array([1500, 1502])
    alone = np.delete(r, at)
    r[at] += [6.0, -6.0]
    found = find_spikes("y", [r], 0.01)
    assert found is not None
    assert found.count > 2
    assert found.level == 0.01
    assert is_tail(found, [alone])
    alone[700] += 9.0
    assert not is_tail(found, [alone])


def furnace(hold: str, *, element: bool = True) -> casid.Model:
    m = casid.Model("furnace")
    T = m.state("T", "K")
    P = m.input("P", "W", hold=hold, known=True)
    C = m.parameter("C", "J/K", start=900.0, lower=1.0)
    G = m.parameter("G", "W/K", start=4.0, lower=0.01)
    R = m.constant("R", 0.01, "K/W")
    m.balance(T, "heat", inertia=C, terms=[P, -G * T])
    m.output("T", T, "K")
    if element:
        m.output("element", T + R * P, "K")
    return m


def test_spikes_to_which_a_controller_replies_are_outliers():
    """Each spike of a sensor makes the controller step as it is read; what moves comes after it.

    T(k + 1) = P / 5 + (T - P / 5) exp(-5 / 1000 s): the input is held, the solution exact.
    """
    rng, N = np.random.default_rng(2), 600
    at = np.array([55, 130, 233, 260, 318, 402, 470, 541])
    goal, spikes = np.repeat(rng.uniform(50, 200, 6), 100), np.zeros(N)
    spikes[at] = 20.0 * rng.choice([-1.0, 1.0], len(at))
    T, P, y = 60.0, np.empty(N), np.empty(N)
    for k in range(N):
        y[k] = T + 0.1 * rng.standard_normal() + spikes[k]
        P[k] = 5 * goal[k] + 40.0 * (goal[k] - y[k])
        T = P[k] / 5 + (T - P[k] / 5) * np.exp(-5e-3)
    units = {"T": "K", "P": "W"}
    e = casid.Experiment(casid.Record({"T": y, "P": P}, units, Ts=1.0), {}, "loop")
    fit = fit_model(furnace("zoh", element=False), [e], casid.FitSettings(starts=1))
    (found,) = without_corrupted(fit, split_records([e], 0.0), ALPHA)[0].spikes
    np.testing.assert_array_equal(np.flatnonzero(found.masks[0]), at)


def test_an_output_shows_a_held_input_at_once_only_where_it_is_part_of_it():
    assert act_a_sample_later(furnace("zoh"), "T").tolist() == [True]
    assert act_a_sample_later(furnace("zoh"), "element").tolist() == [False]
    assert act_a_sample_later(furnace("foh"), "T").tolist() == [False]


@pytest.mark.parametrize(
    ("count", "said"),
    [(1, "1 clipped or outlying sample and"), (2, "2 clipped or outlying samples and")],
)
def test_progress_says_how_many_samples_are_left_out(count, said, monkeypatch):
    """One sample is no "1 samples"."""
    found, lines = SimpleNamespace(count=count), []
    monkeypatch.setattr(baseline, "without_corrupted", lambda *a, **k: (found, None))
    monkeypatch.setattr(baseline, "holding_out_measured", lambda *a: (None, ""))
    monkeypatch.setattr(baseline, "_refitted", lambda *a: None)
    problem = SimpleNamespace(model=SimpleNamespace(outputs={}))
    settings = DiagnosisSettings(progress=lines.append)
    baseline._Cleaning(problem, settings, None, None).leave_out_corrupted()
    assert lines == [f"leave out {said} fit again"]
