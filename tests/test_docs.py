"""The manual: pages run in order, and a page that does not run, or a dead link, ends the build."""

from __future__ import annotations

import importlib
import json
import re
import shutil
import subprocess
import sys
from types import SimpleNamespace

import pytest

import casid
from casid.errors import DataError
from casid.gallery.case import Case
from tests.support.shared import ROOT, shared

pytest.importorskip("sphinx")
DOCS = ROOT / "docs"
EXTENSION = DOCS / "extension"


@pytest.fixture(scope="module")
def manual():
    sys.path.insert(0, str(EXTENSION))
    try:
        runner, pages = map(importlib.import_module, ("code_runner", "executed_pages"))
    finally:
        sys.path.remove(str(EXTENSION))
    return SimpleNamespace(
        executed=pages.executed,
        BlockError=runner.BlockError,
        write_downloads=pages.write_downloads,
    )


def text(*lines: str) -> str:
    return "\n".join(lines) + "\n"


def test_what_a_block_prints_stands_behind_it_and_blocks_share_a_namespace(manual):
    page = text("# T", "```python", "x = 1", "```", "```python", "print(x + 1)", "```", "End.")
    out = manual.executed(page, "p.md")
    assert out.index("print(x + 1)") < out.index('<pre class="output" tabindex="0">2</pre>')
    assert out.index("</pre>") < out.index("End.")


def test_a_block_that_ends_in_a_figure_shows_it(manual):
    page = text(
        "# T",
        "```python",
        "import plotly.graph_objects as go",
        "figure = go.Figure(go.Scatter(y=[1, 2]), {'title': 'Rises'})",
        "figure",
        "```",
        "```python",
        "figure.data",
        "```",
    )
    out = manual.executed(page, "p.md")
    assert out.count('class="plot"') == 1
    assert 'id="data-1"' in out
    assert "<figcaption>Rises</figcaption>" in out


def test_long_output_is_folded_and_cannot_become_markup(manual):
    page = text("# T", "```python", "print('<b>\\n' * 40 + '```')", "```")
    out = manual.executed(page, "p.md")
    assert "<summary>Output, 41 lines</summary>" in out
    assert "<b>" not in out.split("{raw} html")[1]
    assert "````{raw} html" in out


def test_commands_run_and_what_they_print_is_shown(manual):
    out = manual.executed(text("# T", "```console", "$ casid --version", "```"), "p.md")
    assert re.search(r'<pre class="output" tabindex="0">casid.* \d+\.\d+', out)


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        (["# T", "```python", "x = 1", "assert x == 2", "```"], r"p\.md, line 4: AssertionError"),
        (["# T", "```python", "1 / 0", "```"], r"p\.md, line 3: ZeroDivisionError"),
        (["# T", "```python", "x = 1"], r"line 2: the block is not closed; end it with"),
        (["# T", "```python", "x = (", "```"], r"p\.md, line 3: SyntaxError"),
        (["# T", "```console", "$ casid check no.csv", "```"], r"p\.md, line 3: casid check no"),
    ],
)
def test_a_page_that_does_not_run_is_refused_with_its_line(manual, lines, what):
    with pytest.raises((manual.BlockError, DataError), match=what):
        manual.executed(text(*lines), "p.md")


def test_a_block_without_the_file_that_it_needs_is_shown_and_not_run(manual, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = text("# T", "```python needs gone.csv", "1 / 0", "```")
    assert "not run here: gone.csv is absent" in manual.executed(page, "p.md")
    (tmp_path / "gone.csv").touch()
    with pytest.raises(manual.BlockError, match="ZeroDivisionError"):
        manual.executed(page, "p.md")


MEASURED = sorted(
    str(p.relative_to(DOCS))
    for p in DOCS.rglob("*.md")
    if re.search(r"^```\w+ needs ", p.read_text(encoding="utf-8"), re.MULTILINE)
)


@pytest.mark.slow
@pytest.mark.parametrize("name", MEASURED)
def test_pages_on_measurements_run(manual, name, tmp_path, monkeypatch):
    """`.ci/run` builds the manual without the measurements."""
    monkeypatch.setenv("CASID_SHARED", str(shared()))
    shutil.copytree(ROOT / "problems", tmp_path / "problems")
    monkeypatch.chdir(tmp_path)
    out = manual.executed((DOCS / name).read_text(encoding="utf-8"), name)
    assert "not run here" not in out


@pytest.fixture(scope="module")
def links():
    sys.path.insert(0, str(EXTENSION))
    try:
        return importlib.import_module("example_links")
    finally:
        sys.path.remove(str(EXTENSION))


def test_every_public_name_has_an_entry_in_the_reference_and_an_example_that_runs(links):
    reference = "".join(p.read_text("utf-8") for p in (DOCS / "reference").glob("*.md"))
    entries = re.findall(r"^\.\. auto\w+:: casid\.(\w+)$", reference, re.MULTILINE)
    assert sorted(entries) == sorted(casid.__all__)
    pages = links.pages_by_name(DOCS)
    assert not [name for name in pages if not pages[name]]


RESULTS = (
    casid.Assessment,
    casid.Calibration,
    casid.DesignedExperiment,
    casid.Diagnosis,
    casid.Estimate,
    casid.FittedModel,
    casid.Fleet,
    casid.Investigation,
    casid.MonteCarlo,
    casid.Record,
)
NEEDS_MORE = {  # packages that the manual's own extra does not install
    "Estimate.to_inference_data",
    "FittedModel.to_fmu",
    "Record.to_xarray",
}


def test_what_a_result_can_do_is_in_the_reference_and_in_an_example_that_runs(links):
    unlisted, unused = links.members_without(DOCS, *RESULTS)
    assert not unlisted
    assert set(unused) <= NEEDS_MORE


GALLERY = sorted(p.stem for p in (DOCS / "gallery").glob("*.md") if p.stem != "index")


@pytest.mark.parametrize("name", GALLERY)
def test_a_case_of_the_gallery_has_its_sections_asserts_its_numbers_and_is_a_script(
    manual, name, tmp_path
):
    page = (DOCS / "gallery" / f"{name}.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (.*)$", page, re.MULTILINE)
    assert headings[-1] == "What not to conclude"
    assert re.search(r"^ *assert ", page, re.MULTILINE)
    assert "plot()" in page or "figure" in page
    links = manual.write_downloads(Case(name, page), tmp_path)
    assert f"gallery/{name}.py" in links
    compile((tmp_path / f"{name}.py").read_text(encoding="utf-8"), name, "exec")
    notebook = json.loads((tmp_path / f"{name}.ipynb").read_text(encoding="utf-8"))
    code = [c for c in notebook["cells"] if c["cell_type"] == "code"]
    assert len(code) == page.count("```python")


@pytest.mark.parametrize(
    ("line", "status", "what"),
    [
        ("See [the other](b.md#what-it-is).", 0, ""),
        ("See [one](gone.md) and [the other](b.md#lost).", 1, "gone.md lost"),
        ("```python\n1 / 0\n```", 2, "index.md, line 8: ZeroDivisionError"),
    ],
)
def test_the_build_is_strict_and_its_pages_load_nothing(tmp_path, line, status, what):
    """Exit status of Sphinx: 0, 1 where it warns, 2 where it stops."""
    docs = tmp_path / "docs"
    docs.mkdir()
    settings = (DOCS / "conf.py").read_text(encoding="utf-8")
    here = f"HERE = Path({str(DOCS)!r})"
    settings = settings.replace("HERE = Path(__file__).resolve().parent", here)
    settings = settings.replace('["_static"]', "[str(HERE / '_static')]")
    (docs / "conf.py").write_text(settings, encoding="utf-8")
    page = text("# A", "", "```{toctree}", "b", "```", "", line)
    (docs / "index.md").write_text(page, encoding="utf-8")
    (docs / "b.md").write_text("# B\n\n## What it is\n\nText.\n", encoding="utf-8")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "--keep-going", "docs", "site"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert bool(done.returncode) == bool(status), done.stderr
    for word in what.split(" ") if status == 1 else [what]:
        assert word in done.stderr
    if not status:
        site = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|link)[^>]+(?:src|href)="([^"]+)"', site)
        assert loaded
        assert not [address for address in loaded if "//" in address]
