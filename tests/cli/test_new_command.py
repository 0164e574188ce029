"""`casid new`: from a file of measurements to a problem file and the commands to go on with."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from tests.cli.test_main import casid, refused
from tests.support.template_systems import SYSTEMS


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder with a file of a motor, named as people name files."""
    monkeypatch.chdir(tmp_path)
    SYSTEMS["motor"].write(Path("run (Messung 3).csv"))


def test_the_commands_that_it_prints_run_as_they_stand() -> None:
    said = casid("new", "run (Messung 3).csv", "--as", "dc-motor", "--set", "N=5")
    assert said.exit_code == 0
    assert Path("run_Messung_3.py").exists()
    identify = next(n for n in said.stdout.splitlines() if n.startswith("  casid identify "))
    done = casid(*shlex.split(identify)[1:], "--out", "fit")
    assert done.exit_code == 0
    assert Path("fit/estimate.json").exists()


def test_a_second_call_does_not_write_over_the_first() -> None:
    casid("new", "run (Messung 3).csv", "--as", "dc-motor", "--out", "motor.py")
    again = ("new", "run (Messung 3).csv", "--as", "dc-motor", "--out", "motor.py")
    assert "motor.py exists" in refused(casid(*again))
    assert casid(*again, "--force").exit_code == 0


def test_a_wrong_template_or_file_is_refused() -> None:
    assert "did you mean 'thermal'" in refused(
        casid("new", "run (Messung 3).csv", "--as", "termal")
    )
    assert "no such file" in refused(casid("new", "rum.csv"))
    assert "--map names 'angle' twice" in refused(
        casid("new", "run (Messung 3).csv", "--map", "angle=a", "--map", "angle=b")
    )
