"""The set of causes: what explains too little is a remainder, and a better predictor is named."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement, whole_fit
from casid.diagnosis.search.candidates import Adopted, Candidate, Rival
from casid.diagnosis.search.comparison.simulation_errors import simulation_errors
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import JUDGING
from casid.diagnosis.verdict.reported_causes import remainders_of
from casid.errors import SolveError
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    cubic_stiffness,
    deadzone,
    extra_input,
    offset,
    quadratic_damping,
)
from casid.model.effects.parameter_effects import parameter_drift
from problems import roll_decay
from tests.support.moved_fits import with_value

ONCE = casid.FitSettings(starts=1)
MODULE = "casid.diagnosis.search.adoption.refinement"


@functools.cache
def refinement(drag: float, noise: float = 2e-4) -> Refinement:
    """One minute of decay at 10 Hz with hardening and drag, its last 30 % held out."""
    record = roll_decay.simulate(B_2=drag, noise=noise).decimate(5)
    split = split_records([casid.Experiment(record)], 0.3)
    linear = roll_decay.decay_model()
    weighing = Weighing(split.fitted)
    fit = fit_model(linear, split.fitted, ONCE)
    at = weighing.weigh(linear, fit)
    units = fit.criterion.weights
    return Refinement(Search(weighing, {}), split, ONCE, units, at, fit)


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


@pytest.mark.parametrize(("noise", "is_tried"), [(0.0, True), (0.02, False)])
def test_a_channel_takes_no_cause_s_place_by_smaller_errors_beside_a_noisy_input(noise, is_tried):
    """One that predicts the input (its reference) errs less by that alone."""
    model, unused = roll_decay.decay_model(), None
    drag, wind = (
        Candidate(effect, (), model, unused, 100.0, 0.0, 9.0)
        for effect in (
            quadratic_damping(model, "torque"),
            extra_input(model, "torque", "wind", "m/s"),
        )
    )
    of = SimpleNamespace(start=SimpleNamespace(input_sd={"accel": noise}))
    found = list(Refinement._rivals(of, [Adopted(drag, 1e-9, (Rival(wind, 1.0),))], 0))
    assert found == ([wind] if is_tried else [])


@pytest.mark.parametrize(("tested", "is_cause"), [(1, True), (60, False)])
def test_what_was_chosen_among_many_stays_as_significant_as_it_had_to_be(
    monkeypatch: pytest.MonkeyPatch, tested: int, is_cause: bool
) -> None:
    """Three standard errors have a p of 0.0027, of one in sixty 0.16 (Bonferroni)."""
    of = refinement(0.07)
    first = hardening(of)
    second = beside(of, first, quadratic_damping(first.model, "torque"), 0.07)
    sizes = {"k_3": 3.0, "d_2": 30.0}
    monkeypatch.setattr(f"{MODULE}.wald", lambda fit, name, null: sizes[name])
    monkeypatch.setattr(of.search, "first_table", SimpleNamespace(tested=[None] * tested))
    monkeypatch.setattr(Refinement, "_loses_too_much", lambda *_: False)
    kept = of.without_insignificant(adopted(of, first, second)).adopted
    assert [a.candidate.effect.kind for a in kept] == [
        *["cubic_stiffness"] * is_cause,
        "quadratic_damping",
    ]


@pytest.mark.parametrize(("drag", "is_cause"), [(0.07, True), (0.002, False)])
def test_a_cause_that_explains_too_little_is_a_remainder_and_not_in_the_model(drag, is_cause):
    """Damping by drag, of the size of the example and a thirty-fifth of it."""
    of = refinement(drag)
    first = hardening(of)
    second = beside(of, first, quadratic_damping(first.model, "torque"), drag)
    found = of.without_small(adopted(of, first, second))
    kinds = [a.candidate.effect.kind for a in found.adopted]
    assert kinds == ["cubic_stiffness", *["quadratic_damping"] * is_cause]
    assert [a.candidate.effect.kind for a in found.remainders] == ["quadratic_damping"] * (
        not is_cause
    )
    assert all(0 < a.share < JUDGING.practical for a in found.remainders)
    assert ("d_2" in found.fit.criterion.model.parameters) is is_cause


@pytest.mark.parametrize(("noise", "is_cause"), [(1e-5, True), (2e-4, False)])
def test_a_small_share_is_a_cause_where_its_output_would_err_by_far_more_than_noise(
    noise: float, is_cause: bool
) -> None:
    """Drag of a thirty-fifth beside hardening: the same force on two noises."""
    of = refinement(0.002, noise)
    first = hardening(of)
    second = beside(of, first, quadratic_damping(first.model, "torque"), 0.002)
    before = adopted(of, first, second)
    assert before.fit is not None
    bare = whole_fit(first.model, of.split, of.settings, of.units, first.fit.values)
    ratio = (bare.solution.value / before.fit.solution.value) ** 0.5
    assert (ratio > JUDGING.unlike) is is_cause
    found = of.without_small(before)
    assert ("d_2" in {n for a in found.adopted for n in a.candidate.names}) is is_cause


def test_a_remainder_that_nobody_would_see_is_listed_only_where_the_model_has_it():
    of = refinement(0.002)
    first = hardening(of)
    second = beside(of, first, quadratic_damping(first.model, "torque"), 0.002)
    found = of.without_small(adopted(of, first, second))
    (small,) = found.remainders
    tiny = replace(small, share=0.5 * JUDGING.visible)
    lean, full = (SimpleNamespace(best_fit=fit) for fit in (found.fit, second.fit))
    for findings in (lean, full):
        findings.remainders = (small,)
        (listed,) = remainders_of(findings)
        assert listed.share == small.share > JUDGING.visible
        findings.remainders = (tiny,)
    assert remainders_of(lean) == ()
    assert [c.kind for c in remainders_of(full)] == ["quadratic_damping"]
    # Its size is the one that it has beside the causes found after it.
    values = {**second.fit.values, "d_2": 0.004}
    full.best_fit = SimpleNamespace(criterion=second.fit.criterion, values=values)
    assert [p.value for c in remainders_of(full) for p in c.parameters] == [0.004]


@pytest.mark.slow
def test_of_two_that_do_the_same_one_stays_though_each_is_small_beside_the_other():
    """A decay that hardens: play and a drift of the stiffness imitate it, and each other."""
    of = refinement(0.07)
    play = of.search.refitting.refit(of.start, deadzone(of.start.model, "torque", 0.05), 0.02)
    assert play is not None
    drag = beside(of, play, quadratic_damping(play.model, "torque"), 0.07)
    drift = beside(of, drag, parameter_drift(drag.model, "C_1", (0.0, 42.0)), -0.01)
    found = of.without_small(adopted(of, play, drag, drift))
    kinds = {a.candidate.effect.kind for a in found.adopted}
    assert "quadratic_damping" in kinds
    assert len(kinds & {"deadzone", "parameter_drift"}) == 1


@pytest.mark.slow
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
    found = of.with_better_rivals(replace(before, adopted=(tied, before.adopted[1])))
    first = found.adopted[0]
    assert first.candidate.effect.kind == "cubic_stiffness"
    assert [r.candidate.effect.kind for r in first.rivals] == ["deadzone"]
    old, new = (simulation_errors(f.fit, of.split, of.units) for f in (before, found))
    assert new.held_out_square < old.held_out_square


def slide() -> tuple[casid.Model, casid.Record]:
    """A carriage with viscous and dry friction and a constant force, by steps of the midpoint."""
    Ts, M, F_v, F_c, F_0, h = 0.05, 95.0, 100.0, 20.0, 3.0, 0.001  # s, kg, N s/m, N, N, s
    t = Ts * np.arange(1600)
    force = 60.0 * np.sin(1.9 * t) + 45.0 * np.sin(4.3 * t + 1.0) + 30.0 * np.sin(9.7 * t + 2.0)

    def acceleration(v: float, F: float) -> float:
        return float(F - F_v * v - F_c * np.tanh(v / 0.01) + F_0) / M

    q, v, path = 0.0, 0.0, np.empty(t.size)
    for k, F in enumerate(force.tolist()):
        path[k] = q
        for _ in range(round(Ts / h)):
            middle = v + 0.5 * h * acceleration(v, F)
            q, v = q + h * middle, v + h * acceleration(middle, F)
    m = casid.Model("slide")
    position, rate = m.state("q", "m"), m.state("v", "m/s")
    u = m.input("force", "N", hold="zoh", known=True)
    mass = m.parameter("M", "kg", start=60.0, lower=1.0)
    viscous = m.parameter("F_v", "N s/m", start=100.0, lower=0.0)
    m.derivative(position, rate)
    m.balance(rate, "force", inertia=mass, terms=[u, -viscous * rate])
    m.output("position", position, "m")
    path += 1e-4 * np.random.default_rng(4).standard_normal(t.size)
    return m, casid.Record({"force": force, "position": path}, {"force": "N", "position": "m"}, Ts)


@pytest.mark.slow
@pytest.mark.parametrize("carried", [0.5, 2.0])
def test_a_small_effect_is_a_cause_where_a_parameter_is_another_one_without_it(
    carried: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A constant force carries the slide away; viscous friction stands in for dry friction.

    Without dry friction, a quarter of the misfit, F_v is 2.1 times too large: by more than half of
    its value, and less than twice.
    """
    limits = replace(JUDGING, practical=0.4, carried=carried, unlike=np.inf)
    monkeypatch.setattr("casid.diagnosis.search.adoption.refinement.JUDGING", limits)
    model, record = slide()
    split = split_records([casid.Experiment(record)], 0.3)
    weighing = Weighing(split.fitted)
    fit = fit_model(model, split.fitted, ONCE)
    at, units = weighing.weigh(model, fit), fit.criterion.weights
    of = Refinement(Search(weighing, {}), split, ONCE, units, at, fit)
    constant = of.search.refitting.refit(at, offset(model, "force"), 1.0)
    assert constant is not None
    dry = beside(of, constant, coulomb_friction(constant.model, "force", 0.01), 10.0)
    both = adopted(of, constant, dry)
    assert both.fit is not None
    assert both.fit.values["F_v"] == pytest.approx(100.0, rel=0.01)
    assert 1.5 * 100.0 < constant.fit.values["F_v"] < 3.0 * 100.0
    found = of.without_small(both)
    causes = ["offset", "coulomb_friction"] if carried < 1.0 else ["offset"]
    assert [a.candidate.effect.kind for a in found.adopted] == causes
    assert len(found.remainders) == 2 - len(causes)


def test_a_leaner_model_whose_fit_went_astray_is_not_taken():
    """Without the hardening nearly everything is lost; without a drag too small to matter nothing.

    Which of the two a step of the refinement takes out, the error alone tells.
    """
    of = refinement(0.002)
    first = hardening(of)
    second = beside(of, first, quadratic_damping(first.model, "torque"), 0.002)
    found = adopted(of, first, second)
    assert found.fit is not None
    assert not of._loses_too_much(found.fit, first.fit)
    assert of._loses_too_much(found.fit, of.start.fit)
    assert of._rebuilt_unless_worse(found, found.adopted[1:], of.start.fit) is found


def test_a_leaner_model_that_predicts_worse_than_the_model_as_it_is_is_not_taken(monkeypatch):
    """Of two that only together predict what was held out neither is superfluous."""
    of = refinement(0.07)
    first = hardening(of)
    found = adopted(of, first, beside(of, first, quadratic_damping(first.model, "torque"), 0.05))
    one = adopted(of, first).fit
    sizes = {id(of.base): 1.0, id(found.fit): 0.5, id(one): 2.0}

    def predicting(fit, split, units):
        errors = simulation_errors(found.fit, split, units)
        return replace(errors, continued=sizes[id(fit)] * np.ones_like(errors.continued))

    monkeypatch.setattr(f"{MODULE}.simulation_errors", predicting)
    of = replace(of)  # its errors of the model as it is anew
    assert of._loses_too_much(found.fit, one)
    sizes[id(one)] = 0.9
    assert not of._loses_too_much(found.fit, one)


def test_an_effect_that_an_output_shows_is_a_cause_beside_a_far_larger_one_of_another():
    """Two lags that share nothing: a constant in one errs a hundred times as far as in the other.

    With levels of 5 and 0.05 K on noise of 0.01 K the second explains 1e-4 of all squares, and
    without it its output errs by 5 times the noise.
    """
    rng = np.random.default_rng(1)
    m = casid.Model("two cups that cool")
    names = ("hot", "cool")
    for name in names:
        T = m.state(name, "K")
        k = m.parameter(f"k_{name}", "1/s", start=0.05, lower=0.0)
        m.balance(T, f"heat_{name}", inertia=1, terms=[-k * T], unit="K/s")
        m.output(f"T_{name}", T, "K")
    t = 0.5 * np.arange(300)
    levels = {"hot": 5.0, "cool": 0.05}
    signals = {
        f"T_{n}": levels[n] + 20 * np.exp(-0.05 * t) + 0.01 * rng.normal(size=t.size) for n in names
    }
    record = casid.Record(signals, dict.fromkeys(signals, "K"), 0.5)
    split = split_records([casid.Experiment(record)], 0.3)
    weighing = Weighing(split.fitted)
    fit = fit_model(m, split.fitted, ONCE)
    at = weighing.weigh(m, fit)
    of = Refinement(Search(weighing, {}), split, ONCE, fit.criterion.weights, at, fit)
    first = of.search.refitting.refit(at, offset(m, "heat_hot"), 0.25)
    assert first is not None
    second = beside(of, first, offset(first.model, "heat_cool"), 0.0025)
    found = adopted(of, first, second)
    units = np.array([100.0, 100.0])  # one over the noise
    of = replace(of, units=units)
    found = replace(found, fit=whole_fit(second.model, split, ONCE, units, found.fit.values))
    main = of.without_small(found)
    assert {a.candidate.effect.where for a in main.adopted} == {"heat_hot", "heat_cool"}
    assert not main.remainders


def test_a_fit_without_a_cause_begins_without_the_others_where_these_diverge_alone() -> None:
    """A restoring moment that falls so fast with the heel that the ship turns over."""
    of = refinement(0.07)
    first = hardening(of)
    second = beside(of, first, quadratic_damping(first.model, "torque"), 0.07)
    found = adopted(of, first, second)
    assert found.fit is not None
    capsizing = with_value(found.fit, "k_3", -400.0)
    with pytest.raises(SolveError, match="diverges"):
        whole_fit(first.model, of.split, of.settings, of.units, capsizing.values)
    near, far = (of.fit_without(fit, second, found.adopted) for fit in (found.fit, capsizing))
    assert far.solution.value == pytest.approx(near.solution.value, rel=1e-3)


def test_a_model_is_rebuilt_from_its_fit_and_not_from_where_its_causes_were_found() -> None:
    """What was found was a moment that falls with the heel and turns the ship over."""
    of = refinement(0.07)
    first = hardening(of)
    second = beside(of, first, quadratic_damping(first.model, "torque"), 0.07)
    found = adopted(of, first, second)
    assert found.fit is not None
    without = of.fit_without(found.fit, second, found.adopted)
    far = replace(first, fit=with_value(first.fit, "k_3", -400.0))
    kept = [replace(found.adopted[0], candidate=far)]
    lean = of.rebuilt(replace(found, adopted=(*kept, found.adopted[1])), kept, without)
    assert lean.fit is not None
    assert lean.fit.solution.value == pytest.approx(without.solution.value, rel=1e-3)
