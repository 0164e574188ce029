"""Limits of time: around a call, and as long as the machine needs."""

from __future__ import annotations

import math

import pytest

import casid
from casid.time_limit import (
    no_time_limit,
    processor_clock,
    require_time,
    seconds_left,
    time_factor,
    until,
    wall_clock,
)


def test_the_earliest_limit_around_the_work_counts(monkeypatch):
    monkeypatch.setenv("CASID_TIME_FACTOR", "1")
    assert seconds_left() == math.inf
    with until(wall_clock() + 100.0):
        with until(wall_clock() + 1e6):
            assert 90.0 < seconds_left() <= 100.0
        with no_time_limit():
            assert seconds_left() == math.inf
        with until(wall_clock()), pytest.raises(casid.CasidError, match="raise it"):
            require_time("the fit")
    assert seconds_left() == math.inf


@pytest.mark.parametrize("clock", [wall_clock, processor_clock])
def test_the_factor_makes_every_second_of_a_limit_as_much_longer(clock, monkeypatch):
    monkeypatch.setenv("CASID_TIME_FACTOR", "1")
    plain = clock()
    monkeypatch.setenv("CASID_TIME_FACTOR", "4")
    assert time_factor() == 4.0
    slow = clock()
    monkeypatch.setenv("CASID_TIME_FACTOR", "1")
    assert plain <= 4.0 * slow <= clock()


@pytest.mark.parametrize("text", ["0", "-2", "nan", "inf", "five"])
def test_a_factor_that_is_no_number_is_refused(text, monkeypatch):
    monkeypatch.setenv("CASID_TIME_FACTOR", text)
    with pytest.raises(casid.DataError, match=f"CASID_TIME_FACTOR={text}.*for example 5"):
        time_factor()
