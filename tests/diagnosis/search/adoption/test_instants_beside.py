"""A change in a random disturbance is placed under what it leaves of that, not by least squares."""

from __future__ import annotations

import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.adoption.instants_beside import with_last_change_placed
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.instants.jump_times import placed
from casid.diagnosis.search.rounds import Search
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.parameter_effects import parameter_jump
from tests.support.heated_vessel import SETS_IN, TS, changed_vessel, vessel

ONCE = FitSettings(starts=1)


def placed_by_least_squares(seed: int) -> tuple[Refinement, Adoption]:
    """A loss of heat that nearly doubles, adopted where the simulation errs least."""
    record, model = changed_vessel(seed, share=0.8, flow=12.0), vessel().model
    split = split_records([casid.Experiment(record, {}, "run")], 0.0)
    base, weighing = fit_model(model, split.fitted, ONCE), Weighing(split.fitted)
    search, at = Search(weighing, {}), weighing.weigh(model, base)
    rough = search.refitting.refit(at, parameter_jump(model, "k", SETS_IN - 30 * TS), 1.0)
    assert rough is not None
    (jump,) = placed(search.refitting, at, [rough], [], lambda _: None)
    refine = Refinement(search, split, ONCE, base.criterion.weights, at, base)
    (cause,), fit = refine.with_causes([jump], jump.fit)
    return refine, refine.reweighed(Adoption((), at, fit), [Adopted(cause, 0.0, (), at)], fit)


def instant(found: Adoption) -> float:
    when = found.adopted[-1].candidate.effect.variant
    assert isinstance(when, float)
    return when


@pytest.mark.parametrize("seed", [1, 3, 5])
def test_a_change_in_a_slow_disturbance_is_placed_to_the_sample(seed: int) -> None:
    refine, found = placed_by_least_squares(seed)
    assert abs(instant(found) - SETS_IN) > 3 * TS
    assert abs(instant(with_last_change_placed(refine, found)) - SETS_IN) < TS
