"""Which columns of a table become channels, in which unit, and which one is the clock."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from casid.data.reading.tables import Table
from casid.errors import DataError, UnitError
from casid.model.units import ambiguous_units, parse_unit, same_dimension, to_si

_TIME_NAMES = ("t", "time", "zeit", "timestamp", "seconds", "elapsed", "elapsed_time")
_BRACKET = re.compile(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]")
# Endings that are more often a word, an index or another unit than what the list reads: x_in is an
# input, x_bar a mean, x_min a minimum, a_s a sensor's signal, u_ms metres a second.
_NO_ENDINGS = frozenset(
    "none 1 h hr min t s in rev bar L l ms us mg sec second seconds minute minutes hour hours "
    "foot feet amp percent pct".split()
)


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


def unit_from_name(column: str) -> str | None:
    """Return the unit a column's name ends with: `phi_deg`, `phi [deg]`, `u (V)`; None without one.

    Only units that can be read in one way count; `x_g` says nothing.
    """
    bracket = _BRACKET.fullmatch(column)
    if bracket and bracket[1]:
        return _readable(bracket[2], bracketed=True) if bracket[2] else "1"
    stem, underscore, ending = column.rpartition("_")
    return _readable(ending, bracketed=False) if stem and underscore and ending else None


def _readable(text: str, *, bracketed: bool) -> str | None:
    if not bracketed and text in _NO_ENDINGS:
        return None
    try:
        parse_unit(text)
    except UnitError:
        return None
    return text


def resolve(
    table: Table, columns: Columns | None, time: str | ColumnSpec | Sequence[str | None] | None
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


def _with_unit(table: Table, name: str, spec: ColumnSpec) -> ColumnSpec:
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
    table: Table, time: str | ColumnSpec | Sequence[str | None] | None
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
