"""A Sphinx extension: docstrings of the house, whose sections mix paragraphs and entries."""

from __future__ import annotations

import re
from typing import Any

_UNDERLINE = re.compile(r"^-{3,}\s*$")
_ENTRY = re.compile(r"^(\S.*?) : (.*)$")
_TYPE = re.compile(r"^(\([^)]*\) )?[\w\[\].|\"', ]{1,40}(, optional)?( \[[^\]]+\])?$")


def _parted(lines: list[str]) -> tuple[list[str], list[str]]:
    """The paragraphs of a section, and its entries `name : text` with the text on its own line."""
    prose: list[str] = []
    entries: list[str] = []
    in_prose = False
    for i, line in enumerate(lines):
        entry = _ENTRY.match(line)
        follows = i + 1 < len(lines) and lines[i + 1].startswith(" ")
        if line and not line.startswith(" "):
            in_prose = not entry and not follows
        if entry and not (follows and _TYPE.match(entry[2])):
            entries += [entry[1], f"    {entry[2]}"]
        else:
            (prose if in_prose else entries).append(line)
    return prose, entries


def sections(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Rewrite the sections Parameters and Attributes of a docstring, paragraphs before entries."""
    heads = [i for i in range(len(lines) - 1) if _UNDERLINE.match(lines[i + 1])]
    out = lines[: heads[0]] if heads else lines[:]
    for k, head in enumerate(heads):
        body = lines[head + 2 : heads[k + 1] if k + 1 < len(heads) else len(lines)]
        if lines[head] in ("Parameters", "Attributes"):
            prose, body = _parted(body)
            out += [*prose, ""] if prose else []
        out += [*lines[head : head + 2], *body]
    lines[:] = out


def signature(
    app: Any, what: str, name: str, obj: Any, options: Any, arguments: str | None, returned: str
) -> tuple[str | None, str]:
    """Defaults of dataclasses that a function makes, as Python can read them.

    A signature that cannot be read as Python is shown with the full path of every type in it.
    """
    return arguments and arguments.replace("<factory>", "..."), returned


def setup(app: Any) -> dict[str, bool]:
    """Run before napoleon, which connects to the same event."""
    app.connect("autodoc-process-docstring", sections, priority=400)
    app.connect("autodoc-process-signature", signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
