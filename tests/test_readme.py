"""The README: its lines run and print what it says; its commands are the ones that are tested.

`python -m tests.test_readme` writes what the lines print into the README.
"""

from __future__ import annotations

import contextlib
import io
import re
import subprocess
import sys

import pytest

from casid.cli.main import main
from tests.support.shared import ROOT

README = ROOT / "README.md"
CODE = re.compile(r"```python\n(.*?)```", re.DOTALL)
PRINTED = re.compile(r"```text\n(.*?)```", re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.])")


def printed_by(code: str) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    return out.getvalue()


def test_the_ten_lines_print_what_the_readme_says() -> None:
    """Words to the letter; numbers to 5 %, p-values aside: they turn digits into decades."""
    text = README.read_text(encoding="utf-8")
    code, *_ = CODE.findall(text)
    (said,) = PRINTED.findall(text)
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    found = printed_by(code)
    words = [NUMBER.sub("#", x).split() for x in (found, said)]
    assert words[0] == words[1], "if it is meant: python -m tests.test_readme writes the README"
    for line, other in zip(found.splitlines(), said.splitlines(), strict=True):
        without = [re.sub(r"\(p = [^)]*\)", "", x) for x in (line, other)]
        new, old = ([float(x) for x in NUMBER.findall(x)] for x in without)
        assert new == pytest.approx(old, rel=0.05)


def test_the_other_lines_of_the_readme_run() -> None:
    _, *others = CODE.findall(README.read_text(encoding="utf-8"))
    assert others
    for code in others:
        assert printed_by(code) == ""


def test_the_set_up_commands_stand_in_the_readme() -> None:
    text = README.read_text(encoding="utf-8")
    assert "\npython -m pip install . && casid diagnose problems/pendulum.py\n" in text
    assert '\npython -m pip install ".[test]" && python -m pytest\n' in text


def commands_of(text: str) -> list[str]:
    """The commands of all blocks without a language, their remarks left out."""
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line for language, block in blocks if not language for line in block.splitlines()]
    return [re.split(r" {2,}", line)[0] for line in lines if line.startswith("casid ")]


def test_the_manual_runs_every_command_of_the_readme_in_order() -> None:
    """The manual's build runs its console blocks: what stands there runs as printed."""
    commands = commands_of(README.read_text(encoding="utf-8"))
    assert len(commands) >= 10
    page = (ROOT / "docs" / "tutorials" / "your_data.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w+[^\n]*)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    shown = [line for kind, block in blocks if kind == "console" for line in block.splitlines()]
    run = [line.removeprefix("$ ") for line in shown]
    assert [line for line in run if line in commands] == commands


def test_every_line_of_a_block_that_looks_like_a_command_is_one_that_is_run() -> None:
    """Those of the set-up are another test's matter."""
    text = README.read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert {language for language, _ in blocks} <= {"", "python", "text"}  # no other is looked at
    lines = [line for language, block in blocks if not language for line in block.splitlines()]
    commands = [line for line in lines if "casid " in line and not line.startswith("python -m pip")]
    assert [re.split(r" {2,}", line)[0] for line in commands] == commands_of(text)


def test_every_command_of_the_readme_can_be_parsed() -> None:
    for line in commands_of(README.read_text(encoding="utf-8")):
        name, *arguments = line.split()[1:]
        main.commands[name].make_context(name, arguments)


def test_the_readme_speaks_of_files_that_exist() -> None:
    text = README.read_text(encoding="utf-8")
    for path in re.findall(r"\b(?:problems|analysis|docs)/[\w./-]+\w", text):
        assert (ROOT / path).exists(), path
    for path in re.findall(r"\]\((?!https?:|#)([^)]+)\)", text):
        assert (ROOT / path).exists(), path
    headings = {h.lower().replace(" ", "-") for h in re.findall(r"^#+ (.*)$", text, re.MULTILINE)}
    assert set(re.findall(r"\]\(#([^)]+)\)", text)) <= headings


def write() -> None:
    """Put what the lines print into the README."""
    text = README.read_text(encoding="utf-8")
    code, *_ = CODE.findall(text)
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    block = f"```text\n{run.stdout}```"
    README.write_text(PRINTED.sub(lambda _: block, text), encoding="utf-8")


if __name__ == "__main__":
    write()
