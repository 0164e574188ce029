"""A worked case of the gallery: its page, and the script and the notebook that are made of it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from casid.data.files import write_text
from casid.errors import DataError, nearest
from casid.gallery.blocks import Block, split

_PACKAGE = Path(__file__).resolve().parent
_CHECKOUT = _PACKAGE.parent.parent


def _folder(installed: str, in_checkout: str) -> Path:
    """Where the pages, or the problem files, lie: in the wheel beside this file."""
    beside = _PACKAGE / installed
    return beside if beside.is_dir() else _CHECKOUT / in_checkout


@dataclass(frozen=True, slots=True)
class Case:
    """A worked case.

    Attributes
    ----------
    name : by which it is requested.
    text : its page, in Markdown.
    """

    name: str
    text: str

    @property
    def title(self) -> str:
        """The heading of the page."""
        return self.text.splitlines()[0].removeprefix("# ")

    @property
    def script(self) -> str:
        """Code as it is, prose as comments; a block without its file is left out when it runs."""
        return "\n\n".join(_as_script(part) for part in self._parts()) + "\n"

    @property
    def notebook(self) -> str:
        """The page as a Jupyter notebook (nbformat 4.5), not run."""
        cells = [{**_as_cell(part), "id": f"cell-{i}"} for i, part in enumerate(self._parts())]
        book = {"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 5}
        return json.dumps(book, indent=1) + "\n"

    @property
    def problem_files(self) -> list[Path]:
        """Problem files that the code reads, and those that these read, sorted by name."""
        all_files = {p.stem: p for p in _folder("problems", "problems").glob("*.py")}
        found: set[str] = set()
        texts = [b.text for b in self._parts() if isinstance(b, Block)]
        while texts:
            named = re.findall(r"problems[./](\w+)|with_name\(\"(\w+)\.py", texts.pop())
            new = {a or b for a, b in named} & set(all_files) - found - {"__init__"}
            found |= new
            texts += [all_files[name].read_text(encoding="utf-8") for name in new]
        return [all_files[name] for name in sorted(found)]

    def _parts(self) -> Iterator[str | Block]:
        return (p for p in split(self.text) if isinstance(p, Block) or p.strip())

    def write(self, folder: Path, *, force: bool = False) -> list[Path]:
        """Write page, script, notebook and the problem files that they read into a folder.

        Raises
        ------
        DataError
            If one of the files exists, unless `force` is set; nothing is written then.
        """
        texts = {
            folder / f"{self.name}.md": self.text,
            folder / f"{self.name}.py": self.script,
            folder / f"{self.name}.ipynb": self.notebook,
        }
        for path in self.problem_files:
            texts[folder / "problems" / path.name] = path.read_text(encoding="utf-8")
        old = [path for path, text in texts.items() if path.exists() and _differs(path, text)]
        if old and not force:
            raise DataError(f"{old[0]} exists; name another folder with --out, or add --force")
        for path, text in texts.items():
            write_text(path, text)
        return list(texts)


def _differs(path: Path, text: str) -> bool:
    return path.read_bytes() != text.encode("utf-8")


def cases() -> dict[str, Case]:
    """Name -> case, all of the gallery.

    Raises
    ------
    DataError
        If the pages were not installed.
    """
    folder = _folder("cases", "docs/gallery")
    paths = [p for p in sorted(folder.glob("*.md")) if p.stem != "index"]
    if not paths:
        raise DataError(f"no worked cases lie in {folder}; install casid again")
    return {p.stem: Case(p.stem, p.read_text(encoding="utf-8")) for p in paths}


def case_called(name: str) -> Case:
    """The case of this name.

    Raises
    ------
    DataError
        If there is none.
    """
    found = cases()
    if name not in found:
        listed = f"{nearest(name, found)}; casid gallery lists all"
        raise DataError(f"no worked case is called {name!r}{listed}")
    return found[name]


def _is_run(part: str | Block) -> bool:
    return isinstance(part, Block) and part.language == "python"


def _as_script(part: str | Block) -> str:
    if not isinstance(part, Block) or not _is_run(part):
        text = part.shown if isinstance(part, Block) else part.strip()
        return "\n".join(f"# {line}".rstrip() for line in text.splitlines())
    if part.needs is None:
        return part.text
    inside = "\n".join(f"    {line}".rstrip() for line in part.text.splitlines())
    return f'if __import__("os").path.exists({part.needs!r}):\n{inside}'


def _as_cell(part: str | Block) -> dict[str, object]:
    if isinstance(part, Block) and _is_run(part):
        cell: dict[str, object] = {"cell_type": "code", "execution_count": None, "outputs": []}
        return {**cell, "metadata": {}, "source": part.text}
    text = part.shown if isinstance(part, Block) else part.strip()
    return {"cell_type": "markdown", "metadata": {}, "source": text}
