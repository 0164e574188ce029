"""Intervals from simulated records: those of the standard error where the model is linear."""

from __future__ import annotations

import numpy as np
import pytest

from casid.estimation.intervals import bootstrap, choice
from casid.estimation.intervals.thresholds import BootstrapRuns
from casid.identification.identify import identify
from tests.estimation.intervals.test_profile import (
    gain_and_offset,
    lag_problem,
    linear_record,
    step_response,
)


@pytest.mark.slow
def test_of_a_linear_model_they_are_those_of_the_standard_error(monkeypatch):
    """An end of 2.5 % from n draws scatters by sqrt(0.025 0.975 / n) / phi(1.96) = 0.22 errors.

    The correction of the bias adds that of the median, sqrt(pi / 2n); four of these are allowed.
    """
    n = 150
    for module in (bootstrap, choice):
        monkeypatch.setattr(module, "BOOTSTRAP_RUNS", BootstrapRuns(runs=n))
    found = identify(gain_and_offset(), linear_record(colour=0.8), intervals="bootstrap")
    scatter = np.hypot(np.sqrt(0.025 * 0.975 / n) / 0.0584, 2 * np.sqrt(np.pi / 2 / n))
    for p in found.parameters:
        assert p.interval_kind == "bootstrap"
        low, high = p.interval
        assert abs(low - (p.value - 1.96 * p.std_error)) < 4 * scatter * p.std_error
        assert abs(high - (p.value + 1.96 * p.std_error)) < 4 * scatter * p.std_error
    assert f"{n} estimates from records simulated" in found.intervals["bootstrap"]


@pytest.mark.slow
def test_of_a_skewed_estimate_they_are_skewed_as_the_profile_is():
    record = step_response(4, sd=0.03)
    by_simulation = identify(lag_problem(), record, intervals="bootstrap").parameter("tau")
    by_profile = identify(lag_problem(), record, intervals="profile").parameter("tau")
    for a, b in zip(by_simulation.interval, by_profile.interval, strict=True):
        assert a == pytest.approx(b, abs=0.35 * abs(b - by_profile.value))
    low, high = by_simulation.interval
    assert high - by_simulation.value > by_simulation.value - low
