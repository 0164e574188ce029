"""Two effects that lower the held-out error only together: a further store and a dead time."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.comparison.simulation_errors import simulation_errors
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.search.selection import Selection
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.effect import KINDS

ONCE = casid.FitSettings(starts=1)


def oven() -> casid.Model:
    """One heat capacity, scaled to 1: T' = (T_0 + g u - T) / tau."""
    m = casid.Model("oven")
    u, T = m.input("u", "V", hold="zoh"), m.state("T", "K", start=120)
    tau = m.parameter("tau", "s", start=70, lower=1, upper=1000)
    g, T_0 = m.parameter("g", "K/V", start=20), m.parameter("T_0", "K", start=15)
    m.balance(T, "heat", inertia=1, terms=[(T_0 + g * u - T) / tau], unit="K/s")
    m.output("T", T, "K")
    return m


def lamp(seed: int) -> casid.Record:
    """10 min of an oven that radiates: a store of 1.5 behind 77 s, and the lamp 4 s late."""
    rng, dt, per, N = np.random.default_rng(seed), 0.2, 10, 300
    u = np.repeat(rng.integers(0, 5, 13) * 2.0 + 1, 25)[:N]
    late = np.r_[np.full(20, u[0]), np.repeat(u, per)]
    T = R = 15 + 20 * u[0]
    y = np.empty(N)
    for i in range(N * per):
        if i % per == 0:
            y[i // per] = T
        radiated = 100 * (((T + 273) / 373) ** 4 - 1)
        flow = 1.5 * (T - R) / 77
        R += (T - R) / 77 * dt
        T += ((15 + 20 * late[i] - T - radiated) / 38 - flow) * dt
    y += 0.1 * rng.standard_normal(N)
    return casid.Record({"u": u, "T": y}, {"u": "V", "T": "K"}, Ts=2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 7])
def test_a_store_and_a_dead_time_are_adopted_together(seed: int) -> None:
    split = split_records([casid.Experiment(lamp(seed))], 0.3)
    fit, weighing = fit_model(oven(), split.fitted, ONCE), Weighing(split.fitted)
    at, units = weighing.weigh(oven(), fit), fit.criterion.weights
    search = Search(weighing, {}, without=set(KINDS) - {"missing_mode", "time_delay"})
    errors = simulation_errors(fit, split, units)
    state = Selection(search, split, ONCE, units, at, fit, errors, at, fit, errors)
    assert state.adopt_next()
    sizes = {
        a.candidate.effect.kind: state.fit.values[a.candidate.names[-1]] for a in state.adopted
    }
    assert sizes["time_delay"] == pytest.approx(4, abs=0.4)
    assert 50 < sizes["missing_mode"] < 150  # without the law of radiation
    assert state.errors.held_out_square < 0.9 * errors.held_out_square
