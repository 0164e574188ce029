"""What is held out is simulated and never fitted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

import casid
from casid.estimation.holdout import (
    held_out_error,
    holding_out_measured,
    measured_readings,
    record_views,
    split_records,
    why_no_better,
)
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.records.input_gaps import with_gaps_treated
from casid.estimation.simulation.records.signals import clock_inputs, signals_of
from casid.model.effects.parameter_effects import parameter_jump
from tests.support.fitted_models import driven_mass

TS = 0.02


def problem() -> casid.Problem:
    return casid.Problem(name="oscillator", model=driven_mass(), starts=1)


def experiment(
    x0: float = 0.05, N: int = 1000, noise: float = 0.01, seed: int = 3, name: str = "r"
) -> casid.Experiment:
    rng = np.random.default_rng(seed)
    F = np.repeat(rng.normal(0.0, 4.0, N // 25 + 1), 25)[:N]
    A, B = np.array([[0.0, 1.0], [-25.0, -0.75]]), np.array([[0.0], [0.5]])
    a, b, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), TS, method="zoh")
    x, y = np.array([x0, 0.0]), np.empty(N)
    for i in range(N):
        y[i] = x[0]
        x = a @ x + b[:, 0] * F[i]
    record = casid.Record(
        {"force": F, "position": y + noise * rng.normal(size=N)},
        {"force": "N", "position": "m"},
        Ts=TS,
        name=name,
    )
    return casid.Experiment(record, {}, name)


def test_the_last_share_of_a_record_is_held_out():
    split = split_records([experiment()], 0.3)
    assert split.fitted[0].record.N == 700
    assert split.whole[0].record.N == 1000
    assert np.flatnonzero(split.held[0]).tolist() == list(range(700, 1000))


def test_what_is_held_out_was_measured():
    e = experiment()
    off = np.arange(1000) >= 690
    dead = dataclasses.replace(e, record=e.record.mark_missing("position", off))
    split, note = holding_out_measured(split_records([dead], 0.3), ["position"])
    assert int((~split.held[0]).sum()) == split.fitted[0].record.N == 483
    assert split.whole[0].record.N == 1000
    assert "begins at t = 9.66 s, and the last sample is that at t = 13.78 s" in note
    usual = split_records([e], 0.3)
    assert holding_out_measured(usual, ["position"]) == (usual, "")


def test_what_is_held_out_has_no_part_in_the_fit():
    e = experiment()
    spoilt = e.record.with_channel(
        "position",
        np.where(np.arange(1000) >= 700, 99.0, e.record["position"]),
        "m",
    )
    a = casid.identify(problem(), e, hold_out=0.3)
    b = casid.identify(problem(), casid.Experiment(spoilt, {}, "r"), hold_out=0.3)
    assert a["k"] == b["k"]
    assert b.held_out_rmse["r"]["position"] > 90


def test_the_true_model_predicts_held_out_samples_to_their_noise():
    a = casid.identify(problem(), experiment(), hold_out=0.3)
    # sd of an rms of 300 white samples is 4 %; the parameters' own error adds two in 700.
    assert a.held_out_rmse["r"]["position"] == pytest.approx(0.01, rel=0.16)


def test_a_record_held_out_starts_from_an_initial_state_of_its_own():
    other = experiment(x0=-0.4, seed=5, name="other")
    a = casid.identify(problem(), experiment(), hold_out=[other])
    assert a.held_out_rmse["other"]["position"] == pytest.approx(0.01, rel=0.1)
    assert set(a.rmse) == {"r"}


def test_an_end_that_starts_anew_does_not_begin_in_the_known_state_of_the_record():
    """The record begins at rest, its end in the midst of the motion."""
    m = driven_mass()
    m.states = {n: dataclasses.replace(s, initial=0.0) for n, s in m.states.items()}
    split = split_records([experiment(x0=0.0)], 0.3)
    fit = fit_model(m, split.fitted, FitSettings())
    anew = held_out_error(fit, split, anew=True) / fit.criterion.weights
    assert np.sqrt(np.mean(anew**2)) == pytest.approx(0.01, rel=0.15)


def test_an_end_that_starts_anew_may_begin_in_the_state_simulated():
    """Two masses, one of them measured: from rest, a stiff cubic spring between them diverges."""
    m = casid.Model("two_masses")
    x, v, y, w = (m.state(n, u) for n, u in (("x", "m"), ("v", "m/s"), ("y", "m"), ("w", "m/s")))
    k = m.parameter("k", "N/m", start=100.0, lower=1.0)
    F = m.input("F", "N", hold="zoh", known=True)
    m.derivative(x, v)
    m.derivative(y, w)
    spring = k * (x - y) + 1e6 * (x - y) ** 3
    m.balance(v, "first", inertia=1.0, terms=[F, -spring - (v - w)])
    m.balance(w, "second", inertia=1.0, terms=[spring + v - w])
    m.output("x", x, "m")
    t = TS * np.arange(600)
    force = np.sin(2.0 * t) + 0.2

    def rates(at: float, s: np.ndarray) -> list[float]:
        pull = 120.0 * (s[0] - s[2]) + 1e6 * (s[0] - s[2]) ** 3 + s[1] - s[3]
        held = force[min(int(at / TS + 1e-9), t.size - 1)]
        return [s[1], held - pull, s[3], pull]

    found = solve_ivp(
        rates, (0.0, t[-1]), np.zeros(4), "LSODA", t_eval=t, rtol=1e-8, atol=1e-10, max_step=TS / 4
    )
    simulated = found.y[0]
    measured = simulated + 1e-3 * np.random.default_rng(4).standard_normal(t.size)
    record = casid.Record({"F": force, "x": measured}, {"F": "N", "x": "m"}, Ts=TS, name="r")
    split = split_records([casid.Experiment(record, {}, "r")], 0.3)
    fit = fit_model(m, split.fitted, FitSettings())
    assert abs(measured[420]) > 0.5
    anew = held_out_error(fit, split, anew=True) / fit.criterion.weights
    assert np.sqrt(np.mean(anew**2)) == pytest.approx(1e-3, rel=0.15)


def test_a_share_that_leaves_nothing_to_fit_is_refused_with_a_better_one():
    with pytest.raises(casid.DataError, match=r"use 0 to 0\.9, for example 0\.3"):
        casid.identify(problem(), experiment(), hold_out=0.95)


def test_an_improvement_is_accepted_unless_it_may_be_chance():
    """Diebold and Mariano (1995): the mean fall of the squared error against its own spread."""
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(1000, 1))
    misfit = np.sin(np.arange(1000) * 0.1)[:, None]
    assert why_no_better(noise + misfit, noise) == ""
    assert "does not improve" in why_no_better(noise, noise + misfit)
    other = rng.normal(size=(1000, 1))
    other *= 0.99 * np.sqrt(np.mean(noise**2) / np.mean(other**2))  # 2 % less, and 6 % its spread
    assert "may be chance" in why_no_better(noise, other)
    assert "diverges" in why_no_better(noise, np.full((1000, 1), np.inf))


def test_nothing_held_out_refuses_nothing():
    assert why_no_better(np.zeros((0, 1)), np.zeros((0, 1))) == ""
    assert split_records([experiment()], 0.0).is_empty


def test_a_change_in_time_acts_in_the_end_of_its_record_and_not_in_another():
    """The stiffness is 2 % softer than it was from the first sample on: a jump before the record.

    At the end of the record, from an initial state of its own, the jump has happened, and noise
    alone is left, as in a later window of it; in a record apart, whose clock is another, the
    stiffness is the one before. That judges a jump that the problem states, and none that is found.
    """
    whole, other = experiment(noise=1e-3, N=1500), experiment(noise=1e-3, seed=4, name="other")
    one, later = (
        dataclasses.replace(whole, record=whole.record.between(*ends), name=name)
        for ends, name in (((0.0, 19.99), "one"), ((20.0, 29.99), "later"))
    )
    model = problem().model.with_known(k=51.0)
    effect = parameter_jump(model, "k", -1.0)
    model, names = effect.extended(model, starts={effect.parameters[0].name: -0.9})
    split = split_records([one], 0.3)
    fit = fit_model(model, split.fitted, FitSettings(starts=1))
    assert fit.values[names[0]] == pytest.approx(-1.0, abs=0.1)
    own = held_out_error(fit, split, anew=True) / fit.criterion.weights
    assert float(np.std(own)) == pytest.approx(1e-3, rel=0.15)
    window = held_out_error(fit, split_records([one], [later])) / fit.criterion.weights
    assert float(np.std(window)) == pytest.approx(1e-3, rel=0.15)
    apart = split_records([one], [other])
    assert np.isnan(held_out_error(fit, apart)).all()
    stated = dataclasses.replace(apart, stated=frozenset(clock_inputs(model)))
    assert float(np.std(held_out_error(fit, stated) / fit.criterion.weights)) > 2e-3


def test_a_reading_that_is_missing_is_shown_nowhere_and_one_that_was_marked_where_it_was():
    """Missing samples count as zero in the fit: in degC they were drawn at -273."""
    e = experiment()
    y = e.record["position"].copy()
    y[100] = np.nan
    missing = {"position": np.isin(np.arange(1000), [100, 200])}
    columns, units = {"force": e.record["force"], "position": y}, {"force": "N", "position": "m"}
    record = casid.Record(columns, units, Ts=TS, missing=missing)
    split = split_records([casid.Experiment(record, {}, "r")], 0.0)
    fit = fit_model(problem().model, split.fitted, FitSettings(starts=1))
    (view,) = record_views(fit, None, split)
    assert not view.used[[100, 200], 0].any()
    assert np.isnan(view.measured[100, 0])
    assert view.measured[200, 0] == y[200]


def shown(values: np.ndarray, gone: np.ndarray, marked: np.ndarray) -> np.ndarray:
    """What a figure has of readings that lack some, of which others are marked afterwards."""
    model, units = problem().model, {"force": "N", "position": "m"}
    columns = {"force": np.ones(len(values)), "position": values}
    record = casid.Record(columns, units, TS, missing={"position": gone})
    (e,) = with_gaps_treated(model, [casid.Experiment(record)])
    e = dataclasses.replace(e, record=e.record.mark_missing("position", marked))
    return measured_readings(signals_of(model, e), e, ["position"])[:, 0]


def test_a_reading_that_does_not_count_is_shown_and_a_gap_is_not():
    """Of a thinned record straight lines stand in the gaps; an outlier keeps what was read."""
    k = np.arange(12)
    thinned = shown(k**2.0, k % 3 != 0, k == 6)
    assert thinned[6] == 36.0
    assert np.flatnonzero(np.isfinite(thinned)).tolist() == [0, 3, 6, 9]
    stuck = np.array([0.0, 3.0, 5.0, 5.0, 5.0, 4.0])
    plateau = shown(stuck, np.zeros(6, dtype=bool), np.isin(np.arange(6), [2, 3, 4]))
    assert np.isfinite(plateau).all()


def test_a_share_that_leaves_nothing_to_fit_is_refused_with_what_python_takes():
    run = casid.Record({"position": np.zeros(9)}, {"position": "m"}, TS)
    with pytest.raises(casid.DataError, match="2 leaves too little .* or hold out whole records"):
        split_records([casid.Experiment(run)], 2)
