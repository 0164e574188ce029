"""Tables in files: their columns, units and rows, whatever wrote them."""

from __future__ import annotations

import difflib
import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casid.data.reading.file_format import FileFormat
from casid.errors import DataError, shell_option

if TYPE_CHECKING:
    import pandas as pd

    from casid.data.reading.number_marks import Mark

_LONGEST_NAME = 1000  # characters of a column's name; a longer one is a row or a damaged file


class Table(ABC):
    """A file opened far enough to know its columns.

    Attributes
    ----------
    columns : names as written; one that is there twice has the number of its column behind it.
    units : column -> unit that the file names beside the columns' names.
    unnamed : columns without a name, such as an index.
    twice : name that several columns have -> their names here.
    remarks : what a user should know of how it was read.
    decimal : the decimal mark of cells that are text; None where the file leaves it open.
    origin : the first date, where the time stamps are dates.
    is_numbered : whether the file has no names of columns, which are numbered then.
    clocks : columns that are called time stamps, the first of them the clock.
    date_column : the dates of a file that has the time of day in a column of its own.
    """

    def __init__(self, path: Path, form: FileFormat) -> None:
        self.path = path
        self.form = form
        self.columns: list[str] = []
        self.units: dict[str, str] = {}
        self.unnamed: set[str] = set()
        self.twice: dict[str, list[str]] = {}
        self.remarks: list[str] = []
        self.is_numbered = False
        self.decimal: Mark | None = form.decimal
        self.origin: Any = None
        self.clocks: tuple[str, ...] = ()
        self.date_column: str | None = None

    def name_columns(self, names: Sequence[str], units: Sequence[str] = ()) -> None:
        """Take the names and units of the columns, each name once."""
        longest = max(names, key=len, default="")
        if len(longest) > _LONGEST_NAME:
            raise DataError(
                f"{self.path.name}: a column is named by {len(longest)} characters, "
                f"{longest[:30]!r} and so on. Write its name in the file's header."
            )
        for number, name in enumerate(names, start=1):
            unique = name or f"column {number}"
            if name and list(names).count(name) > 1:
                unique = f"{name}#{number}"
                self.twice.setdefault(name, []).append(unique)
            if not name:
                self.unnamed.add(unique)
            self.columns.append(unique)
        for name, numbered in self.twice.items():
            self.remarks.append(
                f"more than one column is named {name!r}; they are called {', '.join(numbered)} "
                "(the number is the column's)"
            )
        for name, unit in zip(self.columns, units, strict=False):
            if unit.strip(" -"):
                self.units[name] = unit.strip()

    @abstractmethod
    def read(self, columns: list[str]) -> pd.DataFrame:
        """Read the named columns whole."""

    def chunks(self, columns: list[str], size: int) -> Iterator[pd.DataFrame]:
        """Read the named columns `size` rows at a time."""
        frame = self.read(columns)
        for start in range(0, len(frame), size):
            yield frame.iloc[start : start + size]

    def sample(self, column: str) -> list[str]:
        """The first cells of a column that are not empty, as text; none where they are numbers."""
        return []

    def place(self, row: int) -> str:
        """Say where a row stands, from 1."""
        return f"row {row + 1}"

    def require(self, column: str, what: str, taken: Collection[str] = ()) -> None:
        """Refuse a column that is not there, or there twice, naming the nearest not `taken`."""
        if column in self.columns:
            return
        if column in self.twice:
            example = shell_option("--map", f"{what}={self.twice[column][0]}")
            raise DataError(
                f"{self.path.name}: more than one column is named {column!r}. Give each column "
                f"its own name in the header, or map one by its number, as in {example} "
                f"(there are {', '.join(self.twice[column])})."
            )
        folded = {c.casefold(): c for c in self.columns if c not in taken}
        name = column.casefold()
        near = [c for c in folded if re.fullmatch(rf"{re.escape(name)}\s*[\[(/].*", c)]
        near = near or [c for c in folded if c == what.casefold()]
        near = near or difflib.get_close_matches(name, list(folded), n=1, cutoff=0.6)
        example = shell_option("--map", f"{what}={folded[near[0]] if near else 'COLUMN'}")
        raise DataError(
            f"{self.path.name}: no column {column!r} for {what}. "
            + (f"Did you mean {folded[near[0]]!r}? " if near else "")
            + f"The file holds {', '.join(self.columns)}. "
            f"Map the channel to one of them, as in {example}."
        )


class FrameTable(Table):
    """A table that is in memory: a sheet, a group of a measurement file."""

    def __init__(
        self, path: Path, form: FileFormat, frame: pd.DataFrame, units: Mapping[str, str]
    ) -> None:
        super().__init__(path, form)
        self.name_columns([str(c) for c in frame.columns])
        self.frame = frame.set_axis(self.columns, axis=1)
        self.units = {c: u for c, u in units.items() if c in self.columns and u.strip()}
        if len(frame) == 0:
            raise DataError(
                f"{path.name}: the file holds no rows. Export the measurement again, "
                "or give another file."
            )

    def read(self, columns: list[str]) -> pd.DataFrame:
        """The named columns."""
        return self.frame[columns]

    def sample(self, column: str) -> list[str]:
        """The first cells of a column that are not empty, as text; none where they are numbers."""
        cells = self.frame[column].dropna().iloc[:20]
        return [] if cells.dtype.kind in "fiub" else [str(c) for c in cells]
