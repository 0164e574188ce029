"""An estimate ends with its budget of time: the best until then, and what was not done."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import casid
from casid import time_limit
from casid.cli.main import main
from casid.estimation.simulation import simulation_error
from casid.estimation.simulation.budget import fit_budget
from casid.estimation.simulation.thresholds import FIT_BUDGET
from problems import roll_decay
from tests.support.moved_clock import MovedClock


@pytest.fixture(scope="module")
def record():
    """Two minutes of a decay, at 2 Hz."""
    return roll_decay.simulate(duration=120.0, C_3=0.0).decimate(10)


@pytest.fixture
def clock(monkeypatch):
    made = MovedClock()
    monkeypatch.setattr(time_limit, "time", made)
    return made


@pytest.fixture
def over_after(monkeypatch, clock):
    """The time is over after so many passes over the records with derivatives."""

    def arrange(passes: int) -> None:
        count = 0
        evaluate = simulation_error.SimulationError.evaluate

        def counted(self, x):
            nonlocal count
            count += 1
            found = evaluate(self, x)
            if count == passes:
                clock.ahead = 1e6
            return found

        monkeypatch.setattr(simulation_error.SimulationError, "evaluate", counted)

    return arrange


def test_the_default_grows_with_samples_and_unknowns_up_to_the_longest(record):
    model = roll_decay.problem.model
    unknowns = len(model.states) + sum(not p.is_known for p in model.parameters.values())
    one = casid.Experiment(record, {}, "a")
    each = FIT_BUDGET.per_value * unknowns * record.N
    assert fit_budget(model, [one], None) == pytest.approx(FIT_BUDGET.seconds + each)
    assert fit_budget(model, [one, one], None) == pytest.approx(FIT_BUDGET.seconds + 2 * each)
    assert fit_budget(model, [one] * 100_000, None) == FIT_BUDGET.longest
    assert fit_budget(model, [one], 5.0) == 5.0


def test_without_time_for_any_fit_there_is_a_clear_error(record):
    with pytest.raises(casid.SolveError, match=r"limit is over; raise it \(--budget SECONDS\)"):
        casid.identify(roll_decay.problem, record, budget=1e-6)


def test_a_fit_that_is_cut_off_gives_its_best_point_and_claims_nothing(record, over_after):
    over_after(4)
    found = casid.identify(roll_decay.problem, record)
    assert not found.is_converged
    assert found.status == "Maximum_WallTime_Exceeded"
    assert "starts" in found.not_done[0]
    assert all(p.std_error is None for p in (*found.parameters, *found.initial_states))
    assert any("budget of time ended" in w for w in found.warnings)
    written = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert written["converged"] is False
    assert written["not_done"] == list(found.not_done)
    assert "NOT converged" in casid.presentation.present(found, "page")


def test_the_best_point_is_better_than_the_start(record, over_after, clock):
    model = roll_decay.problem.model
    over_after(20)
    cut = casid.identify(roll_decay.problem, record)
    clock.ahead = 0.0
    start = simulation_error.SimulationError(model, [casid.Experiment(record, {}, "a")])
    values = {p.name: p.value for p in (*cut.parameters, *cut.initial_states)}
    best = np.array([values[name] for name in start.names])
    assert start.value_alone(best) < start.value_alone(start.start)


def test_starts_are_given_to_an_estimate_as_to_a_diagnosis(record):
    """Over the number in the settings, which keep all else."""
    settings = casid.FitSettings(starts=5, substeps=2)
    found = casid.identify(
        roll_decay.problem, record, settings=settings, starts=2, intervals="quick"
    )
    assert found.starts_tried == 2


def test_of_several_starts_those_that_ended_count(record, clock, monkeypatch):
    from casid.estimation.simulation import minimization

    solved, ended = minimization._solved, []

    def counted(*given):
        found = solved(*given)
        ended.append(found)
        if len(ended) == 2:
            clock.ahead = 1e6
        return found

    monkeypatch.setattr(minimization, "_solved", counted)
    settings = casid.FitSettings(starts=5, substeps=2)
    found = casid.identify(roll_decay.problem, record, settings=settings)
    assert found.is_converged
    assert found.starts_tried == 2
    assert "the search from 3 of 5 starts" in found.not_done
    assert found.parameters[0].std_error is not None


def test_a_budget_that_is_no_time_is_refused(record):
    with pytest.raises(casid.DataError, match=r"budget = -1 s is no time.*--budget 600"):
        casid.identify(roll_decay.problem, record, budget=-1.0)


def test_the_command_ends_with_status_zero_and_what_there_is(tmp_path, over_after):
    over_after(5)
    out = tmp_path / "out"
    run = CliRunner().invoke(main, ["identify", roll_decay.__file__, "--out", str(out)])
    assert run.exit_code == 0, run.output
    written = json.loads((out / "estimate.json").read_text())
    assert written["not_done"]
    assert not written["converged"]


def test_the_command_without_time_says_how_to_get_some(tmp_path):
    arguments = ["identify", roll_decay.__file__, "--budget", "1e-6", "--out", str(tmp_path / "o")]
    run = CliRunner().invoke(main, arguments)
    assert run.exit_code == 2
    assert "--budget SECONDS" in run.output
    assert not (tmp_path / "o").exists()
