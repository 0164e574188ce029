"""The cells of a table as numbers, and the time stamps as seconds."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casid.arrays import FloatArray
from casid.data.reading.clocks.clock_numbers import day_numbers, of_clock_numbers
from casid.data.reading.clocks.time_stamps import (
    DAY,
    Stamps,
    of_dates,
    of_large_numbers,
    of_stamps,
    of_times_of_day,
)
from casid.data.reading.columns import CLOCK_FORMATS, ColumnSpec, unit_of_column
from casid.data.reading.faults import Fault, Survey
from casid.data.reading.layout import NO_VALUE
from casid.data.reading.number_marks import Evidence, decimal_mark, plain_number
from casid.data.reading.tables import Table
from casid.errors import DataError, shell_option
from casid.model.quantities import are, count_text
from casid.model.units import to_si

if TYPE_CHECKING:
    import pandas as pd


_AS_STAMPS = (
    "Correct the cells: time stamps are numbers, or dates such as 2025-01-31 12:00:00; or leave "
    "the column out and give the sample time, --sample-time 0.01 (Ts=0.01)."
)
_NO_VALUE_NUMBERS = frozenset(
    [32767.0, -32768.0, 65535.0, 2147483647.0, -2147483648.0, 1e30, -1e30]
)


def numbers_of(
    table: Table,
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
        plain = np.asarray(column.to_numpy(dtype=np.float64, na_value=np.nan))
        return _without_missing(plain, table)
    there = column.notna().to_numpy()
    if column.dtype.kind in "mM":  # dates are times, not measurements
        column = column.astype(str)
    cells = [str(c).strip() for c in column]
    held = np.array([c.casefold() not in NO_VALUE for c in cells]) & there
    held &= np.array([c not in table.form.missing for c in cells])
    decimal = _decimal_of(table, [c for c, h in zip(cells, held, strict=True) if h], spec, found)
    if decimal is None:
        return None
    texts = [plain_number(c, decimal) if h else None for c, h in zip(cells, held, strict=True)]
    numbers = np.array([np.nan if t is None else float(t) for t in texts], dtype=np.float64)
    text = np.isnan(numbers) & held
    if skip_text and text.sum() == held.sum():
        return None
    if not text.any():
        infinite = {"inf": np.inf, "+inf": np.inf, "-inf": -np.inf, "infinity": np.inf}
        numbers[~held] = [infinite.get(cells[k].casefold(), np.nan) for k in np.flatnonzero(~held)]
        return _without_missing(numbers, table)
    first = int(np.argmax(text))
    detail = (
        f"text in {int(text.sum())} of {text.size} cells, the first at {table.place(first)}: "
        f"{cells[first][:60]!r}"
    )
    found.faults.append(
        Fault(
            "text",
            f"{table.path.name}: column {spec.column!r} (channel {channel}) holds {detail}.",
            "Correct the cells or leave them empty; text that stands for no value is named, "
            f"{shell_option('--missing', cells[first][:60])} --mark-missing.",
            spec.column,
            detail,
        )
    )
    return None


def _decimal_of(table: Table, cells: list[str], spec: ColumnSpec, found: Survey) -> str | None:
    """The decimal mark of cells that are text; None, with a fault noted, where it is open."""
    if table.form.decimal is not None:
        return table.form.decimal
    marks = Evidence().add(cells)
    decimal = decimal_mark(marks, default=table.decimal)
    loose = {m: c for m, c in marks.either.items() if m not in {*marks.decimal, *marks.thousands}}
    known = marks.decimal or marks.thousands
    open_marks = [c for m, c in loose.items() if not known and m != (decimal or ".")]
    open_marks += [c for m, c in loose.items() if known and m != decimal]
    if decimal is not None and not open_marks:
        return decimal
    if decimal is None and not open_marks and not known:
        return "."
    where = f"{table.path.name}: column {spec.column!r}"
    if open_marks:
        cell = open_marks[0]
        text = (
            f"{where} holds {cell!r}, which may be {cell.replace(',', '.')} or "
            f"{cell.replace(',', '').replace('.', '')}."
        )
    else:
        two = " and ".join(map(repr, [*marks.decimal.values(), *marks.thousands.values()][:2]))
        text = f"{where} holds {two}: points and commas are decimal marks both."
    remedy = "Name the decimal mark with --decimal , or --decimal . (FileFormat(decimal=','))."
    found.faults.append(Fault("decimal", text, remedy, spec.column))
    return None


def _without_missing(numbers: FloatArray, table: Table) -> FloatArray:
    """The numbers, those that stand for no value as NaN."""
    for text in table.form.missing:
        plain = plain_number(text, table.decimal or ".")
        if plain is not None and np.any(numbers == float(plain)):
            numbers = np.where(numbers == float(plain), np.nan, numbers)
    return numbers


def stands_for_none(values: FloatArray, column: str) -> str:
    """A remark on a value such as 9999 far off all others, which may stand for none; else empty."""
    finite = values[np.isfinite(values)]
    if finite.size < 4:
        return ""
    for extreme in (float(finite.max()), float(finite.min())):
        rest = finite[finite != extreme]
        digits = f"{abs(extreme):.10g}".replace(".", "")
        known = (set(digits) == {"9"} and len(digits) > 1) or extreme in _NO_VALUE_NUMBERS
        if known and rest.size and float(np.abs(rest - extreme).min()) > 3 * float(np.ptp(rest)):
            count = finite.size - rest.size
            return (
                f"{count} value{'s' if count > 1 else ''} of column {column!r} "
                f"{'are' if count > 1 else 'is'} {extreme:.10g}, far off all others; where that "
                f"stands for no value, add --missing {extreme:.10g} --mark-missing"
            )
    return ""


def non_finite(
    table: Table,
    channel: str,
    spec: ColumnSpec,
    numbers: FloatArray,
    rows: NDArray[np.intp],
    times: FloatArray | None,
) -> Fault:
    """Samples that are not finite: how many, and where the first is; none in an empty column."""
    bad = ~np.isfinite(numbers)
    first, nans = int(np.argmax(bad)), int(np.isnan(numbers).sum())
    column = f"{table.path.name}: column {spec.column!r} (channel {channel})"
    if nans == numbers.size:
        example = shell_option("--map", f"{channel}=COLUMN")
        return Fault(
            "empty",
            f"{column} is empty: none of its {numbers.size} cells holds a value.",
            f"Name the column that was recorded, as in {example}, give a window that holds "
            f"values, or leave {channel} out of the model or the columns to read.",
            spec.column,
        )
    at = f", t = {times[first]:g} s" if times is not None else ""
    return Fault(
        "non-finite",
        f"{column} holds {count_text(int(bad.sum()), 'sample')} that {are(int(bad.sum()))} not "
        f"finite ({nans} empty or NaN, {int(bad.sum()) - nans} Inf), the "
        f"first at {table.place(int(rows[first]))} (k = {first}{at}).",
        "Leave them out with a window, empty the cells that hold Inf, or mark them missing "
        "(--mark-missing; mark_missing=True of read_record, Record.from_frame and Problem.read).",
        spec.column,
    )


def without_values(table: Table, column: str, found: Survey) -> None:
    """Note an empty column that is not read; a doubt where its name has a unit."""
    unit = unit_of_column(table, column)
    text = f"column {column} left out: it is empty"
    if unit is None or not unit.is_sure:
        found.notes.append(text)
        return
    remedy = "Export the measurement again, if the signal was recorded."
    found.doubts.append(
        Fault("empty", f"{text}, though it has the unit {unit.text}.", remedy, column)
    )


def times_of(
    table: Table, frame: pd.DataFrame, clock: ColumnSpec, found: Survey
) -> FloatArray | None:
    """Return the time stamps [s]; dates become seconds since the first."""
    import pandas as pd

    column = frame[clock.column]
    if column.dtype.kind == "m" and column.notna().all():
        return np.asarray(column.dt.total_seconds(), dtype=np.float64)
    try:
        stamps = _stamps(table, frame, clock)
    except DataError as error:
        found.faults.append(Fault("time", str(error), "", clock.column))
        return None
    if stamps is not None:
        return _noted(stamps, table, found)
    numbers = numbers_of(table, frame, "t", clock, found)
    if numbers is None:
        if found.faults[-1].kind == "text":  # what is no value for a channel is a time stamp here
            found.faults[-1] = replace(found.faults[-1], remedy=_AS_STAMPS)
        return None
    if not np.isfinite(numbers).all():
        rows = np.arange(numbers.size)
        fault = non_finite(table, "t", clock, numbers, rows, None)
        remedy = "Correct the time stamps, or leave the column out and give Ts (--sample-time)."
        found.faults.append(replace(fault, remedy=remedy))
        return None
    exact: NDArray[Any] = column.to_numpy() if column.dtype.kind in "iu" else numbers
    large = of_large_numbers(exact, clock.unit, clock.column, table.origin)
    if large is not None:
        return _noted(large, table, found)
    days = day_numbers(table, frame, clock.column) if clock.unit in {None, *CLOCK_FORMATS} else None
    clocked = of_clock_numbers(numbers, clock.unit, clock.column, days)
    if clocked is not None:
        return _noted(clocked, table, found)
    if clock.unit in CLOCK_FORMATS:
        text = f"{table.path.name}: column {clock.column!r} holds no times written {clock.unit}."
        remedy = "Give the unit that its numbers are in, as in --map 't=COLUMN:s'."
        found.faults.append(Fault("time", text, remedy, clock.column))
        return None
    if pd.api.types.is_bool_dtype(column.dtype) or clock.unit in {"d", "day", "days"}:
        return numbers * DAY
    return to_si(numbers, clock.unit or "s", "s")


def _noted(stamps: Stamps, table: Table, found: Survey) -> FloatArray:
    if table.origin is None and stamps.text:
        found.notes.append(f"time stamps are {stamps.text}")
    found.counted = "since midnight" if stamps.origin is None else "since the first stamp"
    table.origin = stamps.origin if table.origin is None else table.origin
    return stamps.seconds


def _stamps(table: Table, frame: pd.DataFrame, clock: ColumnSpec) -> Stamps | None:
    """Dates and times of day; None for numbers, and where cells are neither."""
    import pandas as pd

    column = frame[clock.column]
    where = f"{table.path.name}: column {clock.column!r}"
    if pd.api.types.is_numeric_dtype(column.dtype):
        return None
    empty = column.isna().to_numpy()
    if empty.any():
        first = table.place(int(np.argmax(empty)))
        raise DataError(
            f"{where} holds {int(empty.sum())} empty time stamps, the first at {first}. Fill them, "
            "or leave the rows out; without time stamps give Ts (--sample-time)."
        )
    if column.dtype.kind == "M":
        return of_stamps(column, table.form, where, table.origin)
    text = column.astype(str)
    if table.date_column is not None:
        day = frame[table.date_column].astype(str).str.strip().str.removesuffix(" 00:00:00")
        both = of_dates(day + " " + text.str.strip(), table.form, where, table.origin)
        if both is not None:
            return both
    dates = of_dates(text, table.form, where, table.origin)
    return dates or of_times_of_day(text, clock.unit, where)
