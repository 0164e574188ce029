"""Monte Carlo studies: what is found of bias, spread and coverage, and how sure."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner, Result

from casid import time_limit
from casid.campaigns.accuracy import Accuracy, accuracy, accuracy_of
from casid.campaigns.campaign import Campaign
from casid.campaigns.monte_carlo import montecarlo, simulation_error
from casid.cli.main import main
from casid.data.experiment import Experiment
from casid.data.problem import Problem, load_problem
from casid.errors import CasidError, DataError, ModelError, SolveError
from casid.estimation.nlp.solver import Solver
from casid.estimation.simulation.fit import FitSettings
from casid.saving.archive import load
from tests.support.shared import ROOT

TANK = """\
import numpy as np
import casid

m = casid.Model("tank")
h = m.state("h", "m")
q = m.input("q", "m/s", hold="zoh")
a = m.parameter("a", "1/s", start=0.5, lower=0.01, upper=10)
b = m.parameter("b", "1", start=0.8, lower=0.1, upper=10)
m.derivative(h, b * q - a * h)
m.output("level", h, "m")


def draw(seed, a=0.7, b=1.2, Ts=0.1, N=150):
    rng = np.random.default_rng(seed)
    q = np.where(np.sin(0.3 * np.arange(N)) > 0, 1.0, -0.5)
    h, phi = np.zeros(N), np.exp(-a * Ts)
    for t in range(N - 1):  # exact for an input that is held
        h[t + 1] = phi * h[t] + b / a * (1 - phi) * q[t]
    level = h + 0.05 * rng.standard_normal(N)
    return [casid.Record({"q": q, "level": level}, {"q": "m/s", "level": "m"}, Ts)]


problem = casid.Problem(
    "tank", m, simulate=draw, truth={"a": 0.7, "b": 1.2}, starts=1
)
"""


@pytest.fixture
def tank(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Problem:
    """A problem with its file, `tank.py`, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    Path("tank.py").write_text(TANK)
    return load_problem("tank.py")


def without_file(problem: Problem) -> Problem:
    return replace(problem, source=None)


# ---------------------------------------------------------------------- the numbers


def test_coverage_has_the_binomial_interval_of_wilson() -> None:
    """8 of 10: 0.4902 to 0.9433 (Wilson 1927; Newcombe, Stat. Med. 17 (1998) 857-872, method 3)."""
    p = Accuracy("k", "1", 1.0, 10, 1.0, 0.1, 0.1, 10, 8)
    assert p.coverage == 0.8
    assert p.coverage_interval == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert p.remarks == ()  # 8.6 % of the studies of ten runs that keep 95 %: no more than chance
    assert "95 % intervals contain the truth too rarely" in replace(p, covered=5).remarks  # 6e-5
    always = replace(p, n=200, intervals=200, covered=200)
    assert "95 % intervals contain the truth too often" in always.remarks
    assert replace(p, truth=None, covered=0).coverage_interval is None


def test_accuracy_is_what_its_definitions_say() -> None:
    """Normal estimates about truth + 4: bias, spread and reported errors are told apart."""
    n, rng = 400, np.random.default_rng(3)
    table = pd.DataFrame(
        {
            "run": range(n),
            "k": 10 + 4 + 0.5 * rng.standard_normal(n),
            "k.std_error": np.where(np.arange(n) < 100, np.nan, 0.25),
            "d": 1 + 0.1 * rng.standard_normal(n),
            "d.std_error": 0.1,
            "rmse": 1.0,
            "failed": [None] * n,
        }
    )
    problem = Problem("p", _two_parameters(), truth={"k": 10.0, "d": 1.0})
    k, d = accuracy(problem, Campaign("c", 0, table))
    # Four standard errors: 0.5 / 20 for a mean, 0.5 / sqrt(800) for a standard deviation.
    assert k.bias == pytest.approx(4.0, abs=4 * 0.025)
    assert k.bias_std_error == pytest.approx(0.025, rel=4 / np.sqrt(800))
    assert k.spread == pytest.approx(0.5, rel=4 / np.sqrt(800))
    assert (k.mean_std_error, k.intervals, k.covered) == (0.25, 300, 0)
    assert [re.sub(r"[\d.]+", "#", r) for r in k.remarks] == [
        "biased by # standard deviations",
        "# % intervals contain the truth too rarely",
        "# runs without interval",
    ]
    assert d.coverage == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / n))
    assert d.remarks == ()


@pytest.mark.parametrize("n", [3, 4, 30])
def test_chance_alone_is_called_bias_as_rarely_for_few_runs_as_for_many(n: int) -> None:
    """Student's t: 0.27 % of unbiased means, whatever n; four binomial standard errors allowed."""
    draws, rng = 4000, np.random.default_rng(n)
    called = 0
    for k in 10 + rng.standard_normal((draws, n)):
        p = Accuracy("k", "1", 10.0, n, float(k.mean()), float(k.std(ddof=1)), 1.0, n, n)
        called += any("biased" in r for r in p.remarks)
    assert abs(called - 0.0027 * draws) < 4 * np.sqrt(0.0027 * draws)
    surely = Accuracy("k", "1", 10.0, n, 11.0, 0.0, 1.0, n, n)  # a simulator without noise
    assert "biased by infinitely many standard deviations" in surely.remarks


def test_a_printed_study_fits_into_100_columns() -> None:
    """The widest numbers, a long name, a long unit and a long message."""
    from casid.campaigns.monte_carlo import MonteCarlo

    rows = tuple(
        Accuracy(name, unit, -1.23457e-05, 100, -1.2345e-5, 1.11e-5, 1.11e-5, 100, 100)
        for name, unit in (("d", "N m s/rad"), ("friction_of_the_joint", "N m s^2/rad^2"))
    )
    table = pd.DataFrame({"run": [0, 1], "failed": [None, "DataError: " + 30 * "a word "]})
    lines = str(MonteCarlo("p" * 30, "m" * 50, Campaign("c", 0, table), rows)).splitlines()
    assert max(len(line) for line in lines) <= 100
    assert "  friction_of_the_joint [N m s^2/rad^2]" in lines
    assert any("often" in line for line in lines)


def _two_parameters() -> Any:
    import casid

    m = casid.Model("two")
    x = m.state("x", "m")
    k, d = m.parameter("k", "m/s", start=1.0), m.parameter("d", "1/s", start=1.0)
    m.derivative(x, k - d * x)
    m.output("x", x, "m")
    return m


# ---------------------------------------------------------------------- studies


@pytest.mark.slow
def test_the_estimate_of_a_model_in_the_set_is_unbiased_and_covers(tank: Problem) -> None:
    """White output noise: least squares is maximum likelihood, its covariance asymptotic.

    With 150 samples the robust standard errors are a few per cent small, and the bias of order
    variance; four standard errors of 100 runs are 8.7 points of coverage and 28 % of a spread.
    """
    result = montecarlo(tank, runs=100, seed=1)
    assert not result.failures
    for p in result.parameters:
        assert abs(p.bias or 0.0) < 4 * p.bias_std_error
        assert p.mean_std_error == pytest.approx(p.spread, rel=0.28)
        assert p.coverage == pytest.approx(0.95, abs=0.087)
        assert p.unit == {"a": "1/s", "b": "1"}[p.name]
    assert result.estimates("a").shape == (100,)
    with pytest.raises(KeyError, match="there are a, b"):
        result["c"]


def test_a_study_is_saved_and_read_again_whole(tank: Problem, tmp_path: Path) -> None:
    def half_of_them(problem: Problem, records: Any, settings: FitSettings) -> Any:
        if records[0].record["level"][0] > 0:  # the noise at rest
            raise SolveError("no optimum")
        return simulation_error(problem, records, settings)

    study = montecarlo(tank, runs=6, method=half_of_them, seed=1)
    assert 0 < len(study.campaign.failures) < 6
    again = load(study.save(tmp_path / "study.casid"))
    pd.testing.assert_frame_equal(again.campaign.table, study.campaign.table)
    assert again.parameters == study.parameters
    assert again.to_json() == study.to_json()
    assert str(again) == str(study)


def test_a_wrong_known_value_biases_as_the_static_gain_says(tank: Problem) -> None:
    """In steady state h = b/a q: with b held 10 % high, a comes out about 10 % high as well."""
    result = montecarlo(tank.with_known({"b": 1.1 * 1.2}), runs=6)
    assert [p.name for p in result.parameters] == ["a"]
    assert result["a"].mean / 0.7 == pytest.approx(1.1, abs=0.05)
    assert any("biased" in remark for remark in result["a"].remarks)


@pytest.mark.slow
def test_processes_load_the_problem_and_find_the_same(tank: Problem, tmp_path: Path) -> None:
    """The known values, the settings and the duration go with it."""
    known = tank.with_known({"b": 1.25})
    arguments: dict[str, Any] = {"runs": 5, "seed": 4, "duration": 9.0, "settings": FitSettings(2)}
    one = montecarlo(known, **arguments)
    with joblib.parallel_config(n_jobs=2):
        two = montecarlo(known, **arguments, out="out")
    pd.testing.assert_frame_equal(one.campaign.table, two.campaign.table, check_exact=True)
    assert str(one) == str(two)
    manifest = json.loads(Path("out/campaign.json").read_text())
    assert manifest["settings"]["known"] == {"b": 1.25}
    assert manifest["settings"]["duration"] == 9.0


@pytest.mark.slow
def test_a_problem_that_processes_cannot_have_is_refused_with_the_mend(tank: Problem) -> None:
    changed = replace(tank, truth={"a": 0.9})
    assert montecarlo(without_file(tank), runs=1)["a"].n == 1
    for problem, words in ((without_file(tank), "write it to a file"), (changed, "in the file")):
        with joblib.parallel_config(n_jobs=2), pytest.raises(CasidError) as refusal:
            montecarlo(problem, runs=2)
        assert words in str(refusal.value)
        assert "n_jobs=1" in str(refusal.value)


def test_a_study_of_another_problem_file_is_not_continued(tank: Problem) -> None:
    montecarlo(tank, runs=1, out="out")
    Path("tank.py").write_text(TANK.replace("0.05 * rng", "0.06 * rng"))
    with pytest.raises(DataError, match="problem sha256"):
        montecarlo("tank.py", runs=1, out="out")


def test_any_function_of_problem_and_experiments_is_a_method(tank: Problem) -> None:
    from casid.campaigns.monte_carlo import simulation_error

    def halved(problem: Problem, experiments: Any, settings: FitSettings) -> Any:
        records = [replace(e, record=e.record.between(0.0, 7.4)) for e in experiments]
        return simulation_error(problem, records, settings)

    whole, half = (montecarlo(tank, runs=2, method=m) for m in ("identify", halved))
    assert half["a"].mean_std_error > whole["a"].mean_std_error
    assert half.method.endswith("halved")


def staged(problem: Problem, experiments: Any, settings: FitSettings) -> Any:
    """Stage 1: d and I_x of the nominal pendulum; its stiffness is known."""
    import casid
    from problems.pendulum import TABLE_7_2

    known = problem.model.with_known(k=TABLE_7_2["k"])
    instruments = casid.Instruments("ref", casid.ReferenceFilter.lag(0.1))
    return casid.multistage(known, experiments, [casid.StageSpec(["I_x", "d"])], instruments)


@pytest.mark.slow
def test_instrumental_variables_are_studied_as_any_other_method() -> None:
    """Truth within five Monte Carlo standard errors (t(5): one in 250), and the bilinear
    map's relative offset of 4e-4 at 6.7 rad/s and 0.01 s."""
    result = montecarlo(ROOT / "problems" / "pendulum.py", runs=6, duration=40.0, method=staged)
    assert not result.failures
    assert [p.name for p in result.parameters] == ["I_x", "d"]
    for p in result.parameters:
        assert p.truth is not None
        assert abs(p.bias or 0.0) < 5 * p.bias_std_error + 4e-3 * p.truth
        assert p.intervals == 6
    assert result.method.endswith("staged")


def test_a_method_that_returns_no_estimate_is_told_what_to_return(tank: Problem) -> None:
    with pytest.raises(SolveError, match=r"returned float.*casid.Estimate.*\.estimate"):
        montecarlo(tank, runs=2, method=lambda problem, records, settings: 0.7)

    def wrapped(problem: Problem, experiments: Any, settings: FitSettings) -> Any:
        from types import SimpleNamespace

        from casid.campaigns.monte_carlo import simulation_error

        return SimpleNamespace(estimate=simulation_error(problem, experiments, settings))

    assert montecarlo(tank, runs=1, method=wrapped)["a"].n == 1


@pytest.mark.parametrize("solver", ["foo", "sqpmethod"])
def test_a_solver_is_known_before_the_first_run(tank: Problem, solver: str) -> None:
    drawn: list[int] = []

    def draw(seed: int) -> Any:
        drawn.append(seed)
        return tank.simulated(seed)

    watched = replace(tank, simulate=draw)
    settings = FitSettings(solver=Solver(solver), starts=1)
    if solver == "foo":
        with pytest.raises(SolveError, match="solver 'foo' is no CasADi plug-in.*'sqpmethod'"):
            montecarlo(watched, runs=2, settings=settings)
        assert not drawn
    else:
        assert montecarlo(watched, runs=2, settings=settings)["a"].n == 2
        named = FitSettings(solver=solver, starts=1)  # type: ignore[arg-type]
        assert montecarlo(watched, runs=1, settings=named)["a"].n == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"method": "guess"}, "no method 'guess'; there are identify"),
        ({"runs": 10.0}, "runs = 10.0; give a whole number, for example runs=10"),
        ({"runs": None}, "runs = None; give a whole number"),
        ({"duration": -1.0}, "give a positive number"),
    ],
)
def test_studies_that_cannot_be_meant_are_refused(
    tank: Problem, arguments: dict[str, Any], words: str
) -> None:
    with pytest.raises(DataError, match=words):
        montecarlo(tank, **arguments)


def test_problems_that_cannot_be_studied_are_refused(tank: Problem) -> None:
    with pytest.raises(DataError, match=r"no simulator.*simulate=f, truth="):
        montecarlo(replace(tank, simulate=None))
    with pytest.raises(ModelError, match=r"model tank .*casid.Problem\(name, model, simulate=f"):
        montecarlo(tank.model)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="no unknown parameter left"):
        montecarlo(tank.with_known({"a": 0.7, "b": 1.2}))
    with pytest.raises(DataError, match="returns no experiment"):
        replace(tank, simulate=lambda seed: []).simulated(1)
    with pytest.raises(DataError, match="simulator of problem tank returns no experiment"):
        replace(tank, simulate=lambda seed: ["run 1"]).simulated(1)  # type: ignore[list-item]
    alone = tank.simulated(1)[0].record
    (experiment,) = replace(tank, simulate=lambda seed: alone).simulated(1)
    assert experiment.record is alone
    with pytest.raises(ModelError, match="truth of 'c' = 1"):
        replace(tank, truth={"c": 1.0})
    nothing = replace(tank, simulate=lambda seed: [Experiment(tank.simulated(1)[0].record)] * seed)
    with pytest.raises(SolveError, match="all 2 runs failed"):
        montecarlo(replace(nothing, simulate=lambda seed: 1 / 0), runs=2)  # type: ignore[arg-type]


def test_a_truth_that_no_estimate_reaches_is_refused_before_the_first_run(tank: Problem) -> None:
    """All intervals would end at the bound, and the study call the error bars not reliable."""
    with pytest.raises(DataError, match="truth of a, 70 1/s, lies outside its bounds, 0.01 to"):
        montecarlo(replace(tank, truth={"a": 70.0, "b": 1.2}), runs=2)


# ---------------------------------------------------------------------- figure and page


def test_histograms_hold_every_estimate_and_the_page_says_the_numbers(tank: Problem) -> None:
    result = montecarlo(tank, runs=12)
    figure = result.plot()
    bars = [t for t in figure.data if t.type == "bar"]
    assert [sum(t.y) for t in bars] == [12, 12]
    truth = [t.x[0] for t in figure.data if t.name == "truth"]
    assert truth == [0.7, 1.2]
    assert figure.layout.xaxis.title.text == "a [1/s]"
    curve = next(t for t in figure.data if t.name == "predicted by the standard errors")
    # The normal density: its area is the bars', but for the 0.05 % beyond 3.5 sigma.
    bar_area = 12 * bars[0].width
    assert np.trapezoid(curve.y, curve.x) == pytest.approx(bar_area, rel=2e-3)
    result.write(Path("out"))
    page = Path("out/report.html").read_text()
    assert "Monte Carlo study of tank" in page
    assert result["a"].mean_text in page
    content = json.loads(Path("out/montecarlo.json").read_text())
    assert content["schema"] == "casid.montecarlo/1"
    assert content["parameters"]["a"]["coverage"] == result["a"].coverage
    assert content["failed"] == 0


# ---------------------------------------------------------------------- the command


def casid(*arguments: str) -> Result:
    result = CliRunner().invoke(main, ["montecarlo", *arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception  # a traceback: a fault of casid
    return result


def test_the_command_continues_its_own_study_and_no_other(tank: Problem) -> None:
    first = casid("tank.py", "--runs", "3", "--jobs", "1")
    assert first.exit_code == 0
    assert first.stdout.startswith("Monte Carlo study of tank: 3 runs with seed 0")
    assert "wrote reports/tank-montecarlo-1/report.html" in first.stderr
    files = ["campaign.json", "montecarlo.json", "report.html", "results.parquet"]
    assert sorted(p.name for p in Path("reports/tank-montecarlo-1").iterdir()) == files
    more = casid("tank.py", "--runs", "4", "--jobs", "1", "--json")
    assert json.loads(more.stdout)["runs"] == 4
    assert "3 of 4 runs were done before" in more.stderr
    same_study = montecarlo("tank.py", runs=4, out="reports/tank-montecarlo-1")
    assert same_study.campaign.found == 4  # the library call is the command's
    assert casid("tank.py", "--runs", "1", "--seed", "2", "--jobs", "1", "--quiet").stderr == ""
    assert sorted(p.name for p in Path("reports").iterdir()) == [
        "tank-montecarlo-1",
        "tank-montecarlo-2",
    ]
    there = ("tank.py", "--runs=1", "--seed=9", "--jobs=1", "--out=reports/tank-montecarlo-1")
    other = casid(*there)
    assert other.exit_code == 2
    assert "seed is 0 there and 9 now" in other.stderr
    assert "--force" in other.stderr
    assert casid(*there, "--force").exit_code == 0
    Path("full").mkdir()
    Path("full/file").touch()
    assert "not empty" in casid("tank.py", "--out", "full").stderr


def test_the_command_refuses_what_cannot_be_meant(tank: Problem) -> None:
    Path("mute.py").write_text(TANK.replace("simulate=draw, ", ""))
    for arguments, words in {
        ("mute.py",): "no simulator",
        ("tank.py", "--method", "guess"): "there are identify",
        ("tank.py", "--runs", "0"): "x>=1",
        ("tank.py", "--solver", "foo"): "--solver name",
        ("tank.py", "--set", "c=1"): "no parameter 'c'",
        ("tank.py", "--jobs", "2", "--dask", "tcp://127.0.0.1:1"): "contradict",
    }.items():
        result = casid(*arguments)
        assert result.exit_code == 2
        assert words in result.stderr
        assert not Path("reports").exists()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_an_interrupted_study_says_what_is_kept_and_continues(tank: Problem) -> None:
    command = [sys.executable, "-m", "casid", "montecarlo", "tank.py", "--runs", "5000"]
    with Path("stderr").open("w") as stderr:
        running = subprocess.Popen(
            [*command, "--jobs", "1", "--out", "out"],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=stderr,
        )
    while running.poll() is None and not list(Path("out/parts").glob("*.parquet")):
        time.sleep(0.02)
    running.send_signal(signal.SIGINT)
    assert running.wait(timeout=600) == 130
    message = re.search(
        r"error: interrupted; (\d+) runs are kept in out", Path("stderr").read_text()
    )
    assert message is not None
    kept = int(message[1])
    result = casid("tank.py", "--runs", str(kept + 1), "--out", "out", "--jobs", "1", "--json")
    assert f"{kept} of {kept + 1} runs were done before" in result.stderr
    assert json.loads(result.stdout)["runs"] == kept + 1


@pytest.mark.slow
def test_the_command_works_on_a_dask_cluster(tank: Problem) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        on_dask = casid("tank.py", "--runs", "4", "--dask", cluster.scheduler_address, "--json")
    here = casid("tank.py", "--runs", "4", "--jobs", "1", "--json", "--out", "here")
    assert on_dask.exit_code == 0
    assert on_dask.stdout == here.stdout


# ---------------------------------------------------------------------- a budget of time


class Clock:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self.ahead = 0.0

    def monotonic(self) -> float:
        return time.monotonic() + self.ahead


def test_a_study_ends_with_its_budget_and_the_same_call_goes_on(
    tank: Problem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    clock = Clock()
    monkeypatch.setattr(time_limit, "time", clock)
    ended = []

    def method(problem, experiments, settings):
        ended.append(simulation_error(problem, experiments, settings))
        clock.ahead = 1e6 if len(ended) == 3 else clock.ahead
        return ended[-1]

    study = montecarlo(tank, runs=8, method=method, out=tmp_path / "s", budget=1000.0)
    assert study.campaign.runs == 3
    assert study.not_done == ("5 of 8 runs",)
    assert study.to_json()["not_done"] == ["5 of 8 runs"]
    assert "5 of 8 runs" in str(study)
    whole = montecarlo(tank, runs=8, method=method, out=tmp_path / "s")
    assert (whole.campaign.found, whole.campaign.runs, whole.not_done) == (3, 8, ())
    alone = montecarlo(tank, runs=8, method=method)
    assert alone.estimates("a").tolist() == whole.estimates("a").tolist()


def test_a_run_that_the_budget_cuts_off_does_not_count(
    tank: Problem, monkeypatch: pytest.MonkeyPatch
):
    clock = Clock()
    monkeypatch.setattr(time_limit, "time", clock)
    begun = []

    def method(problem, experiments, settings):
        begun.append(None)
        clock.ahead = 1e6 if len(begun) == 2 else clock.ahead
        return simulation_error(problem, experiments, settings)

    study = montecarlo(tank, runs=4, method=method, budget=1000.0)
    assert study.campaign.runs == 1
    assert not study.failures
    assert study.not_done == ("3 of 4 runs",)


def test_a_study_without_time_for_any_run_says_so(tank: Problem):
    with pytest.raises(SolveError, match=r"no run ended.*--budget SECONDS"):
        montecarlo(tank, runs=2, budget=1e-9)
    with pytest.raises(DataError, match="budget = -1 s is no time"):
        montecarlo(tank, runs=2, budget=-1.0)


def test_coverage_is_that_of_the_intervals_whatever_their_kind():
    value, error = np.array([1.0, 2.0, 0.0]), np.array([0.1, 0.1, np.nan])
    ends = np.array([0.5, 0.5, 0.0]), np.array([1.1, np.inf, 1.2])
    normal, own = (accuracy_of("k", "1", 1.15, value, error, e) for e in ((), ends))
    assert (normal.intervals, normal.covered) == (2, 1)
    assert (own.intervals, own.covered) == (3, 2)
