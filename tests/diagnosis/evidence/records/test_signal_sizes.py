"""How far effects are sought follows from how the records move."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.records.signal_sizes import sizes_of
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
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


def test_a_switched_column_acts_until_its_next_sample():
    """A window that is open or shut, logged every ten minutes beside a thermometer.

    The heat balance is solved exactly over each interval. Joined by straight lines, the switch
    would act half an interval early, and its gain be wrong by more than its error.
    """
    rng, Ts, N, C, G, loss = np.random.default_rng(8), 600.0, 700, 2e5, 60.0, 40.0
    power = np.repeat(rng.choice([0.0, 800.0], N // 5), 5)
    window = rng.integers(0, 2, N).astype(float)
    T = np.zeros(N)
    for k in range(N - 1):
        level = (power[k] - loss * window[k]) / G
        T[k + 1] = level + (T[k] - level) * np.exp(-G * Ts / C)
    m = casid.Model("room")
    x = m.state("x", "K", initial=0.0)
    u = m.input("power", "W", hold="zoh", known=True)
    heat = m.parameter("C", "J/K", start=1e5, lower=1e4)
    m.balance(x, "heat", inertia=heat, terms=[u, -m.parameter("G", "W/K", start=50.0) * x])
    m.output("above", x, "K")
    problem = casid.Problem("room", m, recorded={"window": "1"}, starts=1)
    above = T + 0.02 * rng.standard_normal(N)
    record = casid.Record(
        {"power": power, "window": window, "above": above},
        {"power": "W", "window": "1", "above": "K"},
        Ts=Ts,
    )
    found = casid.diagnose(problem, record, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("extra_input", "window")
    size = cause.parameters[0]
    assert abs(size.value + loss) < 3 * size.std_error
    assert found.extended.model.model.inputs["window"].hold == "zoh"
