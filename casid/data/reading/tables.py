"""Tables in files: CSV as instruments and spreadsheets write it, and Parquet."""

from __future__ import annotations

import csv
import difflib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casid.errors import DataError

if TYPE_CHECKING:
    import pandas as pd

_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".parquet", ".pq")


class Table:
    """A file opened far enough to know its columns."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        _refuse_path(self.path)
        self.is_parquet = self.path.suffix.lower() in {".parquet", ".pq"} or _magic(self.path)
        self.separator = ","
        self.decimal = "."
        self.encoding = "utf-8-sig"
        self.header_line = 0  # lines above the header
        self.origin: Any = None  # the first date, where time stamps are dates
        self.trailing = 0  # empty columns behind the last named one
        self.columns = self._parquet_columns() if self.is_parquet else self._csv_columns()
        twice = sorted({c for c in self.columns if self.columns.count(c) > 1})
        if twice:
            raise DataError(
                f"{self.path.name}: more than one column is named {', '.join(map(repr, twice))}. "
                "Give each column its own name in the header."
            )

    def _parquet_columns(self) -> list[str]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            file = pq.ParquetFile(self.path)
        except (pa.ArrowInvalid, OSError) as error:
            raise DataError(
                f"{self.path.name}: not a readable Parquet file ({str(error).splitlines()[0]}). "
                "Write it again, or give the measurement as CSV."
            ) from None
        if file.metadata.num_rows == 0:
            raise DataError(
                f"{self.path.name}: the file holds no rows. Export the measurement again, "
                "or give another file."
            )
        return [str(name) for name in file.schema_arrow.names]

    def _csv_columns(self) -> list[str]:
        if self.path.stat().st_size == 0:
            raise DataError(
                f"{self.path.name}: the file is empty. Export the measurement again, "
                "or give another file."
            )
        with self.path.open("rb") as file:
            start = file.read(65536)
        if b"\0" in start:
            raise DataError(
                f"{self.path.name}: not a text file (it holds zero bytes). "
                "Give a CSV in UTF-8, or a Parquet file named .parquet."
            )
        if not self._is_utf8():
            self.encoding = "latin-1"
        lines = self._header_and_first_row()
        if not lines:
            raise DataError(
                f"{self.path.name}: the file holds no header and no samples. "
                "Export the measurement again, or give another file."
            )
        counts = {s: lines[0].count(s) for s in (";", "\t", ",")}
        self.separator = max(counts, key=lambda s: counts[s])
        names = self._split(lines[0])
        if all(_is_number(n) for n in names):
            raise DataError(
                f"{self.path.name}: the first line holds numbers, not column names. "
                "Put a header line with one name per column above it."
            )
        if len(lines) == 1:
            raise DataError(
                f"{self.path.name}: the file holds a header ({', '.join(names)}) and no samples. "
                "Export the measurement again, or give another file."
            )
        cells = self._split(lines[1])
        while len(cells) > len(names) and not cells[-1]:
            cells.pop()  # a separator at the end of every line
            self.trailing += 1
        if len(cells) > len(names):
            raise DataError(
                f"{self.path.name}: the header names {len(names)} columns, the first row holds "
                f"{len(cells)} values. Give every column a name, or correct the separator."
            )
        if self.separator == ";" and any(
            re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", c) for c in cells
        ):
            self.decimal = ","
        return names

    def _is_utf8(self) -> bool:
        try:
            with self.path.open("rb") as file:
                for block in iter(lambda: file.read(1 << 20), b""):
                    if not block.isascii():
                        self.path.read_text(encoding="utf-8-sig")
                        break
        except UnicodeDecodeError:
            return False
        return True

    def _header_and_first_row(self) -> list[str]:
        """The first two lines that are not empty; `header_line` counts those above the header."""
        lines: list[str] = []
        with self.path.open(encoding=self.encoding, newline=None) as text:
            for line in text:
                if not lines and (not line.strip() or line.lstrip().startswith("#")):
                    self.header_line += 1
                    continue
                if line.strip():
                    lines.append(line.rstrip("\n"))
                if len(lines) == 2:
                    break
        return lines

    def _split(self, line: str) -> list[str]:
        return [c.strip() for c in next(csv.reader([line], delimiter=self.separator))]

    def _csv_options(self) -> dict[str, Any]:
        import pandas as pd

        # Exact decimals are the default from pandas 3 on, and asking for them warns there.
        exact = {} if int(pd.__version__.split(".")[0]) >= 3 else {"float_precision": "round_trip"}
        return {
            "sep": self.separator,
            "decimal": self.decimal,
            "encoding": self.encoding,
            "skiprows": self.header_line + 1,
            "header": None,
            # All columns are read: if it takes a few, pandas drops surplus cells without a word,
            # and a decimal comma in a comma file would pass.
            "names": [*self.columns, *(f"\0{i}" for i in range(self.trailing))],
            "skipinitialspace": True,
            **exact,
        }

    def read(self, columns: list[str]) -> pd.DataFrame:
        """Read the named columns whole."""
        import pandas as pd

        frame: pd.DataFrame
        if self.is_parquet:
            import pyarrow.parquet as pq

            frame = pq.read_table(self.path, columns=columns).to_pandas(ignore_metadata=True)
            return frame
        try:
            frame = pd.read_csv(self.path, low_memory=False, **self._csv_options())
        except (pd.errors.ParserError, ValueError) as error:
            raise self._broken(error) from None
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

        if self.is_parquet:
            import pyarrow.parquet as pq

            # Without these pyarrow reads ahead, all of the file; a row group may be all of it too.
            file = pq.ParquetFile(self.path, pre_buffer=False, buffer_size=1 << 20)
            for batch in file.iter_batches(batch_size=size, columns=columns):
                yield batch.to_pandas(ignore_metadata=True)
            return
        try:
            with pd.read_csv(
                self.path, chunksize=size, low_memory=False, **self._csv_options()
            ) as reader:
                for frame in reader:
                    yield frame[columns]
        except (pd.errors.ParserError, ValueError) as error:
            raise self._broken(error) from None

    def place(self, row: int) -> str:
        """Return the place of a row: the line of a CSV file, the row of a Parquet file (from 1)."""
        if self.is_parquet:
            return f"row {row + 1}"
        for index, (line, _) in enumerate(self._rows()):
            if index == row:
                return f"line {line}"
        return f"row {row + 1}"

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield (line number, cells) of each data row; the slow way, for messages only."""
        with self.path.open(encoding=self.encoding, newline="") as text:
            reader = csv.reader(text, delimiter=self.separator)
            header = True
            for cells in reader:
                if reader.line_num <= self.header_line or not any(c.strip() for c in cells):
                    continue
                if header:
                    header = False
                    continue
                yield reader.line_num, cells

    def require(self, column: str, what: str) -> None:
        """Refuse a column that is not there, naming the nearest."""
        if column in self.columns:
            return
        folded = {c.casefold(): c for c in self.columns}
        near = difflib.get_close_matches(column.casefold(), list(folded), n=1, cutoff=0.4)
        raise DataError(
            f"{self.path.name}: no column {column!r} for {what}. "
            + (f"Did you mean {folded[near[0]]!r}? " if near else "")
            + f"The file holds {', '.join(self.columns)}. "
            f"Map the channel to one of them, as in "
            f"--map {what}={folded[near[0]] if near else self.columns[-1]}."
        )


def _refuse_path(path: Path) -> None:
    if path.is_dir():
        inside = sorted(p.name for p in path.iterdir() if p.suffix.lower() in _SUFFIXES)
        raise DataError(
            f"{path} is a folder, not a file. "
            + (
                f"Give one of its files: {', '.join(inside[:8])}."
                if inside
                else "Give a CSV or Parquet file."
            )
        )
    if path.exists():
        return
    folder = path.parent
    if not folder.is_dir():
        raise DataError(f"{path}: there is no folder {folder}. Check the path.")
    files = [p.name for p in folder.iterdir() if p.is_file()]
    near = difflib.get_close_matches(path.name, files, n=1, cutoff=0.4)
    data = sorted(f for f in files if f.lower().endswith(_SUFFIXES))
    hint = f"Did you mean {near[0]!r}?" if near else ""
    if not near:
        hint = f"The folder holds {', '.join(data[:8])}." if data else "Check the path."
    raise DataError(f"{path}: there is no such file. {hint}")


def _magic(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == b"PAR1"


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
