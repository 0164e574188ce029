"""A controlled input has a level of its own in lost rows, which the outputs behind them show.

The truth is a room of one heat capacity by its exact recursion; its heater is set anew every 600 s,
and single rows of heater and room are lost.
"""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from scipy.signal import lfilter

import casid
from casid.data.record import Record
from casid.diagnosis.evidence.recording_faults.levels_in_gaps import with_levels_in_gaps
from casid.diagnosis.settings import DiagnosisSettings
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.records.input_gaps import with_gaps_treated

TS, C, G = 600.0, 2.6e6, 300.0


def room() -> casid.Model:
    m = casid.Model("room")
    T = m.state("T", "K")
    P = m.input("P", "W", hold="zoh", known=True)
    capacity = m.parameter("C", "J/K", start=2e6, lower=1e5)
    loss = m.parameter("G", "W/K", start=250.0, lower=10.0)
    m.balance(T, "heat", inertia=capacity, terms=[P, -loss * T])
    m.output("air", T, "K")
    return m


def recorded(drain: np.ndarray | None = None) -> tuple[Record, np.ndarray]:
    """A record with one row of twelve lost, and the heater; `drain` [W] leaves the room."""
    N = 900
    lost = np.zeros(N) if drain is None else drain
    rng = np.random.default_rng(3)
    day = np.sin(2 * np.pi * np.arange(N) / 144)
    P = np.clip(4000 + 2500 * day + 1200 * rng.standard_normal(N), 0, 9000)
    E = np.exp(-G / C * TS)
    T = np.full(N, 4000 / G)
    for k in range(N - 1):
        T[k + 1] = E * T[k] + (1 - E) * (P[k] - lost[k]) / G
    T += 0.05 * rng.standard_normal(N)
    gone = rng.random(N) < 1 / 12
    gone[[0, -1]] = False
    record = Record(
        {"P": np.where(gone, 0.0, P), "air": np.where(gone, 0.0, T)},
        {"P": "W", "air": "K"},
        Ts=TS,
        name="run",
        missing={"P": gone, "air": gone},
    )
    return record, P


def test_levels_are_estimated_to_a_fraction_of_their_spread() -> None:
    record, P = recorded()
    chosen = with_gaps_treated(room(), [casid.Experiment(record, {}, "run")])
    split = split_records(chosen, 0.3)
    fit = fit_model(room(), split.fitted, FitSettings(starts=1), throw=False)
    filled, count = with_levels_in_gaps(fit, split)
    for part in (filled.whole[0], filled.fitted[0]):
        assert any("is the likeliest by the samples" in line for line in part.record.provenance)
        assert not any("by steps" in line for line in part.record.provenance)
    gone = record.missing["P"]
    assert count > 50
    before, after = (float(np.std((s.whole[0].record["P"] - P)[gone])) for s in (split, filled))
    assert before > 1400.0
    assert after < 0.45 * before
    np.testing.assert_array_equal(filled.whole[0].record["P"][~gone], P[~gone])
    assert "P: its level in a gap" in filled.whole[0].record.provenance[-1]


def test_a_command_that_steps_now_and_then_is_left_to_its_steps() -> None:
    record, P = recorded()
    stepping = np.where(record.missing["P"], 0.0, np.repeat(P[::30], 30))
    record = record.with_channel("P", stepping, "W")
    chosen = with_gaps_treated(room(), [casid.Experiment(record, {}, "run")])
    split = split_records(chosen, 0.3)
    fit = fit_model(room(), split.fitted, FitSettings(starts=1), throw=False)
    assert with_levels_in_gaps(fit, split) == (split, 0)


def test_gaps_of_a_heater_are_no_deficiency_of_the_room() -> None:
    found = casid.diagnose(casid.Problem("room", room()), recorded()[0], starts=1, advise=False)
    assert (found.verdict, found.causes) == ("adequate", ())


def test_levels_by_the_inputs_alone_take_up_nothing_of_what_is_missing() -> None:
    """Those by the outputs take up a part of the gusts that draw heat from the room."""
    rng = np.random.default_rng(4)
    gusts = 1000.0 * lfilter([np.sqrt(1 - 0.9**2)], [1, -0.9], rng.standard_normal(900))
    record, P = recorded(drain=gusts)
    chosen = with_gaps_treated(room(), [casid.Experiment(record, {}, "run")])
    split = split_records(chosen, 0.3)
    fit = fit_model(room(), split.fitted, FitSettings(starts=1), throw=False)
    gone = record.missing["P"]
    taken = []
    for by_outputs in (True, False):
        filled, _ = with_levels_in_gaps(fit, split, by_outputs=by_outputs)
        error = (filled.whole[0].record["P"] - P)[gone]
        taken.append(-float(error @ gusts[gone] / (gusts[gone] @ gusts[gone])))
    assert taken[0] > 0.4
    assert abs(taken[1]) < 3 * 1300.0 / float(np.linalg.norm(gusts[gone]))


@pytest.mark.parametrize(("drained", "by_outputs"), [(0.0, True), (2500.0, False)])
def test_where_much_is_missing_causes_are_sought_once(
    monkeypatch: pytest.MonkeyPatch, drained: float, by_outputs: bool
) -> None:
    """What levels by the outputs do not take up is not the gaps': the search is not repeated."""
    searched: list[bool] = []

    class Searched(Exception):
        pass

    def search(problem: object, baseline: object, settings: DiagnosisSettings) -> None:
        searched.append(settings.levels_by_outputs)
        raise Searched

    monkeypatch.setattr(
        importlib.import_module("casid.diagnosis.diagnose"), "search_causes", search
    )
    drain = drained * (np.arange(900) % 144 > 100)
    record, _ = recorded(drain)
    with pytest.raises(Searched):
        casid.diagnose(casid.Problem("room", room(), starts=1), record)
    assert searched == [by_outputs]
