"""Uneven samples on a uniform clock, on request."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import casid
from casid.errors import DataError


def readings(count=800, seed=5):
    """Readings every 20 s to 95 s of a vessel whose heater is switched every half hour."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.integers(20, 96, count)).astype(float)
    heater = np.array([0.0, 400.0, 1200.0, 800.0])[(t // 1800).astype(int) % 4]
    return pd.DataFrame({"t": t, "temp": 60 + 20 * np.sin(t / 4000), "P": heater})


def vessel():
    m = casid.Model("vessel")
    T, P = m.state("T", "K"), m.input("P", "W", hold="zoh", known=True)
    C, UA = m.parameter("C", "J/K", start=2e4), m.parameter("UA", "W/K", start=4.0)
    m.balance(T, "heat", inertia=C, terms=[P, -UA * T])
    m.output("T_out", T, "K")
    return casid.Problem("vessel", m, channels={"T_out": "temp"})


@pytest.mark.parametrize("Ts", [30.0, 60.0, 88.0])
def test_no_interval_is_a_gap_that_others_resemble(Ts):
    """A median of 57 s makes half of the intervals longer than it, and none of them a gap."""
    frame = readings()
    found = casid.Record.from_frame(frame, resample=Ts)
    assert found.Ts == Ts
    assert found.is_missing("temp").mean() < 0.01
    assert found["temp"] == pytest.approx(60 + 20 * np.sin(found.t / 4000), abs=0.01)


LOST = [50, 51, 120, 121, 122, 300]


def test_rows_that_an_even_clock_has_lost_are_gaps_as_they_were():
    t = np.delete(np.arange(400.0), LOST)
    frame = pd.DataFrame({"t": t, "temp": np.sin(t / 30)})
    found = casid.Record.from_frame(frame, resample=1.0)
    assert np.flatnonzero(found.is_missing("temp")).tolist() == LOST


def test_a_clock_on_which_no_sample_is_left_is_refused():
    frame = readings()
    frame.loc[frame.index % 20 < 3, "temp"] = np.nan
    with pytest.raises(
        DataError, match="no sample of temp is left: .* the anti-alias filter takes"
    ):
        casid.Record.from_frame(frame, resample=300.0)


def test_a_held_input_keeps_what_flows_in_between_two_samples(tmp_path):
    """Interpolated from level to level, a heater would warm the vessel before it is switched on."""
    frame = readings()
    frame.to_csv(tmp_path / "log.csv", index=False)
    given = vessel().read(tmp_path / "log.csv", resample=60.0).record
    t, P = frame["t"].to_numpy(), frame["P"].to_numpy()
    exact = np.concatenate([[0.0], np.cumsum(P[:-1] * np.diff(t))])
    flowed = np.concatenate([[0.0], np.cumsum(given["P"][:-1] * 60.0)])
    assert flowed == pytest.approx(np.interp(given.t, t, exact), rel=1e-9, abs=1e-6)
    levels = np.isin(given["P"], (0.0, 400.0, 800.0, 1200.0))
    assert levels.mean() > 0.95
