"""How far effects are sought follows from how the records move."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.prewhitening import Weighing
from casid.diagnosis.evidence.signal_sizes import sizes_of
from casid.diagnosis.thresholds import PREWHITENING
from casid.estimation.simulation.fit import fit_model


@pytest.mark.parametrize(("time_constant", "longest"), [(200.0, 40.0), (30.0, 30.0), (2.0, 15.0)])
def test_a_delay_is_sought_up_to_a_time_constant_some_samples_or_a_tenth_of_the_record(
    time_constant, longest
):
    """One step of a heater, recorded for 400 s at 1 Hz."""
    assert (PREWHITENING.delay_samples, PREWHITENING.delay_share) == (15.0, 0.1)
    m = casid.Model("heater")
    T = m.state("T", "K", initial=0.0)
    power = m.input("power", "W", hold="zoh", known=True)
    C = m.parameter("C", "J/K", start=time_constant, lower=0.1)
    m.balance(T, "heat", inertia=C, terms=[power, -m.constant("G", 1.0, "W/K") * T])
    m.output("heater", T, "K")
    t = np.arange(400.0)
    heated = 1 - np.exp(-t / time_constant)
    heated += 1e-3 * np.random.default_rng(2).standard_normal(400)
    record = casid.Record(
        {"power": np.ones(400), "heater": heated}, {"power": "W", "heater": "K"}, Ts=1
    )
    data = [casid.Experiment(record)]
    fit = fit_model(m, data, casid.FitSettings(starts=1))
    found = sizes_of(Weighing(data).weigh(m, fit), {})
    assert found.longest_delay == pytest.approx(longest, rel=0.02)
