"""Reading a file whole: the record where there is one, and every fault met on the way."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from casid.arrays import BoolArray, FloatArray
from casid.data.reading.cells import (
    non_finite,
    numbers_of,
    stands_for_none,
    times_of,
    without_values,
)
from casid.data.reading.clocks.absent_rows import EvenClock, even_clock
from casid.data.reading.clocks.even_clock import (
    RARE,
    UNIFORM,
    even_step,
    jitter_text,
    repeated_rows,
    time_faults,
    window_rows,
)
from casid.data.reading.clocks.resampling import resampled
from casid.data.reading.clocks.unit_of_time import assumed_seconds
from casid.data.reading.column_survey import column_surveys, note_other_units
from casid.data.reading.columns import (
    Columns,
    ColumnSpec,
    Time,
    resolve,
    time_unit,
)
from casid.data.reading.faults import Fault, Survey
from casid.data.reading.file_format import FileFormat
from casid.data.reading.header_units import header_unit
from casid.data.reading.opening import open_table
from casid.data.reading.several_clocks import UnitedTable, on_one_clock, united_rows
from casid.data.reading.sources import sha256, source_of
from casid.data.reading.tables import Table
from casid.data.record import Record
from casid.errors import DataError, UnitError
from casid.model.quantities import count_text, window_text
from casid.model.units import parse_unit, si_unit, to_si

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class ReadingOptions:
    """How a file is read: `time` to `form` of `casid.read_record`.

    Empty cells are missing samples. `takes_gaps`: so are rows that an even clock leaves out;
    otherwise these are a fault. Then, and with `mark_missing`, channels may have own clocks.
    `held`: channels that stand until their next row (`EvenClock.spread`).
    """

    time: Time = None
    window: tuple[float, float] | None = None
    name: str | None = None
    resample: float | None = None
    Ts: float | None = None
    mark_missing: bool = False
    form: FileFormat | None = None
    takes_gaps: bool = False
    held: Collection[str] = ()

    @property
    def format(self) -> FileFormat:
        """`form`, with the sample time."""
        form = self.form or FileFormat()
        return form if self.Ts is None else replace(form, Ts=self.Ts)


def survey(
    path: str | Path | Table,
    columns: Columns | None = None,
    options: ReadingOptions | None = None,
    *,
    describe: bool = True,
) -> Survey:
    """Read a file as `read_record` does, but collect the faults instead of raising at the first.

    Parameters
    ----------
    path : of the file, or a table that is open already.
    describe : whether the columns are described (`Survey.columns`), used or not.

    Returns
    -------
    Survey
        The record is None where the clock cannot be used. Channels with faults are left out of
        it or, where only some samples are not finite, have those marked missing.
    """
    table = path if isinstance(path, Table) else None
    source, own_window = (path.path, None) if isinstance(path, Table) else source_of(path)
    options = options or ReadingOptions()
    window = own_window if options.window is None else options.window
    resample = options.resample
    _require_positive(resample=resample, Ts=options.Ts)
    found = Survey(source)
    opened = _opened(found, table, columns, options, describe=describe)
    if opened is None:
        return found
    if isinstance(opened.table, UnitedTable):
        options = replace(options, takes_gaps=True)
    N = len(opened.frame)
    if N < 2:
        count = count_text(N, "sample")
        text = f"{source.name}: {count}; a record needs at least 2."
        return found.with_fault(Fault("length", text, "Give a longer file."))
    digest = sha256(source) if source.is_file() else ""
    steps = [f"read {source.name}{f' (sha256 {digest})' if digest else ''}, {N} samples"]
    _read_clock(opened, found, steps, is_chosen=options.time is not None)
    opened = _with_united_rows(opened, found, options, describe=describe)
    if describe:
        found.columns = column_surveys(opened.table, opened.frame, found.clock, found.times)
    rows = _rows_read_once(opened, found)
    if found.times is not None and window is not None:
        inside = window_rows(source.name, found.times, window, found)
        found.times = None if inside is None else found.times[inside]
        if inside is not None:
            rows = rows[inside]
            steps.append(f"window {window_text(*window)} s: {rows.size} samples")
    channels = _channels(opened, rows, found, steps, options, skip_text=columns is None)
    note_other_units(opened.table, opened.given, found)
    steps += [f"remark: {note}" for note in (*found.notes, *found.doubts)]
    clock = _with_absent_rows(found, channels, options)
    if found.times is None or not (clock or _is_even(opened, rows, found, resample)):
        return found
    if not channels.values:
        return found
    part = f"@{window_text(*window)}" if window is not None else ""
    label = options.name or f"{_stem(source)}{part}"
    found.record = _record(channels, found, options, label, steps, clock)
    _name_clock(opened, found, digest)
    return found


class _Opened(NamedTuple):
    """A table, its cells, the channels to read from it, and its clock."""

    table: Table
    frame: pd.DataFrame
    specs: dict[str, ColumnSpec]
    clock: ColumnSpec | None

    @property
    def given(self) -> dict[str, ColumnSpec]:
        """The channels to read, the time as `t` among them."""
        return self.specs | ({} if self.clock is None else {"t": self.clock})


def _opened(
    found: Survey,
    table: Table | None,
    columns: Columns | None,
    options: ReadingOptions,
    *,
    describe: bool,
) -> _Opened | None:
    """The table, its cells, the channels to read and the clock; None, with a fault noted, else."""
    try:
        table = open_table(found.path, options.format) if table is None else table
        if options.takes_gaps or options.mark_missing:
            table = on_one_clock(table, options.time)
        found.notes += table.remarks
        frame = table.read(table.columns) if describe else None
    except DataError as error:
        found.with_fault(Fault("file", str(error), ""))
        return None
    try:
        specs, clock = _resolved(table, columns, options.time)
        if frame is None:
            frame = table.read(_used(table, specs, clock))
        return _Opened(table, frame, specs, clock)
    except DataError as error:
        if frame is not None:
            found.columns = column_surveys(table, frame, None, None)
        kind = "unit" if isinstance(error, UnitError) else "file"
        found.with_fault(Fault(kind, str(error), ""))
        return None


def _name_clock(opened: _Opened, found: Survey, digest: str) -> None:
    """Name the clock by the bytes of the file: its windows have it in common."""
    if found.record is not None and digest:
        form, column = opened.table.form, found.clock
        clock = " ".join(filter(None, (column or f"every {form.Ts} s", form.table, digest)))
        found.record = replace(found.record, clock=clock)


def _with_unit(column: str, unit: str) -> str:
    """A column and its unit, which stands once where the column's name ends in it."""
    named = header_unit(column)
    is_named = named is not None and named.is_sure and named.text == unit
    return column if is_named or not unit else f"{column} [{unit}]"


def _read_clock(opened: _Opened, found: Survey, steps: list[str], *, is_chosen: bool) -> None:
    """Read the time stamps into `found`, its faults with them."""
    table, frame, _, clock = opened
    if clock is None:
        step = table.form.Ts
        assert step is not None
        found.times = step * np.arange(len(frame), dtype=np.float64)
        steps.append(f"no time column; Ts = {step:g} s given, clock starts at 0")
        return
    found.times, found.clock = times_of(table, frame, clock, found), clock.column
    is_plain = not (clock.unit or found.notes[len(table.remarks) :])
    unit = "s, the file names no unit" if is_plain else clock.unit or ""
    steps.append(f"time column {_with_unit(clock.column, unit)}")
    if is_plain and found.times is not None and found.times.size > 1:
        assumed = assumed_seconds(clock.column, found.times)
        if isinstance(assumed, str):
            found.notes.append(assumed)
        else:
            found.doubts.append(assumed)
    if is_chosen or found.times is None:
        return
    _compare_clocks(table, frame, clock, found.times, found)


def _with_united_rows(
    opened: _Opened, found: Survey, options: ReadingOptions, *, describe: bool
) -> _Opened:
    """Rows that share a stamp as one, where each of them holds other channels."""
    times, clock = found.times, opened.clock
    if not options.takes_gaps or times is None or clock is None or (np.diff(times) > 0).all():
        return opened
    table, frame = opened.table, opened.frame
    columns = [
        c
        for c in (table.columns if describe else [s.column for s in opened.specs.values()])
        if c != clock.column
    ]
    united = united_rows(table, frame, times, columns)
    if united is None:
        return opened
    found.notes.append(
        f"rows of their own for the channels: {times.size} rows are {united.times.size} instants"
    )
    found.times = united.times
    united.frame.insert(0, clock.column, united.times)
    united.columns.insert(0, clock.column)
    return opened._replace(table=united, frame=united.frame)


def _rows_read_once(opened: _Opened, found: Survey) -> NDArray[np.intp]:
    """All rows but those that repeat the one before, which are left out of the stamps, too."""
    rows: NDArray[np.intp] = np.arange(len(opened.frame))
    again = repeated_rows(opened.frame, found.times) if found.times is not None else None
    if again is None or found.times is None:
        return rows
    count, first = int(again.sum()), opened.table.place(int(np.argmax(again)))
    found.notes.append(
        f"{count} row{'' if count == 1 else 's'} repeat{'s' if count == 1 else ''} the one before, "
        f"stamp and all, {'at' if count == 1 else 'first at'} {first}: read once"
    )
    found.times = found.times[~again]
    return rows[~again]


def _compare_clocks(
    table: Table, frame: pd.DataFrame, clock: ColumnSpec, times: FloatArray, found: Survey
) -> None:
    """Add the fault of a second clock that disagrees with the first, whose times [s] are given."""
    for other in (c for c in table.clocks if c != clock.column and c in frame):
        second = _times_quietly(table, frame, other)
        if second is None or second.size != times.size:
            continue
        if np.mean(np.diff(second) < 0) > RARE:  # T beside t: a temperature that falls, too
            continue
        apart = _distance(times, second)
        if apart is None:
            found.notes.append(f"time was read from {clock.column!r}, as {other!r} shows it too")
            continue
        found.faults.append(
            Fault(
                "clocks",
                f"{table.path.name}: two clocks, columns {clock.column!r} and {other!r}, which "
                f"differ by up to {apart:.4g} s.",
                f"Say which one the channels were sampled by, --map t='{clock.column}' or "
                f"--map t='{other}'; channels of the other one belong into a file of their own.",
                other,
            )
        )
        return


def _times_quietly(table: Table, frame: pd.DataFrame, column: str) -> FloatArray | None:
    """The time stamps of a second clock [s]; None where they cannot be read."""
    origin, table.origin = table.origin, None
    try:
        spec = ColumnSpec(column, time_unit(table, column), "s")
        return times_of(table, frame, spec, Survey(table.path))
    finally:
        table.origin = origin


def _distance(times: FloatArray, second: FloatArray) -> float | None:
    """How far two clocks run apart [s]; None where no farther than they can resolve."""
    a, b = times - times[0], second - second[0]
    steps = [s[s > 0] for s in (np.diff(a), np.diff(b))]
    if any(s.size == 0 for s in steps):
        return None
    coarse = [s.min() if s.size < times.size - 1 else 0.0 for s in steps]
    apart = float(np.abs(a - b).max())
    return apart if apart > UNIFORM * float(np.median(steps[0])) + 1.01 * max(coarse) else None


def _require_positive(**seconds: float | None) -> None:
    """Refuse sample times [s], where given, that are not positive."""
    for option, value in seconds.items():
        if value is not None and not (np.isfinite(value) and value > 0):
            raise DataError(f"{option} = {value!r} s. Give a positive number of seconds.")


def _stem(source: Path) -> str:
    """The file's name without its ending; `run.csv.gz` is `run`."""
    return Path(source.stem).stem if source.suffix == ".gz" else source.stem


@dataclass(slots=True)
class _Channels:
    """Channels in SI units: samples, units, and where a sample is missing."""

    values: dict[str, FloatArray] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    missing: dict[str, BoolArray] = field(default_factory=dict)


def _resolved(
    table: Table, columns: Columns | None, time: Time
) -> tuple[dict[str, ColumnSpec], ColumnSpec | None]:
    """The channels to read from a table, and its clock; refused where there is none."""
    specs, clock = resolve(table, columns, time if table.form.Ts is None else None)
    if table.form.Ts is not None and time is None:
        return specs, None
    if clock is None:
        alone = len(table.columns) == 1
        bare = table.is_numbered
        raise DataError(
            f"{table.path.name}: no time column found among {', '.join(table.columns)}. "
            + ("The file has no line of names, and the columns are numbered. " if bare else "")
            + ("Separate columns by comma, semicolon or tab. " if alone and not bare else "")
            + "Name it with --map t=COLUMN (time='column'), or give the sample time with "
            "--sample-time 0.01 (Ts=0.01)."
        )
    return specs, clock


def _used(table: Table, specs: Mapping[str, ColumnSpec], clock: ColumnSpec | None) -> list[str]:
    """The columns that are read, each once."""
    beside = [*table.clocks, *([table.date_column] if table.date_column else [])] if clock else []
    wanted = [*(s.column for s in specs.values()), *([clock.column] if clock else []), *beside]
    return list(dict.fromkeys(wanted))


def _channels(
    opened: _Opened,
    rows: NDArray[np.intp],
    found: Survey,
    steps: list[str],
    options: ReadingOptions,
    *,
    skip_text: bool,
) -> _Channels:
    """Read the channels; faults and steps are noted."""
    table, frame, specs, _ = opened
    channels = _Channels()
    for channel, spec in specs.items():
        numbers = numbers_of(table, frame, channel, spec, found, skip_text=skip_text)
        if numbers is None:
            if not found.faults or found.faults[-1].column != spec.column:
                found.notes.append(f"column {spec.column} left out: it holds no numbers")
            continue
        if skip_text and not np.isfinite(numbers).any():
            without_values(table, spec.column, found)
            continue
        numbers = numbers[rows]
        bad = ~np.isfinite(numbers)
        if bad.any():
            if not options.mark_missing and (np.isinf(numbers).any() or bad.all()):
                found.faults.append(non_finite(table, channel, spec, numbers, rows, found.times))
                if bad.all():
                    continue
            channels.missing[channel] = bad
            steps.append(
                f"{count_text(int(bad.sum()), 'sample')} of {channel} not finite, marked missing"
            )
        far_off = stands_for_none(numbers, spec.column)
        found.notes += [far_off] if far_off else []
        unit, target = spec.unit or "1", spec.target
        channels.values[channel] = to_si(numbers, unit, target)
        kept = target if target and parse_unit(target).is_si else si_unit(unit)
        channels.units[channel], found.units[channel] = kept, unit
        steps.append(
            f"column {_with_unit(spec.column, unit)} to {_with_unit(channel, kept)}"
            f"{conversion_text(unit)}" + (f"; unit {spec.origin}" if spec.origin else "")
        )
    if not channels.values and not found.faults:
        text = f"{table.path.name}: no column of numbers beside the time stamps."
        remedy = f"The file holds {', '.join(table.columns)}; give a file with measurements."
        found.faults.append(Fault("columns", text, remedy))
    return channels


def _is_even(
    opened: _Opened, rows: NDArray[np.intp], found: Survey, resample: float | None
) -> bool:
    """Whether the clock can be used; its faults are noted otherwise."""
    table, clock = opened.table, opened.clock
    if clock is None or found.times is None:
        return True
    faults = time_faults(found.times, table.path.name, lambda k: table.place(int(rows[k])))
    hard = [f for f in faults if f.kind not in {"irregular", "gap"}]
    if hard or (faults and resample is None):
        found.faults += hard or faults
        return False
    return True


def _record(
    channels: _Channels,
    found: Survey,
    options: ReadingOptions,
    name: str,
    steps: list[str],
    clock: EvenClock | None = None,
) -> Record | None:
    """The record, resampled on request; None, with a fault noted, where it fails."""
    resample = options.resample
    values, units, missing, times = channels.values, channels.units, channels.missing, found.times
    assert times is not None
    if clock is not None:
        found.notes.append(str(clock))
        values, missing, late = clock.spread(values, missing, options.held)
        steps = [*steps, f"remark: {clock}"]
        t0 = float(times[0]) + clock.first
        return Record(values, units, clock.Ts, t0, name, missing, tuple(steps), late)
    if resample is None:
        if text := jitter_text(times):
            found.notes.append(text)
            steps = [*steps, f"remark: {text}"]
        step, t0 = even_step(times), float(times[0])
        return Record(values, units, step, t0, name, missing, tuple(steps))
    try:
        return resampled(times, values, units, missing, resample, name, steps, options.held)
    except DataError as error:
        median = float(np.median(np.diff(times)))
        remedy = f"Resample nearer to the median interval, resample={median:.6g}."
        found.faults.append(Fault("resample", str(error), remedy))
        return None


def _with_absent_rows(
    found: Survey, channels: _Channels, options: ReadingOptions
) -> EvenClock | None:
    """The even clock that the file leaves rows out of, where that is no fault."""
    if found.times is None or not options.takes_gaps or options.resample is not None:
        return None
    if jitter_text(found.times) is not None:  # even as it is
        return None
    N = found.times.size
    there = {n: ~channels.missing.get(n, np.zeros(N, dtype=bool)) for n in channels.values}
    return even_clock(found.times, there)


def conversion_text(unit: str) -> str:
    """How a number in `unit` becomes SI: `: times 0.001`, `: plus 273.15`; empty for none."""
    parsed = parse_unit(unit)
    parts = [f"times {parsed.factor:.9g}"] if parsed.factor != 1.0 else []
    parts += [f"plus {parsed.offset:.9g}"] if parsed.offset else []
    return f": {', '.join(parts)}" if parts else ""
