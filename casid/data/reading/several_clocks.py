"""Files whose channels have clocks of their own: a time column for each, or rows for each.

Loggers write `t_F, F, t_x, x` (or `time, F, time, x`) with columns of different lengths, or one
time column whose rows hold one channel each. Either is one table of the instants at which anything
was measured, with empty cells where a channel was not; nothing is interpolated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casid.arrays import BoolArray, FloatArray
from casid.data.reading.cells import times_of
from casid.data.reading.clocks.even_clock import UNIFORM
from casid.data.reading.columns import (
    ColumnSpec,
    Time,
    as_written,
    is_time_name,
    time_unit,
    unit_of_column,
)
from casid.data.reading.faults import Survey
from casid.data.reading.layout import NO_VALUE
from casid.data.reading.tables import FrameTable, Table
from casid.errors import DataError, UnitError

if TYPE_CHECKING:
    import pandas as pd

_WORDS = frozenset("t time zeit timestamp clock temps tiempo tempo".split())
_NAMES = ("t", "time", "timestamp")


class UnitedTable(FrameTable):
    """A table of all instants of another one, `times` (N,) [s], each once and in order.

    Its time column is new where the other has one for each channel.
    """

    def __init__(self, of: Table, frame: pd.DataFrame, times: FloatArray) -> None:
        units = {c: of.units[c] for c in frame.columns if c in of.units}
        super().__init__(of.path, of.form, frame, units)
        self.unnamed = {c for c in of.unnamed if c in self.columns}
        self.decimal, self.origin, self.remarks = of.decimal, of.origin, list(of.remarks)
        self.is_numbered = of.is_numbered
        self.times = times

    def place(self, row: int) -> str:
        """Say where a row stands, by its instant."""
        return f"t = {self.times[row]:.9g} s"


def on_one_clock(table: Table, time: Time) -> Table:
    """The table, or that of all its instants where its channels have time columns of their own.

    A channel belongs to the time column that has its name (`t_x`, `x time`), else to the one before
    it. Two clocks are taken for that only where names say so, by being the same or those of
    channels, or where they differ in length; a file is left as it is where `time` names its clock.

    Raises
    ------
    DataError
        If clocks do not overlap: they count from different instants.
    """
    if time is not None or table.form.Ts is not None or isinstance(table, UnitedTable):
        return table
    clocks = [c for c in table.columns if is_time_name(table, c) or _holds_word(table, c)]
    if len(clocks) < 2:
        return table
    owners, are_named = _owners(table, clocks)
    clocks = [c for c in clocks if c in owners.values()]
    if len(clocks) < 2 or len(owners) + len(clocks) < len(table.columns):
        return table
    frame = table.read(table.columns)
    there = {c: held(table, frame[c]) for c in table.columns}
    lengths = {c: int(there[c].sum()) for c in clocks}
    at_front = all(there[c][: lengths[c]].all() for c in clocks)
    of_clock = all(not (there[c] & ~there[o]).any() for c, o in owners.items())
    if min(lengths.values()) < 2 or not (at_front and of_clock):
        return table
    if not are_named and len(set(lengths.values())) == 1:
        return table
    origin = table.origin
    stamps = {c: _stamps(table, frame.iloc[: lengths[c]], c) for c in clocks}
    if any(s is None or not (np.diff(s) > 0).all() for s in stamps.values()) or _agree(stamps):
        table.origin = origin
        return table
    times = {c: s for c, s in stamps.items() if s is not None}
    _require_overlap(table, times)
    return _united(table, frame, owners, there, times)


def united_rows(
    table: Table, frame: pd.DataFrame, times: FloatArray, columns: Sequence[str]
) -> UnitedTable | None:
    """The table of rows that hold one channel each; None where a channel's stamps do not increase.

    Parameters
    ----------
    times : (rows,) time stamps [s]; rows of different channels may share one, or be out of order.
    """
    there = {c: held(table, frame[c]) for c in dict.fromkeys(columns)}
    if any(not (np.diff(times[t]) > 0).all() for t in there.values()):
        return None
    instants, place = np.unique(times, return_inverse=True)
    parts = {c: (frame[c][t.tolist()], place[t]) for c, t in there.items()}
    return UnitedTable(table, _placed(parts, instants), instants)


def held(table: Table, column: pd.Series[Any]) -> BoolArray:
    """(rows,) True where a cell holds a value."""
    there: BoolArray = column.notna().to_numpy()
    if column.dtype.kind in "fiubmM":
        return there
    cells = column.astype(str).str.strip()
    empty = cells.str.casefold().isin(NO_VALUE) | cells.isin(table.form.missing)
    return there & ~empty.to_numpy()


def _placed(
    parts: Mapping[str, tuple[pd.Series[Any], NDArray[np.intp]]],
    instants: FloatArray,
) -> pd.DataFrame:
    """Columns with the cells of each at their places among the instants, the others empty."""
    import pandas as pd

    rows = range(instants.size)
    return pd.DataFrame({c: cells.set_axis(at).reindex(rows) for c, (cells, at) in parts.items()})


def _united(
    table: Table,
    frame: pd.DataFrame,
    owners: Mapping[str, str],
    there: Mapping[str, BoolArray],
    times: Mapping[str, FloatArray],
) -> UnitedTable:
    instants = np.unique(np.concatenate(list(times.values())))
    places = {c: np.searchsorted(instants, t) for c, t in times.items()}
    parts = {}
    for column, clock in owners.items():
        rows = np.flatnonzero(there[column])
        parts[column] = (frame[column].iloc[rows], places[clock][rows])
    out = _placed(parts, instants)
    name = next((n for n in _NAMES if n not in out.columns), "t of all clocks")
    out.insert(0, name, instants)
    united = UnitedTable(table, out, instants)
    united.units[name] = "s"
    united.remarks.append(_remark(owners, times))
    return united


def _remark(owners: Mapping[str, str], times: Mapping[str, FloatArray]) -> str:
    said = []
    for clock, stamps in times.items():
        mine = ", ".join(c for c, o in owners.items() if o == clock)
        step = float(np.median(np.diff(stamps)))
        said.append(f"{mine} at the {stamps.size} instants of {clock!r} (about {step:.4g} s apart)")
    return f"{len(times)} clocks: {'; '.join(said)}"


def _holds_word(table: Table, column: str) -> bool:
    """Whether a name has time among its words, `t_x [s]`, `x time`, and no other unit."""
    return bool(_words(table, column) & _WORDS) and (
        unit_of_column(table, column) is None or time_unit(table, column) is not None
    )


def _words(table: Table, column: str) -> set[str]:
    """The words of a name, its unit and number left out."""
    found = unit_of_column(table, column)
    stem = found.stem if found is not None and column not in table.units else as_written(column)
    return {w for w in re.split(r"[\W_]+", stem.casefold()) if w}


def _owners(table: Table, clocks: Sequence[str]) -> tuple[dict[str, str], bool]:
    """Channel -> its clock, and whether names alone say so."""
    own = {c: frozenset(_words(table, c) - _WORDS) for c in clocks}
    by_words = {words: c for c, words in own.items() if words}
    owners: dict[str, str] = {}
    named: set[str] = set()
    last: str | None = None
    for column in table.columns:
        if column in own:
            last = column
            continue
        clock = by_words.get(frozenset(_words(table, column)))
        if clock is not None:
            named.add(clock)
        clock = clock or last
        if clock is not None:
            owners[column] = clock
    same = any(set(names) >= set(clocks) for names in table.twice.values())
    return owners, same or named >= set(owners.values())


def _stamps(table: Table, frame: pd.DataFrame, clock: str) -> FloatArray | None:
    """The stamps of a clock [s]; None where they cannot be read."""
    try:
        spec = ColumnSpec(clock, time_unit(table, clock), "s")
        return times_of(table, frame, spec, Survey(table.path))
    except UnitError:
        return None


def _agree(stamps: Mapping[str, FloatArray | None]) -> bool:
    """Whether all clocks show the same instants."""
    first, *others = (s for s in stamps.values() if s is not None)
    return all(
        s.size == first.size
        and float(np.abs(s - first).max()) <= UNIFORM * float(np.median(np.diff(first)))
        for s in others
    )


def _require_overlap(table: Table, times: Mapping[str, FloatArray]) -> None:
    names = list(times)
    for a, b in zip(names[:-1], names[1:], strict=True):
        s, t = times[a], times[b]
        if max(s[0], t[0]) >= min(s[-1], t[-1]):
            raise DataError(
                f"{table.path.name}: the channels have clocks of their own, {a!r} from {s[0]:.9g} "
                f"to {s[-1]:.9g} s and {b!r} from {t[0]:.9g} to {t[-1]:.9g} s, which do not "
                "overlap: they count from different instants. Write both from the same one, or "
                "read the channels from files of their own and align them (record.align)."
            )
