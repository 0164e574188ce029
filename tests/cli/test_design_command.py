"""The command `casid design`: from a problem file to a folder, and its refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from casid.cli.main import main
from tests.support.shared import ROOT

PROBLEM = """
import casid

m = casid.Model("lag")
x, u = m.state("x", "m", initial=0.0), m.input("u", "N")
c, k = m.parameter("c", "N s/m", start=1.0), m.parameter("k", "N/m", start=2.0)
m.balance(x, "force", inertia=c, terms=[-k * x, u])
m.output("y", x, "mm")
problem = casid.Problem("lag", m)
"""


@pytest.fixture
def path(tmp_path: Path) -> str:
    file = tmp_path / "lag.py"
    file.write_text(PROBLEM)
    return str(file)


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["design", *arguments])
    return int(ended.value.code or 0)


def test_a_design_becomes_a_page_a_table_and_numbers(
    path: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    small = ["--sample-time", "0.1", "--intervals", "10", "--candidates", "4", "--starts", "1"]
    status = run(
        *(path, "--estimate", "k", "--duration", "3", "--limit", "u=-2:2"),
        *("--limit", "y=-0.5:0.5:m", "--noise", "y=1", *small, "--out", str(out), "--json"),
    )
    printed = json.loads(capsys.readouterr().out)
    assert status == 0
    assert printed == json.loads((out / "design.json").read_text())
    assert {f.name for f in out.iterdir()} == {
        *("design.json", "report.html", "input.csv", "result.casid")
    }
    assert (out / "input.csv").read_text().splitlines()[:2] == ["t,u,y", "s,N,mm"]
    y = printed["limits"][1]
    assert (y["unit"], y["upper"]) == ("m", pytest.approx(0.5))  # as it was given, not as declared
    assert y["highest"] <= 0.5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--duration", "3"], "no aim given"),
        (
            ["--estimate", "k", "--detect", "offset", "--duration", "3"],
            "one experiment has one aim",
        ),
        (["--separate", "offset", "--duration", "3"], "at least two causes"),
        (["--estimate", "k", "--duration", "3", "--limit", "u"], "write it as name=lower:upper"),
        (["--estimate", "k", "--duration", "3", "--limit", "u=-1:1:kg"], "no unit of it"),
        (["--estimate", "k", "--duration", "3", "--slew", "u=x"], "--slew u=x: write it as"),
        (["--estimate", "K", "--duration", "3", "--limit", "u=-1:1", "--noise", "y=1"], "'k'"),
        (["--estimate", "k", "--duration", "3", "--band", "1"], "two frequencies in Hz"),
    ],
)
def test_bad_requests_end_with_one_message(
    path: str, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(path, *arguments) == 2
    error = capsys.readouterr().err
    assert error.count("error:") == 1
    assert words in error


def test_a_design_that_gains_nothing_says_that_the_standard_input_is_as_good(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The decay from the largest angle is the best that a release within the limits gives."""
    roll = str(ROOT / "problems" / "roll_decay.py")
    options = ["--estimate", "B_1", "--release", "phi=-0.2:0.2", "--noise", "phi=2e-4"]
    assert run(roll, *options, "--duration", "8", "--out", str(tmp_path / "out"), "--quiet") == 0
    text = capsys.readouterr().out
    assert "No input was found whose record of 8 s carries more information" in text
    assert "1 times the information" not in text
