"""A Sphinx extension: pages run when they are read, and show what their code prints and draws.

The code runs in a folder of the page's own that holds a copy of `problems/`. Pages of the gallery
can be had as scripts and notebooks, too.
"""

from __future__ import annotations

import contextlib
import html
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from code_runner import BlockError, Output, run_block
from sphinx.errors import ExtensionError

from casid.errors import DataError
from casid.gallery.blocks import split
from casid.gallery.case import Case
from casid.report.document import Figure
from casid.report.html import drawing

_FOLDED = 30  # lines of output; longer ones unfold
_SCRIPTS = ("plotly.js", "figures.js")


def setup(app: Any) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("builder-inited", _find_measurements)
    app.connect("builder-inited", _write_scripts)
    app.connect("source-read", _run_page)
    app.connect("html-page-context", _add_scripts)
    # Worker processes of a page's own code do not end with a process that was forked to read it.
    return {"parallel_read_safe": False, "parallel_write_safe": True}


def _find_measurements(app: Any) -> None:
    """`CASID_SHARED` is by default the folder beside the checkout: pages run in another one."""
    shared = Path(app.srcdir).parents[1] / "shared"
    if shared.exists():
        os.environ.setdefault("CASID_SHARED", str(shared))


def _write_scripts(app: Any) -> None:
    """The scripts that draw figures, beside the other static files."""
    folder = Path(app.outdir) / "_static"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in zip(_SCRIPTS, (drawing.library(), drawing.DRAW), strict=True):
        (folder / name).write_text(text, encoding="utf-8")


def _add_scripts(app: Any, name: str, template: str, context: dict[str, Any], tree: Any) -> None:
    if 'class="plot"' in context.get("body", ""):
        for script in _SCRIPTS:
            app.add_js_file(script, loading_method="defer")


def _run_page(app: Any, name: str, source: list[str]) -> None:
    text = source[0]
    with _scratch(Path(app.srcdir).parent):
        try:
            source[0] = executed(text, f"{name}.md")
            if name.startswith("gallery/") and name != "gallery/index":
                folder = Path(app.outdir) / "_static" / "gallery"
                source[0] += _raw(write_downloads(Case(Path(name).name, text), folder))
        except (BlockError, DataError) as error:
            raise ExtensionError(f"the manual does not build: {error}") from error


@contextlib.contextmanager
def _scratch(root: Path) -> Iterator[None]:
    """A folder to run in."""
    with tempfile.TemporaryDirectory() as folder:
        if (root / "problems").exists():
            shutil.copytree(root / "problems", Path(folder) / "problems")
        with contextlib.chdir(folder):
            yield


def write_downloads(case: Case, folder: Path) -> str:
    """Write a case's script and notebook into `folder`; returns the links for the page's end."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{case.name}.py").write_text(case.script, encoding="utf-8")
    (folder / f"{case.name}.ipynb").write_text(case.notebook, encoding="utf-8")
    where = f"../_static/gallery/{case.name}"
    return (
        f'<p class="downloads">This page as a <a href="{where}.py" download>script</a> and as a '
        f'<a href="{where}.ipynb" download>notebook</a>; <code>casid gallery {case.name} --out '
        f"{case.name}</code> writes both, with the problem files that they read.</p>"
    )


def executed(text: str, page: str) -> str:
    """The page with the output of its code in it.

    Raises
    ------
    BlockError
        If a block does not run.
    DataError
        If a block is not closed.
    """
    namespace: dict[str, Any] = {"__name__": "__main__"}
    out, figures = [], 0
    for part in split(text):
        if isinstance(part, str):
            out.append(part)
            continue
        output = run_block(part, page, namespace)
        out += [part.shown, *_printed(output)]
        if output.figure is not None:
            figures += 1
            out.append(_raw(_drawn(Figure(str(figures), output.figure))))
    return "\n".join(out) + "\n"


def _drawn(figure: Figure) -> str:
    caption = f"<figcaption>{html.escape(figure.caption)}</figcaption>"
    place = drawing.place_html(figure) + drawing.data_html(figure)
    return f'<figure class="drawn">{place}{caption}</figure>'


def _printed(output: Output) -> Iterator[str]:
    if not output.text:
        return
    lines = output.text.splitlines(keepends=True)
    block = f'<pre class="output" tabindex="0">{"".join(map(_output_line, lines))}</pre>'
    if len(lines) > _FOLDED:
        summary = f"<summary>Output, {len(lines)} lines</summary>"
        block = f'<details class="output">{summary}{block}</details>'
    yield _raw(block)


def _output_line(line: str) -> str:
    """A printed line as HTML; a long one wraps if it is prose, not a row of a table."""
    text = html.escape(line)
    is_prose = len(line) > 40 and "  " not in re.sub(r"^ *(\S+( \S+)? {2,})?", "", line.rstrip())
    return f'<span class="prose">{text}</span>' if is_prose else text


def _raw(markup: str) -> str:
    fence = "`" * (2 + max(map(len, re.findall("`+", markup)), default=1))
    return f"\n{fence}{{raw}} html\n{markup}\n{fence}\n"
