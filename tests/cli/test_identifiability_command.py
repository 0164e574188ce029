"""`casid identifiability` from the outside: files, refusals with their mend, what it prints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import casid
from casid.cli.main import main
from casid.identifiability.remedies.replicas import replicas_needed
from tests.support.shared import ROOT

PUSH = """
states = ["v"]
params = ["F", "m"]
equations.v = "F/m"
outputs.a = "F/m"
"""
SPRING = """
states = ["x", "v"]
params = ["k", "m", "d"]
inputs = ["u"]
equations = {x = "v", v = "(u - k*x - d*v)/m"}
outputs.y = "x"
"""
BARE = """
import casid

m = casid.Model("decay")
x, a = m.state("x", "m"), m.parameter("a", "1/s", start=1.0)
m.derivative(x, -a * x)
m.output("x", x, "m")
problem = casid.Problem("decay", m)
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "push.toml").write_text(PUSH)
    (tmp_path / "spring.toml").write_text(SPRING)
    (tmp_path / "branch.toml").write_text(SPRING.replace("k*x", "k*min(x, 1)"))
    (tmp_path / "decay.py").write_text(BARE)
    return tmp_path


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["identifiability", *arguments])


def test_the_force_on_a_mass_is_told_up_to_their_ratio(here: Path) -> None:
    done = run("push.toml", "--json", "--quiet", "--out", "push")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert (found["rank"], found["unknowns"]) == (1, 3)
    assert found["confounded_groups"] == [["F", "m"]]
    assert found["minimal_fixing_sets"] == [["F"], ["m"]]
    assert json.loads((here / "push" / "identifiability.json").read_text()) == found
    assert (here / "push" / "report.html").read_text().startswith("<!DOCTYPE html>")


REFUSED: dict[str, tuple[list[str], list[str]]] = {
    "data beside equations": (["spring.toml", "run.csv"], ["equations alone", "problem file"]),
    "an ending of neither kind": (["spring.yaml"], [".json or .toml"]),
    "a file that is not there": (["sprin.toml"], ["no such equation file", "'spring.toml'"]),
    "a state that is not there": (["spring.toml", "--known-initial", "z"], ["'z'", "x"]),
    "an initial value in words": (["spring.toml", "--known-initial", "x=low"], ["name=value"]),
    "a point in words": (["spring.toml", "--at", "k=soft"], ["--at k=soft", "name=value"]),
    "a sensor without formula": (["spring.toml", "--sensor", "s"], ["name=formula"]),
    "a sensor of nothing known": (["spring.toml", "--sensor", "s=q"], ["sensor s", "'q'"]),
    "a sensor that is no formula": (["spring.toml", "--sensor", "s=x+*2"], ["sensor s"]),
    "a cost in words": (["spring.toml", "--sensor", "s=x@much"], ["cost 'much'", "formula@cost"]),
    "a sensor that is there": (["push.toml", "--sensor", "a=v"], ["output 'a'", "rename"]),
    "a branch": (["branch.toml"], ["min", "each branch as a model of its own"]),
    "a profile of equations": (["spring.toml", "--profile", "k"], ["records", "leave it out"]),
    "a profile without records": (["decay.py", "--profile", "a"], ["records", "leave it out"]),
    "a profile without fits": (["decay.py", "--profile", "a", "--structural"], ["drop one"]),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_used_is_refused_with_its_mend(here: Path, what: str) -> None:
    arguments, words = REFUSED[what]
    done = run(*arguments, "--quiet")
    assert done.exit_code == 2, done.output
    for word in words:
        assert word in done.stderr
    assert not (here / "reports").exists()


def test_a_sensor_that_nothing_needs_is_not_weighed_in_silence(here: Path) -> None:
    done = run("spring.toml", "--sensor", "speed=v", "--quiet")
    assert done.exit_code == 0, done.output
    assert "not compared" in done.stdout


def chain(n: int) -> dict[str, Any]:
    rates = {f"x{i}": f"k{i}*x{i - 1} - k{(i + 1) % n}*x{i}" for i in range(n)}
    return {
        "states": [f"x{i}" for i in range(n)],
        "params": [f"k{i}" for i in range(n)],
        "inputs": ["u"],
        "equations": {**rates, "x0": "u - k1*x0"},
        "outputs": {"y": f"x{n - 1}"},
    }


def test_very_many_undecided_parameters_are_counted_not_listed() -> None:
    system = casid.parse_system(chain(90), name="chain")
    text = str(casid.assess_identifiability(system, time_limit=1e-9))
    assert "Time ran out" in text
    assert "k39 and 50 more are undecided" in " ".join(text.split())


def test_where_one_replica_tells_nothing_no_number_of_them_does() -> None:
    """The parameter acts on nothing, so its information is zero in each replica and in all."""
    system = casid.parse_system(
        {
            "states": ["x"],
            "params": ["a"],
            "inputs": ["v"],
            "equations": {"x": "v + 0*a"},
            "outputs": {"y": "x"},
        },
        name="drift",
    )
    told = replicas_needed(system)
    assert (told.is_cut, told.needed, told.enough) == (False, None, 1)
    assert "no number of them" in told.conclusion
    assert told.deficiency(7) == 1


def test_an_error_beside_a_value_of_zero_is_no_verdict_against_the_records() -> None:
    """The offset starts at zero: no error is relative to it, and none makes it unidentifiable."""
    problem = casid.load_problem(ROOT / "problems" / "roll_decay.py")
    found = casid.assess_identifiability(problem)
    assert found.practical is not None
    assert found.practical["phi_0"].verdict == "seen, not judged"
    assert "not with these records" not in str(found)
