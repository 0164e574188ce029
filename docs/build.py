"""Build the manual: run its code, put in what it prints, render it to a folder of HTML pages.

    python docs/build.py --out site

Every ```python block of a page is executed, all blocks of a page in one namespace, and what it
prints is inserted behind it. Every line of a ```console block that starts with "$ casid" is run as
well. An exception, a failing assertion or an exit status other than 0 ends the build with the page
and line. Blocks in another language are shown as they are. A block that opens with ```console needs
FILE (or python) is shown and not run where no such file is there.
"""

from __future__ import annotations

import argparse
import contextlib
import html
import io
import os
import re
import shlex
import shutil
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
PAGES = (
    "index",
    "your_data",
    "ten_lines",
    "problem_file",
    "report",
    "records",
    "diagnosis",
    "diagnosis_power",
    "experiment_design",
    "fitted_model",
    "identifiability",
    "linear_models",
    "instruments",
    "prediction",
    "solvers",
    "campaigns",
    "unknown_inputs",
    "networks",
    "ships",
    "limits",
    "architecture",
)


class BuildError(Exception):
    """A page whose code does not run, with page and line."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    language: str
    text: str
    line: int  # of its first line of code, from 1
    needs: str | None = None  # a file without which it is shown, and not run

    @property
    def runs(self) -> bool:
        """True if it has what it needs."""
        return self.needs is None or Path(self.needs).exists()


def split(text: str) -> Iterator[str | Block]:
    """Prose and fenced blocks of a page, in order."""
    prose: list[str] = []
    lines = text.splitlines()
    i = 0
    while i < len(lines):
        opening = re.fullmatch(r"```(\w+)(?: needs (.+))?", lines[i])
        if opening is None:
            prose.append(lines[i])
            i += 1
            continue
        yield "\n".join(prose)
        prose = []
        start = i = i + 1
        while i < len(lines) and lines[i] != "```":
            i += 1
        if i == len(lines):
            raise BuildError(f"line {start}: the block is not closed; end it with ```")
        yield Block(opening[1], "\n".join(lines[start:i]), start + 1, opening[2])
        i += 1
    yield "\n".join(prose)


def run_python(block: Block, page: str, namespace: dict[str, Any]) -> str:
    """Run a block; what it prints."""
    printed = io.StringIO()
    code = "\n" * (block.line - 1) + block.text  # tracebacks then tell the page's own lines
    try:
        with contextlib.redirect_stdout(printed):
            exec(compile(code, page, "exec"), namespace)
    except Exception as error:
        frames = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == page]
        line = frames[-1] if frames else getattr(error, "lineno", None) or block.line
        raise BuildError(f"{page}, line {line}: {type(error).__name__}: {error}") from error
    return printed.getvalue()


def run_console(block: Block, page: str) -> None:
    """Run the casid commands of a block, in this process; what they print is not shown."""
    from click.testing import CliRunner

    from casid.cli.main import main as casid

    for i, line in enumerate(block.text.splitlines()):
        if not line.startswith("$ casid "):
            continue
        done = CliRunner().invoke(casid, shlex.split(line)[2:])
        if done.exit_code != 0:
            where = f"{page}, line {block.line + i}: {line[2:]}"
            raise BuildError(f"{where}: {done.stderr.strip() or repr(done.exception)}")


def execute(text: str, page: str) -> str:
    """The page with the output of its code in it."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    out = []
    for part in split(text):
        if isinstance(part, str):
            out.append(part)
            continue
        out.append(f"```{part.language}\n{part.text}\n```")
        if not part.runs:
            out.append(f"```output\nnot run here: {part.needs} is absent\n```")
        elif part.language == "python":
            printed = run_python(part, page, namespace).rstrip()
            if printed:
                out.append(f"```output\n{printed}\n```")
        elif part.language == "console":
            run_console(part, page)
    return "\n".join(out) + "\n"


# -- rendering ------------------------------------------------------------------------------------

STYLE = """
body { margin: 0; font: 16px/1.55 system-ui, sans-serif; color: #1c2330; background: #fff; }
nav { position: fixed; inset: 0 auto 0 0; width: 13rem; padding: 1.5rem; background: #f3f5f8;
      box-sizing: border-box; overflow: auto; }
nav b { display: block; font-size: 1.3rem; margin-bottom: 1rem; }
nav a { display: block; padding: .25rem 0; color: #2a5599; text-decoration: none; }
nav a.here { font-weight: 600; color: #1c2330; }
main { margin-left: 13rem; padding: 1.5rem 2.5rem 4rem; max-width: 58rem; }
main > p, main > ul, main > ol { max-width: 50rem; }
h1 { font-size: 1.8rem; } h2 { margin-top: 2.2rem; font-size: 1.3rem; }
a { color: #2a5599; }
pre { padding: .8rem 1rem; overflow-x: auto; background: #f3f5f8; border-radius: 4px;
      font: 12.5px/1.45 ui-monospace, monospace; }
pre.output { background: #fff; border-left: 3px solid #9db3d0; border-radius: 0; }
pre .prose { white-space: pre-wrap; }
code { font: .9em ui-monospace, monospace; }
table { border-collapse: collapse; } th, td { padding: .3rem .8rem .3rem 0; text-align: left;
      vertical-align: top; border-bottom: 1px solid #dde3ea; }
@media (max-width: 46rem) { nav { position: static; width: auto; } main { margin: 0; } }
"""

TEMPLATE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title} - casid</title><style>{style}</style></head>
<body><nav><b>casid</b>{links}</nav><main>{body}</main></body></html>
"""


def output_line(line: str) -> str:
    """A printed line as HTML; a long one wraps if it is prose, not a row of a table."""
    text = html.escape(line)
    is_prose = len(line) > 40 and "  " not in re.sub(r"^ *(\S+( \S+)? {2,})?", "", line)
    return f'<span class="prose">{text}</span>' if is_prose else text


def highlight(code: str, language: str, _: str) -> str:
    """A fenced block as HTML, coloured by Pygments, its colours in the page."""
    if language == "output":
        return f'<pre class="output">{"".join(output_line(n) for n in code.splitlines(True))}</pre>'
    from pygments import highlight as colour
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import get_lexer_by_name

    formatter = HtmlFormatter(nowrap=True, noclasses=True, style="friendly")
    return f"<pre>{colour(code, get_lexer_by_name(language or 'text'), formatter)}</pre>"


def render(pages: dict[str, str]) -> dict[str, str]:
    """HTML of every page; links between pages point at the HTML, and are checked."""
    from markdown_it import MarkdownIt

    parser = MarkdownIt("commonmark", {"highlight": highlight}).enable("table")
    titles = {name: text.splitlines()[0].lstrip("# ") for name, text in pages.items()}
    out = {}
    for name, text in pages.items():
        for target in re.findall(r"\]\((\w+)\.md", text):
            if target not in pages:
                raise BuildError(f"{name}.md links to {target}.md, which does not exist")
        links = "".join(
            f'<a href="{n}.html"{" class=here" if n == name else ""}>{html.escape(t)}</a>'
            for n, t in titles.items()
        )
        body = parser.render(re.sub(r"\]\((\w+)\.md", r"](\1.html", text))
        out[name] = TEMPLATE.format(
            title=html.escape(titles[name]), style=STYLE, links=links, body=body
        )
    return out


def build(out: Path, names: Sequence[str] = PAGES, source: Path = HERE) -> None:
    """Run and render the pages into `out`; nothing is written unless all of them run.

    Code runs in a folder of its own with a copy of `problems/`.
    """
    executed = {}
    back = Path.cwd()
    sys.path.insert(0, str(ROOT))
    with tempfile.TemporaryDirectory() as scratch:
        shutil.copytree(ROOT / "problems", Path(scratch) / "problems")
        try:
            for name in names:
                os.chdir(scratch)
                print(f"{name}.md", file=sys.stderr, flush=True)
                text = (source / f"{name}.md").read_text(encoding="utf-8")
                executed[name] = execute(text, f"{name}.md")
        finally:
            os.chdir(back)
            sys.path.remove(str(ROOT))
    rendered = render(executed)
    out.mkdir(parents=True, exist_ok=True)
    for name, page in rendered.items():
        (out / f"{name}.html").write_text(page, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Build the site; 1 if a page does not run."""
    parser = argparse.ArgumentParser(prog="python docs/build.py", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("site"), help="folder of the pages")
    options = parser.parse_args(arguments)
    try:
        build(options.out.resolve())
    except BuildError as error:
        print(f"the manual does not build: {error}", file=sys.stderr)
        return 1
    print(f"{len(PAGES)} pages in {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
