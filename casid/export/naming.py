"""Names of a model as names of another language."""

from __future__ import annotations

import keyword
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Literal

from casid.errors import DataError
from casid.model.identifiers import identifier
from casid.versions import versions

Target = Literal["problem", "casadi", "c", "control", "modelica", "fmu"]

ENDINGS: Mapping[str, tuple[str, str]] = {
    "problem": (".py", "a problem file"),
    "casadi": (".casadi", "a CasADi function"),
    "c": (".c", "C"),
    "control": (".py", "a state space"),
    "modelica": (".mo", "Modelica"),
    "fmu": (".fmu", "an FMU"),
}
"""The ending of each target's file, and what it is in words."""


def checked_path(path: Path, target: Target | str) -> Path:
    """The path with the ending of its target.

    Raises
    ------
    DataError
        If it has another ending, or its folder does not exist.
    """
    ending, what = ENDINGS[target]
    if path.suffix == "":
        path = path.with_suffix(ending)
    if path.suffix != ending:
        raise DataError(
            f"{path}: {what} is written to a file that ends with {ending}; name one, such as "
            f"{path.with_suffix(ending).name}"
        )
    if not path.parent.is_dir():
        raise DataError(f"{path}: there is no folder {path.parent}; make it, or name another")
    return path


def identifiers(names: Iterable[str], taken: Collection[str] = ()) -> dict[str, str]:
    """Each name with an identifier of its own, none of those in `taken`, no word of Python."""
    found: dict[str, str] = {}
    used = set(taken)
    for name in names:
        # What is an identifier already keeps it.
        base = name if name.isidentifier() and name.isascii() else identifier(name)
        text, n = base, 2
        while text in used or keyword.iskeyword(text):
            text, n = (f"{base}_{n}", n + 1) if text in used else (f"{text}_", n)
        used.add(text)
        found[name] = text
    return found


def written_by() -> str:
    """casid, with its version where it is installed."""
    version = versions()["casid"]
    return f"casid {version}" if version[0].isdigit() else "casid"
