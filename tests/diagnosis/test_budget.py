"""A diagnosis ends with its budget of time: it gives what it has and says what was not done."""

from __future__ import annotations

import json

import pytest

import casid
from casid import time_limit
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.thresholds import BUDGET
from casid.time_limit import wall_clock
from problems import roll_decay
from tests.support.moved_clock import MovedClock


@pytest.fixture
def record():
    """Two minutes of a decay with drag, at 2 Hz."""
    return roll_decay.simulate(duration=120.0, C_3=0.0).decimate(10)


def late_at(line, seconds, record, monkeypatch, **settings):
    """The diagnosis of a record whose clock leaps, once, at the line of progress given."""
    clock = MovedClock()
    monkeypatch.setattr(time_limit, "time", clock)

    def progress(text: str) -> None:
        if text.startswith(line):
            clock.ahead = clock.ahead or seconds

    return casid.diagnose(roll_decay.problem, record, progress=progress, **settings)


def ended_at(line, record, monkeypatch, **settings):
    """The diagnosis of a record, its budget over at the line of progress given."""
    return late_at(line, 1e6, record, monkeypatch, **settings)


def taken(line, share, record, monkeypatch):
    """The diagnosis of a record, a share of the time for causes over at the line of progress."""
    for_causes = BUDGET.search * BUDGET.adoption * 10_000 * time_limit.time_factor()
    late = share * for_causes
    return late_at(line, late, record, monkeypatch, budget=10_000.0, advise=False)


def test_without_time_to_fit_the_model_nothing_is_claimed(record):
    found = casid.diagnose(roll_decay.problem, record, budget=1e-6)
    assert not found.causes
    assert found.verdict == "undecided"
    assert "raise the budget (--budget)" in found.sentence


def test_a_search_that_is_cut_off_names_nothing_and_lists_what_was_not_done(record, monkeypatch):
    found = ended_at("refit 3/", record, monkeypatch)
    assert found.verdict == "undecided"
    assert not found.causes
    assert "budget" in found.sentence
    assert len(found.not_done) > 2
    assert any("budget of time ended" in note for note in found.notes)
    written = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert written["not_done"] == list(found.not_done)


def test_refits_leave_time_to_adopt_the_best_of_them(monkeypatch):
    """Each attempt takes 1 s of a clock; 0.6 of 100 s are the refits', the rest is kept."""
    clock = MovedClock()
    monkeypatch.setattr(time_limit, "time", clock)
    attempts = Attempts(ends=wall_clock() + 100 / time_limit.time_factor())

    def a_second() -> bool:
        clock.ahead += 1.0
        return True

    with attempts.within(0.6):
        refitted = [attempts.attempt(f"refit {i}", a_second) for i in range(90)]
    assert 58 <= sum(map(bool, refitted)) <= 61
    assert len(attempts.not_done) == refitted.count(None)
    assert attempts.attempt("adopt the best", a_second)
    clock.ahead += 50.0
    assert attempts.attempt("the next round", a_second) is None


@pytest.mark.slow
def test_the_leader_is_adopted_where_the_time_of_its_refits_ends(record, monkeypatch):
    """The clock stands but for the first refits: a few of them take their share of the time."""
    found = taken("refit 4/", 0.65, record, monkeypatch)
    assert found.verdict == "deficient"
    assert found.causes[0].kind == "quadratic_damping"
    assert any("budget of time ended" in note for note in found.notes)


@pytest.mark.slow
def test_after_the_search_the_causes_stand_and_the_rest_is_listed(record, monkeypatch):
    found = ended_at("test every effect (round 2)", record, monkeypatch)
    assert found.verdict == "deficient"
    assert found.causes[0].kind == "quadratic_damping"
    assert "round 2 of the search" in found.not_done
    assert not found.proposals


@pytest.mark.slow
def test_causes_found_when_the_rounds_end_are_tested_beside_each_other(record, monkeypatch):
    """The clock stands but for the second round, which takes what the rounds have of the search."""
    found = taken("test every effect (round 2)", 0.9, record, monkeypatch)
    assert "round 2 of the search" in found.not_done
    assert not [what for what in found.not_done if what.startswith("the test whether")]


def test_a_budget_that_is_no_time_is_refused(record):
    with pytest.raises(casid.DataError, match=r"budget = -1 s is no time.*--budget 600"):
        casid.diagnose(roll_decay.problem, record, budget=-1.0)
