"""Jumps are looked for in every record, by the records' clock."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.scores.score_tests import scan
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.instants.jump_times import is_known_event, placed
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.clock_effects import at_instant, gain_step
from casid.model.effects.parameter_effects import parameter_jump

TS, JUMP, NOISE = 0.1, 62.0, 5e-3


def leak() -> casid.Problem:
    m = casid.Model("leak")
    h = m.state("h", "m")
    q = m.input("q", "m/s", hold="zoh", known=True)
    k = m.parameter("k", "1/s", start=0.5, lower=0.01, upper=10.0)
    m.balance(h, "volume", inertia=1, terms=[q, -k * h], unit="m/s")
    m.output("level", h, "m")
    return casid.Problem("leak", m)


def run() -> casid.Record:
    """80 s of dh/dt = q - k h sampled exactly, the leak k half as large again from 62 s on."""
    rng = np.random.default_rng(6)
    q = np.repeat(rng.uniform(0.0, 1.0, 40), 20)
    level, h = np.empty(800), 1.0
    for i, inflow in enumerate(q):
        level[i] = h
        k = 0.6 if i * TS < JUMP else 0.9
        h = inflow / k + (h - inflow / k) * np.exp(-k * TS)
    level += NOISE * rng.standard_normal(800)
    return casid.Record({"q": q, "level": level}, {"q": "m/s", "level": "m"}, Ts=TS, name="run")


def test_nothing_sets_in_while_a_lagging_actuator_shows_the_time_before_the_record():
    """Five time constants after the start less than a hundredth is left of what it did before."""
    model, tau = leak().model, 0.4
    lagging = casid.actuator_lag(model, "q", 5.0).extend(model, starts={"tau_q": tau})
    experiments = [casid.Experiment(run().between(0.0, 60.0))]
    for m, is_due_to_past in ((model, False), (lagging.with_known(tau_q=tau), True)):
        at = Weighing(experiments).weigh(m, fit_model(m, experiments, FitSettings(starts=1)))
        early, later = (parameter_jump(m, "k", share * tau) for share in (4.9, 5.1))
        assert is_known_event(at, early, []) == is_due_to_past
        assert not is_known_event(at, later, [])


@pytest.mark.slow
def test_a_jump_in_the_second_record_is_found_where_it_is():
    whole = run()
    records = [whole.between(0.0, 39.95), whole.between(40.0, np.inf)]
    d = casid.diagnose(leak(), records, hold_out=0, max_causes=1, advise=False)
    (cause,) = d.causes
    assert (cause.kind, cause.where) == ("parameter_jump", "k")
    found = {p.name: p for p in cause.parameters}
    assert found["time"].value == pytest.approx(JUMP, abs=3 * TS)
    jump = found["jump_k"]
    assert jump.value == pytest.approx(0.3, abs=3 * jump.std_error)


def test_at_its_own_instant_a_change_of_a_gain_leaves_what_its_fit_leaves():
    """Also where the simulation without it is far away: drag is quadratic in the speed.

    A large gain is taken out of the simulation: one of -1 hides all other gains of its channel.
    """
    m = casid.Model("boat")
    v = m.state("v", "m/s", start=2.0)
    F = m.input("F", "N", hold="zoh", known=True)
    d = m.parameter("d", "N s^2/m^2", start=3.0, lower=0.01, upper=50.0)
    m.balance(v, "surge", inertia=10.0, terms=[F, -d * v**2])
    m.output("speed", v, "m/s")
    rng, N = np.random.default_rng(2), 600
    force = np.repeat(rng.uniform(5.0, 60.0, N // 30), 30)
    acting, speed, at = force * np.where(np.arange(N) < 350, 1.0, 0.6), np.empty(N), 2.0
    for i in range(N):
        speed[i] = at
        for _ in range(20):
            at += TS / 20 * (acting[i] - 3.0 * at**2) / 10.0
    record = casid.Record(
        {"F": force, "speed": speed + 1e-4 * rng.standard_normal(N)},
        {"F": "N", "speed": "m/s"},
        Ts=TS,
    )
    effect = gain_step(m, "F", 35.0)
    model, (name, *_) = effect.extended(m)
    fit = fit_model(model, [casid.Experiment(record)], FitSettings(starts=1))
    assert fit.values[name] == pytest.approx(-0.4, abs=0.01)
    (left,) = scan(fit, name, [effect])
    assert left == pytest.approx(2 * fit.solution.value, rel=1e-6)
    assert min(scan(fit, name, [at_instant(effect, m, t) for t in (34.5, 35.5)])) > 10 * left


def test_where_no_refit_succeeded_nothing_is_placed():
    experiments = [casid.Experiment(run())]
    weighing = Weighing(experiments)
    fit = fit_model(leak().model, experiments, FitSettings(starts=1))
    at = weighing.weigh(leak().model, fit)
    assert placed(Refitting(weighing), at, [], (), lambda _: None) == []


@pytest.mark.slow
def test_the_instant_is_placed_to_a_fraction_of_a_sample():
    """A tenth of a sample is made up for by the size of the jump, by much of its standard error.

    A step that is held sets in at the first sample of which it is all.
    """
    rng, Ts, N = np.random.default_rng(6), 0.02, 2000
    q = np.repeat(rng.uniform(0.0, 1.0, 40), 50)
    level, h = np.empty(N), 1.0
    for i, inflow in enumerate(q):
        level[i] = h
        k = 3.0 if i < 1531 else 4.5
        h = inflow / k + (h - inflow / k) * np.exp(-k * Ts)
    level += 2e-5 * rng.standard_normal(N)
    record = casid.Record({"q": q, "level": level}, {"q": "m/s", "level": "m"}, Ts=Ts, name="run")
    others = (
        "sensor_bias sensor_scale offset hold time_delay actuator_lag sensor_lag missing_mode "
        "scheduled_parameter parameter_drift periodic_disturbance quadratic_damping cubic_damping "
        "unknown end_stop saturation outliers actuator_saturation rectified"
    ).split()
    d = casid.diagnose(leak(), record, hold_out=0, max_causes=1, advise=False, without=others)
    found = {p.name: p for p in d.causes[0].parameters}
    assert found["time"].value == pytest.approx(1531 * Ts, abs=0.05 * Ts)
    assert found["jump_k"].value == pytest.approx(1.5, abs=3 * found["jump_k"].std_error)
