"""The manual's builder: pages run in order, and a page that does not run ends the build."""

from __future__ import annotations

import importlib.util

import pytest

from tests.support.shared import ROOT

pytest.importorskip("markdown_it")


@pytest.fixture(scope="module")
def builder():
    spec = importlib.util.spec_from_file_location("docs_build", ROOT / "docs" / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules["docs_build"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def page(folder, name, *lines):
    (folder / f"{name}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def test_what_a_block_prints_stands_behind_it_and_blocks_share_a_namespace(builder, tmp_path):
    page(tmp_path, "a", "# First", "", "```python", "x = 20", "```", "", "See [b](b.md).")
    page(
        tmp_path,
        "b",
        "# Second",
        "",
        "```python",
        "x = 1",
        "```",
        "```python",
        "print(x + 1)",
        "```",
    )
    builder.build(tmp_path / "out", ["a", "b"], tmp_path)
    first, second = ((tmp_path / "out" / f"{n}.html").read_text() for n in "ab")
    assert 'href="b.html"' in first
    assert '<pre class="output">2' in second
    assert "http" not in second  # it opens without a network


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        (["# T", "```python", "x = 1", "assert x == 2", "```"], r"p\.md, line 4: AssertionError"),
        (["# T", "```python", "1 / 0", "```"], r"p\.md, line 3: ZeroDivisionError"),
        (["# T", "```python", "x = 1"], r"not closed; end it with"),
        (["# T", "[gone](gone.md)"], r"links to gone\.md, which does not exist"),
        (["# T", "```console", "$ casid check no.csv", "```"], r"p\.md, line 3: casid check no"),
    ],
)
def test_a_page_that_does_not_run_ends_the_build_with_its_line(builder, tmp_path, lines, what):
    page(tmp_path, "p", *lines)
    with pytest.raises(builder.BuildError, match=what):
        builder.build(tmp_path / "out", ["p"], tmp_path)
    assert not (tmp_path / "out").exists()


def test_a_block_without_the_file_that_it_needs_is_shown_and_not_run(builder, tmp_path):
    page(tmp_path, "p", "# T", "```python needs gone.csv", "1 / 0", "```")
    builder.build(tmp_path / "out", ["p"], tmp_path)
    assert "not run here: gone.csv is absent" in (tmp_path / "out" / "p.html").read_text()
    page(tmp_path, "p", "# T", "```python needs problems", "1 / 0", "```")
    with pytest.raises(builder.BuildError, match="ZeroDivisionError"):
        builder.build(tmp_path / "there", ["p"], tmp_path)


def test_every_page_is_in_the_menu(builder):
    assert {p.stem for p in (ROOT / "docs").glob("*.md")} == set(builder.PAGES)
