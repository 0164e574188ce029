"""A diagnosis of records from which samples are missing keeps its false-alarm rate and its causes.

The truth is the mass of `tests.support.hidden_forces`, its force measured with noise.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

import casid
from casid.diagnosis.evidence.recording_faults.corrupted_samples import without_corrupted
from casid.diagnosis.evidence.residual.residual_tests import NOISE, residual_tests
from casid.diagnosis.evidence.scores.score_tests import score_test
from casid.estimation.holdout import split_records
from casid.model.effects.balances.balance_effects import cubic_stiffness, quadratic_damping
from casid.model.effects.channels.channel_effects import sensor_lag
from casid.model.effects.channels.delays import time_delay
from casid.model.effects.effect import Effect
from tests.support.hidden_forces import FORCES, model, record, weighted

ALPHA = 0.05


def with_gaps(
    kind: str, seed: int, gaps: str = "a fifth", seconds: float = 40.0
) -> casid.Experiment:
    e = record(FORCES[kind], seed, seconds=seconds)
    rng = np.random.default_rng(1000 + seed)
    mask = rng.random(e.record.N) < 0.2
    if gaps == "two of three":
        mask = np.arange(e.record.N) % 3 != 0
    return casid.Experiment(e.record.mark_missing("x", mask), {}, e.name)


def damping_and_stiffness(m: casid.Model) -> list[Effect]:
    stiffness = cubic_stiffness(m, "force")
    assert stiffness is not None
    return [stiffness, quadratic_damping(m, "force")]


@pytest.mark.slow
@pytest.mark.parametrize("gaps", ["a fifth", "two of three"])
def test_records_of_the_model_itself_raise_no_more_alarms_than_stated(gaps: str) -> None:
    """Scores family-wise and residual tests at 5 %: within the 99.5 % quantile of the binomial."""
    runs, scores, residuals = 6, 0, 0
    m = model()
    effects = [
        *damping_and_stiffness(m),
        time_delay(m, "x", 0.1),
        sensor_lag(m, "x", 0.1),
    ]
    for seed in range(runs):
        made = [with_gaps("none", seed, gaps)]
        at = weighted(made, m)
        smallest = score_test(at.unbiased or at.fit, effects, input_sd=at.input_sd).smallest
        scores += smallest is not None and smallest.adjusted < ALPHA
        residuals += residual_tests(at, made, alpha=ALPHA, seed=seed).verdict != NOISE
    most = binom.ppf(0.995, runs, ALPHA)
    assert scores <= most
    assert residuals <= most


@pytest.mark.slow
def test_a_force_that_the_model_lacks_is_found_all_the_same() -> None:
    """10 N/m^3 of a cubic spring, with a fifth of the positions missing."""
    problem = casid.Problem("mass", model(), starts=1)
    found = casid.diagnose(problem, with_gaps("cubic spring", 3, seconds=24.0), advise=False)
    assert [c.kind for c in found.causes] == ["cubic_stiffness"]
    size = found.causes[0].parameters[0]
    assert size.std_error is not None
    assert abs(size.value - 10.0) < 3.5 * size.std_error


def test_gaps_are_no_spikes_and_spikes_between_them_are_found_at_their_place() -> None:
    """Neighbours of a sample are those that there are."""
    m = model()
    e = with_gaps("none", 5, "two of three")
    fit = weighted([e], m).fit
    found, _ = without_corrupted(fit, split_records([e], 0.0), ALPHA)
    assert found.count == 0
    x = np.array(e.record["x"])
    x[[300, 999, 1500]] += 0.05  # fifty times the noise
    spiked = e.record.with_channel("x", x, "m").mark_missing("x", e.record.is_missing("x"))
    found, split = without_corrupted(
        fit, split_records([casid.Experiment(spiked, {}, e.name)], 0.0), ALPHA
    )
    new = split.fitted[0].record.is_missing("x") & ~e.record.is_missing("x")
    assert np.flatnonzero(new).tolist() == [300, 999, 1500]
