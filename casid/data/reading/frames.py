"""Records from tables in memory, and back: pandas DataFrames and xarray datasets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from casid.data.reading.columns import Columns
from casid.data.reading.file_format import FileFormat
from casid.data.reading.record_file import sound_record
from casid.data.reading.survey import ReadingOptions, survey
from casid.data.reading.tables import FrameTable
from casid.data.record import Record
from casid.errors import DataError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def is_frame(value: Any) -> bool:
    """True of a pandas DataFrame; pandas is not loaded to find out."""
    return type(value).__module__.partition(".")[0] == "pandas" and hasattr(value, "columns")


def table_of(frame: pd.DataFrame) -> pd.DataFrame:
    """The columns of a frame, its index among them where that is no mere count of rows."""
    import pandas as pd

    if not is_frame(frame):
        raise DataError(
            f"{type(frame).__name__} is no table; give a pandas DataFrame with a column for each "
            "channel"
        )
    index = frame.index
    if isinstance(index, pd.RangeIndex) and index.name is None:
        return frame
    if isinstance(index, pd.MultiIndex):
        raise DataError(
            f"the table has an index of {index.nlevels} levels; give one experiment at a time, "
            "with the time as its index or as a column"
        )
    name = "t" if index.name is None else str(index.name)
    if name in map(str, frame.columns):
        return frame
    moved = frame.reset_index(names=name)
    moved.attrs = dict(frame.attrs)
    return moved


def record_of_frame(
    frame: pd.DataFrame,
    columns: Columns | None = None,
    units: Mapping[str, str] | None = None,
    options: ReadingOptions | None = None,
) -> Record:
    """A record of a DataFrame, read as a file with the same columns is.

    Parameters
    ----------
    units : column -> unit of its numbers, over those of the frame's `attrs["units"]` and of the
        columns' names.

    Raises
    ------
    DataError, UnitError
        As `casid.read_record`.
    """
    options = options or ReadingOptions()
    table = open_frame(frame, units, name=options.name, form=options.format)
    return sound_record(survey(table, columns, options, describe=False))


def record_of_signals(
    signals: Mapping[str, tuple[ArrayLike, ArrayLike]],
    units: Mapping[str, str],
    *,
    name: str = "record",
) -> Record:
    """A record of channels that have time vectors of their own.

    Every sample counts at its own instant, on an even clock that all of them lie near to
    (`even_clock`); a channel misses the samples between. Nothing is interpolated.

    Parameters
    ----------
    signals : channel -> times (n,) [s], increasing, and values (n,); NaN where there is none.
    units : channel -> unit of its values; kept in SI.

    Raises
    ------
    DataError
        For times and values of different lengths, times that do not increase, or clocks that are
        too far apart in rate to be one record.
    UnitError
        For a unit that cannot be read.
    """
    import pandas as pd

    columns = []
    for channel, (t, values) in signals.items():
        times, column = (np.asarray(v, dtype=np.float64) for v in (t, values))
        if times.shape != column.shape or times.ndim != 1:
            raise DataError(
                f"{name}: {channel} has times of shape {times.shape} and values of shape "
                f"{column.shape}. Give two arrays of one length, (n,)."
            )
        columns.append(pd.Series(column, index=times, name=channel))
        if not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise DataError(
                f"{name}: the times of {channel} do not increase from sample to sample. "
                "Sort them, and leave out doubled ones."
            )
    if not columns:
        raise DataError(f"{name}: no signals. Give {{'phi': (times, values)}}.")
    frame = pd.concat(columns, axis=1, sort=True)
    frame.index.name = next(n for n in ("t", "time", "timestamp") if n not in signals)
    options = ReadingOptions((frame.index.name, "s"), name=name, takes_gaps=True)
    return record_of_frame(frame, None, units, options)


def open_frame(
    frame: pd.DataFrame,
    units: Mapping[str, str] | None = None,
    *,
    name: str | None = None,
    form: FileFormat | None = None,
) -> FrameTable:
    """The table of a DataFrame, as `open_table` opens a file; `units` as in `record_of_frame`.

    Raises
    ------
    DataError
        If it is no table, has no rows, or a unit is given for no column.
    """
    name = name or str(getattr(frame, "attrs", {}).get("name", "frame"))
    table_frame = table_of(frame)
    given = {**table_frame.attrs.get("units", {}), **(units or {})}
    foreign = [c for c in units or {} if c not in map(str, table_frame.columns)]
    if foreign:
        raise DataError(
            f"{name}: a unit is given for {', '.join(foreign)}, which is no column; there are "
            f"{', '.join(map(str, table_frame.columns))}"
        )
    if len(table_frame) == 0:
        raise DataError(f"{name}: the table holds no rows")
    return FrameTable(Path(name), form or FileFormat(), table_frame, given)


def frame_of(record: Record) -> pd.DataFrame:
    """A DataFrame of a record: its time [s] as index `t`, a column a channel, SI.

    Missing samples are NaN. `attrs` has the units by column and the record's name.
    """
    import pandas as pd

    columns = {
        name: np.where(record.is_missing(name), np.nan, values)
        for name, values in record.channels.items()
    }
    frame = pd.DataFrame(columns, index=pd.Index(record.t, name="t"))
    frame.attrs = {"units": {"t": "s", **record.units}, "name": record.name}
    return frame


def dataset_of(record: Record) -> xr.Dataset:
    """An xarray Dataset of a record: a variable a channel over the coordinate `t` [s], SI.

    Raises
    ------
    DataError
        If xarray is not installed.
    """
    try:
        import xarray as xr
    except ImportError:
        raise DataError(
            'to_xarray needs xarray, which is not installed; pip install "casid[xarray]"'
        ) from None
    frame = frame_of(record)
    variables = {n: ("t", frame[n].to_numpy(), {"units": record.units[n]}) for n in record}
    time = ("t", record.t, {"units": "s"})
    return xr.Dataset(variables, {"t": time}, {"name": record.name, "Ts": record.Ts})
