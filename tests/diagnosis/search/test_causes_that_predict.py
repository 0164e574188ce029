"""Where causes predict what was held out and leave what is no disturbance, none is sought.

What a search beside one has found before is compared all the same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.baseline import fit_baseline
from casid.diagnosis.search.noise_assumptions import disturbance_rival
from casid.diagnosis.search.noise_assumptions.disturbance_rival import (
    searched_beside,
    weighed_against_disturbances,
)
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.search.selection import adopt_causes
from casid.diagnosis.settings import DiagnosisSettings
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings
from casid.model.effects.effect import KINDS

TS, N = 0.02, 900


def mass() -> casid.Problem:
    m = casid.Model("mass")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", known=True)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.01)
    k = m.parameter("k", "N/m", start=50.0, lower=1.0)
    M = m.parameter("M", "kg", value=1.5)
    m.derivative(x, v)
    m.balance(v, "forces", inertia=M, terms=[F, -d * v, -k * x])
    m.output("position", x, "m")
    return casid.Problem("mass", m)


def record(friction: float = 0.4, drag: float = 0.0) -> casid.Record:
    """A spring that stiffens, and dry friction or a drag."""
    rng, parts = np.random.default_rng(5), 10
    h = TS / parts
    F = np.repeat(20.0 * rng.standard_normal(N // 15), 15)
    x, v, path = 0.0, 0.0, np.empty(N)
    for i in range(N * parts):
        if i % parts == 0:
            path[i // parts] = x
        force = F[i // parts] - 1.2 * v - 40.0 * x - 400.0 * x**3 - friction * np.tanh(v / 1e-3)
        force -= drag * abs(v) * v
        v += h * force / 1.5
        x += h * v
    path += 1e-4 * rng.standard_normal(N)
    return casid.Record({"F": F, "position": path}, {"F": "N", "position": "m"}, Ts=TS)


@pytest.mark.slow
@pytest.mark.parametrize("predicts", [True, False])
def test_nothing_is_sought_beside_a_disturbance_where_causes_predict(monkeypatch, predicts):
    """Friction is kept out of the search: it shows in what the spring leaves."""
    said: list[str] = []
    problem = mass()
    split = split_records([casid.Experiment(record(), {}, "r")], 0.3)
    settings = DiagnosisSettings(fit=FitSettings(starts=1), progress=said.append)
    baseline = fit_baseline(problem, split, settings)
    without = set(KINDS) - {"cubic_stiffness"}
    search = Search(baseline.weighing, {}, max_causes=1, without=without)
    found = adopt_causes(search, baseline.start, baseline.fit, split, settings.refit)
    assert [a.candidate.effect.kind for a in found.adopted] == ["cubic_stiffness"]
    if not predicts:
        monkeypatch.setattr(disturbance_rival, "is_all_but_predicted", lambda *_: False)
    *_, after = weighed_against_disturbances(search, found, baseline, settings)
    assert [a.candidate.effect.kind for a in after.adopted] == ["cubic_stiffness"]
    assert any("treat the remainder as a disturbance" in s for s in said) != predicts


@pytest.mark.slow
def test_causes_found_beside_a_disturbance_before_are_named_if_they_predict_better():
    """The search under the sensors' noise is held to one cause, a spring. There is a drag, too."""
    split = split_records([casid.Experiment(record(0.0, 2.0), {}, "r")], 0.3)
    settings = DiagnosisSettings(fit=FitSettings(starts=1))
    baseline = fit_baseline(mass(), split, settings)
    without = set(KINDS) - {"cubic_stiffness", "quadratic_damping"}
    search = Search(baseline.weighing, {}, max_causes=1, without=without)
    found = adopt_causes(search, baseline.start, baseline.fit, split, settings.refit)
    again = replace(search, weighing=baseline.weighing.with_disturbances(), max_causes=2)
    beside = searched_beside(again, again.under_disturbance(baseline.fit), baseline, settings)
    *_, after = weighed_against_disturbances(search, found, baseline, settings, beside)
    assert kinds(found) == ["cubic_stiffness"]
    assert kinds(after) == ["cubic_stiffness", "quadratic_damping"]


def kinds(found):
    return sorted(a.candidate.effect.kind for a in found.adopted)
