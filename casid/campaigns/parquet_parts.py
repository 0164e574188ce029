"""Rows of a campaign, kept as Parquet parts while it runs.

A folder holds `campaign.json` (what the rows are results of), `parts/*.parquet` while the campaign
runs, and `results.parquet` once it has ended. Every file is moved into place in one step: whatever
kills the process, a file is there whole or not at all, and the next call reads what is there.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from casid.campaigns.manifest import MANIFEST, difference, read_manifest
from casid.errors import DataError
from casid.whole_files import replacing

RUN, FAILED = "run", "failed"
"""The columns of every table: number of the run, and why it has no results (null: it has)."""

_RESULTS, _PARTS = "results.parquet", "parts"
_KINDS = ("bool", "int64", "double")  # each holds the ones before it
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}

Row = dict[str, Any]


def row_of(run: int, result: object) -> Row:
    """The results of one run as numbers and strings of Python.

    Raises
    ------
    DataError
        If `result` is no mapping of names to numbers and strings.
    """
    if not isinstance(result, Mapping):
        raise DataError(
            f"run {run} returned {type(result).__name__}, not a mapping of names to numbers and "
            "strings; return for example {'k': 10.4, 'd': 0.11}"
        )
    row: Row = {RUN: run}
    for name, value in result.items():
        if not isinstance(name, str) or name in (RUN, FAILED, ""):
            raise DataError(
                f"run {run} returned a result named {name!r}; use a string other than "
                f"{RUN!r} and {FAILED!r}, which the campaign fills in itself"
            )
        if getattr(value, "ndim", None) == 0:
            value = value.item()  # NumPy's number as Python's
        if not isinstance(value, bool | int | float | str | None) or (
            isinstance(value, int) and not -(2**63) <= value < 2**63
        ):
            raise DataError(
                f"run {run} returned {name} = {_short(value)}, which is neither a number of 64 "
                "bits nor a string; give each entry of an array a name of its own"
            )
        if value is not None:
            row[name] = value
    return row


def _short(value: object) -> str:
    text = repr(value)
    return f"{text[:57]}..." if len(text) > 60 else text


def table_of(rows: Sequence[Row]) -> Any:
    """Rows as an Arrow table by run number; a column that a row does not have is null there.

    Raises
    ------
    DataError
        If a column holds numbers in one run and strings in another.
    """
    import pyarrow as pa

    rows = sorted(rows, key=lambda row: int(row[RUN]))
    names = dict.fromkeys([RUN, *(name for row in rows for name in row if name != FAILED), FAILED])
    columns = {}
    for name in names:
        values = [row.get(name) for row in rows]
        kinds = {_kind_of(value) for value in values if value is not None}
        kind = _common(name, kinds or {"string"})
        if kind == "double":
            values = [None if v is None else float(v) for v in values]
        elif kind == "int64":
            values = [None if v is None else int(v) for v in values]
        columns[name] = pa.array(values, type=pa.type_for_alias(kind))
    return pa.table(columns)


def _kind_of(value: object) -> str:
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, int):
        return "int64"
    return "double" if isinstance(value, float) else "string"


def _common(name: str, kinds: set[str]) -> str:
    if "string" in kinds and len(kinds) > 1:
        raise DataError(
            f"result {name!r} is a number in some runs and a string in others; give the two "
            "different names"
        )
    return "string" if "string" in kinds else max(kinds, key=_KINDS.index)


def joined(tables: Sequence[Any]) -> Any:
    """One table of several, by run number: the same however the runs were divided into tables.

    Columns stand in the order of the first run that has them.
    """
    import pyarrow as pa

    tables = sorted((t for t in tables if t.num_rows), key=lambda t: int(t[RUN][0].as_py()))
    kinds: dict[str, set[str]] = {}
    first: dict[str, tuple[int, int]] = {}
    for table in tables:
        for place, field in enumerate(table.schema):
            column = table[field.name]
            valid = column.is_valid().to_pylist()
            if True not in valid:
                continue
            kinds.setdefault(field.name, set()).add(str(field.type))
            run = int(table[RUN][valid.index(True)].as_py())
            first[field.name] = min(first.get(field.name, (run, place)), (run, place))
    results = sorted(kinds.keys() - {RUN, FAILED}, key=lambda name: first[name])
    schema = pa.schema(
        [(RUN, pa.int64())]
        + [(name, pa.type_for_alias(_common(name, kinds[name]))) for name in results]
        + [(FAILED, pa.string())]
    )
    cast = [
        pa.table(
            [
                table[field.name].cast(field.type, safe=False)
                if field.name in table.schema.names
                else pa.nulls(table.num_rows, field.type)
                for field in schema
            ],
            schema=schema,
        )
        for table in tables
    ]
    whole = pa.concat_tables(cast) if cast else schema.empty_table()
    return whole.sort_by(RUN).combine_chunks()


class Parts:
    """The rows that a campaign has so far: in memory, and in a folder where it has one.

    Parameters
    ----------
    folder : where to keep them; None keeps them in memory alone.
    manifest : what the rows are results of; a folder that holds another campaign is refused.
    resume : False deletes what an earlier call of the campaign left in the folder.

    Raises
    ------
    DataError
        If the folder cannot be used, saying what differs and how to correct it.
    """

    def __init__(
        self, folder: Path | None, manifest: Mapping[str, Any], *, resume: bool = True
    ) -> None:
        self.folder = folder
        self.tables: list[Any] = []
        self.runs: set[int] = set()  # that have a row
        if folder is None:
            return
        with explained(folder, "nothing was begun"):
            (folder / _PARTS).parent.mkdir(parents=True, exist_ok=True)
            if not resume:
                self._delete()
            there = read_manifest(folder)
            if there is None:
                self._refuse_strangers()
                _write(folder / MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())
            elif there != manifest:
                raise DataError(difference(folder, there, manifest))
        self.tables = [_read(path) for path in self._files()]
        self.runs.update(*(table[RUN].to_pylist() for table in self.tables))

    def add(self, rows: Sequence[Row]) -> None:
        """Keep the rows of runs that had none.

        Raises
        ------
        DataError
            If they cannot be written: a full disk, a folder that has gone.
        """
        table = table_of(rows)
        if self.folder is not None:
            n = len(self.runs)
            with explained(self.folder, f"{n} runs are kept there, these {len(rows)} are not"):
                (self.folder / _PARTS).mkdir(exist_ok=True)
                first = int(table[RUN][0].as_py())
                _write(self.folder / _PARTS / f"{first:09d}.parquet", _parquet(table))
        self.tables.append(table)
        self.runs.update(table[RUN].to_pylist())

    def end(self) -> Any:
        """One table of all rows; the folder holds it as `results.parquet` in place of the parts."""
        whole = joined(self.tables)
        if self.folder is not None and (
            (self.folder / _PARTS).exists() or not (self.folder / _RESULTS).exists()
        ):
            with explained(self.folder, f"all {whole.num_rows} runs are kept there in parts"):
                _write(self.folder / _RESULTS, _parquet(whole))
                self._delete(_PARTS)
        self.tables = [whole]
        return whole

    def _files(self) -> list[Path]:
        assert self.folder is not None
        parts = sorted((self.folder / _PARTS).glob("*.parquet"))
        whole = self.folder / _RESULTS
        if not whole.exists():
            return parts
        # Killed between writing the whole and deleting its parts: those say the same once more.
        there = set(_read(whole)[RUN].to_pylist())
        return [whole, *(p for p in parts if not there >= set(_read(p)[RUN].to_pylist()))]

    def _refuse_strangers(self) -> None:
        assert self.folder is not None
        for name in (_RESULTS, _PARTS):
            if (self.folder / name).exists():
                raise DataError(
                    f"{self.folder} holds {name} but no {MANIFEST} that says what of; name "
                    "another folder"
                )

    def _delete(self, *names: str) -> None:
        """Delete the campaign's files, the manifest last, or the named ones of them."""
        assert self.folder is not None
        for name in names or (_PARTS, _RESULTS, MANIFEST):
            path = self.folder / name
            if path.is_dir():
                for file in (*path.glob("*.parquet"), *path.glob(".*.parquet.*")):
                    file.unlink()
                path.rmdir()
            else:
                path.unlink(missing_ok=True)


def _parquet(table: Any) -> bytes:
    import pyarrow.parquet as pq

    file = io.BytesIO()  # in memory first: the disk's errors are then Python's own
    pq.write_table(table, file)
    return file.getvalue()


def _read(path: Path) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(path).read()
        if {RUN, FAILED} <= set(table.schema.names):
            return table
        why = f"no columns {RUN} and {FAILED}"
    except (pa.ArrowException, OSError) as error:
        why = str(error)
    raise DataError(
        f"{path} cannot be read: {why}; delete it and repeat the call, its runs are then done anew"
    )


def _write(path: Path, content: bytes) -> None:
    with replacing(path, is_synced=True) as file:
        file.write(content)


@contextlib.contextmanager
def explained(folder: Path, state: str) -> Iterator[None]:
    """Turn what the disk refuses into what is kept and how to go on."""
    try:
        yield
    except OSError as error:
        full = error.errno in _FULL
        why = "the disk is full" if full else error.strerror or str(error)
        remedy = "make room" if full else "correct that"
        raise DataError(
            f"{folder}: {why}; {state}. To continue, {remedy} and repeat the same call"
        ) from error
