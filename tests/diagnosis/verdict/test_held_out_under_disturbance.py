"""Causes under a disturbance that are valid in the fitted part alone: held-out errors show it."""

from __future__ import annotations

import weakref
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.rounds import Memory, Search
from casid.diagnosis.verdict import gain
from casid.diagnosis.verdict.judgement import predicts_held_out
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model

N, TS, GAIN, RATE = 1200, 0.1, 2.0, 0.5


def model() -> casid.Model:
    m = casid.Model("store")
    x, u = m.state("x", "1"), m.input("u", "1", hold="zoh", known=True)
    a, b = (m.parameter(n, "1/s", start=1.0, lower=0.0, upper=10.0) for n in ("a", "b"))
    m.balance(x, "content", inertia=1, terms=[b * u, -a * x], unit="1/s")
    m.output("y", x, "1")
    return m


def record(seed: int, changed: float) -> casid.Record:
    """x' = b u - a x + d, by its exact solution; after 70 % `changed` times as much of b."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, N // 20), 20)
    slow = 0.05 * lfilter([1.0], [1.0, -0.9], rng.standard_normal(N))
    decay = np.exp(-RATE * TS)
    gain = GAIN * np.where(np.arange(N) < 0.7 * N, 1.0, changed)
    x = lfilter([0.0, (1 - decay) / RATE], [1.0, -decay], gain * u + slow)
    y = x + 0.02 * rng.standard_normal(N)
    return casid.Record({"u": u, "y": y}, {"u": "1", "y": "1"}, Ts=TS)


@pytest.mark.parametrize(("changed", "is_predicted"), [(1.0, True), (0.5, False)])
def test_a_law_that_ends_with_the_fitted_part_is_no_disturbance(
    changed: float, is_predicted: bool, monkeypatch: pytest.MonkeyPatch
):
    """What was held out is compared once, whoever asks for it."""
    compared: list[object] = []
    compare = gain.simulation_errors

    def counted(*given: Any) -> Any:
        compared.append(given)
        return compare(*given)

    monkeypatch.setattr(gain, "simulation_errors", counted)
    split = split_records([casid.Experiment(record(2, changed), {}, "r")], 0.3)
    weighing = Weighing(split.fitted)
    fit = fit_model(model(), split.fitted, FitSettings(starts=1, substeps=1))
    at = weighing.with_disturbances().weigh(model(), fit, rounds=1)
    assert list(at.noise.spectra) == ["content"]
    search = Search(weighing, {})
    baseline = SimpleNamespace(split=split)
    found: Any = SimpleNamespace(adopted=(object(),), at=at, baseline=baseline, search=search)
    assert predicts_held_out(found, None) is is_predicted
    assert predicts_held_out(found, None) is is_predicted
    assert len(compared) == 1
    # Without causes there is a verdict of its own for it.
    found.adopted = ()
    assert predicts_held_out(found, None)


class _Model:
    """What stands for a model here: it may be referred to weakly."""


def test_innovations_are_compared_once_a_model_and_no_longer_kept_than_its_search(monkeypatch):
    compared = []
    monkeypatch.setattr(gain, "_unlike_innovations", lambda at, split: compared.append(at) or "far")
    at, search = _Model(), SimpleNamespace(memory=Memory())
    found = SimpleNamespace(search=search, baseline=SimpleNamespace(split=()))
    assert [gain.unlike_under_disturbance(found, at) for _ in range(3)] == ["far"] * 3
    assert compared == [at]
    kept = weakref.ref(at)
    del at, found, search
    compared.clear()
    assert kept() is None
