"""Runs the code of a page: what its blocks print, and the figures that they end in.

Every ```python block of a page is executed, all blocks of a page in one namespace. What it prints
stands behind it; if its last line is a Plotly figure, so does the figure. Every line of a console
block that starts with "$ casid" is run, and what it prints stands behind the block. An exception, a
failing assertion or an exit status other than 0 ends the build with the page and line. Blocks in
another language are shown as they are. A block that opens with ```console needs FILE (or python) is
shown and not run where no such file is there.
"""

from __future__ import annotations

import ast
import contextlib
import io
import shlex
import traceback
from dataclasses import dataclass
from typing import Any

from casid.gallery.blocks import Block


class BlockError(Exception):
    """A page whose code does not run, with page and line."""


@dataclass(frozen=True)
class Output:
    """What a block left: the text that it printed, and the figure that it ended in."""

    text: str = ""
    figure: Any = None


def run_block(block: Block, page: str, namespace: dict[str, Any]) -> Output:
    """Run a block of a page if it can be run; `namespace` is that of the page's Python.

    Raises
    ------
    BlockError
        If it fails.
    """
    if block.language not in ("python", "console"):
        return Output()
    if not block.runs:
        return Output(f"not run here: {block.needs} is absent")
    run = _run_python if block.language == "python" else _run_console
    return run(block, page, namespace)


def _run_python(block: Block, page: str, namespace: dict[str, Any]) -> Output:
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            last = _execute(block, page, namespace)
    except Exception as error:
        frames = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == page]
        line = frames[-1] if frames else getattr(error, "lineno", None) or block.line
        raise BlockError(f"{page}, line {line}: {type(error).__name__}: {error}") from error
    is_figure = hasattr(last, "to_plotly_json")
    return Output(printed.getvalue().rstrip(), last if is_figure else None)


def _execute(block: Block, page: str, namespace: dict[str, Any]) -> Any:
    """Run the block; the value of its last line if that is an expression."""
    code = "\n" * (block.line - 1) + block.text  # tracebacks then tell the page's own lines
    tree = ast.parse(code, page)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, page, "exec"), namespace)
    if last is None:
        return None
    return eval(compile(ast.Expression(last.value), page, "eval"), namespace)


def _run_console(block: Block, page: str, _: dict[str, Any]) -> Output:
    """Run the casid commands of a block in this process."""
    from click.testing import CliRunner

    from casid.cli.main import main as casid

    commands = [(i, s) for i, s in enumerate(block.text.splitlines()) if s.startswith("$ casid ")]
    printed = []
    for i, line in commands:
        done = CliRunner().invoke(casid, shlex.split(line)[2:])
        if done.exit_code != 0:
            where = f"{page}, line {block.line + i}: {line[2:]}"
            raise BlockError(f"{where}: {done.stderr.strip() or repr(done.exception)}")
        above = [line] if len(commands) > 1 else []
        printed.append("\n".join([*above, done.stdout.rstrip()]).rstrip())
    return Output("\n\n".join(printed))
