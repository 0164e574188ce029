"""The records of a fleet: which file is of which asset and time, in an order that only grows.

A record is known by its number, its place in this list. New files come behind the old ones, so that
what was done of a record stays valid when others arrive.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from casid.data.reading.opening import open_table
from casid.errors import CasidError, DataError
from casid.fleets.record_files import RecordFile, local, natural, place_of
from casid.whole_files import replacing

RECORDS = "records.json"
"""Its file in the folder of a fleet."""

UNKNOWN = "unknown"
"""The asset of a record whose file does not say it."""

_FIELD = re.compile(r"\{(asset|time)\}|(\*)")


@dataclass(frozen=True, slots=True)
class FleetRecord:
    """One record of the fleet.

    Attributes
    ----------
    path : of its file.
    asset : what it was recorded on.
    when : seconds since 1970-01-01 where `is_dated`; else the number that the file has for its
        time, or the record's place among those of its asset, from 1.
    size, modified : of the file, bytes and ns, by which a change of it is noticed.
    """

    path: str
    asset: str
    when: float
    is_dated: bool
    size: int
    modified: int


def distinct_names(paths: Sequence[str]) -> list[str]:
    """The names of files, with as many folders before them as distinguish them from the others."""
    parts = [place_of(path).parts for path in paths]
    depths = [1] * len(paths)
    while True:
        names = ["/".join(p[-n:]) for p, n in zip(parts, depths, strict=True)]
        count = Counter(names)
        longer = [
            i for i, name in enumerate(names) if count[name] > 1 and depths[i] < len(parts[i])
        ]
        if not longer:
            return names
        for i in longer:
            depths[i] += 1


@dataclass(frozen=True, slots=True)
class Labels:
    """Where the asset and the time of a record stand.

    Parameters
    ----------
    asset : a pattern of the end of the path with {asset} in it, as in "{asset}/*.parquet" or
        "{asset}_{time}.csv"; or a column of the files, of which the first value counts. None: the
        name of the folder that the file is in.
    time : a column, or a pattern with {time}; None: the {time} of the asset's pattern, or else the
        natural order of the names.
    """

    asset: str | None = None
    time: str | None = None

    def __post_init__(self) -> None:
        for option, text, field in (
            ("asset", self.asset, "{asset}"),
            ("time", self.time, "{time}"),
        ):
            is_pattern = text is not None and re.search(r"[{}*/]", text)
            if is_pattern and field not in str(text):
                raise DataError(
                    f"{option} {text!r} is a pattern without {field}; write it as in "
                    f"'{field}/*.parquet', or name a column"
                )

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the files that are labels, and no signals."""
        return tuple(t for t in (self.asset, self.time) if t is not None and "{" not in t)

    def of(self, file: RecordFile) -> tuple[str, str | None]:
        """Asset and time of a file, in words; `UNKNOWN` and None where it does not say them."""
        first, path = _first_values(file.path, self.columns), file.place
        asset: str | None = path.parent.name or UNKNOWN
        when: str | None = None
        for text in (self.asset, self.time):
            if text is not None and "{" in text:
                found = _matched(text, path)
                asset = found.get("asset", UNKNOWN if text is self.asset else asset)
                when = found.get("time", when)
        if self.asset is not None and "{" not in self.asset:
            asset = first.get(self.asset, UNKNOWN)
        if self.time is not None and "{" not in self.time:
            when = first.get(self.time)
        return asset or UNKNOWN, when


def _require_labels(
    labels: Labels, new: Sequence[tuple[FleetRecord, str | None]], before: Sequence[FleetRecord]
) -> None:
    """Refuse an asset or a time that none of the records says."""
    if not new or before:
        return
    example = new[0][0].path
    readable = [r.path for r, _ in new if _has_rows(r.path)] if labels.columns else []
    for option, text, lacking in (
        ("asset", labels.asset, all(r.asset == UNKNOWN for r, _ in new)),
        ("time", labels.time, all(when is None for _, when in new)),
    ):
        if text is None or not lacking:
            continue
        if "{" in text:
            raise DataError(
                f"{option} {text!r} matches none of the {len(new)} records, the first of which is "
                f"{example}; write the pattern of the end of their paths, as in "
                "'{asset}/{time}.parquet' (--asset)"
            )
        if readable:
            raise DataError(
                f"{option} {text!r}: none of the {len(new)} records has such a column, the first "
                f"of which is {readable[0]}; name a column of the files, or a pattern of their "
                f"paths with {{{option}}} in it"
            )
    if not any(math.isfinite(r.when) for r, _ in new):
        said = [when for _, when in new if when is not None]
        if said:
            raise DataError(
                f"the times of the records, {said[0]!r} the first, are neither dates nor numbers; "
                "write them as 2025-03-01, or leave {time} out for the order of the names"
            )


def _has_rows(path: str) -> bool:
    """True of a file that can be read."""
    try:
        with local(path) as file:
            return bool(open_table(file).columns)
    except (CasidError, OSError):
        return False


def _matched(pattern: str, path: PurePosixPath) -> dict[str, str]:
    parts, end = [], 0
    for field in _FIELD.finditer(pattern):
        parts.append(re.escape(pattern[end : field.start()]))
        parts.append("[^/]*" if field[2] else f"(?P<{field[1]}>[^/]+?)")
        end = field.end()
    text = "".join(parts) + re.escape(pattern[end:])
    found = re.search(f"(?:^|/){text}$", str(path))
    return {} if found is None else found.groupdict()


def _first_values(path: str, columns: Sequence[str]) -> dict[str, str]:
    """The first values of columns, as text; nothing of a file that cannot be read."""
    if not columns:
        return {}
    try:
        with local(path) as file:
            table = open_table(file)
            there = [c for c in columns if c in table.columns]
            frame = next(table.chunks(there, 1)) if there else None
    except (CasidError, StopIteration, OSError):
        return {}
    if frame is None or not len(frame):
        return {}
    return {c: str(frame[c].iloc[0]).strip() for c in there}


def _seconds(text: str) -> tuple[float, bool]:
    """A time as a number, and whether it was a date; NaN where it is neither."""
    import pandas as pd

    try:
        return float(text), False
    except ValueError:
        pass
    try:
        stamp = pd.Timestamp(text)
    except (ValueError, TypeError):
        return math.nan, False
    stamp = stamp.tz_convert(None) if stamp.tz is not None else stamp
    return (stamp - pd.Timestamp(0)).total_seconds(), True


class RecordList:
    """The records of a fleet by number, kept in its folder.

    Parameters
    ----------
    folder : of the fleet; None keeps nothing.

    Raises
    ------
    DataError
        If the list in the folder cannot be read.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.records: list[FleetRecord] = []
        if folder is None or not (folder / RECORDS).exists():
            return
        try:
            content = json.loads((folder / RECORDS).read_text(encoding="utf-8"))
            self.records = [FleetRecord(**entry) for entry in content]
        except (ValueError, TypeError) as error:
            raise DataError(
                f"{folder / RECORDS} cannot be read ({error}); name another folder"
            ) from error

    def add(self, files: Sequence[RecordFile], labels: Labels) -> int:
        """Take the files that are not there yet, by time; returns how many.

        Raises
        ------
        DataError
            If a file is another one than it was, some times are dates and others numbers, or no
            record has the asset or the time that was named.
        """
        known = {record.path: i for i, record in enumerate(self.records)}
        new: list[tuple[FleetRecord, str | None]] = []
        for file in files:
            at = known.get(file.path)
            if at is not None:
                self._require_same(self.records[at], file.size, file.modified)
                continue
            asset, text = labels.of(file)
            when, is_dated = (math.nan, False) if text is None else _seconds(text)
            record = FleetRecord(file.path, asset, when, is_dated, file.size, file.modified)
            new.append((record, text))
        _require_labels(labels, new, self.records)
        self._append(new)
        return len(new)

    def _append(self, new: Sequence[tuple[FleetRecord, str | None]]) -> None:
        kinds = {r.is_dated for r in self.records}
        kinds |= {r.is_dated for r, _ in new if math.isfinite(r.when)}
        if len(kinds) > 1:
            text = next(text for r, text in new if math.isfinite(r.when))
            raise DataError(
                f"the times of some records are dates and those of others are numbers, as "
                f"{text!r}; write all of them in one way"
            )
        count: dict[str, int] = {}
        for record in self.records:
            count[record.asset] = count.get(record.asset, 0) + 1
        timed = []
        for record, _ in new:
            if not math.isfinite(record.when):
                count[record.asset] = count.get(record.asset, 0) + 1
                place = float(count[record.asset])
                is_dated = True in kinds  # a file that cannot be read is of when it was written
                when = 1e-9 * record.modified if is_dated else place
                record = replace(record, when=when, is_dated=is_dated)
            timed.append(record)
        timed.sort(key=lambda r: (r.when, natural(r.asset), natural(r.path)))
        self.records += timed

    def _require_same(self, record: FleetRecord, size: int, modified: int) -> None:
        if (record.size, record.modified) != (size, modified):
            raise DataError(
                f"{record.path} was changed after it was done; give the changed record a name of "
                "its own, or begin anew in another folder (or with resume=False, --force)"
            )

    def write(self) -> None:
        """Keep the list in the folder."""
        if self.folder is None:
            return
        content = json.dumps([asdict(r) for r in self.records], indent=0)
        with replacing(self.folder / RECORDS, is_synced=True) as file:
            file.write(content.encode())

    def frame(self) -> Any:
        """pandas.DataFrame, a row a record: record, asset, when, path."""
        import pandas as pd

        names = distinct_names([r.path for r in self.records])
        rows = [(i, names[i], r.asset, r.when, r.path) for i, r in enumerate(self.records)]
        return pd.DataFrame(rows, columns=["number", "record", "asset", "when", "path"])
