"""Values given on the command line are in the units that the model declares, as the help says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from casid.cli.main import main

PROBLEM = """
import numpy as np
import casid

m = casid.Model("decay")
x = m.state("x", "mm")
k = m.parameter("k", "1/h", start=100, lower=0, upper=100000)
s = m.parameter("s", "1/h", start=1, lower=0, upper=1000)
m.derivative(x, (s - k) * x)
m.output("y", x, "mm")


def example():
    y = np.exp(-0.1 * np.arange(100)) + 1e-6 * np.cos(np.arange(100))
    return casid.Record({"y": y}, {"y": "m"}, 1.0, name="decay")


problem = casid.Problem("decay", m, example=example, starts=1)
"""


@pytest.fixture
def problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A decay of 0.1/s = 360/h, beside it a growth s."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.py").write_text(PROBLEM)
    return "p.py"


def test_a_known_value_is_in_its_unit(problem: str) -> None:
    arguments = ["identify", problem, "--set", "s=36", "--json", "--quiet", "--out", "o"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    k = json.loads(result.stdout)["parameters"]["k"]
    assert (k["value"], k["unit"]) == (pytest.approx(396, rel=1e-3), "1/h")


def test_the_help_says_so() -> None:
    for command in ("identify", "diagnose", "montecarlo"):
        text = " ".join(CliRunner().invoke(main, [command, "--help"]).output.split())
        assert "A parameter that is known, in its declared unit." in text
    text = " ".join(CliRunner().invoke(main, ["identifiability", "--help"]).output.split())
    assert "this value of a parameter, in its declared unit;" in text
