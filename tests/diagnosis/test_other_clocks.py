"""What sets in at an instant holds on the clock of its record: in every window of it, and no other.

The slide of `test_effects_in_time`, on which a load is taken at 14 s.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

import casid
from tests.diagnosis.test_effects_in_time import TS, N, T, only, record, slide

INSTANT, LOAD = 14.0, -3.0
FITTED = 20.0
"""How long the record is fitted [s]."""
LEFT_OUT = (
    "unknown",
    "missing_mode",
    "actuator_lag",
    "sensor_lag",
    "time_delay",
    "backlash",
    "hold",
)
"""Kinds that take long to fit, and are no rivals of a load."""


@functools.cache
def loaded() -> casid.Record:
    return record(load=np.where(T >= INSTANT, LOAD, 0.0))


def named(path: str, of: casid.Record) -> casid.Record:
    return casid.Record(of.channels, of.units, of.Ts, name=path)


def diagnosed(*apart: casid.Record) -> casid.Diagnosis:
    first = loaded().between(0.0, FITTED - TS)
    return sought(first, *apart)


def sought(first: casid.Record, *apart: casid.Record) -> casid.Diagnosis:
    return casid.diagnose(
        slide(), first, hold_out=list(apart), without=LEFT_OUT, starts=1, max_causes=2, advise=False
    )


def assert_is_the_load(found: casid.Diagnosis) -> None:
    cause = only(found)
    size, time = cause.parameters
    assert (cause.kind, cause.where) == ("offset", "force")
    assert size.value == pytest.approx(LOAD, abs=4 * size.std_error)
    assert time.value == pytest.approx(INSTANT, abs=2 * TS)


def test_a_load_is_on_in_a_later_window_that_is_held_out():
    later = loaded().between(FITTED, (N - 1) * TS)
    found = diagnosed(later)
    assert_is_the_load(found)
    assert found.held_out["extended_rmse"]["position"] == pytest.approx(2e-4, rel=0.1)
    assert not any("clock" in note for note in found.notes)


@pytest.mark.parametrize("load", [LOAD, pytest.param(0.0, marks=pytest.mark.slow)])
def test_a_record_on_another_clock_neither_confirms_nor_refutes_a_load(load: float):
    found = diagnosed(named("tuesday", record(load=load, seed=1)))
    assert_is_the_load(found)
    assert not found.held_out
    (note,) = (note for note in found.notes if "clock" in note)
    assert "constant force in the force balance (step) was found on the clock of" in note
    assert "tuesday is not known to be on that clock" in note


@pytest.mark.slow
def test_beside_a_record_on_another_clock_a_later_window_judges_the_load():
    later = loaded().between(FITTED, (N - 1) * TS)
    found = diagnosed(named("tuesday", record(seed=1)), later)
    assert_is_the_load(found)
    assert found.held_out["extended_rmse"]["position"] == pytest.approx(2e-4, rel=0.1)


@pytest.mark.slow
def test_a_record_on_another_clock_judges_what_is_on_no_clock():
    """A load that acts in all that was fitted is simulated there, and errs where it is not."""
    always = record(load=LOAD)
    other = named("tuesday", record(load=LOAD, seed=1))
    found = sought(always, other)
    assert only(found).kind == "offset"
    assert found.held_out["extended_rmse"]["position"] == pytest.approx(2e-4, rel=0.1)
    assert not any("clock" in note for note in found.notes)
