"""`casid gallery`: the worked cases of the manual, listed, shown, and written so that they run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from casid.data.problem import load_problem
from casid.gallery.case import cases
from tests.cli.test_main import casid, refused
from tests.support.shared import ROOT


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_every_page_of_the_manuals_gallery_is_listed_with_its_title() -> None:
    pages = [p for p in (ROOT / "docs" / "gallery").glob("*.md") if p.stem != "index"]
    lines = casid("gallery").stdout.splitlines()
    assert [line.split()[0] for line in lines] == sorted(p.stem for p in pages)
    assert len(lines) == 15
    for page, line in zip(sorted(pages), lines, strict=True):
        assert line.endswith(page.read_text(encoding="utf-8").splitlines()[0].removeprefix("# "))


def test_a_case_is_shown_as_its_page() -> None:
    page = (ROOT / "docs" / "gallery" / "motor.md").read_text(encoding="utf-8")
    assert casid("gallery", "motor").stdout == page.rstrip() + "\n"


@pytest.mark.parametrize("name", sorted(cases()))
def test_a_case_is_written_with_every_problem_file_that_it_reads(name: str) -> None:
    said = casid("gallery", name, "--out", "case")
    assert said.stdout == f"cd case && python {name}.py\n"
    script = Path(f"case/{name}.py").read_text(encoding="utf-8")
    compile(script, name, "exec")
    assert json.loads(Path(f"case/{name}.ipynb").read_text(encoding="utf-8"))["nbformat"] == 4
    for path in cases()[name].problem_files:
        load_problem(Path("case/problems") / path.name)
    assert ("problems" in script) == Path("case/problems").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two_masses", "load"])
def test_a_written_script_runs_where_it_lies(name: str) -> None:
    """One without problem files, and one that imports from them; both end in assertions."""
    casid("gallery", name, "--out", "case")
    Path("library").mkdir()
    Path("library/casid").symlink_to(ROOT / "casid")  # and no problems beside it
    subprocess.run(
        [sys.executable, f"{name}.py"],
        cwd="case",
        env={**os.environ, "PYTHONPATH": str(Path("library").resolve())},
        check=True,
        capture_output=True,
    )


def test_a_file_of_ones_own_is_kept() -> None:
    casid("gallery", "motor", "--out", "case")
    assert casid("gallery", "motor", "--out", "case").exit_code == 0  # nothing would change
    Path("case/motor.py").write_text("mine")
    message = refused(casid("gallery", "motor", "--out", "case"), "motor.py exists", "--force")
    assert message
    assert Path("case/motor.py").read_text() == "mine"
    assert casid("gallery", "motor", "--out", "case", "--force").exit_code == 0
    assert Path("case/motor.py").read_text() != "mine"


def test_a_name_that_is_no_case_is_refused() -> None:
    refused(casid("gallery", "moter"), "did you mean 'motor'?")
    refused(casid("gallery", "--out", "case"), "--out needs the name of a case")
