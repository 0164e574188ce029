"""A Sphinx extension: every public name of the reference links to the pages whose code uses it.

Code of the manual runs, so each of these links leads to an example that runs. A class that is only
returned is used where a function that returns it is called.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import casid
from casid.gallery.blocks import Block, split

_MOST = 4  # links


def setup(app: Any) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("autodoc-process-docstring", _add_links, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def pages_by_name(docs: Path) -> Mapping[str, list[str]]:
    """Public name -> pages, without ending, whose code uses it; the page that does most first."""
    code = {path: _code(path) for path in sorted(docs.rglob("*.md"))}
    makers = _makers()
    found = {}
    for name in casid.__all__:
        used = re.compile(rf"\b(?:{'|'.join([name, *makers.get(name, ())])})\b")
        counts = {p: len(used.findall(text)) for p, text in code.items()}
        pages = sorted((p for p in counts if counts[p]), key=lambda p: -counts[p])
        found[name] = [p.relative_to(docs).with_suffix("").as_posix() for p in pages[:_MOST]]
    return found


def members_without(docs: Path, *classes: type) -> tuple[list[str], list[str]]:
    """Public methods and properties of classes that the reference omits, and that no code uses.

    Old names, which warn and lead to the new ones, need neither.
    """
    reference = "".join(p.read_text(encoding="utf-8") for p in (docs / "reference").glob("*.md"))
    code = "\n".join(map(_code, docs.rglob("*.md")))
    unlisted, unused = [], []
    for kind in classes:
        entry = re.search(rf"autoclass:: casid\.{kind.__name__}\n((?: +:.*\n)*)", reference)
        options = entry[1] if entry else ""
        for name, member in inspect.getmembers(kind):
            if name.startswith("_") or not (callable(member) or isinstance(member, property)):
                continue
            if (inspect.getdoc(member) or "").startswith("Old name of"):
                continue
            inherited = name not in vars(kind) and ":inherited-members:" not in options
            if ":members:" not in options or inherited:
                unlisted.append(f"{kind.__name__}.{name}")
            if not re.search(rf"\.{name}\b", code):
                unused.append(f"{kind.__name__}.{name}")
    return unlisted, unused


def _code(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    blocks = (b for b in split(text) if isinstance(b, Block) and b.language == "python")
    return "\n".join(block.text for block in blocks)


def _makers() -> dict[str, list[str]]:
    """Name of a class -> public functions that return it."""
    makers: dict[str, list[str]] = {}
    for name in casid.__all__:
        thing = getattr(casid, name)
        if isinstance(thing, type):
            continue
        annotation = str(getattr(thing, "__annotations__", {}).get("return", ""))
        for word in re.findall(r"\w+", annotation):
            makers.setdefault(word, []).append(name)
    return makers


_pages: dict[str, list[str]] = {}


def _add_links(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    module, _, own = name.partition(".")
    if module != "casid" or own not in casid.__all__:
        return
    if not _pages:
        _pages.update(pages_by_name(Path(app.srcdir)))
    links = ", ".join(f":doc:`/{page}`" for page in _pages.get(own, ()))
    if links:
        lines += ["", f"Examples that run: {links}."]
