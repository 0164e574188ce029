"""A diagnosis ends with its budget of time: it gives what it has and says what was not done."""

from __future__ import annotations

import json
import time

import pytest

import casid
from casid import time_limit
from problems import roll_decay


@pytest.fixture
def record():
    """Two minutes of a decay with drag, at 2 Hz."""
    return roll_decay.simulate(duration=120.0, C_3=0.0).decimate(10)


class Clock:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self.ahead = 0.0

    def monotonic(self) -> float:
        return time.monotonic() + self.ahead


def ended_at(line, record, monkeypatch, **settings):
    """The diagnosis of a record, its budget over at the line of progress given."""
    clock = Clock()
    monkeypatch.setattr(time_limit, "time", clock)

    def progress(text: str) -> None:
        if text.startswith(line):
            clock.ahead = 1e6

    return casid.diagnose(roll_decay.problem, record, progress=progress, **settings)


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


@pytest.mark.slow
def test_after_the_search_the_causes_stand_and_the_rest_is_listed(record, monkeypatch):
    found = ended_at("test every effect (round 2)", record, monkeypatch)
    assert found.verdict == "deficient"
    assert found.causes[0].kind == "quadratic_damping"
    assert "round 2 of the search" in found.not_done
    assert not found.proposals


def test_a_budget_that_is_no_time_is_refused(record):
    with pytest.raises(casid.DataError, match=r"budget = -1 s is no time.*--budget 600"):
        casid.diagnose(roll_decay.problem, record, budget=-1.0)
