"""Tables in text: CSV as instruments and spreadsheets write it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casid.data.reading.file_format import FileFormat
from casid.data.reading.layout import NO_VALUE, cells_of, is_date, layout_of, names_above
from casid.data.reading.number_marks import Evidence, decimal_mark
from casid.data.reading.tables import Table
from casid.data.reading.text_source import COMMENT, HEAD, TextSource
from casid.errors import DataError
from casid.model.quantities import count_text

if TYPE_CHECKING:
    import pandas as pd

_MISSING = ["-", "--", "---", "?", "*", "n.a.", "#NV", "#VALUE!", "#WERT!", "#DIV/0!", "#REF!"]
_MISSING += ["#BEZUG!", "<NA>", "bad", "Bad", "no data", "No Data", "NoData", "missing", "1.#INF"]


_EMPTY = (
    "the file holds no header and no samples. Export the measurement again, or give another file."
)


def _is_count(rows: list[list[str]]) -> bool:
    """Whether the first line counts the columns, 0, 1, 2 or 1, 2, 3, as a program's header does."""
    first = rows[0]
    counts = any(first == [str(k + start) for k in range(len(first))] for start in (0, 1))
    return counts and len(first) > 2 and any("." in c or "e" in c for r in rows[1:] for c in r)


class TextTable(Table):
    """A table in a text file."""

    def __init__(self, path: Path, form: FileFormat) -> None:
        super().__init__(path, form)
        self.source = TextSource(path, form)
        self.remarks += self.source.remarks
        head = self.source.head()
        self.layout = layout_of(head, self.source.tail())
        self._frame: pd.DataFrame | None = None
        self.trailing = 0  # empty columns behind the last named one
        self._take_names(head)
        self._comments = self._lines_of_comment() if self.source.has_comments else []
        self._rows = self._first_rows(head)
        self._take_decimal()
        self._say_layout()

    def _take_names(self, head: list[str]) -> None:
        layout, name = self.layout, self.path.name
        if not any(line.strip() for line in head):
            raise DataError(f"{name}: {_EMPTY}")
        if not layout.names and (named := names_above(head[: layout.first], layout)):
            raise DataError(
                f"{name}: the header names {len(named)} columns, the rows hold {layout.width} "
                f"values; the last names are {', '.join(named[layout.width :])}. Take away the "
                "names that have no column, or correct the separator."
            )
        if not layout.names:
            self._number_columns(head)
            return
        names = list(layout.names)
        while len(names) > 1 and not names[-1] and len(names) > layout.width:
            names.pop()
        first = head[layout.first : layout.first + 1]
        if not first:
            raise DataError(
                f"{name}: the file holds a header ({', '.join(names)}) and no samples. "
                "Export the measurement again, or give another file."
            )
        cells = cells_of(first[0], layout.separator)
        while len(cells) > len(names) and not cells[-1]:
            cells.pop()  # a separator at the end of every line
            self.trailing += 1
        if len(cells) > len(names):
            raise DataError(
                f"{name}: the header names {len(names)} columns, the first row holds "
                f"{len(cells)} values. Give every column a name, or correct the separator; decimal "
                "commas need semicolons, tabs or quotes."
            )
        while not names[-1] and len(names) > 1 and self.trailing == 0 and len(cells) == len(names):
            if any(cells_of(x, layout.separator)[-1:] != [""] for x in head[layout.first :] if x):
                break
            names.pop()
            cells.pop()
            self.trailing += 1
        self.name_columns(names, layout.units)

    def _number_columns(self, head: list[str]) -> None:
        """Names for the columns of a file that has none, by their places."""
        layout, name = self.layout, self.path.name
        rows = [cells_of(x, layout.separator) for x in head if x.strip() and not COMMENT.match(x)]
        if not rows or layout.first >= len(head):  # comments alone
            raise DataError(f"{name}: {_EMPTY}")
        first = cells_of(head[layout.first], layout.separator)
        if layout.above or _is_count(rows):
            raise DataError(
                f"{name}: the first line holds numbers, not column names. "
                "Put a header line with one name per column above it."
            )
        columns = [f"column {k + 1}" for k in range(len(first))]
        while len(columns) > 1 and all("".join(r[len(columns) - 1 :]) == "" for r in rows):
            columns.pop()  # a separator at the end of every line
            self.trailing += 1
        are, one = (
            ("column is", columns[0])
            if len(columns) == 1
            else ("columns are", f"{columns[0]} to {columns[-1]}")
        )
        shown = ", ".join(first[: len(columns)])
        self.remarks.append(
            f"no line of names: the {are} called {one}, and the first row is {shown}"
        )
        self.is_numbered = True
        self.name_columns(columns)

    def _lines_of_comment(self) -> list[int]:
        lines = enumerate(self.source.lines())
        return [k for k, line in lines if k >= self.layout.first and COMMENT.match(line)]

    def _first_rows(self, head: list[str]) -> list[list[str]]:
        lines = (x for x in head[self.layout.first :] if x.strip() and not COMMENT.match(x))
        rows = [cells_of(x, self.layout.separator) for x in lines]
        return rows[: len(rows) - self.layout.footers] if len(head) < HEAD else rows

    def sample(self, column: str) -> list[str]:
        """The first cells of a column that are not empty, as text."""
        k = self.columns.index(column)
        cells = (row[k] for row in self._rows if k < len(row))
        return [c for c in cells if c.casefold() not in NO_VALUE]

    def _take_decimal(self) -> None:
        """The decimal mark, from the first rows."""
        if self.decimal is not None:
            return
        found = Evidence().add(c for row in self._rows for c in row if c and not is_date(c))
        # Semicolons stand between columns where commas are decimal marks.
        commas = self.layout.separator == ";" and "," in found.either and "." not in found.decimal
        self.decimal = decimal_mark(found, default="," if commas else None)
        if self.layout.separator == ";" and list(found.either) == ["."] and not self.decimal:
            cell = found.either["."]
            self.remarks.append(
                f"{cell!r} was read with a decimal point; where the point separates thousands, add "
                "--decimal ,"
            )
        if commas and not found.decimal and not found.thousands:
            cell = found.either[","]
            self.remarks.append(
                f"{cell!r} was read as {cell.replace(',', '.')}, with a decimal comma; where the "
                "comma separates thousands, add --decimal ."
            )

    def _say_layout(self) -> None:
        layout = self.layout
        if layout.above:
            self.remarks.append(
                f"{count_text(layout.above, 'line')} above the names of the columns not read"
            )
        if layout.footers:
            self.remarks.append(f"{count_text(layout.footers, 'line')} below the last row not read")
        if self._comments:
            self.remarks.append(f"{count_text(len(self._comments), 'line')} of comment not read")
        if layout.units:
            self.remarks.append(
                f"units from a row of units: {', '.join(filter(None, layout.units))}"
            )

    def _options(self) -> dict[str, Any]:
        import pandas as pd

        # Exact decimals are the default from pandas 3 on, and asking for them warns there.
        exact = {} if int(pd.__version__.split(".")[0]) >= 3 else {"float_precision": "round_trip"}
        first = self.layout.first
        separator = self.layout.separator
        decimal = self.decimal or "."
        return {
            "sep": r"\s+" if separator == " " else separator,
            # A comma that separates columns is a decimal mark in quotes alone: read as text.
            "decimal": decimal if decimal != separator else ".",
            "encoding": self.source.encoding,
            "skiprows": [*range(first), *self._comments] if self._comments else first,
            "header": None,
            "na_values": [*_MISSING, *self.form.missing],
            # All columns are read: if it takes a few, pandas drops surplus cells without a word,
            # and a decimal comma in a comma file would pass.
            "names": [*self.columns, *(f"\0{i}" for i in range(self.trailing))],
            "skipinitialspace": True,
            "low_memory": False,
            **exact,
        }

    def read(self, columns: list[str]) -> pd.DataFrame:
        """Read the named columns whole."""
        import pandas as pd

        if self._frame is not None:
            return self._frame[columns]
        try:
            frame: pd.DataFrame = pd.read_csv(self.source.handle(), **self._options())
        except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError) as error:
            raise self._broken(error) from None
        if self.layout.footers:
            frame = frame.iloc[: -self.layout.footers]
        self._frame = frame
        return frame[columns]

    def _broken(self, error: Exception) -> DataError:
        reason = str(error).strip().splitlines()[-1].rpartition("C error: ")[2].rstrip(".")
        return DataError(
            f"{self.path.name}: the table is broken: {reason}. "
            "Give every line as many values as the header has names."
        )

    def chunks(self, columns: list[str], size: int) -> Iterator[pd.DataFrame]:
        """Read the named columns `size` rows at a time."""
        import pandas as pd

        if self.layout.footers:
            yield from super().chunks(columns, size)
            return
        try:
            with pd.read_csv(self.source.handle(), chunksize=size, **self._options()) as reader:
                for frame in reader:
                    yield frame[columns]
        except (pd.errors.ParserError, ValueError) as error:
            raise self._broken(error) from None

    def place(self, row: int) -> str:
        """The line of a row."""
        line = next(itertools.islice(self._row_lines(), row, None), None)
        return f"row {row + 1}" if line is None else f"line {line}"

    def _row_lines(self) -> Iterator[int]:
        """The line number, from 1, of each row; the slow way, for messages only."""
        number = 0
        for k, line in enumerate(self.source.lines()):
            number += line.count("\n") + 1
            if k >= self.layout.first and line.strip() and not COMMENT.match(line):
                yield number
