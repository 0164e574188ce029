"""Reading records from files."""

from __future__ import annotations

from pathlib import Path

from casid.argument_types import names_wrong_types
from casid.data.reading.columns import Columns, Time
from casid.data.reading.faults import Survey
from casid.data.reading.file_format import FileFormat
from casid.data.reading.opening import open_table
from casid.data.reading.sources import source_of
from casid.data.reading.survey import ReadingOptions, survey
from casid.data.reading.tables import Table
from casid.data.record import Record
from casid.errors import DataError, UnitError


@names_wrong_types()
def read_record(
    path: str | Path,
    columns: Columns | None = None,
    *,
    time: Time = None,
    window: tuple[float, float] | None = None,
    name: str | None = None,
    resample: float | None = None,
    Ts: float | None = None,
    mark_missing: bool = False,
    form: FileFormat | None = None,
) -> Record:
    """Read a record from a file, in SI units.

    Parameters
    ----------
    path : path of a table in text (CSV, TSV, LabVIEW, also in gzip or zip), Parquet, Excel, MATLAB,
        HDF5, TDMS, MDF 4, NumPy or a ROS bag; the extras `casid[excel]`, `casid[matlab]` and
        `casid[daq]` bring what reads the last ones.
        May carry a window, `run.csv@12:194`.
    columns : mapping of channel name to ColumnSpec, optional
        A column's name alone, or a tuple (column, unit in the file, SI target), will do. Without
        it every column of numbers is read under its own name, its unit from the file.
    time : column of the time stamps, optional
        Found by its name (`t`, `time`, `t_ms`, `t / s`, `Zeit [min]` ...), or as the one column of
        dates, where not given. Numbers with a unit of time (`Time:h`; else seconds), dates, times
        of day (930 is half past nine, too), seconds since 1970, serial days of Excel or MATLAB. A
        file without one needs `Ts`.
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
        Mark Inf as missing, as empty cells and NaN are, instead of refusing it, and take every
        sample of an uneven clock, or of channels with clocks of their own, at its own instant.
    form : FileFormat, optional
        How the file is written, where the file itself leaves it open: order of dates, decimal
        mark, encoding, sheet, time zone, cells that stand for no value.

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
    options = ReadingOptions(
        time, window, name, resample, Ts, mark_missing, form, takes_gaps=mark_missing
    )
    return sound_record(survey(path, columns, options, describe=False))


def record_of(table: Table, columns: Columns, options: ReadingOptions | None = None) -> Record:
    """Read a record from an open table, as `read_record`."""
    return sound_record(survey(table, columns, options, describe=False))


def sound_record(found: Survey) -> Record:
    """The record of a file without faults; the first fault raised otherwise."""
    if found.faults:
        first, *others = found.faults
        more = f" ({len(others)} more: casid check {found.path.name} lists all.)" if others else ""
        more = more if found.path.is_file() else ""  # a table in memory
        error = UnitError if first.kind == "unit" else DataError
        raise error(f"{first}{more}")
    assert found.record is not None
    return found.record


def column_names(path: str | Path, form: FileFormat | None = None) -> tuple[str, ...]:
    """Return the names of a file's columns, in order, without reading its samples.

    A window behind the path, `run.csv@12:194`, is passed over.

    Raises
    ------
    DataError
        If there is no such file, or it is no table.
    """
    return tuple(open_table(source_of(path)[0], form).columns)
