"""Which kind of interval a parameter has: by the stated rule, and said wherever the interval is."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import casid
from casid import time_limit
from casid.cli.main import main
from casid.estimation.intervals import choice
from casid.estimation.intervals.quadratic_check import NotQuadratic
from casid.identification.identify import identify
from casid.presentation import present
from problems import roll_decay
from tests.estimation.intervals.test_profile import (
    gain_and_offset,
    lag_problem,
    linear_record,
    spring_problem,
    step_response,
    swing,
)
from tests.support.moved_clock import MovedClock


def test_a_parabola_keeps_its_normal_intervals():
    found = identify(gain_and_offset(), linear_record())
    for p in found.parameters:
        assert p.interval_kind == "quick"
        assert p.interval == pytest.approx(
            (p.value - 1.96 * p.std_error, p.value + 1.96 * p.std_error)
        )
    assert "quadratic that far" in found.intervals["quick"]


def test_a_skewed_criterion_gives_the_profile_and_it_is_said_everywhere(tmp_path):
    found = identify(lag_problem(), step_response(4, sd=0.06))
    tau = found.parameter("tau")
    low, high = tau.interval
    assert tau.interval_kind == "profile"
    assert high - tau.value > 1.2 * (tau.value - low)
    assert "scaled" in found.intervals["profile"]
    written = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert written["parameters"]["tau"]["interval_kind"] == "profile"
    assert written["parameters"]["tau"]["interval"] == [low, high]
    assert written["intervals"]["profile"] == found.intervals["profile"]
    assert "(profile)" in str(found)
    assert "K, tau: profile" in str(found)
    page = present(found, "page")
    assert "(profile)" in page
    assert "Intervals of K, tau: profile" in page
    bars = present(found, "figure").data[0].error_x
    assert bars.symmetric is False
    assert bars.array[0] > bars.arrayminus[0]
    again = casid.load(found.save(tmp_path / "a.casid"))
    assert again.parameter("tau").interval == (low, high)


def test_an_interval_is_shown_in_the_declared_unit():
    m = casid.Model("lag")
    x = m.state("x", "1", initial=0.0)
    u = m.input("u", "1", hold="zoh")
    K = m.parameter("K", "1", start=1.0, lower=1e-3, upper=30)
    tau = m.parameter("tau", "min", start=1 / 60, lower=1e-3, upper=0.5)
    m.derivative(x, (K * u - x) / tau)
    m.output("y", x, "1")
    problem = casid.Problem("lag", m, noise={"u": 0.0}, starts=1)
    record = step_response(4, sd=0.06)
    in_minutes = identify(problem, record).parameter("tau").interval
    in_seconds = identify(lag_problem(), record).parameter("tau").interval
    assert 60 * np.array(in_minutes) == pytest.approx(np.array(in_seconds), rel=0.02)


def test_near_a_bound_the_interval_ends_there():
    estimates = [identify(spring_problem(), swing(seed, 0.0)) for seed in range(6)]
    near = [e.parameter("d") for e in estimates if e.parameter("d").interval[0] == 0.0]
    assert near
    for d in near:
        assert d.interval_kind == "profile"
        if d.std_error is not None:  # not at the bound, and the normal one leaves what is allowed
            assert d.value - 2 * d.std_error < 0.0


def test_quick_keeps_normal_intervals_and_says_that_they_were_not_tested():
    found = identify(lag_problem(), step_response(4, sd=0.06), intervals="quick")
    assert {p.interval_kind for p in found.parameters} == {"quick"}
    assert "not tested" in found.intervals["quick"]


def test_what_there_is_no_time_for_is_normal_and_said(monkeypatch):
    clock, profile_interval = MovedClock(), choice.profile_interval

    def then_over(*given):
        found = profile_interval(*given)
        clock.ahead = 1e6
        return found

    monkeypatch.setattr(time_limit, "time", clock)
    monkeypatch.setattr(choice, "profile_interval", then_over)
    found = identify(lag_problem(), step_response(4, sd=0.06))
    kinds = [p.interval_kind for p in found.parameters]
    assert kinds == ["profile", "quick"]
    assert found.is_converged
    assert found.not_done == ("the test whether intervals are normal",)


def test_one_warning_names_all_that_are_normal_for_the_same_reason():
    curved = "the criterion does not rise as a parabola does"
    why = {
        "a": NotQuadratic(curved, "by 9 and 2"),
        "b": NotQuadratic("a bound is near", "0.3 standard errors away"),
        "c": NotQuadratic(curved, "by 1 and 2"),
    }
    first, second = choice.normal_nevertheless(why)
    assert first.startswith(
        f"the intervals of a and c are normal, though {curved} (by 9 and 2 for a, by 1 and 2 for c)"
    )
    assert second.startswith(
        "the interval of b is normal, though a bound is near (0.3 standard errors away): the bias"
    )
    assert not list(choice.normal_nevertheless({}))


def test_another_word_is_refused():
    with pytest.raises(casid.DataError, match="intervals = 'profiles'; did you mean 'profile'"):
        identify(gain_and_offset(), linear_record(), intervals="profiles")


def test_the_command_takes_the_kind(tmp_path):
    arguments = ["identify", roll_decay.__file__, "--intervals", "profile", "--starts", "1"]
    run = CliRunner().invoke(main, [*arguments, "--out", str(tmp_path / "o")])
    assert run.exit_code == 0, run.output
    written = json.loads((tmp_path / "o" / "estimate.json").read_text())
    free = [p for p in written["parameters"].values() if not p["known"]]
    assert {p["interval_kind"] for p in free} == {"profile"}
