"""The equations of a JSON or TOML file, in the fields that `equation_text` reads."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from casid.argument_types import names_wrong_types
from casid.errors import DataError, ModelError, nearest
from casid.identifiability.equations.equation_text import parse_system as parse_system
from casid.identifiability.equations.equation_text import parse_systems, text_of
from casid.identifiability.equations.system import System
from casid.model.quantities import count_text

MAX_BYTES = 5_000_000  # of a file


@dataclass(frozen=True, slots=True, eq=False)
class EquationFile:
    """Content of an equation file: one system for each data set (one where there are none).

    Attributes
    ----------
    name, description : as the file has them.
    systems : the equations, once for each data set, with the values known in it.
    path : the file.
    """

    name: str
    description: str
    systems: tuple[System, ...]
    path: Path

    def __repr__(self) -> str:
        return f"<EquationFile {self.name}: {count_text(len(self.systems), 'system')}>"


@names_wrong_types(ModelError)
def read_equations(path: str | Path) -> EquationFile:
    """Read a JSON or TOML equation file; its fields are those of `equations`.

    Parameters
    ----------
    path : of the file, .json or .toml.

    Raises
    ------
    DataError
        If the file is absent, larger than `MAX_BYTES`, or not JSON or TOML (with the line).
    ModelError
        If its equations contradict themselves; the message names file, field and entry.
    """
    path = Path(path)
    fields = _loaded(path)
    name = text_of(fields, "name", path.name) or path.stem
    description = text_of(fields, "description", path.name)
    systems = parse_systems(fields, name=name, where=path.name)
    return EquationFile(name, description, systems, path)


def _loaded(path: Path) -> Mapping[str, Any]:
    if path.suffix.lower() not in (".json", ".toml"):
        raise DataError(f"{path}: equations are read from .json or .toml; rename or convert it")
    if not path.is_file():
        folder = path.parent if path.parent.is_dir() else Path()
        there = [p.name for p in folder.glob(f"*{path.suffix}")]
        raise DataError(f"{path}: no such equation file{nearest(path.name, there)}")
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); check its rights") from error
    if len(data) > MAX_BYTES:
        raise DataError(
            f"{path}: larger than {MAX_BYTES / 1e6:g} MB, too large for equations; check that it "
            "is an equation file, or give a mapping to parse_systems"
        )
    kind = path.suffix.lower()[1:].upper()
    try:
        text = data.decode("utf-8-sig")
        loaded = _from_json(text) if kind == "JSON" else tomllib.loads(text)
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise DataError(f"{path}, line {line}: not UTF-8; save it in that encoding") from error
    except ModelError as error:
        raise ModelError(f"{path.name}: {error}") from None
    except json.JSONDecodeError as error:
        raise DataError(
            f"{path}, line {error.lineno}, column {error.colno}: not JSON ({error.msg}); correct "
            "that line: names and formulas in double quotes, commas between entries, none at the "
            "end"
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise DataError(
            f"{path}: not TOML ({error}); correct that line: formulas in quotes, each key once"
        ) from error
    except (RecursionError, ValueError) as error:
        raise DataError(
            f"{path}: not {kind} that can be read (nested too deep, or a number of too many "
            "digits); an equation file holds lists and mappings of names and formulas"
        ) from error
    if not isinstance(loaded, Mapping):
        raise ModelError(f"{path.name}: expected a mapping of fields, such as states, equations")
    return loaded


def _from_json(text: str) -> Any:
    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        """A mapping whose keys occur once; a repeated key is refused."""
        seen = dict(pairs)
        if len(seen) < len(pairs):
            keys = [k for k, _ in pairs]
            twice = next(k for k in keys if keys.count(k) > 1)
            raise ModelError(f"{twice!r} occurs twice in one mapping; remove one of them")
        return seen

    def refuse(word: str) -> NoReturn:
        raise ModelError(f"{word} is no number that an equation can use; remove it")

    return json.loads(text, object_pairs_hook=once, parse_constant=refuse)
