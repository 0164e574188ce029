"""Reading records from files."""

from __future__ import annotations

import csv
import difflib
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casid.data import BoolArray, FloatArray, Record
from casid.errors import DataError, UnitError
from casid.units import ambiguous_units, parse_unit, same_dimension, si_unit, to_si

if TYPE_CHECKING:
    import pandas as pd

UNIFORM = 0.01  # every interval within 1 % of the median
GAP = 1.5  # an interval longer than this many medians is a gap
_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".parquet", ".pq")
_TIME_NAMES = ("t", "time", "zeit", "timestamp", "seconds", "elapsed", "elapsed_time")


class ColumnSpec(NamedTuple):
    """Where a channel comes from.

    Attributes
    ----------
    column : str
        Name of the column in the file.
    unit : str, optional
        Unit in which the file is written. Without one, the ending of the column's name is taken
        (`phi_deg`, `phi [deg]`) where it fits the target, else the target.
    target : str, optional
        Unit the model expects; it fixes the dimension. Channels are always kept in SI.
    """

    column: str
    unit: str | None = None
    target: str | None = None


Columns = Mapping[str, "ColumnSpec | str | Sequence[str | None]"]


@dataclass(frozen=True, slots=True)
class Fault:
    """Something in a file that keeps it from being a record: what, where, and how to mend it."""

    kind: str
    text: str
    mend: str
    column: str | None = None

    def __str__(self) -> str:
        return f"{self.text} {self.mend}"


@dataclass(slots=True)
class Survey:
    """What was found in a file: the record where there is one, and every fault met on the way."""

    path: Path
    record: Record | None = None
    faults: list[Fault] = field(default_factory=list)
    times: FloatArray | None = None


# ---------------------------------------------------------------------- sources


def parse_source(text: str) -> tuple[Path, tuple[float, float] | None]:
    """Split `run.csv@12:194` into the path and the window [s]; open ends are infinite.

    Raises
    ------
    DataError
        If the window is not two numbers in order, or the path is empty.
    """
    head, at, tail = text.rpartition("@")
    if not at or (":" not in tail and not re.fullmatch(r"[\d.]+", tail)):
        head, tail = text, ""
    if not head.strip():
        raise DataError(
            f"data source {text!r} names no file. Write it as run.csv or run.csv@12:194."
        )
    return Path(head), (parse_window(tail) if tail else None)


def parse_window(text: str) -> tuple[float, float]:
    """Read a window `12:194`, `12:` or `:194` in seconds of the record's own clock.

    Raises
    ------
    DataError
        If it is not two numbers in order.
    """
    start, colon, stop = text.partition(":")
    try:
        if not colon:
            raise ValueError
        window = (
            float(start) if start.strip() else -np.inf,
            float(stop) if stop.strip() else np.inf,
        )
    except ValueError:
        raise DataError(
            f"window {text!r} is not two numbers of seconds. Write it as 12:194, or 12: and :194 "
            "with one end open."
        ) from None
    if not window[0] < window[1]:
        raise DataError(
            f"window {text!r} is empty or backward. Give the earlier time first, as in 12:194."
        )
    return window


def parse_case(text: str) -> tuple[str | None, Path, tuple[float, float] | None]:
    """Split `nominal=a.csv@12:194` into load case, path and window; the case is None without one.

    Raises
    ------
    DataError
        As `parse_source`, or if the case has no name.
    """
    case, equals, rest = text.partition("=")
    if (
        not equals
        or "/" in case
        or "\\" in case
        or (not Path(rest).exists() and Path(text).exists())
    ):
        return (None, *parse_source(text))
    if not case.strip():
        raise DataError(
            f"data source {text!r} has an empty load case. Write it as nominal=run.csv."
        )
    return (case.strip(), *parse_source(rest))


# ---------------------------------------------------------------------- tables


class _Table:
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

    @property
    def unit_of_place(self) -> str:
        return "row" if self.is_parquet else "line"

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
        try:
            with self.path.open("rb") as file:
                for block in iter(lambda: file.read(1 << 20), b""):
                    if not block.isascii():
                        self.path.read_text(encoding="utf-8-sig")
                        break
        except UnicodeDecodeError:
            self.encoding = "latin-1"
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
                f"{len(cells)} values. Give every column a name, or mend the separator."
            )
        if self.separator == ";" and any(
            re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", c) for c in cells
        ):
            self.decimal = ","
        return names

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
            # All columns are read: told to take a few, pandas drops surplus cells without a word,
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
        """Say where a row stands: the line of a CSV file, the row of a Parquet file (from 1)."""
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


# ---------------------------------------------------------------------- columns


def unit_from_name(column: str) -> str | None:
    """Return the unit a column's name ends with: `phi_deg`, `phi [deg]`, `u (V)`; None without one.

    Only units that can be read in one way count; `x_g` tells nothing.
    """
    bracket = _BRACKET.fullmatch(column)
    if bracket and bracket[1]:
        return _readable(bracket[2], bracketed=True) if bracket[2] else "1"
    stem, underscore, ending = column.rpartition("_")
    return _readable(ending, bracketed=False) if stem and underscore and ending else None


_BRACKET = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]")
# Endings that are more often a word, an index or another unit than what the list reads: x_in is an
# input, x_bar a mean, x_min a minimum, a_s a sensor's signal, u_ms metres a second.
_NO_ENDINGS = frozenset(
    "none 1 h hr min t s in rev bar L l ms us mg sec second seconds minute minutes hour hours "
    "foot feet amp percent pct".split()
)


def _readable(text: str, *, bracketed: bool) -> str | None:
    if not bracketed and text in _NO_ENDINGS:
        return None
    try:
        parse_unit(text)
    except UnitError:
        return None
    return text


def _resolve(
    table: _Table, columns: Columns | None, time: str | ColumnSpec | Sequence[str | None] | None
) -> tuple[dict[str, ColumnSpec], ColumnSpec | None]:
    """Return the channels to read and the time column, every unit settled."""
    clock = _time_column(table, time)
    if columns is None:
        named = [c for c in table.columns if c]  # an index written out has no name
        specs = {c: ColumnSpec(c) for c in named if clock is None or c != clock.column}
    else:
        specs = {name: _spec(value) for name, value in columns.items()}
        for name, spec in specs.items():
            table.require(spec.column, name)
    return {name: _with_unit(table, name, spec) for name, spec in specs.items()}, clock


def _spec(value: ColumnSpec | str | Sequence[str | None]) -> ColumnSpec:
    if isinstance(value, ColumnSpec):
        return value
    if isinstance(value, str):
        return ColumnSpec(value)
    parts = list(value)
    if not 1 <= len(parts) <= 3 or not isinstance(parts[0], str):
        raise DataError(
            f"column {value!r} cannot be read. Give (column, unit in the file, SI target), "
            "for example ('roll', 'deg', 'rad')."
        )
    return ColumnSpec(parts[0], *parts[1:])


def _with_unit(table: _Table, name: str, spec: ColumnSpec) -> ColumnSpec:
    unit = spec.unit
    if unit is None:
        ending = unit_from_name(spec.column)
        bracket = _BRACKET.fullmatch(spec.column)
        if bracket and ending is None and bracket[2] in ambiguous_units():
            ending = bracket[2]  # refused below: the file names a unit with two readings
        plain = ending is not None and (spec.target is None or bracket is not None)
        fits = ending is not None and (plain or same_dimension(ending, spec.target or "1"))
        unit = ending if fits else spec.target
    unit = unit or "1"
    try:
        to_si([], unit, spec.target)
    except UnitError as error:
        raise UnitError(
            f"{table.path.name}: channel {name} from column {spec.column!r}: {error}"
        ) from None
    return ColumnSpec(spec.column, unit, spec.target)


def _time_column(
    table: _Table, time: str | ColumnSpec | Sequence[str | None] | None
) -> ColumnSpec | None:
    if time is not None:
        spec = _spec(time)
        table.require(spec.column, "t")
        return _with_unit(table, "t", ColumnSpec(spec.column, spec.unit, "s"))
    for column in table.columns:
        bracket = _BRACKET.fullmatch(column)
        stem, unit = (bracket[1], bracket[2]) if bracket else _time_ending(column)
        if stem.casefold() in _TIME_NAMES and _is_time(unit):
            return ColumnSpec(column, unit, "s")
    return None


def _is_time(unit: str) -> bool:
    try:
        return same_dimension(unit, "s")
    except UnitError:
        return False


def _time_ending(column: str) -> tuple[str, str]:
    stem, underscore, ending = column.rpartition("_")
    if underscore and ending in {"s", "sec", "ms", "us", "min", "h"}:
        return stem, ending
    return column, "s"


# ---------------------------------------------------------------------- records


def read_record(
    path: str | Path,
    columns: Columns | None = None,
    *,
    time: str | ColumnSpec | Sequence[str | None] | None = None,
    window: tuple[float, float] | None = None,
    name: str | None = None,
    resample: float | None = None,
    Ts: float | None = None,
    mark_missing: bool = False,
) -> Record:
    """Read a record from a CSV or Parquet file, in SI units.

    Parameters
    ----------
    path : path of a CSV (comma, semicolon or tab) or Parquet file
        May carry a window, `run.csv@12:194`.
    columns : mapping of channel name to ColumnSpec, optional
        A column's name alone, or a tuple (column, unit in the file, SI target), will do. Without
        it every column of numbers is read under its own name, its unit from the name's ending.
    time : column of the time stamps, optional
        Found by its name (`t`, `time`, `t_s`, `time [ms]` ...) where not given. A file without
        one needs `Ts`.
    window : (start, stop), optional
        Seconds of the record's own clock; ends may be infinite. Only samples inside are judged.
    name : str, optional
        The file's name without its ending where not given.
    resample : float, optional
        Sample time [s] of a uniform grid onto which an irregular record is interpolated (PCHIP),
        written into the provenance. Samples inside gaps are marked missing.
    Ts : float, optional
        Sample time [s] of a file without time stamps; its clock starts at 0.
    mark_missing : bool
        Mark empty cells, NaN and Inf as missing instead of refusing them.

    Returns
    -------
    Record
        Ts = (t_end - t0)/(N - 1); the file's sha256 and every conversion in its provenance.

    Raises
    ------
    DataError
        For a file, column, value or clock that cannot be used. Uniform means that every interval
        is within 1 % of the median.
    UnitError
        For a unit that cannot be read or does not fit the channel.
    """
    found = survey(
        path,
        columns,
        time=time,
        window=window,
        name=name,
        resample=resample,
        Ts=Ts,
        mark_missing=mark_missing,
    )
    if found.faults:
        first, *others = found.faults
        more = f" ({len(others)} more: casid check {found.path.name} lists all.)" if others else ""
        error = UnitError if first.kind == "unit" else DataError
        raise error(f"{first}{more}")
    assert found.record is not None
    return found.record


def column_names(path: str | Path) -> tuple[str, ...]:
    """Return the names of a file's columns, in order, without reading its samples.

    A window behind the path, `run.csv@12:194`, is passed over.

    Raises
    ------
    DataError
        If there is no such file, or it is no table.
    """
    return tuple(_Table(_source(path)[0]).columns)


def survey(
    path: str | Path,
    columns: Columns | None = None,
    *,
    time: str | ColumnSpec | Sequence[str | None] | None = None,
    window: tuple[float, float] | None = None,
    name: str | None = None,
    resample: float | None = None,
    Ts: float | None = None,
    mark_missing: bool = False,
) -> Survey:
    """Read a file as `read_record` does, but collect the faults instead of raising at the first.

    Returns
    -------
    Survey
        The record is None where the clock cannot be used. Channels with faults are left out of
        it or, where only some samples are not finite, have those marked missing.
    """
    source, own_window = _source(path)
    window = own_window if window is None else window
    found = Survey(source)
    for option, value in (("resample", resample), ("Ts", Ts)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise DataError(f"{option} = {value!r} s. Give a positive number of seconds.")
    try:
        table = _Table(source)
        specs, clock = _resolve(table, columns, time)
        if clock is None and Ts is None:
            raise DataError(
                f"{source.name}: no time column found among {', '.join(table.columns)}. "
                + (
                    "Separate columns by comma, semicolon or tab. "
                    if len(table.columns) == 1
                    else ""
                )
                + "Name it with time='column', or give the sample time with Ts=0.01."
            )
        wanted = list(
            dict.fromkeys(s.column for s in (*specs.values(), *([clock] if clock else ())))
        )
        frame = table.read(wanted)
    except UnitError as error:
        found.faults.append(Fault("unit", str(error), ""))
        return found
    except DataError as error:
        found.faults.append(Fault("file", str(error), ""))
        return found
    N = len(frame)
    if N < 2:
        found.faults.append(
            Fault(
                "length",
                f"{source.name}: {N} sample{'' if N == 1 else 's'}; a record needs at least 2.",
                "Give a longer file.",
            )
        )
        return found

    steps = [f"read {source.name} (sha256 {sha256(source)}), {N} samples"]
    if clock is None:
        assert Ts is not None
        times: FloatArray | None = Ts * np.arange(N, dtype=np.float64)
        steps.append(f"no time column; Ts = {Ts:g} s given, clock starts at 0")
    else:
        times = _times(table, frame, clock, found)
        steps.append(f"time column {clock.column} [{clock.unit}]")
    rows: NDArray[np.intp] = np.arange(N)
    if times is not None and window is not None:
        inside = _window_rows(source.name, times, window, found)
        if inside is None:
            times = None
        else:
            times, rows = times[inside], rows[inside]
            steps.append(f"window {_limit(window[0])}:{_limit(window[1])} s: {rows.size} samples")
    values: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    missing: dict[str, BoolArray] = {}
    for channel, spec in specs.items():
        numbers = _numbers(table, frame, channel, spec, found, skip_text=columns is None)
        if numbers is None:
            if not found.faults or found.faults[-1].column != spec.column:
                steps.append(f"column {spec.column} left out: it holds no numbers")
            continue
        numbers = numbers[rows]
        bad = ~np.isfinite(numbers)
        if bad.any():
            if not mark_missing:
                found.faults.append(_non_finite(table, channel, spec, numbers, rows, times))
            missing[channel] = bad
            steps.append(f"{int(bad.sum())} samples of {channel} not finite, marked missing")
        unit = spec.unit or "1"
        values[channel] = to_si(numbers, unit, spec.target)
        units[channel] = (
            spec.target if spec.target and parse_unit(spec.target).is_si else si_unit(unit)
        )
        steps.append(f"column {spec.column} [{unit}] to {channel} [{units[channel]}]")
    found.times = times
    if not values and not found.faults:
        found.faults.append(
            Fault(
                "columns",
                f"{source.name}: no column of numbers beside the time stamps.",
                f"The file holds {', '.join(table.columns)}; give a file with measurements.",
            )
        )
    if times is None:
        return found
    label = name or source.stem
    if window is not None and name is None:
        label += f"@{_limit(window[0])}:{_limit(window[1])}"
    if clock is not None:
        clock_faults = time_faults(times, source.name, lambda k: table.place(int(rows[k])))
        hard = [f for f in clock_faults if f.kind not in {"irregular", "gap"}]
        if hard or (clock_faults and resample is None):
            found.faults += hard or clock_faults
            return found
    if not values:
        return found
    if resample is not None:
        try:
            found.record = _resampled(times, values, units, missing, resample, label, steps)
        except DataError as error:
            median = float(np.median(np.diff(times)))
            mend = f"Resample nearer to the median interval, resample={median:.6g}."
            found.faults.append(Fault("resample", str(error), mend))
        return found
    step = float(times[-1] - times[0]) / (times.size - 1)
    found.record = Record(values, units, step, float(times[0]), label, missing, tuple(steps))
    return found


def _source(path: str | Path) -> tuple[Path, tuple[float, float] | None]:
    if Path(path).exists():  # a file whose own name may hold an @
        return Path(path), None
    return parse_source(str(path))


def sha256(path: str | Path) -> str:
    """Return the sha256 of a file's bytes, in hexadecimal."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _limit(x: float) -> str:
    return f"{x:g}" if np.isfinite(x) else ""


def _numbers(
    table: _Table,
    frame: pd.DataFrame,
    channel: str,
    spec: ColumnSpec,
    found: Survey,
    *,
    skip_text: bool = False,
) -> FloatArray | None:
    """Return a column as floats; None, with a fault noted, where it holds text."""
    import pandas as pd

    column = frame[spec.column]
    if pd.api.types.is_numeric_dtype(column.dtype):
        return np.asarray(column.to_numpy(dtype=np.float64, na_value=np.nan))
    if column.dtype.kind in "mM":  # dates are times, not measurements
        column = column.astype(str)
    if table.decimal == ",":
        column = column.where(column.isna(), column.astype(str).str.replace(",", "."))
    numbers = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    text = np.isnan(numbers) & column.notna().to_numpy()
    if skip_text and text.sum() == column.notna().sum():
        return None
    if not text.any():
        return np.asarray(numbers)
    first = int(np.argmax(text))
    found.faults.append(
        Fault(
            "text",
            f"{table.path.name}: column {spec.column!r} (channel {channel}) holds "
            f"{int(text.sum())} values that are no numbers, the first at {table.place(first)}: "
            f"{str(column.iloc[first])!r}.",
            "Mend the cells or leave them empty and read with mark_missing=True; for decimal "
            "commas use semicolons between columns.",
            spec.column,
        )
    )
    return None


def _non_finite(
    table: _Table,
    channel: str,
    spec: ColumnSpec,
    numbers: FloatArray,
    rows: NDArray[np.intp],
    times: FloatArray | None,
) -> Fault:
    bad = ~np.isfinite(numbers)
    first, nans = int(np.argmax(bad)), int(np.isnan(numbers).sum())
    at = f", t = {times[first]:g} s" if times is not None else ""
    return Fault(
        "non-finite",
        f"{table.path.name}: column {spec.column!r} (channel {channel}) holds {int(bad.sum())} "
        f"samples that are not finite ({nans} empty or NaN, {int(bad.sum()) - nans} Inf), the "
        f"first at {table.place(int(rows[first]))} (k = {first}{at}).",
        "Leave them out with a window, or mark them missing with mark_missing=True.",
        spec.column,
    )


def _times(
    table: _Table, frame: pd.DataFrame, clock: ColumnSpec, found: Survey
) -> FloatArray | None:
    """Return the time stamps [s]; dates become seconds since the first."""
    import pandas as pd

    column = frame[clock.column]
    if column.dtype.kind == "m" and column.notna().all():
        return np.asarray(column.dt.total_seconds(), dtype=np.float64)
    if not pd.api.types.is_numeric_dtype(column.dtype):
        stamps = pd.to_datetime(column, errors="coerce", format="ISO8601", utc=True)
        if stamps.notna().all():
            table.origin = stamps.iloc[0] if table.origin is None else table.origin
            return np.asarray((stamps - table.origin).dt.total_seconds(), dtype=np.float64)
    numbers = _numbers(table, frame, "t", clock, found)
    if numbers is None:
        return None
    if not np.isfinite(numbers).all():
        rows = np.arange(numbers.size)
        fault = _non_finite(table, "t", clock, numbers, rows, None)
        mend = "Mend the time stamps, or leave the column out and give Ts."
        found.faults.append(replace(fault, mend=mend))
        return None
    return to_si(numbers, clock.unit or "s", "s")


def _window_rows(
    name: str, times: FloatArray, window: tuple[float, float], found: Survey
) -> NDArray[np.intp] | None:
    start, stop = window
    low, high = float(times.min()), float(times.max())
    slack = (high - low) / max(times.size - 1, 1)
    span = f"{name} runs from {low:g} to {high:g} s of its own clock"
    label = f"window {_limit(start)}:{_limit(stop)} s"
    problem = mend = ""
    tiny = 1e-6 * slack
    inside = np.flatnonzero((times >= start - tiny) & (times <= stop + tiny))
    if not start < stop:
        problem, mend = "is empty or backward", "Give the earlier time first."
    elif any(np.isfinite(x) and not low - slack <= x <= high + slack for x in window):
        problem = "reaches outside the record"
        mend = "Give a window inside that span, or leave an end open (12: or :194)."
    elif inside.size < 2:
        problem = f"keeps {inside.size} samples"
        mend = "Widen the window to at least two samples."
    if problem:
        found.faults.append(Fault("window", f"{label} {problem}; {span}.", mend))
        return None
    return inside


# ---------------------------------------------------------------------- clocks


def time_faults(
    times: FloatArray, name: str, place: Callable[[int], str] = lambda k: f"k = {k}"
) -> list[Fault]:
    """Judge time stamps: doubled or backward ones, gaps, irregular intervals.

    Parameters
    ----------
    times : (N,) array [s], finite
    name : str
        The record's name, for the messages.
    place : function of k
        How to say where sample k stands.

    Returns
    -------
    list of Fault, empty where every interval is within 1 % of the median
    """
    intervals = np.diff(times)
    backward = np.flatnonzero(intervals < 0)
    doubled = np.flatnonzero(intervals == 0)
    faults = []
    if doubled.size or backward.size:
        first = int(min([*doubled[:1], *backward[:1]])) + 1
        faults.append(
            Fault(
                "order",
                f"{name}: time stands still {doubled.size} times (duplicate stamps) and runs "
                f"backward {backward.size} times, first at {place(first)} "
                f"(t = {times[first]:.9g} s after {times[first - 1]:.9g} s).",
                "Sort the file and drop doubled rows, or cut it where the clock was reset.",
            )
        )
        return faults
    median = float(np.median(intervals))
    off = np.abs(intervals - median) > UNIFORM * median * (1 + 1e-9)
    if not off.any():
        return faults
    gaps = np.flatnonzero(intervals > GAP * median)
    if gaps.size:
        shown = "; ".join(
            f"{intervals[k]:.4g} s from t = {times[k]:.6g} s ({place(int(k))})" for k in gaps[:3]
        )
        edges = [0, *(int(k) + 1 for k in gaps), times.size]
        longest = int(np.argmax(np.diff(edges)))
        a, b = edges[longest], edges[longest + 1] - 1
        faults.append(
            Fault(
                "gap",
                f"{name}: {gaps.size} gap{'' if gaps.size == 1 else 's'} longer than {GAP:g} times "
                f"the median interval of {median:.6g} s: {shown}{' ...' if gaps.size > 3 else ''}.",
                f"Take the longest stretch with the window {times[a]:.6g}:{times[b]:.6g}, or "
                f"resample with resample={median:.6g} (--resample {median:.6g}), which marks the "
                "gaps missing.",
            )
        )
    rest = off & ~(intervals > GAP * median)
    if rest.any():
        faults.append(
            Fault(
                "irregular",
                f"{name}: sampling is irregular: intervals min {intervals.min():.6g}, median "
                f"{median:.6g}, max {intervals.max():.6g} s; {100 * off.mean():.3g} % of them "
                f"outside 1 % of the median, the first after t = {times[np.argmax(off)]:.6g} s.",
                f"Resample with read_record(..., resample={median:.6g}) or --resample "
                f"{median:.6g}; nothing is resampled unasked.",
            )
        )
    return faults


def resample(times: ArrayLike, values: ArrayLike, Ts: float) -> tuple[FloatArray, FloatArray]:
    """Interpolate samples at irregular times onto a uniform grid.

    Monotone piecewise cubic interpolation (PCHIP; Fritsch & Carlson 1980, SIAM J. Numer. Anal.
    17, 238-246): third order on smooth signals and no overshoot at steps. It does not
    limit the bandwidth: choose Ts near the median interval, then decimate.

    Parameters
    ----------
    times : (N,) array [s], strictly increasing
    values : (N,) or (N, n) array
    Ts : float
        Sample time of the grid [s].

    Returns
    -------
    (M,) times t0 + k Ts within the given ones [s]; (M,) or (M, n) values

    Raises
    ------
    DataError
        If the times do not increase, or the grid has fewer than two samples.
    """
    from scipy.interpolate import PchipInterpolator

    t = np.asarray(times, dtype=np.float64)
    y = np.asarray(values, dtype=np.float64)
    if t.ndim != 1 or t.size < 2 or y.shape[:1] != t.shape or not (np.diff(t) > 0).all():
        raise DataError(
            f"resampling needs strictly increasing times and as many values, got shapes {t.shape} "
            f"and {y.shape}. Sort the samples and drop doubled time stamps."
        )
    if not (np.isfinite(Ts) and 0 < Ts <= t[-1] - t[0]):
        raise DataError(
            f"Ts = {Ts!r} s does not fit a record of {t[-1] - t[0]:g} s. "
            f"Give for example the median interval, {np.median(np.diff(t)):.6g} s."
        )
    grid = t[0] + Ts * np.arange(int((t[-1] - t[0]) / Ts * (1 + 1e-12)) + 1)
    grid = np.minimum(grid, t[-1])
    return grid, np.asarray(PchipInterpolator(t, y, axis=0)(grid), dtype=np.float64)


def _resampled(
    times: FloatArray,
    values: dict[str, FloatArray],
    units: dict[str, str],
    missing: dict[str, BoolArray],
    Ts: float,
    name: str,
    steps: list[str],
) -> Record:
    """Resample every channel; a sample between neighbours far apart or missing is marked."""
    intervals = np.diff(times)
    median = float(np.median(intervals))
    # A grid coarser than the samples would alias: interpolate finer, then decimate behind a filter.
    factor = int(np.ceil(Ts / median * (1 - UNIFORM))) if Ts > median * (1 + UNIFORM) else 1
    fine = Ts / factor
    gridded: dict[str, FloatArray] = {}
    masks: dict[str, BoolArray] = {}
    marked = 0
    grid, _ = resample(times, times, fine)
    for channel, y in values.items():
        kept = ~missing[channel] if channel in missing else np.ones(times.size, dtype=bool)
        t_kept = times[kept]
        if t_kept.size < 2:
            gridded[channel], masks[channel] = np.zeros(grid.size), np.ones(grid.size, dtype=bool)
            continue
        inner = np.clip(grid, t_kept[0], t_kept[-1])
        gridded[channel] = _pchip(t_kept, y[kept], inner)
        after = np.clip(np.searchsorted(t_kept, grid, side="left"), 1, t_kept.size - 1)
        far = t_kept[after] - t_kept[after - 1] > GAP * median
        nearest = np.minimum(np.abs(grid - t_kept[after]), np.abs(grid - t_kept[after - 1]))
        masks[channel] = (far & (nearest > 0.5 * median)) | (inner != grid)
        marked += int(masks[channel].sum())
    steps.append(
        f"resampled by PCHIP onto Ts = {fine:g} s (intervals were {intervals.min():.6g} to "
        f"{intervals.max():.6g} s, median {median:.6g} s); {marked} samples in gaps marked missing"
    )
    record = Record(gridded, units, fine, float(times[0]), name, masks, tuple(steps))
    return record if factor == 1 else record.decimate(factor)


def _pchip(t: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    from scipy.interpolate import PchipInterpolator

    return np.asarray(PchipInterpolator(t, y)(at), dtype=np.float64)


# ---------------------------------------------------------------------- larger than memory


def iter_chunks(
    path: str | Path,
    columns: Columns | None = None,
    size: int = 100_000,
    *,
    time: str | ColumnSpec | Sequence[str | None] | None = None,
    gaps: bool = False,
) -> Iterator[dict[str, FloatArray]]:
    """Read a CSV or Parquet file `size` samples at a time, in SI units.

    Parameters
    ----------
    gaps : bool
        Let samples through that are not finite, and put one row of NaN where the clock leaves out
        rows, instead of refusing the file.

    Yields
    ------
    dict of channel name to (n,) array, n <= size
        With the time stamps [s] under `t`, where the file has them and no channel takes the name.

    Raises
    ------
    DataError
        As `read_record`, at the chunk in which the fault is met; the clock is held against the
        first chunk's median interval, across chunks too.
    """
    if size < 2:
        raise DataError(f"chunks of {size} samples. Give a size of at least 2.")
    table = _Table(path)
    specs, clock = _resolve(table, columns, time)
    wanted = list(dict.fromkeys(s.column for s in (*specs.values(), *([clock] if clock else ()))))
    start = 0
    last: float | None = None
    median: float | None = None
    for frame in table.chunks(wanted, size):
        found = Survey(table.path)
        rows = np.arange(start, start + len(frame))
        chunk: dict[str, FloatArray] = {}
        for channel, spec in specs.items():
            numbers = _numbers(table, frame, channel, spec, found, skip_text=columns is None)
            if numbers is not None and not gaps and not np.isfinite(numbers).all():
                found.faults.append(_non_finite(table, channel, spec, numbers, rows, None))
            if numbers is not None:
                chunk[channel] = to_si(numbers, spec.unit or "1", spec.target)
        times = None if clock is None else _times(table, frame, clock, found)
        holes: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
        if times is not None and times.size > (last is None):
            joined = times if last is None else np.concatenate(([last], times))
            median = float(np.median(np.diff(times))) if median is None else median
            clock_faults = time_faults(joined, table.path.name)
            found.faults += [f for f in clock_faults if f.kind == "order" or not gaps]
            slow = np.abs(np.diff(joined) - median) > UNIFORM * median * (1 + 1e-9)
            if gaps:
                long = np.diff(joined) > GAP * median
                slow &= ~long
                holes = np.flatnonzero(long) + (1 if last is None else 0)
            if slow.any() and not found.faults:
                found.faults.append(
                    Fault(
                        "irregular",
                        f"{table.path.name}: intervals leave 1 % of {median:.6g} s from "
                        f"t = {joined[int(np.argmax(slow))]:.6g} s on.",
                        "Read the part before and the part after by themselves.",
                    )
                )
            last = float(times[-1])
        if found.faults:
            raise DataError(str(found.faults[0]))
        if times is not None and "t" not in chunk:
            chunk["t"] = times
        if holes.size:
            chunk = {name: np.insert(values, holes, np.nan) for name, values in chunk.items()}
        start += len(frame)
        yield chunk
