"""Files that results are saved in: one zip, or a folder, of JSON and Parquet."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import CasidError, DataError
from casid.saving.plain_values import Decoder, Encoder, columns_of
from casid.versions import versions
from casid.whole_files import write_bytes

SCHEMA = "casid.saved"
VERSION = 1
"""Of the files written; every version up to it is read."""

RESULT_FILE = "result.casid"
"""The saved result in the folder that a command writes, beside its page and JSON."""

_CONTENT = "result.json"
_GIVE = "give the path that save() returned, or the folder that a command wrote to (--out)"
_TIME = (1980, 1, 1, 0, 0, 0)  # of every member: the same result makes the same file


def save(result: Any, path: str | Path) -> Path:
    """Write a result to a file, or to a folder where `path` has no ending; returns the path.

    A file is a zip of what a folder holds: `result.json`, and a Parquet table for all arrays of one
    length, with a column for each attribute. It is written whole or not at all.

    Raises
    ------
    DataError
        If the result holds what no file can keep (a function of the user's own), or the path
        cannot be written, or is a folder with the result of a command.
    """
    path = Path(path)
    encoder = Encoder()
    content = encoder.plain(result, "")
    members = {
        _CONTENT: _text(
            {
                "schema": f"{SCHEMA}/{VERSION}",
                "kind": type(result).__name__,
                "versions": dict(versions()),
                "expressions": _packed(encoder.expressions),
                "content": content,
            }
        ),
        **_tables(encoder.arrays),
    }
    try:
        if path.suffix:
            write_bytes(path, _zipped(members))
        else:
            _refuse_taken(path)
            path.mkdir(parents=True, exist_ok=True)
            for old in path.glob("arrays_*.parquet"):
                if old.name not in members:
                    old.unlink()
            for name, data in members.items():
                write_bytes(path / name, data)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror}; give another path") from error
    return path


@names_wrong_types()
def load(path: str | Path) -> Any:
    """Read a saved `Estimate`, `Diagnosis`, `Assessment`, `FittedModel` or `MonteCarlo`.

    Parameters
    ----------
    path : of the file or folder that `save` wrote, or a folder that `casid identify` or `casid
        diagnose` wrote (its `result.casid`).

    Returns
    -------
    The result, equal in every number; its page and figures can be written again, and its model
    simulates to the last bit as it did.

    Raises
    ------
    DataError
        If there is no such file, it is no saved result or damaged, or it was saved by a later
        version of casid.

    Notes
    -----
    No code in the file is run: it names dataclasses of casid, and holds numbers, texts and
    expressions.
    """
    path = Path(path)
    members = _members(path)
    try:
        head = json.loads(members[_CONTENT])
        schema, _, number = str(head["schema"]).partition("/")
        version = int(number)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"{path.name}: no result of casid, or damaged ({_CONTENT} is no such text); give a "
            "file that save() wrote"
        ) from error
    if schema != SCHEMA or version < 1:
        raise DataError(f"{path.name}: has schema {head['schema']!r}, not {SCHEMA}/{VERSION}")
    if version > VERSION:
        by = head.get("versions", {}).get("casid", "unknown")
        raise DataError(
            f"{path.name}: was saved by a later casid ({by}, schema {head['schema']}), and this "
            f"one reads up to {SCHEMA}/{VERSION}; upgrade casid"
        )
    try:
        columns = _columns({n: data for n, data in members.items() if n != _CONTENT})
        return Decoder(columns, _unpacked(str(head["expressions"]))).value(head["content"])
    except CasidError as error:
        raise DataError(f"{path.name}: {error}") from error
    except Exception as error:
        raise DataError(
            f"{path.name}: damaged ({type(error).__name__}: {error}); save the result again"
        ) from error


# -- what a file is made of ---------------------------------------------------------------------


def _text(content: Mapping[str, Any]) -> bytes:
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def _packed(expressions: list[Any]) -> str:
    from casid.model.serialisation import packed

    return packed({"expressions": expressions})[1] if expressions else ""


def _unpacked(text: str) -> list[Any]:
    from casid.model.serialisation import expressions_of

    return expressions_of(text) if text else []


def _tables(arrays: Mapping[str, Array]) -> dict[str, bytes]:
    """A Parquet table for all arrays (N, ...) of one N."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    by_length: dict[int, dict[str, Any]] = {}
    for path, array in arrays.items():
        flat = array.reshape(len(array), -1)
        for j, name in enumerate(columns_of(path, array.shape)):
            by_length.setdefault(len(array), {})[name] = np.ascontiguousarray(flat[:, j])
    members = {}
    for length, columns in by_length.items():
        buffer = io.BytesIO()
        pq.write_table(pa.table(columns), buffer)
        members[f"arrays_{length}.parquet"] = buffer.getvalue()
    return members


def _columns(tables: Mapping[str, bytes]) -> dict[str, Array]:
    """All columns of all tables."""
    import pyarrow.parquet as pq

    found: dict[str, Array] = {}
    for data in tables.values():
        table = pq.read_table(io.BytesIO(data))
        found |= {name: table.column(name).to_numpy() for name in table.column_names}
    return found


def _refuse_taken(folder: Path) -> None:
    """Refuse a folder with the result of a command, which `load` would read instead."""
    if (folder / RESULT_FILE).is_file():
        raise DataError(
            f"{folder} holds the result of a command, {RESULT_FILE}, which load() would read; name "
            f"another folder, or a file such as {folder / 'mine.casid'}"
        )


def _members(path: Path) -> dict[str, bytes]:
    """The files inside."""
    if path.is_dir() and (path / RESULT_FILE).is_file():
        path = path / RESULT_FILE
    if path.is_dir():
        found = [path / _CONTENT, *sorted(path.glob("arrays_*.parquet"))]
        if not found[0].exists():
            raise DataError(f"{path}: the folder holds no {_CONTENT}; {_GIVE}")
        return {p.name: p.read_bytes() for p in found}
    if not path.is_file():
        raise DataError(f"{path} does not exist; {_GIVE}")
    try:
        with zipfile.ZipFile(path) as file:
            return {name: file.read(name) for name in file.namelist()}
    except (zipfile.BadZipFile, OSError, EOFError) as error:
        raise DataError(
            f"{path.name}: no result of casid, or damaged ({error}); give a file that save() wrote"
        ) from error


def _zipped(members: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in members.items():
            file.writestr(zipfile.ZipInfo(name, _TIME), data, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()
