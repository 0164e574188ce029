"""Files larger than memory, some samples at a time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from casid.arrays import BoolArray, FloatArray
from casid.data.reading.cells import non_finite, numbers_of, times_of
from casid.data.reading.clocks.even_clock import GAP, UNIFORM, time_faults
from casid.data.reading.columns import Columns, Time, resolve
from casid.data.reading.faults import Fault, Survey
from casid.data.reading.opening import open_table
from casid.errors import DataError
from casid.model.units import to_si


def iter_chunks(
    path: str | Path,
    columns: Columns | None = None,
    size: int = 100_000,
    *,
    time: Time = None,
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
        As `read_record`, at the chunk in which the fault is met; the clock is compared with the
        first chunk's median interval, across chunks too.
    """
    if size < 2:
        raise DataError(f"chunks of {size} samples. Give a size of at least 2.")
    table = open_table(path)
    specs, clock = resolve(table, columns, time)
    day = [table.date_column] if clock and table.date_column else []
    wanted = [*(s.column for s in specs.values()), *([clock.column] if clock else []), *day]
    wanted = list(dict.fromkeys(wanted))
    start = 0
    last: float | None = None
    median: float | None = None
    for frame in table.chunks(wanted, size):
        found = Survey(table.path)
        rows = np.arange(start, start + len(frame))
        chunk: dict[str, FloatArray] = {}
        for channel, spec in specs.items():
            numbers = numbers_of(table, frame, channel, spec, found, skip_text=columns is None)
            if numbers is None:
                continue
            if not gaps and not np.isfinite(numbers).all():
                found.faults.append(non_finite(table, channel, spec, numbers, rows, None))
            chunk[channel] = to_si(numbers, spec.unit or "1", spec.target)
        times = None if clock is None else times_of(table, frame, clock, found)
        holes: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
        if times is not None and times.size > (last is None):
            joined = times if last is None else np.concatenate(([last], times))
            median = float(np.median(np.diff(times))) if median is None else median
            long = _judge_clock(joined, median, gaps, found)
            holes = np.flatnonzero(long) + (1 if last is None else 0)
            last = float(times[-1])
        if found.faults:
            raise DataError(str(found.faults[0]))
        if times is not None and "t" not in chunk:
            chunk["t"] = times
        if holes.size:
            chunk = {name: np.insert(values, holes, np.nan) for name, values in chunk.items()}
        start += len(frame)
        yield chunk


def _judge_clock(times: FloatArray, median: float, gaps: bool, found: Survey) -> BoolArray:
    """Add the faults of the time stamps (n,) [s], compared with the first chunk's median interval.

    Returns
    -------
    (n - 1,) intervals that are gaps let through; none where gaps are faults.
    """
    name = found.path.name
    found.faults += [f for f in time_faults(times, name) if f.kind == "order" or not gaps]
    intervals = np.diff(times)
    slow = np.abs(intervals - median) > UNIFORM * median * (1 + 1e-9)
    long = (intervals > GAP * median) & gaps
    slow &= ~long
    if slow.any() and not found.faults:
        found.faults.append(
            Fault(
                "irregular",
                f"{name}: intervals leave 1 % of {median:.6g} s from "
                f"t = {times[int(np.argmax(slow))]:.6g} s on.",
                "Read the part before and the part after by themselves.",
            )
        )
    return np.asarray(long)
