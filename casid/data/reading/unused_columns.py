"""Columns of a file that no channel is read from: which of them may be missing inputs, and why not.

A column of numbers that moves is one that an experimenter found worth recording; a model that does
not use it may lack it. Left out are columns without a value in some row, constants, counters and
further clocks, copies of used columns, and derivatives of them, which are what the system does and
not what acts on it.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from casid.arrays import FloatArray
from casid.data.reading.cells import numbers_of
from casid.data.reading.clocks.even_clock import UNIFORM
from casid.data.reading.columns import ColumnSpec, unit_of_column
from casid.data.reading.faults import Survey
from casid.data.reading.tables import Table
from casid.errors import DataError, nearest
from casid.model.units import si_unit

if TYPE_CHECKING:
    import pandas as pd

COPY = 1 - 1e-6
"""Correlation from which a column is a copy of another, up to scale and offset and rounding."""

TWIN = 0.999
"""Correlation from which a column shows what a used one shows: heuristic, noise allowed for."""

DERIVATIVE = 0.99
"""Correlation from which a column is the derivative of a used one, noise and lag allowed for."""


class Unused(NamedTuple):
    """Columns that may be missing inputs, and those that may not.

    Attributes
    ----------
    specs : name of a channel -> column and unit.
    left_out : column -> why it is no candidate.
    """

    specs: dict[str, ColumnSpec]
    left_out: dict[str, str]

    @property
    def lines(self) -> list[str]:
        """What a record's provenance says of them."""
        return [
            f"column {spec.column!r} is not used by the model: a diagnosis tests it as a missing "
            f"input, {name} [{spec.target}] (--ignore leaves it out)"
            for name, spec in self.specs.items()
        ] + [f"column {column!r} is not used: {why}" for column, why in self.left_out.items()]


def unused_columns(
    table: Table,
    used: Mapping[str, ColumnSpec],
    clock: str | None,
    *,
    ignore: Collection[str] = (),
    taken: Collection[str] = (),
) -> Unused:
    """The columns of a table that are neither channels nor time stamps, judged as candidates.

    Parameters
    ----------
    used : channels that are read, with their columns.
    clock : the time column.
    ignore : columns that are left out on request.
    taken : names that a new channel may not have.

    Raises
    ------
    DataError
        If a column to ignore is not there.
    """
    for column in ignore:
        if column not in table.columns:
            raise DataError(
                f"{table.path.name}: no column {column!r} to ignore; name one as the file writes it"
                f"{nearest(column, table.columns)}"
            )
    there = [c for c in table.columns if c in {spec.column for spec in used.values()}]
    beside = {clock, table.date_column, *table.clocks}
    rest = [c for c in table.columns if c not in there and c not in beside]
    found = Unused({}, {c: "left out as requested (--ignore)" for c in rest if c in ignore})
    rest = [c for c in rest if c not in ignore]
    if not rest:
        return found
    frame = table.read([*there, *rest])
    own = {c: v for c in there if (v := _numbers(table, frame, c)) is not None}
    kept: dict[str, FloatArray] = {}
    names = {*taken, *used}
    for column in rest:
        values = _numbers(table, frame, column)
        why = _why_not(frame[column], values, {**own, **kept}, own)
        if why:
            found.left_out[column] = why
            continue
        assert values is not None
        kept[column] = values
        name = _free(_identifier(column), names)
        names.add(name)
        unit = unit_of_column(table, column)
        if unit is not None and unit.unit is not None:
            found.specs[name] = ColumnSpec(column, None, si_unit(unit.unit))
        else:  # also where it can be read in two ways: a scale of the candidate's size
            found.specs[name] = ColumnSpec(column, "1", "1")
    return found


def _numbers(table: Table, frame: pd.DataFrame, column: str) -> FloatArray | None:
    if frame[column].dtype.kind in "mM":
        return None
    return numbers_of(table, frame, column, ColumnSpec(column), Survey(table.path))


def _why_not(
    cells: pd.Series[str],
    values: FloatArray | None,
    others: Mapping[str, FloatArray],
    used: Mapping[str, FloatArray],
) -> str:
    """Why a column is no candidate for a missing input; an empty text where it is one."""
    if not cells.notna().any():
        return "empty"
    if values is None:
        return "text"
    if values.size < 3 or not np.isfinite(values).all():
        bad = int((~np.isfinite(values)).sum())
        return f"{bad} of {values.size} rows have no value"
    if np.ptp(values) == 0:
        return "constant"
    steps = np.diff(values)
    even = np.abs(steps - np.median(steps)) <= UNIFORM * abs(float(np.median(steps)))
    if np.median(steps) != 0 and even.mean() > 0.99:
        return "a counter or a clock"
    for name, other in others.items():
        if _correlation(values, other) >= COPY:
            return f"a copy of column {name!r}, up to scale and offset"
    for name, other in used.items():
        if _correlation(values, other) >= TWIN:
            return f"all but a copy of column {name!r}, as another sensor of it would be"
        if np.isfinite(other).all() and other.size == values.size:
            if _correlation(values, np.gradient(other)) >= DERIVATIVE:
                return f"the derivative of column {name!r}"
    return ""


def _correlation(a: FloatArray, b: FloatArray) -> float:
    """The absolute correlation of two columns, 0 where one rests or misses values."""
    if a.size != b.size or not (np.isfinite(a).all() and np.isfinite(b).all()):
        return 0.0
    x, y = a - a.mean(), b - b.mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return abs(float(x @ y)) / size if size > 0 else 0.0


def _identifier(column: str) -> str:
    """A name for a channel: the column's without its unit, as a word of letters and digits."""
    import unicodedata

    from casid.data.reading.header_units import header_unit

    found = header_unit(column)
    stem = found.stem if found is not None and found.unit is not None else column
    for letter, plain in (("ä", "ae"), ("ö", "oe"), ("ü", "ue"), ("ß", "ss"), ("µ", "u")):
        stem = stem.replace(letter, plain).replace(letter.upper(), plain.capitalize())
    plain = unicodedata.normalize("NFKD", stem).encode("ascii", "ignore").decode()
    word = re.sub(r"\W+", "_", plain).strip("_") or "column"
    return f"c_{word}" if word[0].isdigit() else word


def _free(name: str, taken: Collection[str]) -> str:
    number, free = 2, name
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    return free
