"""A disturbance is fitted beside causes only where it may explain what they leave."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import minus_log_likelihood
from casid.diagnosis.search.disturbance.disturbance_price import (
    explaining_disturbance,
    is_no_disturbance,
    pays,
    pays_at_best,
)
from casid.diagnosis.search.rounds import Search
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from tests.diagnosis.search.disturbance.test_evidence_beside import tank


def record(*, heat: float = 0.0, radiation: float = 0.0) -> casid.Record:
    """A heater switched for 90 samples at a time, heat that wanders, and loss that is no line.

    By Euler's rule in steps of a twentieth of a sample.
    """
    rng = np.random.default_rng(0)
    N, Ts, loss, capacity, slow = 1500, 10.0, 20.0, 5e4, 0.97
    power = np.repeat(2000.0 * rng.integers(0, 2, N // 30 + 1), 30)[:N]
    wander, T, course = 0.0, 40.0, []
    for k in range(N):
        course.append(T)
        wander = slow * wander + heat * np.sqrt(1 - slow**2) * rng.normal()
        for _ in range(20):
            lost = loss * T + radiation * T * abs(T)
            T += Ts / 20 * (power[k] + wander - lost) / capacity
    shown = np.array(course) + 0.05 * rng.normal(size=N)
    return casid.Record({"u": power, "shown": shown}, {"u": "W", "shown": "K"}, Ts=Ts)


def searched(data: casid.Record) -> tuple[Search, Fit]:
    """A search, and the fit of the model as it is."""
    experiments = [casid.Experiment(data, {}, "tank")]
    fit = fit_model(tank().model, experiments, FitSettings(starts=1))
    return Search(Weighing(experiments), {}), fit


def test_heat_that_wanders_may_explain_what_a_model_leaves() -> None:
    search, fit = searched(record(heat=100.0))
    start = search.weighing.weigh(fit.criterion.model, fit)
    assert start.noise_absorbs_misfit
    assert not is_no_disturbance(search, fit)
    assert explaining_disturbance(search, start, fit) is not None


def test_no_disturbance_is_fitted_in_the_place_of_a_law(monkeypatch: Any) -> None:
    """What goes with the square of the temperature is no force without cause, of any spectrum."""
    search, fit = searched(record(radiation=1.0))
    start = search.weighing.weigh(fit.criterion.model, fit)
    assert start.noise_absorbs_misfit
    assert is_no_disturbance(search, fit)
    monkeypatch.setattr(Search, "under_disturbance", lambda *_: pytest.fail("it was fitted"))
    assert explaining_disturbance(search, start, fit) is None


def test_a_candidate_has_no_evidence_from_a_likelier_disturbance_that_is_there_without_it() -> None:
    """The model as it is ended at a lower maximum of its likelihood, with twice the loss."""
    search, fit = searched(record(heat=100.0))
    start = search.weighing.weigh(fit.criterion.model, fit)
    bias = next(s for s in search.table(start, []).tested if s.effect.kind == "sensor_bias")
    (candidate,) = search.refits_of(start, [bias])
    left, best = search.under_disturbance(candidate.fit), search.under_disturbance(fit)
    assert best.unbiased is not None
    x = best.unbiased.x.copy()
    x[best.criterion.names.index("a")] *= 2.0
    at = replace(best.fit.solution, x=x, value=best.criterion.evaluate(x).value)
    lower = replace(best, fit=replace(best.fit, solution=at), unbiased=None)
    search.memory.disturbed[fit] = lower
    assert pays(lower, left, [candidate], tested=50)
    assert not pays_at_best(search, fit, candidate, tested=50)
    found = minus_log_likelihood(search.under_disturbance(fit))
    assert found == pytest.approx(minus_log_likelihood(best), abs=0.1)
