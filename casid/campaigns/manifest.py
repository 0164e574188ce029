"""The manifest of a campaign: what its results depend on, compared with what a folder has."""

from __future__ import annotations

import dataclasses
import functools
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from casid.errors import DataError

MANIFEST = "campaign.json"
"""Its file in the folder of a campaign."""


def manifest_of(
    function: Any, seed: int, settings: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """All that the rows of a campaign depend on, as `campaign.json` holds it."""
    from casid.versions import versions

    own = {**_settings_of(function), **(settings or {})}
    return {
        "schema": "casid.campaigns.campaign/1",
        "function": name_of(function),
        "seed": int(seed),
        "settings": {name: _plain(name, value) for name, value in own.items()},
        "versions": versions(),
    }


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """The manifest of the campaign in `folder`, None where there is none.

    Raises
    ------
    DataError
        If the file is there and cannot be read.
    """
    path = folder / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise DataError(f"{path} is no JSON ({error}); name another folder") from error
    return content if isinstance(content, dict) else {}


def difference(folder: Path, there: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """What a folder's manifest has otherwise than a new one, as a refusal with its remedy."""
    a, b = _flat(there), _flat(new)
    differ = [
        f"{name} is {a.get(name, 'not given')} there and {b.get(name, 'not given')} now"
        for name in dict.fromkeys([*a, *b])
        if (name in a, a.get(name)) != (name in b, b.get(name))
    ]
    return (
        f"{folder} holds another campaign: {'; '.join(differ)}. Name another folder, or repeat the "
        "call as it was to continue that one, or begin anew (resume=False, or --force)"
    )


def _flat(content: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            out |= _flat(value, f"{before}{name} ")
        else:
            out[f"{before}{name}"] = value
    return out


def continues(folder: Path, manifest: Mapping[str, Any]) -> bool:
    """True if `folder` holds the campaign of this manifest."""
    return read_manifest(folder) == manifest


def name_of(function: Any) -> str:
    """Module and name of a function, of what a partial calls, or of a callable object's class."""
    while isinstance(function, functools.partial):
        function = function.func
    named = function if hasattr(function, "__qualname__") else type(function)
    module = named.__module__
    if module == "__main__":  # python -m analysis.study, or python analysis/study.py
        spec = getattr(sys.modules["__main__"], "__spec__", None)
        module = spec.name if spec is not None else Path(sys.argv[0]).stem or module
    return f"{module}.{named.__qualname__}"


def _settings_of(function: Any) -> dict[str, Any]:
    """The plain values that a partial or a dataclass carries."""
    values: dict[str, Any] = {}
    if isinstance(function, functools.partial):
        values = _settings_of(function.func)
        values |= {f"argument {i}": value for i, value in enumerate(function.args)}
        values |= function.keywords
    elif dataclasses.is_dataclass(function) and not isinstance(function, type):
        values = {f.name: getattr(function, f.name) for f in dataclasses.fields(function)}
    return {name: value for name, value in values.items() if _is_plain(value)}


def _is_plain(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(isinstance(k, str) and _is_plain(v) for k, v in value.items())
    if isinstance(value, list | tuple):
        return all(_is_plain(v) for v in value)
    return isinstance(value, bool | int | float | str | None) or isinstance(value, Path)


def _plain(name: str, value: Any) -> Any:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not _is_plain(value):
        raise DataError(
            f"setting {name!r} is {type(value).__name__}; give numbers, strings, and lists or "
            "mappings of them, so that a later call can be compared with it"
        )
    if isinstance(value, Mapping):
        return {str(k): _plain(name, v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(name, v) for v in value]
    return str(value) if isinstance(value, Path) else value
