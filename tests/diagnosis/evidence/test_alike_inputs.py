"""Inputs that act alike have the noise of their channels, not what the model leaves."""

from __future__ import annotations

import numpy as np

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.estimation.simulation.fit import FitSettings, fit_model


def warmed(seed: int, open_for: float) -> tuple[casid.Model, list[casid.Experiment]]:
    """A vessel in K, its heater in W and the air; it loses 30 % more for a share of the record."""
    rng = np.random.default_rng(seed)
    N, Ts, C, loss = 1000, 10.0, 500.0, 0.8
    P = np.repeat(rng.choice([0.0, 20.0, 40.0], N // 50), 50)
    air = 290.0 + 3.0 * np.sin(np.arange(N) / 150)
    T, out = 300.0, np.empty(N)
    for k in range(N):
        out[k] = T
        h = loss * (1.3 if 0.3 * N < k < (0.3 + open_for) * N else 1.0)
        settled = air[k] + P[k] / h
        T = settled + (T - settled) * np.exp(-h * Ts / C)
    noisy = {
        "P": P + 0.05 * rng.normal(size=N),
        "air": air + 0.02 * rng.normal(size=N),
        "T": out + 0.05 * rng.normal(size=N),
    }
    m = casid.Model("vessel")
    x = m.state("T", "K", start=300.0)
    power, around = m.input("P", "W", hold="zoh"), m.input("air", "K", hold="zoh")
    c = m.parameter("C", "J/K", start=400.0, lower=10.0)
    g = m.parameter("h", "W/K", start=1.0, lower=0.01)
    m.balance(x, "heat", inertia=c, terms=[power, -g * (x - around)])
    m.output("T", x, "K")
    record = casid.Record(noisy, {"P": "W", "air": "K", "T": "K"}, Ts)
    return m, [casid.Experiment(record, {}, "run")]


def test_no_input_takes_the_misfit_that_another_may_not_have() -> None:
    """The heater's share goes to the air, whose sensor has no such noise either: 0.02 K."""
    for open_for, is_hidden in ((0.25, True), (0.0, False)):
        model, runs = warmed(1, open_for)
        fit = fit_model(model, runs, FitSettings(starts=1))
        at = Weighing(runs).weigh(model, fit)
        assert at.noise_absorbs_misfit is is_hidden
        assert at.noise.source_sd["air"] < 0.1
