"""The scan for dead times beside causes from whose declared sizes the simulation diverges."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import casid
from casid.diagnosis.search.refits.dead_times import best_delay
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.delays import dead_time


def test_delays_are_tried_from_the_fit_where_the_declared_starts_diverge():
    """x' = (u(t - 6 s) - x) / 8 s - c x^3, c declared to start at -1 and fitted as 0."""
    m = casid.Model("lag")
    u, x = m.input("u", "V", hold="zoh"), m.state("x", "V", start=0)
    tau, c = m.parameter("tau", "s", start=8, lower=1), m.parameter("c", "1/(V^2 s)", start=-1.0)
    m.derivative(x, (u - x) / tau - c * x**3)
    m.output("x", x, "V")
    column = 3 * np.sign(np.sin(np.arange(200) / 9.0))
    y, level = np.empty(200), 0.0
    for k in range(200):
        y[k] = level
        late = column[max(k - 6, 0)]
        level = late + (level - late) * np.exp(-1 / 8)
    experiment = casid.Experiment(casid.Record({"u": column, "x": y}, {"u": "V", "x": "V"}, Ts=1))
    fit = SimpleNamespace(values={"tau": 8.0, "c": 0.0, "x(0)": 0.0})
    at: Any = SimpleNamespace(model=m, criterion=SimulationError(m, [experiment]), fit=fit)
    effect = dead_time(m, "u", 20.0)
    assert best_delay(at, [experiment], effect) == pytest.approx(6.0, abs=0.5)
    fit.values["c"] = -1.0  # from nowhere
    assert best_delay(at, [experiment], effect) == 0.0
