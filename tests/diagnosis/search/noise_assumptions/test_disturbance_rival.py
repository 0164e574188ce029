"""Effects beside a force that nobody records: waves on a hull, simulated without casid."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import casid
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import minus_log_likelihood
from casid.diagnosis.search.adoption.refinement import Adoption
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.search.comparison.simulation_errors import SimulationErrors
from casid.diagnosis.search.disturbance.disturbance_price import as_white
from casid.diagnosis.search.noise_assumptions import disturbance_rival
from casid.diagnosis.search.noise_assumptions.disturbance_rival import (
    minus_log_likelihood_beside,
    takes_place_of,
    without_replaceable,
)
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.verdict import judgement
from casid.diagnosis.verdict.tested_remainder import Remainder
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.balances.balance_effects import quadratic_damping
from casid.model.effects.parameter_effects import parameter_jump
from tests.diagnosis.verdict.test_unknown_cause import left

TS, N, SD = 0.1, 3000, 0.002
B, C, K = 0.05, 0.8, 0.25
WAVES, DECAY, HEIGHT = 1.1, 0.3, 0.02  # rad/s, 1/s and rad/s^2


def hull() -> casid.Problem:
    m = casid.Model("hull")
    fin = m.input("fin", "rad", hold="zoh", known=True)
    phi, w = m.state("phi", "rad"), m.state("w", "rad/s")
    b = m.parameter("B", "1/s", start=0.1, lower=0.0, upper=2.0)
    c = m.parameter("C", "1/s^2", start=1.0, lower=0.05, upper=10.0)
    k = m.parameter("K", "1/s^2", start=0.2, lower=0.0, upper=10.0)
    m.derivative(phi, w)
    m.balance(w, "moment", inertia=1, terms=[-b * w, -c * phi, k * fin], unit="rad/s^2")
    m.output("roll", phi, "rad")
    m.output("rate", w, "rad/s")
    return casid.Problem("hull", m)


def record(seed: int, drag: float = 0.0) -> casid.Record:
    """Rolling under random fins in waves of order two, held over each tenth of a sample."""
    rng, parts = np.random.default_rng(seed), 10
    step = TS / parts
    fin = np.repeat(rng.choice([-0.3, 0.0, 0.3], N // 25), 25)
    r = np.exp(-DECAY * step)
    a1, a2 = 2 * r * np.cos(WAVES * step), -r * r
    share = (1 + a2) * ((1 - a2) ** 2 - a1**2) / (1 - a2)
    e = HEIGHT * np.sqrt(share) * rng.standard_normal(parts * N + 2000)
    waves = lfilter([1.0], [1.0, -a1, -a2], e)[2000:]
    x, y = np.array([0.05, 0.0]), np.empty((N, 2))

    def rate(x, force):
        return np.array([x[1], -B * x[1] - C * x[0] - drag * abs(x[1]) * x[1] + force])

    for k in range(N):
        y[k] = x
        for i in range(parts):
            force = K * fin[k] + waves[parts * k + i]
            half = x + 0.5 * step * rate(x, force)
            x = x + step * rate(half, force)
    y += SD * rng.standard_normal(y.shape)
    units = {"fin": "rad", "roll": "rad", "rate": "rad/s"}
    return casid.Record({"fin": fin, "roll": y[:, 0], "rate": y[:, 1]}, units, Ts=TS)


@pytest.mark.slow
def test_a_sea_is_a_disturbance_with_its_place_size_and_peak_and_no_cause() -> None:
    found = casid.diagnose(hull(), record(1), advise=False)
    assert (found.verdict, found.causes) == ("adequate", ())
    (sea,) = found.disturbances
    assert sea.where == "moment"
    # Some 2 DECAY T / pi = 40 independent samples of a process: its deviation to 1/sqrt(2 40).
    assert sea.std == pytest.approx(HEIGHT, rel=3 * 0.11)
    # The peak of order two lies at sqrt(w^2 - DECAY^2) / 2 pi; it is DECAY / pi wide, and seen in
    # some 20 lines of the spectrum, to sqrt(2 / 20) of half that: three such deviations.
    half = DECAY / 2 / np.pi
    assert sea.peak == pytest.approx(
        np.sqrt(WAVES**2 - DECAY**2) / 2 / np.pi, abs=3 * half * np.sqrt(2 / 20)
    )


@pytest.mark.slow
def test_a_drag_is_named_in_a_sea() -> None:
    found = casid.diagnose(hull(), record(3, drag=1.5), advise=False)
    assert found.verdict == "deficient"
    named = {(c.kind, c.where) for c in found.causes[:1]}
    named |= {(a.kind, a.where) for c in found.causes[:1] for a in c.alternatives}
    assert ("quadratic_damping", "moment") in named
    assert [x.where for x in found.disturbances] == ["moment"]


@pytest.mark.slow
def test_a_drag_stays_named_in_a_sea_of_which_more_can_be_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The excess over a sea is known no better than the sea: to 0.11, of 40 independent samples."""
    something = Remainder(1e-3, 0.02, left().unexplained)
    monkeypatch.setattr(judgement, "tested_remainder", lambda *_: something)
    found = casid.diagnose(hull(), record(3, drag=1.5), advise=False)
    assert found.causes[0].kind == "quadratic_damping"
    errors = found.fitted["extended_rmse"]
    assert found.fitted["noise_floor"] == pytest.approx(errors, rel=3 * 0.11)


@pytest.mark.slow
def test_spikes_of_a_sensor_are_told_in_a_sea() -> None:
    """They are small beside the waves, and large beside the noise of the sensor that has them."""
    calm = record(1)
    at = np.arange(40, N, 100)
    rate = calm["rate"].copy()
    rate[at] += 8 * SD * np.where(np.arange(len(at)) % 3 == 0, -1.0, 1.0)
    channels = {name: calm[name] for name in ("fin", "roll")} | {"rate": rate}
    spiked = casid.Record(channels, calm.units, Ts=TS)
    found = casid.diagnose(hull(), spiked, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("outliers", "rate")
    size = next(p.value for p in cause.parameters if p.name == "size")
    assert size == pytest.approx(8 * SD, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("is_open", [True, False])
def test_a_later_cause_is_none_where_the_sea_that_the_first_leaves_explains_as_much(
    is_open: bool,
) -> None:
    """Drag is a law in any sea; a righting moment that changes half-way follows this one.

    Also where both together are taken to leave noise: a change in time is doubted all the same.
    """
    once = FitSettings(starts=1)
    split = split_records([casid.Experiment(record(3, drag=1.5), {}, "sea")], 0.3)
    model, settings = hull().model, DiagnosisSettings()
    weighing = Weighing(split.fitted)
    base = fit_model(model, split.fitted, once)
    start = weighing.weigh(model, base)
    assert start.noise_absorbs_misfit
    search = Search(weighing, {})
    drag = search.refitting.refit(start, quadratic_damping(model, "moment"), 1.0)
    assert drag is not None
    at = weighing.weigh(drag.model, drag.fit)
    jump = search.refitting.refit(at, parameter_jump(drag.model, "C", 100.0), 0.01)
    assert jump is not None
    fit = fit_model(jump.model, split.fitted, once, start=jump.fit.values, throw=False)
    causes = tuple(Adopted(c, 1e-9, ()) for c in (drag, jump))
    beside = replace(weighing.weigh(jump.model, fit), noise_absorbs_misfit=is_open)
    both = Adoption(causes, beside, fit)
    baseline: Any = SimpleNamespace(fit=base, split=split, start=start)
    again = replace(search, weighing=weighing.with_disturbances())
    kept = without_replaceable(again, both, baseline, search, settings)
    assert [a.candidate.effect.kind for a in kept.adopted] == ["quadratic_damping"]
    assert [c.effect.kind for c, _ in search.refused] == ["parameter_jump"]


@pytest.mark.slow
def test_what_is_found_beside_a_sea_is_judged_in_the_sea_that_it_leaves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The sea of the model as it is has to explain the drag as well, and is larger."""
    once, settings = FitSettings(starts=1), DiagnosisSettings()
    split = split_records([casid.Experiment(record(3, drag=1.5), {}, "sea")], 0.3)
    model, weighing = hull().model, Weighing(split.fitted).with_disturbances()
    search = Search(weighing, {})
    base = fit_model(model, split.fitted, once)
    bare = search.under_disturbance(base)
    drag = search.refitting.refit(bare, quadratic_damping(model, "moment"), 1.0)
    assert drag is not None
    fit = fit_model(drag.model, split.fitted, once, start=drag.fit.values, throw=False)
    in_its_sea = replace(bare, model=drag.model, fit=drag.fit, unbiased=None)
    found = Adoption((Adopted(drag, 1e-9, ()),), in_its_sea, fit)
    monkeypatch.setattr(disturbance_rival, "adopt_causes", lambda *_: found)
    baseline: Any = SimpleNamespace(fit=base, split=split, start=bare)
    other = disturbance_rival.searched_beside(search, bare, baseline, settings).found
    own = minus_log_likelihood(search.under_disturbance(fit))
    assert minus_log_likelihood(other.at) <= own < minus_log_likelihood(in_its_sea)


@pytest.mark.slow
def test_a_model_with_an_effect_is_no_less_likely_in_a_sea_than_without_it() -> None:
    """It has the other one in it, whatever disturbance its own residual suggests."""
    once, model = FitSettings(starts=1), hull().model
    experiments = [casid.Experiment(record(1), {}, "sea")]
    weighing = Weighing(experiments).with_disturbances()
    base = fit_model(model, experiments, once)
    bare = weighing.weigh(model, base, rounds=1)
    effect = quadratic_damping(model, "moment")
    extended, names = effect.extended(model)
    start = {**base.values, "d_2": 5.0, "C": 5.0}
    fit = fit_model(extended, experiments, once, start=start, throw=False)
    cause = Adopted(Candidate(effect, names, extended, fit, 0.0, 0.0, 0.0), 0.01, ())
    own = weighing.weigh(extended, fit)
    beside = minus_log_likelihood_beside(weighing, Adoption((cause,), bare, fit), own, bare)
    assert beside <= minus_log_likelihood(bare)


@pytest.mark.parametrize(("is_cut", "error"), [(True, 1.2), (False, 1.2), (False, 0.6)])
def test_causes_give_way_to_likelier_ones_beside_a_disturbance(
    monkeypatch: pytest.MonkeyPatch, is_cut: bool, error: float
) -> None:
    """Where the time of their search ended, or the others predict better what was held out.

    Both leave misfit: a held input was named, and the other search had the cubic spring as well.
    """
    errors = np.random.default_rng(2).standard_normal((2, 400, 1))
    before, after = (
        SimulationErrors(size * e, size * e, np.zeros((0, 1)))
        for size, e in zip((1.0, error), errors, strict=True)
    )
    monkeypatch.setattr(disturbance_rival, "is_more_than_noise", lambda *_: True)
    monkeypatch.setattr(disturbance_rival, "_errors", lambda *_: (before, after))
    found: Any = SimpleNamespace(adopted=("hold",), fit=object())
    other: Any = SimpleNamespace(at=None, fit=object())
    search: Any = SimpleNamespace(attempts=Attempts())
    split: Any = None
    if is_cut:
        search.attempts.not_done["round 2 of the search"] = None
    takes = takes_place_of(found, other, search, search, split)
    assert takes == (is_cut or error < 1.0)


def test_a_residual_as_white_noise_has_the_gaussian_likelihood() -> None:
    """-log L of n samples of white noise at its own variance is n (1 + log s^2) / 2."""
    experiments = [casid.Experiment(record(1), {}, "sea")]
    fit = fit_model(hull().model, experiments, FitSettings(starts=1))
    residual = fit.criterion.simulated(fit.x, 0).residual
    expected = 0.5 * N * np.sum(1 + np.log(np.mean(residual**2, axis=0)))
    assert as_white(fit) == pytest.approx(expected, rel=1e-12)
    assert minus_log_likelihood(
        Weighing(experiments).with_disturbances().weigh(hull().model, fit, rounds=1)
    ) < as_white(fit)
