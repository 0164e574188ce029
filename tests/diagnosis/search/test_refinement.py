"""The set of causes: what explains too little is a remainder, and a better predictor is named."""

from __future__ import annotations

import functools
from dataclasses import replace

import pytest

import casid
from casid.diagnosis.evidence.prewhitening import Weighing
from casid.diagnosis.search.candidates import Adopted, Candidate, Rival
from casid.diagnosis.search.refinement import Adoption, Refinement, whole_fit
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.search.simulation_errors import simulation_errors
from casid.diagnosis.thresholds import JUDGING
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.balance_effects import cubic_stiffness, deadzone, quadratic_damping
from casid.model.effects.parameter_effects import parameter_drift
from problems import roll_decay

ONCE = casid.FitSettings(starts=1)


@functools.cache
def refinement(drag: float) -> Refinement:
    """One minute of decay at 10 Hz with hardening and drag, its last 30 % held out."""
    record = roll_decay.simulate(B_2=drag).decimate(5)
    split = split_records([casid.Experiment(record)], 0.3)
    linear = roll_decay.decay_model()
    weighing = Weighing(split.fitted)
    fit = fit_model(linear, split.fitted, ONCE)
    at = weighing.weigh(linear, fit)
    units = fit.criterion.weights
    return Refinement(
        Search(weighing, {}), split, ONCE, units, at, simulation_errors(fit, split, units)
    )


def adopted(of: Refinement, *refits: Candidate) -> Adoption:
    """Candidates, each found beside those before it."""
    last = refits[-1]
    fit = whole_fit(last.model, of.split, of.settings, of.units, last.fit.values)
    at = of.search.weighing.weigh(last.model, fit, rounds=1)
    return Adoption(tuple(Adopted(c, 1e-9, (), of.start) for c in refits), at, fit)


def beside(of: Refinement, first: Candidate, effect, step: float) -> Candidate:
    at = of.search.weighing.weigh(first.model, first.fit, rounds=1)
    found = of.search.refitting.refit(at, effect, step)
    assert found is not None
    return found


def hardening(of: Refinement) -> Candidate:
    found = of.search.refitting.refit(of.start, cubic_stiffness(of.start.model, "torque"), 4.0)
    assert found is not None
    return found


@pytest.mark.parametrize(("drag", "is_cause"), [(0.07, True), (0.002, False)])
def test_a_cause_that_explains_too_little_is_a_remainder_and_not_in_the_model(drag, is_cause):
    """Damping by drag, of the size of the example and a thirty-fifth of it."""
    of = refinement(drag)
    first = hardening(of)
    second = beside(of, first, quadratic_damping(first.model, "torque"), drag)
    found = of.main(adopted(of, first, second))
    kinds = [a.candidate.effect.kind for a in found.adopted]
    assert kinds == ["cubic_stiffness", *["quadratic_damping"] * is_cause]
    assert [a.candidate.effect.kind for a in found.remainders] == ["quadratic_damping"] * (
        not is_cause
    )
    assert all(0 < a.share < JUDGING.practical for a in found.remainders)
    assert ("d_2" in found.fit.criterion.model.parameters) is is_cause


def test_of_two_that_do_the_same_one_stays_though_each_is_small_beside_the_other():
    """A decay that hardens: play and a drift of the stiffness imitate it, and each other."""
    of = refinement(0.07)
    play = of.search.refitting.refit(of.start, deadzone(of.start.model, "torque", 0.05), 0.02)
    assert play is not None
    drag = beside(of, play, quadratic_damping(play.model, "torque"), 0.07)
    drift = beside(of, drag, parameter_drift(drag.model, "C_1", (0.0, 42.0)), -0.01)
    found = of.main(adopted(of, play, drag, drift))
    kinds = {a.candidate.effect.kind for a in found.adopted}
    assert "quadratic_damping" in kinds
    assert len(kinds & {"deadzone", "parameter_drift"}) == 1


def test_of_two_that_fit_alike_the_one_that_predicts_is_named():
    """Play was named, and hardening not rejected: beside the drag, hardening predicts the end."""
    of = refinement(0.07)
    of = replace(of, start=replace(of.start, noise_absorbs_misfit=True))
    play = next(
        c
        for e in [deadzone(of.start.model, "torque", 0.05)]
        if (c := of.search.refitting.refit(of.start, e, 0.02)) is not None
    )
    drag = beside(of, play, quadratic_damping(play.model, "torque"), 0.07)
    before = adopted(of, play, drag)
    tied = replace(before.adopted[0], rivals=(Rival(hardening(of), 0.4),))
    found = of.exchanged(replace(before, adopted=(tied, before.adopted[1])))
    first = found.adopted[0]
    assert first.candidate.effect.kind == "cubic_stiffness"
    assert [r.candidate.effect.kind for r in first.rivals] == ["deadzone"]
    old, new = (simulation_errors(f.fit, of.split, of.units) for f in (before, found))
    assert new.held_out_square < old.held_out_square
