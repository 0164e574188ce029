"""What each column of a table is: unit, kind, sample time, and remarks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from casid.arrays import FloatArray
from casid.data.reading.cells import numbers_of, stands_for_none
from casid.data.reading.clocks.even_clock import even_step, jitter_text
from casid.data.reading.columns import (
    ColumnSpec,
    is_dated,
    stated_otherwise,
    time_unit,
    unit_of_column,
)
from casid.data.reading.faults import ColumnSurvey, Fault, Survey
from casid.data.reading.tables import Table
from casid.errors import shell_option
from casid.model.units import parse_unit

if TYPE_CHECKING:
    import pandas as pd

COPY = 1 - 1e-9
"""Correlation from which a column is a copy of another, up to scale and offset."""


def column_surveys(
    table: Table, frame: pd.DataFrame, clock: str | None, times: FloatArray | None
) -> tuple[ColumnSurvey, ...]:
    """Survey every column of `frame`; `times` are the time stamps [s], where they can be read."""
    numbers: dict[str, FloatArray] = {}
    found = []
    for name in table.columns:
        if name == clock:
            found.append(ColumnSurvey(name, time_unit(table, name), "time", _step(times)))
            continue
        entry = _survey_of(table, frame, name, times, numbers)
        found.append(entry)
    return tuple(found)


def _survey_of(
    table: Table,
    frame: pd.DataFrame,
    name: str,
    times: FloatArray | None,
    numbers: dict[str, FloatArray],
) -> ColumnSurvey:
    column = frame[name]
    there = column.notna().to_numpy()
    if not there.any():
        return ColumnSurvey(name, None, "empty", None)
    if column.dtype.kind in "mM" or is_dated(table, name):
        return ColumnSurvey(name, None, "time", _step(times))
    seen = Survey(table.path)
    values = numbers_of(table, frame, name, ColumnSpec(name), seen, skip_text=True)
    if values is None:  # all of it text, or numbers with text among them
        mixed = tuple(f"holds {f.detail}" for f in seen.faults if f.detail)
        return ColumnSurvey(name, None, "text", None, mixed)
    far_off = stands_for_none(values, name)
    remarks = [far_off] if far_off else []
    finite = np.isfinite(values)
    if not finite.all():
        remarks.append(f"{int((~finite).sum())} of {values.size} rows have no value")
    if not finite.any() or np.ptp(values[finite]) == 0:
        remarks.append("constant")
    else:
        twin = next((n for n, other in numbers.items() if _is_copy(values, other)), None)
        if twin is not None:
            remarks.append(f"a copy of column {twin!r}, up to scale and offset")
        numbers[name] = values
    unit, written, doubt = unit_of_column(table, name), "", ""
    if unit is not None and unit.unit is None and unit.is_sure:
        written = unit.text
        why = f"may be {unit.why}" if unit.why else "is not in the list of units"
        doubt = f"its unit {unit.text!r} {why}"
        remarks.append(doubt)
    read = unit.unit if unit is not None else None
    step = None if times is None or times.size != values.size else _step(times[finite])
    return ColumnSurvey(name, read, "numeric", step, tuple(remarks), written, doubt)


def _step(times: FloatArray | None) -> float | None:
    """The sample time [s] of even time stamps."""
    if times is None or times.size < 2:
        return None
    intervals = np.diff(times)
    median = float(np.median(intervals))
    if median <= 0 or jitter_text(times) is None:
        return None
    return even_step(times)


def _is_copy(a: FloatArray, b: FloatArray) -> bool:
    """True where one is the other up to scale and offset."""
    if a.size != b.size or not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return False
    kept = np.isfinite(a)
    x, y = a[kept] - a[kept].mean(), b[kept] - b[kept].mean()
    return abs(float(x @ y)) >= COPY * float(np.sqrt((x @ x) * (y @ y)))


def note_other_units(table: Table, given: Mapping[str, ColumnSpec], found: Survey) -> None:
    """Note every unit that is given and is not the one that the file states."""
    for channel, spec in given.items():
        stated = stated_otherwise(table, spec)
        if stated is None or stated.unit is None or spec.unit is None:
            continue
        text = (
            f"column {spec.column!r} is read in {spec.unit}, the unit given, though "
            f"{'the file states' if stated.is_sure else 'its name ends with'} {stated.text}"
        )
        one, other = parse_unit(spec.unit), parse_unit(stated.unit)
        if one.dimension == other.dimension and one.offset == other.offset:
            text += f": its numbers count {one.factor / other.factor:.6g} times as much"
        example = shell_option("--map", f"{channel}={spec.column}")
        remedy = (
            f"Leave the unit out, as in {example}, to read it in {stated.text}; keep it where the "
            "file is wrong."
        )
        if stated.is_sure:
            found.doubts.append(Fault("unit", f"{text}.", remedy, channel))
        else:
            found.notes.append(f"{channel}: {text}. {remedy.rstrip('.')}")
