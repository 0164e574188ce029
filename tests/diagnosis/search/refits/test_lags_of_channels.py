"""Lags and delays that are refitted beside the short list.

A stirred reactor whose coolant answers its setting late, by Runge-Kutta in plain Python. Without
the lag the heat of reaction, which cannot be negative, makes up for it until it is zero.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.scores.score_tests import Score
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.refits.lags_of_channels import delays_of_best, lags_beside
from casid.diagnosis.search.rounds import Search, shortlist
from casid.diagnosis.thresholds import SHORTLIST
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.model.effects.channels.actuator_effects import actuator_lag
from casid.model.effects.channels.channel_effects import sensor_bias, sensor_lag
from casid.model.effects.channels.delays import dead_time, time_delay
from casid.model.effects.effect import LATE, Effect

LAG = 40.0  # s


def model() -> casid.Model:
    m = casid.Model("stirred reactor")
    coolant, feed = m.input("coolant", "K", hold="zoh"), m.input("feed", "mol/m^3", hold="zoh")
    c, T = m.state("c", "mol/m^3"), m.state("T", "K")
    V, q = m.parameter("V", "m^3", value=0.1), m.parameter("q", "m^3/s", value=2.8e-4)
    cp = m.parameter("cp", "kJ/(m^3 K)", value=4000)
    inlet = m.parameter("inlet", "K", value=300)
    k = m.parameter("k", "1/s", start=0.02, lower=1e-4, upper=1.0)
    E = m.parameter("E", "K", start=6000, lower=0, upper=20000)
    H = m.parameter("H", "kJ/mol", start=50, lower=0, upper=300)
    UA = m.parameter("UA", "kW/K", start=1.0, lower=0.01, upper=20)
    rate = k * ca.exp(-E * (1 / T - 1 / 310)) * c
    m.balance(c, "amount", inertia=V, terms=[q * (feed - c), -V * rate])
    heat = [q * cp * (inlet - T), H * V * rate, UA * (coolant - T)]
    m.balance(T, "heat", inertia=V * cp, terms=heat)
    m.output("conc", c, "mol/m^3")
    m.output("temp", T, "K")
    return m


def record(seed: int = 8) -> casid.Record:
    """1000 s of random steps of both inputs; noise of 10 mol/m^3 and 0.3 K."""
    rng = np.random.default_rng(seed)
    N = 1000

    def steps(low: float, high: float, shortest: float, longest: float) -> np.ndarray:
        u, t = np.zeros(N), 0.0
        while t < N:
            held = rng.uniform(shortest, longest)
            u[round(t) : round(t + held)] = rng.uniform(low, high)
            t += held
        return u

    coolant, feed = steps(288, 308, 40, 120), steps(800, 1200, 60, 160)

    def slope(x: tuple[float, ...], k: int) -> tuple[float, ...]:
        c, T, acts = x
        rate = 0.01 * math.exp(-8000 * (1 / T - 1 / 310)) * c
        heat = 1120 * (300 - T) + 0.1 * 20e3 * rate + 7200 * (acts - T)
        return (2.8e-3 * (feed[k] - c) - rate, heat / 4e5, (coolant[k] - acts) / LAG)

    x, y, h = (270.0, float(coolant[0]), float(coolant[0])), np.empty((N, 2)), 0.5
    for k in range(N):
        y[k] = x[:2]
        for _ in range(2):
            k1 = slope(x, k)
            k2 = slope(tuple(a + h / 2 * b for a, b in zip(x, k1, strict=True)), k)
            k3 = slope(tuple(a + h / 2 * b for a, b in zip(x, k2, strict=True)), k)
            k4 = slope(tuple(a + h * b for a, b in zip(x, k3, strict=True)), k)
            x = tuple(
                a + h / 6 * (p + 2 * q + 2 * r + s)
                for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True)
            )
    y += rng.standard_normal((N, 2)) * [10.0, 0.3]
    columns = {"coolant": coolant, "feed": feed, "conc": y[:, 0], "temp": y[:, 1]}
    units = {"coolant": "K", "feed": "mol/m^3", "conc": "mol/m^3", "temp": "K"}
    return casid.Record(columns, units, Ts=1.0)


@pytest.mark.slow
def test_a_lag_that_a_parameter_at_its_bound_stands_for_comes_first():
    """None is on the short list: a bias, the temperature's zero and a limit score higher."""
    m, experiments = model(), [casid.Experiment(record().between(-math.inf, 699.0), {}, "steps")]
    fit = fit_model(m, experiments, FitSettings(starts=1), throw=False)
    weighing = Weighing(experiments)
    at, search = weighing.weigh(m, fit), Search(weighing, {})
    assert at.fit.values["H"] < 1e-4 * m.parameters["H"].start
    table = search.table(at, [])
    assert not [s for s in shortlist(at, table) if s.effect.kind in LATE]
    best = search.round(at, table, [])[0]
    assert best.effect.key == ("actuator_lag", "coolant")
    assert best.fit.values[best.names[0]] == pytest.approx(LAG, rel=0.1)


def _score(effect: Effect, step: float, unrobust: float) -> Score:
    """A score of so much without its sign, which is that of the step."""
    energy = unrobust / step**2
    kept = unrobust if step > 0 else 0.0
    return Score(effect, 3.0, 0.01, 0.01, energy, step, kept, 1.0)


def _table(**steps: tuple[float, float]) -> Any:
    m = model()
    effects = {
        "conc": sensor_lag(m, "conc", 100.0),
        "conc_late": time_delay(m, "conc", 100.0),
        "temp": sensor_lag(m, "temp", 100.0),
        "coolant": actuator_lag(m, "coolant", 100.0),
        "coolant_dead": dead_time(m, "coolant", 100.0),
        "coolant_record": sensor_lag(m, "coolant", 100.0),
        "feed": actuator_lag(m, "feed", 100.0),
    }
    return SimpleNamespace(tested=[_score(effects[name], *each) for name, each in steps.items()])


AT: Any = SimpleNamespace(model=model(), noise_absorbs_misfit=True)


def test_lags_off_the_short_list_are_refitted_where_misfit_passes_for_noise():
    """One whose score is negative starts from the best that is positive and not too long."""
    table = _table(
        conc=(12.0, 50.0), temp=(-3.0, 90.0), feed=(900.0, 80.0), coolant_record=(-3.0, 99.0)
    )
    found = lags_beside(AT, table, [])
    assert [s.effect.where for s in found] == ["temp", "feed", "conc"]
    assert [s.step for s in found] == [12.0, 900.0, 12.0]
    quiet: Any = SimpleNamespace(model=AT.model, noise_absorbs_misfit=False)
    assert not lags_beside(quiet, table, [])


def test_a_channel_with_a_delay_on_the_short_list_gets_no_lag_beside_it():
    table = _table(conc=(12.0, 50.0), conc_late=(12.0, 50.0), temp=(5.0, 90.0))
    assert [s.effect.where for s in lags_beside(AT, table, table.tested[1:2])] == ["temp"]


def test_of_many_channels_the_lags_that_move_most_are_refitted():
    m = casid.Model("many tanks")
    for i in range(9):
        m.output(f"h{i}", m.state(f"x{i}", "m"), "m")
    lags = [_score(sensor_lag(m, f"h{i}", 10.0), -1.0, 10.0 + i) for i in range(9)]
    found = lags_beside(AT, SimpleNamespace(tested=lags), [])  # type: ignore[arg-type]
    assert [s.effect.where for s in found] == [f"h{8 - i}" for i in range(SHORTLIST.lags)]


def _found(score: Score, gain: float, size: float = 33.0) -> Any:
    name = score.effect.parameters[0].name
    fit = SimpleNamespace(values={name: size})
    return SimpleNamespace(effect=score.effect, gain=gain, names=(name,), fit=fit)


def test_a_dead_time_is_tried_where_the_lag_of_the_same_command_is_among_the_best():
    table = _table(
        conc=(12.0, 50.0), conc_late=(12.0, 50.0), coolant=(9.0, 1.0), coolant_dead=(9.0, 1.0)
    )
    conc, conc_late, coolant, coolant_dead = table.tested
    found = [_found(conc, 20.0), _found(coolant, 100.0)]
    (late,) = delays_of_best(table, found, [conc, coolant])
    assert (late.effect.key, late.step) == (coolant_dead.effect.key, 33.0)
    assert not delays_of_best(table, found, table.tested)
    # A delay leads, which may be that of the command.
    found = [_found(conc_late, 100.0), _found(coolant, 40.0)]
    (late,) = delays_of_best(table, found, [conc_late, coolant, conc])
    assert late.effect.key == coolant_dead.effect.key
    # Something else does, by far.
    found = [_found(_score(sensor_bias(AT.model, "temp"), 1.0, 9.0), 100.0), _found(coolant, 40.0)]
    assert not delays_of_best(table, found, [conc_late, coolant, conc])
