"""A reaction that its product inhibits, beside what acts on the same balances."""

from __future__ import annotations

import functools

import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.rounds import Search
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.effect import Motion, Spread
from casid.model.effects.parameter_effects import scheduled_parameter
from casid.model.effects.state_schedules import inhibited_parameter
from tests.model.effects.balances.test_flow_laws import reactor, reactor_record

RATE, INHIBITED = 1.2e-3, 10.0  # 1/s, mmol/L


def inhibited(S: float, P: float) -> float:
    return RATE * S / (1 + P / INHIBITED)


@functools.cache
def weighed() -> tuple[Search, Weighted]:
    """The reactor fitted with its reaction in proportion to the substrate alone."""
    experiments = [casid.Experiment(reactor_record(inhibited), {}, "r")]
    weighing = Weighing(experiments)
    fit = fit_model(reactor(), experiments, FitSettings(starts=1, substeps=1))
    return Search(weighing, {}), weighing.weigh(reactor(), fit)


def refitted(step: float) -> Candidate | None:
    search, at = weighed()
    effect = inhibited_parameter(at.model, "k", "P", Motion(6.0, 2.0, 12.0, 5.5))
    return search.refitting.refit(at, effect, step)


@pytest.mark.parametrize("step", [-1.0, 0.0, 0.3])
def test_an_inhibition_is_found_from_wherever_its_score_would_begin(step: float):
    """Its size is no change of k in k's unit, within which a jump of k is sought."""
    found = refitted(step)
    assert found is not None
    # The standard error by which `wald` divides.
    size = found.fit.values["inverse_K_P"]
    assert size == pytest.approx(1 / INHIBITED, abs=3 * size / found.wald)
    assert found.wald > 30


def test_the_size_of_a_cause_does_not_depend_on_an_amount():
    """k + s (F - mean) in a reaction: s is no coefficient that the product could inhibit."""
    search, at = weighed()
    effect = scheduled_parameter(at.model, "k", "F", "m^3/s", Spread(3e-6, 1e-6, 5e-6))
    first = search.refitting.refit(at, effect, 0.0)
    assert first is not None
    beside = search.weighing.weigh(first.model, first.fit, rounds=1)
    found = {s.effect.key for s in search.table(beside, [first]).scores}
    assert ("scheduled_parameter", "k~P") in found
    assert not [where for _, where in found if where.startswith("slope_k_F~")]
