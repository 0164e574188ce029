"""Which columns of a table become channels, in which unit, and which one is the clock."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from casid.data.reading.header_units import (
    HeaderUnit,
    header_unit,
    likely_reading,
    settled,
    written_unit,
)
from casid.data.reading.layout import is_date
from casid.data.reading.name_endings import name_ending
from casid.data.reading.tables import Table
from casid.errors import DataError, UnitError, shell_option
from casid.model.units import parse_unit, same_dimension, to_si

_TIME_NAMES = frozenset(
    "t|time|zeit|timestamp|time stamp|seconds|elapsed|elapsed time|zeitstempel|datum|date|datetime"
    "|date time|datum uhrzeit|date and time|datum zeit|uhrzeit|messzeit|time of day|x value|epoch"
    "|unix time|unixtime|utc|local time|localtime|time utc|utc time|sample time|rel time|abs time"
    "|temps|horodatage|tiempo|tempo|fecha|tijd|czas|ts|time stamp utc|recording time".split("|")
)
_DATE_NAMES = frozenset("date datum day tag fecha data jour dato".split())
_UNIT_NAMES = {  # a clock called by its unit alone
    "ms": "ms", "msec": "ms", "millis": "ms", "milliseconds": "ms", "millisekunden": "ms",
    "us": "us", "µs": "us", "μs": "us", "usec": "us", "micros": "us", "microseconds": "us",
    "sec": "s", "secs": "s", "sekunden": "s", "millis()": "ms", "micros()": "us",
    "seconds": "s", "minutes": "min", "hours": "h", "minuten": "min", "stunden": "h",
}  # fmt: skip
_UNIT_ENDINGS = {  # behind a name of time: t_ms, time_hours, Time h
    "s": "s", "ms": "ms", "us": "us", "ns": "ns", "min": "min", "mins": "min", "h": "h", "hr": "h",
    "hrs": "h", "d": "d", "days": "d",
    "nanos": "ns", "nsec": "ns", "nanoseconds": "ns",
} | {name: unit for name, unit in _UNIT_NAMES.items() if name.isalpha()}  # fmt: skip
_CLOCK_NAMES = frozenset("time zeit uhrzeit clock heure hora tid tijd".split())
_ABSCISSAS = frozenset(["x", "x axis", "x values", "abscissa"])
CLOCK_FORMATS = ("hh:mm", "mm:ss", "hh:mm:ss")


class ColumnSpec(NamedTuple):
    """Where a channel comes from.

    Attributes
    ----------
    column : str
        Name of the column in the file.
    unit : str, optional
        Unit in which the file is written. Without one, it is read from the file: a row of units,
        brackets (`phi [deg]`), `P in kW`, `i/mA`; the ending of the column's name (`phi_deg`)
        where it fits the target; else it is the target.
    target : str, optional
        Unit the model expects; it fixes the dimension. Channels are always kept in SI.
    origin : str
        Where the unit was read; filled in as a file is opened.
    """

    column: str
    unit: str | None = None
    target: str | None = None
    origin: str = ""


Columns = Mapping[str, "ColumnSpec | str | Sequence[str | None]"]
Time = str | ColumnSpec | Sequence[str | None] | None


def unit_of_column(table: Table, column: str) -> HeaderUnit | None:
    """The unit that the file names for a column, beside its name or in it."""
    if column in table.units:
        return written_unit(table.units[column], column)
    return header_unit(as_written(column))


def as_written(column: str) -> str:
    """A column's name in the file: one that is there several times is read as `name#2`."""
    return re.sub(r"#\d+$", "", column)


def stated_otherwise(table: Table, spec: ColumnSpec) -> HeaderUnit | None:
    """The unit that the file names for a column, where it converts in another way than the one
    that is given; None for the same in another spelling, and for a mere ending that measures
    another quantity."""
    if spec.origin != "given" or not spec.unit or spec.unit in CLOCK_FORMATS:
        return None
    found = unit_of_column(table, spec.column)
    if found is None or found.unit is None or found.text.strip(" -") == "":
        return None
    stated, given = parse_unit(found.unit), parse_unit(spec.unit)
    if stated.dimension != given.dimension:
        return found if found.is_sure else None
    alike = np.isclose([stated.factor, stated.offset], [given.factor, given.offset], rtol=1e-9)
    return None if alike.all() else found


def resolve(
    table: Table, columns: Columns | None, time: Time
) -> tuple[dict[str, ColumnSpec], ColumnSpec | None]:
    """Return the channels to read and the time column, every unit settled."""
    clock = _time_column(table, time)
    if columns is None:
        beside = {clock.column, table.date_column} if clock else set()
        named = [c for c in table.columns if c not in table.unnamed and c not in beside]
        specs = {c: ColumnSpec(c) for c in named}
    else:
        specs = as_headed(table.columns, {name: _spec(v) for name, v in columns.items()})
        clocks = {c for c in table.columns if is_time_name(table, c)}
        taken = {spec.column for spec in specs.values()} | ({clock.column} if clock else set())
        for name, spec in specs.items():
            table.require(spec.column, name, taken | clocks)
    return {name: _with_unit(table, name, spec) for name, spec in specs.items()}, clock


def as_headed(columns: Sequence[str], specs: Mapping[str, ColumnSpec]) -> dict[str, ColumnSpec]:
    """The specs, each with its column as the file's header has it.

    A column `F` that the file does not have is the one called `F [N]`, `F / N` or `F in N`, where
    there is one alone and no other channel is read from it.
    """
    taken = {spec.column for spec in specs.values()}
    headed: dict[str, list[str]] = {}
    for column in columns:
        found = header_unit(column)
        if found is not None and found.is_sure:
            headed.setdefault(found.stem.strip(), []).append(column)
    out = {}
    for name, spec in specs.items():
        near = headed.get(spec.column, []) if spec.column not in columns else []
        is_one = len(near) == 1 and near[0] not in taken
        out[name] = spec._replace(column=near[0]) if is_one else spec
    return out


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
    unit, target = (*parts[1:], None, None)[:2]
    return ColumnSpec(parts[0], unit, target)


def _with_unit(table: Table, name: str, spec: ColumnSpec) -> ColumnSpec:
    unit, origin = spec.unit, "given"
    try:
        if unit is None:
            unit, origin = _read_unit(table, name, spec)
        elif spec.target is not None:
            written = written_unit(unit)
            fits = _measures(written, spec.target)
            unit = unit if fits else settled(written, spec.target) or unit
        to_si([], unit, spec.target)
    except UnitError as error:
        raise UnitError(
            f"{table.path.name}: channel {name} from column {spec.column!r}: {error}"
        ) from None
    return ColumnSpec(spec.column, unit, spec.target, origin)


def _measures(found: HeaderUnit, target: str) -> bool:
    """Whether a unit, as it is usually read, has the target's dimension."""
    return found.unit is not None and same_dimension(found.unit, target)


def _read_unit(table: Table, name: str, spec: ColumnSpec) -> tuple[str, str]:
    """The unit of a column, and where it was read."""
    found, target = unit_of_column(table, spec.column), spec.target
    origin = "from the file's units" if spec.column in table.units else "from its name"
    if found is not None and target is not None and not _measures(found, target):
        one = settled(found, target)
        if one is not None:
            return one, f"{origin}, the reading of {found.text!r} that fits"
    if found is not None and found.unit is not None:
        if found.is_sure or target is None or _measures(found, target):
            return found.unit, origin
    if found is not None and found.unit is None and found.why:
        example, signal = likely_reading(found.text), "SIGNAL" if name == spec.column else name
        likely = example is not None and (target is None or same_dimension(example, target))
        shown = example if likely else "UNIT"
        raise UnitError(
            f"unit {found.text!r} is ambiguous: {found.text!r} may mean {found.why}. Write which, "
            f"as in {shell_option('--map', f'{signal}={spec.column}:{shown}')}."
        )
    if found is not None and found.unit is None and target is not None:
        raise UnitError(
            f"the file's unit {found.text!r} is not in the list of units. Give the unit, as in "
            f"{shell_option('--map', f'{name}={spec.column}:{target}')}."
        )
    if target is not None:
        if ending := name_ending(as_written(spec.column), target):
            if not ending.is_doubtful:
                return ending.units[0], "from its name"
            units = ending.units
            ways = [shell_option("--map", f"{name}={spec.column}:{u}") for u in (*units, target)]
            raise UnitError(
                f"{ending.text!r} at the end of its name may mean {' or '.join(units)}, or be part "
                f"of the name of a signal in {target}. Write which, as in {' or '.join(ways)}."
            )
        return target, "the model's: the file names none"
    return "1", "the file names none" if found is None else f"{found.text!r} is no unit"


# ---------------------------------------------------------------------- the clock


def clock_and_unit(text: str) -> tuple[str, str | None]:
    """`column`, `column:unit` or `column:hh:mm`, taken apart."""
    for written in sorted(CLOCK_FORMATS, key=len, reverse=True):
        if text.endswith(f":{written}"):
            return text.removesuffix(f":{written}").strip(), written
    column, colon, unit = text.rpartition(":")
    return (column.strip(), unit.strip()) if colon else (text.strip(), None)


def _clock_spec(table: Table, time: ColumnSpec | str | Sequence[str | None]) -> ColumnSpec:
    if isinstance(time, str) and time not in table.columns:
        return ColumnSpec(*clock_and_unit(time))
    return _spec(time)


def _time_column(table: Table, time: Time) -> ColumnSpec | None:
    if time is not None:
        spec = as_headed(table.columns, {"t": _clock_spec(table, time)})["t"]
        table.require(spec.column, "t")
        pair = _date_and_clock(table)
        if pair is not None and pair[1] == spec.column:
            table.date_column = pair[0]
        if spec.unit in CLOCK_FORMATS:
            return spec._replace(target="s", origin="given")
        unit = spec.unit or time_unit(table, spec.column)
        if unit is not None and not _is_days(unit):
            try:
                to_si([], unit, "s")
            except UnitError as error:
                raise UnitError(
                    f"{table.path.name}: channel t from column {spec.column!r}: {error}"
                ) from None
        return ColumnSpec(spec.column, unit, "s", "given")
    named = [c for c in table.columns if is_time_name(table, c)]
    pair = _date_and_clock(table)
    if pair is not None and pair[1] not in named[:1]:
        named = [pair[1], *named]
    if pair is not None:
        table.date_column = pair[0]
        named = [c for c in named if c != pair[0]]
    if not named:
        named = [c for c in table.columns if c not in table.units and is_dated(table, c)]
        named = named if len(named) == 1 else []
    for is_clock in (_holds_time, _is_unit_of_time, _is_abscissa_in_time):
        if not named:
            named = [c for c in table.columns if is_clock(table, c)]
            named = named if len(named) == 1 else []
    if not named:
        return None
    table.clocks = tuple(named)
    return ColumnSpec(named[0], time_unit(table, named[0]), "s", "found by its name")


def time_unit(table: Table, column: str) -> str | None:
    """The unit of time that the file names for a column, None where it names none."""
    found = unit_of_column(table, column)
    if (
        found is not None
        and found.unit is not None
        and (_is_time(found.unit) and found.unit != "1")
    ):
        return found.unit
    _, unit = _time_ending(column)
    return unit or _UNIT_NAMES.get(column.strip().casefold())


def is_time_name(table: Table, column: str) -> bool:
    """Whether a column is called time, in one of the ways of `_TIME_NAMES`."""
    found = unit_of_column(table, column)
    text = as_written(column)
    if found is not None and found.is_sure and column not in table.units:
        stem = found.stem
        if found.unit is None or not (_is_time(found.unit) or found.unit == "1"):
            if not _is_days(found.text) and not re.search("hh|mm:|yy|jj|utc", found.text, re.I):
                return False
    else:
        bracket = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]", text)
        stem = bracket[1] if bracket and re.search("hh|mm:|yy|jj|utc|d", bracket[2], re.I) else text
        stem = _time_ending(stem)[0]
    name = re.sub(r"[\s_\-/.,:]+", " ", stem).strip().casefold()
    return name in _TIME_NAMES


def _holds_time(table: Table, column: str) -> bool:
    """Whether the word time is part of a name: `sim_time [s]`, `Zeit seit Start`."""
    found = unit_of_column(table, column)
    stem = found.stem if found is not None and found.unit is not None else column
    is_time = found is None or found.unit is None or _is_time(found.unit)
    words = re.split(r"[\W_]+", stem.casefold())
    return is_time and bool({"time", "zeit", "timestamp"} & set(words))


def _is_unit_of_time(_: Table, column: str) -> bool:
    """Whether a column is called by a unit of time alone: `ms`, `sec`."""
    return column.strip().casefold() in _UNIT_NAMES


def _is_abscissa_in_time(table: Table, column: str) -> bool:
    """Whether a column is the axis of an oscilloscope's plot and in a unit of time."""
    found = unit_of_column(table, column)
    if found is None or found.unit in {None, "1"} or not found.is_sure:
        return False
    name = re.sub(r"[\s_\-]+", " ", found.stem).strip().casefold()
    return name in _ABSCISSAS and _is_time(found.unit)


def _date_and_clock(table: Table) -> tuple[str, str] | None:
    """A column of dates and one of times of day, where a file has both."""

    def of(names: frozenset[str], pattern: str) -> list[str]:
        found = [c for c in table.columns if re.sub(r"\W.*", "", c).casefold() in names]
        cells = {c: table.sample(c) for c in found}
        return [c for c, v in cells.items() if v and all(re.search(pattern, x) for x in v)]

    dates = of(_DATE_NAMES, r"^\d{1,4}[-./ ]\w+\.?[-./ ]\d{1,4}(?:[T ]00:00:00)?$")
    clocks = of(_CLOCK_NAMES, r"^\d{1,2}:\d{2}")
    return (dates[0], clocks[0]) if len(dates) == 1 and len(clocks) == 1 else None


def is_dated(table: Table, column: str) -> bool:
    """Whether the first cells of a column are dates or times of day."""
    cells = table.sample(column)
    return bool(cells) and all(is_date(c) for c in cells)


def _is_days(unit: str) -> bool:
    return unit in {"d", "day", "days", "Tage"}


def _is_time(unit: str) -> bool:
    try:
        return parse_unit(unit).dimension == parse_unit("s").dimension
    except UnitError:
        return False


def _time_ending(column: str) -> tuple[str, str | None]:
    """A name and the unit of time at its end: `t_ms`, `Time h`, `TimeUS`, `timeMillis`."""
    apart = re.fullmatch(r"(.*\w)(?:_|,? )(\w+)", column)
    if apart and apart[2].casefold() in _UNIT_ENDINGS:
        return apart[1], _UNIT_ENDINGS[apart[2].casefold()]
    capital = re.fullmatch(
        r"(.*?[a-z])([MUN]?[Ss]|Millis|Micros|Nanos|Seconds|Minutes|Hours)", column
    )
    if capital and capital[2] != "s":
        return capital[1], _UNIT_ENDINGS[capital[2].casefold()]
    return column, None
