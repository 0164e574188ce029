"""Reading a file whole: the record where there is one, and every fault met on the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casid.data.reading.cells import non_finite, numbers_of, times_of
from casid.data.reading.clocks import time_faults, window_rows
from casid.data.reading.column_survey import column_surveys
from casid.data.reading.columns import Columns, ColumnSpec, resolve
from casid.data.reading.faults import Fault, Survey
from casid.data.reading.resampling import resampled
from casid.data.reading.sources import limit_text, sha256, source_of
from casid.data.reading.tables import Table
from casid.data.record import BoolArray, FloatArray, Record
from casid.errors import DataError, UnitError
from casid.model.units import parse_unit, si_unit, to_si

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class ReadingOptions:
    """How a file is read: `time` to `mark_missing` of `casid.read_record`."""

    time: str | ColumnSpec | Sequence[str | None] | None = None
    window: tuple[float, float] | None = None
    name: str | None = None
    resample: float | None = None
    Ts: float | None = None
    mark_missing: bool = False


def survey(
    path: str | Path,
    columns: Columns | None = None,
    options: ReadingOptions | None = None,
    *,
    describe: bool = True,
) -> Survey:
    """Read a file as `read_record` does, but collect the faults instead of raising at the first.

    Parameters
    ----------
    describe : whether the columns are described (`Survey.columns`), used or not.

    Returns
    -------
    Survey
        The record is None where the clock cannot be used. Channels with faults are left out of
        it or, where only some samples are not finite, have those marked missing.
    """
    source, own_window = source_of(path)
    options = options or ReadingOptions()
    window = own_window if options.window is None else options.window
    Ts, resample = options.Ts, options.resample
    _require_positive(resample=resample, Ts=Ts)
    found = Survey(source)
    try:
        table = Table(source)
        frame = table.read(table.columns) if describe else None
    except DataError as error:
        return found.with_fault(Fault("file", str(error), ""))
    try:
        specs, clock = _resolved(table, columns, options.time, Ts)
        if frame is None:
            frame = table.read(_used(specs, clock))
    except DataError as error:
        if frame is not None:
            found.columns = column_surveys(table, frame, None, None)
        return found.with_fault(
            Fault("unit" if isinstance(error, UnitError) else "file", str(error), "")
        )
    N = len(frame)
    if N < 2:
        count = f"{N} sample{'' if N == 1 else 's'}"
        text = f"{source.name}: {count}; a record needs at least 2."
        return found.with_fault(Fault("length", text, "Give a longer file."))
    steps = [f"read {source.name} (sha256 {sha256(source)}), {N} samples"]
    if clock is None:
        assert Ts is not None
        found.times = Ts * np.arange(N, dtype=np.float64)
        steps.append(f"no time column; Ts = {Ts:g} s given, clock starts at 0")
    else:
        found.times, found.clock = times_of(table, frame, clock, found), clock.column
        steps.append(f"time column {clock.column} [{clock.unit}]")
    if describe:
        found.columns = column_surveys(table, frame, found.clock, found.times)
    rows: NDArray[np.intp] = np.arange(N)
    if found.times is not None and window is not None:
        inside = window_rows(source.name, found.times, window, found)
        found.times = None if inside is None else found.times[inside]
        if inside is not None:
            rows = rows[inside]
            steps.append(f"window {_window_text(window)} s: {rows.size} samples")
    skip_text, mark = columns is None, options.mark_missing
    channels = _channels(table, frame, specs, rows, found, steps, skip_text=skip_text, mark=mark)
    if found.times is None or not _is_even(table, clock, rows, found, resample):
        return found
    if not channels.values:
        return found
    label = options.name or source.stem + (f"@{_window_text(window)}" if window is not None else "")
    found.record = _record(channels, found, resample, label, steps)
    return found


def _require_positive(**seconds: float | None) -> None:
    """Refuse sample times [s], where given, that are not positive."""
    for option, value in seconds.items():
        if value is not None and not (np.isfinite(value) and value > 0):
            raise DataError(f"{option} = {value!r} s. Give a positive number of seconds.")


@dataclass(slots=True)
class _Channels:
    """Channels in SI units: samples, units, and where a sample is missing."""

    values: dict[str, FloatArray] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    missing: dict[str, BoolArray] = field(default_factory=dict)


def _resolved(
    table: Table,
    columns: Columns | None,
    time: str | ColumnSpec | Sequence[str | None] | None,
    Ts: float | None,
) -> tuple[dict[str, ColumnSpec], ColumnSpec | None]:
    """The channels to read from a table, and its clock; refused where there is none."""
    specs, clock = resolve(table, columns, time)
    if clock is None and Ts is None:
        alone = len(table.columns) == 1
        raise DataError(
            f"{table.path.name}: no time column found among {', '.join(table.columns)}. "
            + ("Separate columns by comma, semicolon or tab. " if alone else "")
            + "Name it with time='column', or give the sample time with Ts=0.01."
        )
    return specs, clock


def _used(specs: Mapping[str, ColumnSpec], clock: ColumnSpec | None) -> list[str]:
    """The columns that are read, each once."""
    return list(dict.fromkeys(s.column for s in (*specs.values(), *([clock] if clock else ()))))


def _channels(
    table: Table,
    frame: pd.DataFrame,
    specs: Mapping[str, ColumnSpec],
    rows: NDArray[np.intp],
    found: Survey,
    steps: list[str],
    *,
    skip_text: bool,
    mark: bool,
) -> _Channels:
    """Read the channels; faults and steps are noted."""
    channels = _Channels()
    for channel, spec in specs.items():
        numbers = numbers_of(table, frame, channel, spec, found, skip_text=skip_text)
        if numbers is None:
            if not found.faults or found.faults[-1].column != spec.column:
                steps.append(f"column {spec.column} left out: it holds no numbers")
            continue
        numbers = numbers[rows]
        bad = ~np.isfinite(numbers)
        if bad.any():
            if not mark:
                found.faults.append(non_finite(table, channel, spec, numbers, rows, found.times))
            channels.missing[channel] = bad
            steps.append(f"{int(bad.sum())} samples of {channel} not finite, marked missing")
        unit, target = spec.unit or "1", spec.target
        channels.values[channel] = to_si(numbers, unit, target)
        kept = target if target and parse_unit(target).is_si else si_unit(unit)
        channels.units[channel] = kept
        steps.append(f"column {spec.column} [{unit}] to {channel} [{kept}]")
    if not channels.values and not found.faults:
        text = f"{table.path.name}: no column of numbers beside the time stamps."
        remedy = f"The file holds {', '.join(table.columns)}; give a file with measurements."
        found.faults.append(Fault("columns", text, remedy))
    return channels


def _is_even(
    table: Table,
    clock: ColumnSpec | None,
    rows: NDArray[np.intp],
    found: Survey,
    resample: float | None,
) -> bool:
    """Whether the clock can be used; its faults are noted otherwise."""
    if clock is None or found.times is None:
        return True
    faults = time_faults(found.times, table.path.name, lambda k: table.place(int(rows[k])))
    hard = [f for f in faults if f.kind not in {"irregular", "gap"}]
    if hard or (faults and resample is None):
        found.faults += hard or faults
        return False
    return True


def _record(
    channels: _Channels, found: Survey, resample: float | None, name: str, steps: list[str]
) -> Record | None:
    """The record, resampled on request; None, with a fault noted, where it fails."""
    values, units, missing, times = channels.values, channels.units, channels.missing, found.times
    assert times is not None
    if resample is None:
        step = float(times[-1] - times[0]) / (times.size - 1)
        return Record(values, units, step, float(times[0]), name, missing, tuple(steps))
    try:
        return resampled(times, values, units, missing, resample, name, steps)
    except DataError as error:
        median = float(np.median(np.diff(times)))
        remedy = f"Resample nearer to the median interval, resample={median:.6g}."
        found.faults.append(Fault("resample", str(error), remedy))
        return None


def _window_text(window: tuple[float, float]) -> str:
    return f"{limit_text(window[0])}:{limit_text(window[1])}"
