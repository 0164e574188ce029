"""A leak is named as one: no store that follows next to never, and no square that fits nearly."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.adoption.refinement import Adoption, Refinement, whole_fit
from casid.diagnosis.search.candidates import Adopted, Rival
from casid.diagnosis.search.rounds import Search
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.balances.balance_effects import quadratic_damping
from casid.model.effects.balances.missing_parts import missing_store
from casid.model.effects.balances.unnamed_effects import linear_loss

ONCE = casid.FitSettings(starts=1)


def tank() -> casid.Model:
    """An area of 1 m^2 that loses nothing: dh/dt = g u."""
    m = casid.Model("tank")
    u, h = m.input("u", "V", hold="zoh"), m.state("h", "m", start=1.0)
    g = m.parameter("g", "m/(s V)", start=0.01, lower=0)
    m.balance(h, "flow", inertia=1, terms=[g * u], unit="m/s")
    m.output("h", h, "m")
    return m


def filled(leak: float, second: bool) -> casid.Record:
    """10 min of a tank that leaks, or that fills a second one of 0.5 m^2 within 30 s."""
    rng, N, dt = np.random.default_rng(1), 300, 0.2
    u = np.repeat(rng.uniform(0.0, 1.0, 20), 15)
    h, r, y = 1.0, 0.0, np.empty(N)
    for i in range(N):
        y[i] = h
        for _ in range(10):
            rate = 0.01 * u[i] - leak * h - (0.5 * r / 30 if second else 0.0)
            r += (rate - r / 30) * dt
            h += rate * dt
    return casid.Record(
        {"u": u, "h": y + 0.005 * rng.standard_normal(N)}, {"u": "V", "h": "m"}, Ts=2
    )


@pytest.mark.parametrize(
    ("leak", "second", "kind"), [(3e-3, False, "unknown"), (0.0, True, "missing_mode")]
)
def test_a_store_whose_time_constant_ends_at_its_bound_gives_way_to_a_leak(leak, second, kind):
    split = split_records([casid.Experiment(filled(leak, second))], 0.3)
    weighing, fit = Weighing(split.fitted), fit_model(tank(), split.fitted, ONCE)
    at, units = weighing.weigh(tank(), fit), fit.criterion.weights
    search = Search(weighing, {})
    store = search.refitting.refit(at, missing_store(at.model, "flow", 100.0), 0.5)
    lost = search.refitting.refit(at, linear_loss(at.model, "flow", 0.0), 3e-3)
    assert at.noise_absorbs_misfit
    assert None not in (store, lost)
    search.first_candidates = [store, lost]
    of = Refinement(search, split, ONCE, units, at, fit)
    whole = whole_fit(store.model, split, ONCE, units, store.fit.values)
    assert ("tau_m" in whole.solution.at_upper) is (leak > 0)
    extended = weighing.weigh(store.model, whole, rounds=1)
    found = of.with_better_rivals(Adoption((Adopted(store, 1e-9, (), at),), extended, whole))
    assert [a.candidate.effect.kind for a in found.adopted] == [kind]


def test_a_named_law_that_leaves_more_than_noise_does_not_replace_a_leak_that_leaves_noise_alone():
    """The square takes all but 2 % of the misfit away, and the line, which has no name, all."""
    split = split_records([casid.Experiment(filled(3e-3, False))], 0.3)
    weighing, fit = Weighing(split.fitted), fit_model(tank(), split.fitted, ONCE)
    at, units = weighing.weigh(tank(), fit), fit.criterion.weights
    search = Search(weighing, {})
    line = search.refitting.refit(at, linear_loss(at.model, "flow", 0.0), 3e-3)
    square = search.refitting.refit(at, quadratic_damping(at.model, "flow"), 3e-3)
    assert line is not None
    assert square is not None
    whole = whole_fit(line.model, split, ONCE, units, line.fit.values)
    extended = weighing.weigh(line.model, whole, rounds=1)
    leak = Adopted(line, 1e-9, (Rival(square, 0.5),), at)
    found = Refinement(search, split, ONCE, units, at, fit).with_better_rivals(
        Adoption((leak,), extended, whole)
    )
    assert [a.candidate.effect.kind for a in found.adopted] == ["unknown"]
