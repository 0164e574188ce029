"""What a file of measurements holds: its columns as channels with names, units and signals."""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from casid.arrays import FloatArray
from casid.data.held_signals import is_held, is_switched
from casid.data.reading.clocks.unit_of_time import is_open
from casid.data.reading.columns import ColumnSpec
from casid.data.reading.faults import ColumnSurvey, Survey
from casid.data.reading.file_format import FileFormat
from casid.data.reading.header_units import header_unit, likely_reading
from casid.data.reading.sources import source_of
from casid.data.reading.survey import ReadingOptions, survey
from casid.data.record import Record
from casid.errors import DataError, nearest
from casid.model.quantities import window_text
from casid.model.unit_names import ALIASES
from casid.model.units import parse_unit

_COUNTING = 0.99  # of the steps of a column that counts rows, at least, are the same; heuristic
_COPY = 1e-6  # of its largest deviation: a column of seven digits computed from another; heuristic
_NO_NAMES = {*keyword.kwlist, "m", "t", "casid", "ca", "problem"}  # of a problem file's own
_WHY = {"empty": "it is empty", "text": "it holds no numbers", "time": "it holds times"}
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue"})


@dataclass(frozen=True, slots=True, eq=False)
class FileChannel:
    """A column of numbers.

    Attributes
    ----------
    name : an identifier made of the column's name without its unit.
    unit : in which the file is written; None where the file does not say.
    values : (N,) samples, SI units; missing ones joined by straight lines.
    doubt : what is not sure about the unit; empty where the file says it in one way.
    """

    name: str
    column: str
    unit: str | None
    values: FloatArray
    doubt: str = "the file gives no unit"

    @property
    def words(self) -> tuple[str, ...]:
        """The words of the column's name, in small ASCII letters."""
        stem = ascii_text(stem_of(self.column))
        text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", stem)
        return tuple(re.findall(r"[a-z]+", text.lower()))

    def in_unit(self, unit: str) -> FileChannel:
        """The column with its values read in this unit; an empty one changes nothing."""
        if not unit:
            return self
        parsed = parse_unit(unit)
        return replace(self, unit=unit, values=self.values * parsed.factor + parsed.offset)

    def is_copy_of(self, other: FileChannel) -> bool:
        """True if it is a straight line of another channel that moves, but for rounding."""
        x, y = (c.values - c.values.mean() for c in (other, self))
        if not (x.any() and y.any()):
            return False
        slope = float(x @ y) / float(x @ x)
        return bool(np.abs(y - slope * x).max() <= _COPY * np.abs(y).max())

    @property
    def is_constant(self) -> bool:
        """True if all samples are the same."""
        return bool(np.ptp(self.values) == 0.0)

    @property
    def is_switched(self) -> bool:
        """True for a command that is on or off, 0 or 1: no sensor adds noise to it."""
        return is_switched(self.values)

    @property
    def step_of_count(self) -> float | None:
        """The step of whole numbers without a unit that count rows; None for measurements."""
        steps = np.diff(self.values)
        usual = float(np.median(steps)) if steps.size else 0.0
        is_whole = usual != 0.0 and bool(np.all(self.values == np.round(self.values)))
        if self.unit is not None or not is_whole or np.mean(steps == usual) <= _COUNTING:
            return None
        return usual

    @property
    def is_held(self) -> bool:
        """True for a signal of steps: most samples repeat the one before."""
        return is_held(self.values)


class FileChannels(NamedTuple):
    """A file looked through: its channels, its clock, and what was left out.

    Attributes
    ----------
    time : column of the time stamps; None where the sample time was given.
    left_out : columns that are no channels -> why.
    form : how the file is written, where it leaves it open.
    resampled : sample time [s] where the clock is too uneven for the commands that estimate.
    spoilt : columns left out that hold numbers, and text in some cells.
    time_unit : of the time stamps, where it is given.
    time_doubt : what was assumed of a clock whose unit the file does not name.
    """

    path: Path
    window: tuple[float, float] | None
    channels: tuple[FileChannel, ...]
    time: str | None
    Ts: float
    N: int
    left_out: Mapping[str, str]
    resampled: float | None = None
    form: FileFormat | None = None
    spoilt: tuple[str, ...] = ()
    time_unit: str | None = None
    time_doubt: str = ""

    @property
    def source(self) -> str:
        """The file and its window, as a command takes them."""
        if self.window is None:
            return str(self.path)
        return f"{self.path}@{window_text(*self.window)}"

    def in_units(self, units: Mapping[str, str]) -> FileChannels:
        """The table with its columns in the units that their values fit.

        Parameters
        ----------
        units : column -> unit; empty for one that stays as it is.
        """
        return self._replace(
            channels=tuple(c.in_unit(units.get(c.column, "")) for c in self.channels)
        )

    def without_copies(self, named: Collection[str]) -> FileChannels:
        """The table without columns that are a linear function of another column.

        As further inputs they would have gains that nothing separates. A column that the user
        named stays, then one with a unit, then the first of the file.
        """
        order = sorted(self.channels, key=lambda c: (c.column not in named, c.unit is None))
        kept: list[FileChannel] = []
        left_out = dict(self.left_out)
        for c in order:
            of = next((k for k in kept if c.column not in named and c.is_copy_of(k)), None)
            if of is None:
                kept.append(c)
            else:
                left_out[c.column] = f"it is {of.column!r} on another scale"
        channels = tuple(c for c in self.channels if c in kept)
        return self._replace(channels=channels, left_out=left_out)

    def column(self, column: str, signal: str) -> FileChannel:
        """The channel of a column that is to be `signal`.

        Raises
        ------
        DataError
            If there is none, naming the nearest.
        """
        for channel in self.channels:
            if channel.column == column:
                return channel
        why = self.left_out.get(column)
        if why is None and column == self.time:
            why = "it holds the time stamps"
        if why is not None:
            raise DataError(
                f"{self.path.name}: column {column!r} cannot be {signal}: {why}; map another column"
            )
        raise DataError(
            f"{self.path.name}: no column {column!r} for {signal}"
            f"{nearest(column, [c.column for c in self.channels])}"
        )


def file_channels(
    source: str | Path,
    time: str | ColumnSpec | None = None,
    units: Iterable[tuple[str, str]] = (),
    form: FileFormat | None = None,
) -> FileChannels:
    """Look through a file: every column of numbers, its unit, and the sample time.

    Parameters
    ----------
    source : path, perhaps with a window: `run.csv@12:194`.
    time : column of the time stamps; found by its name where not given.
    units : pairs of a column and the unit in which it is written, where the header does not say.
    form : how the file is written, where it leaves it open.

    Raises
    ------
    DataError
        If the file cannot be read, has no time stamps or no column of numbers.
    """
    path, window = source_of(source)
    columns = survey(path, {}, ReadingOptions(time=time, window=window, form=form))
    if columns.times is None and columns.clock is None and columns.columns:
        raise DataError(
            f"{path.name}: no time column found among "
            f"{', '.join(c.name for c in columns.columns)}. Name it with --map t=COLUMN "
            "(mapping={'t': column}), or give the sample time with --sample-time TS."
        )
    unusable = [f for f in columns.faults if f.kind in {"file", "unit", "length", "window"}]
    if unusable or columns.times is None:
        raise DataError(str((unusable or columns.faults)[0]))
    given = dict(units)
    numeric = {c.name: c for c in columns.columns if c.kind == "numeric"}
    units_of = {n: c.unit or likely_reading(c.written) for n, c in numeric.items()} | given
    specs = {column: ColumnSpec(column, unit or "1") for column, unit in units_of.items()}
    given_unit = time.unit if isinstance(time, ColumnSpec) and columns.clock else None
    clock = (columns.clock, given_unit) if columns.clock and given_unit else columns.clock
    options = ReadingOptions(clock, window, mark_missing=True, form=form)
    record, resampled = _record(path, specs, columns, options)
    spoilt = {c.name: c.remarks[0] for c in columns.columns if c.kind == "text" and c.remarks}
    left_out = {
        c.name: f"it {spoilt[c.name]}" if c.name in spoilt else _WHY[c.kind]
        for c in columns.columns
        if c.name not in units_of
    }
    left_out.pop(columns.clock or "", None)
    doubts = {c: "" if c in given else _doubt(numeric[c]) for c in units_of}
    channels = _channels(record, units_of, doubts, left_out)
    return FileChannels(
        path=path,
        window=window,
        channels=channels,
        time=columns.clock,
        Ts=record.Ts,
        N=record.N,
        left_out=left_out,
        resampled=resampled,
        form=form,
        spoilt=tuple(spoilt),
        time_unit=given_unit,
        time_doubt=_time_doubt(columns),
    )


def _channels(
    record: Record,
    units_of: Mapping[str, str | None],
    doubts: Mapping[str, str],
    left_out: dict[str, str],
) -> tuple[FileChannel, ...]:
    """The channels that have values; the others are added to `left_out`."""
    channels: list[FileChannel] = []
    for column, unit in units_of.items():
        if record.is_missing(column).all():
            left_out[column] = "it holds no values in this window"
            continue
        name = free_name(identifier(stem_of(column)), {c.name for c in channels})
        known = ALIASES.get(unit, unit) if unit is not None else None
        channel = FileChannel(name, column, known, record.filled(column), doubts[column])
        if (step := channel.step_of_count) is not None:
            left_out[column] = (
                f"it counts rows, in steps of {step:g} (with its unit behind it, {column}:UNIT, it "
                "is a signal)"
            )
            continue
        channels.append(channel)
    return tuple(channels)


def _time_doubt(columns: Survey) -> str:
    """What was assumed of the unit of time, and how to write another one behind the column."""
    said = [*columns.notes, *(fault.text for fault in columns.doubts)]
    if not any(is_open(text) for text in said):
        return ""
    return "the file names no unit of time: read in seconds; COLUMN:h is hours, :ms milliseconds"


def _doubt(column: ColumnSurvey) -> str:
    """What is not sure about the unit of a column, as the file has it."""
    if column.unit is not None:
        return ""
    if not column.written:
        return "the file gives no unit"
    if likely_reading(column.written) is not None:
        return f"the file's unit {column.written!r} is ambiguous"
    return f"the file's unit {column.written!r} cannot be read"


def _record(
    path: Path, specs: Mapping[str, ColumnSpec], columns: Survey, options: ReadingOptions
) -> tuple[Record, float | None]:
    """The record, interpolated where its clock is uneven: good enough to guess from.

    With it the sample time where the commands that estimate need it interpolated, too.
    """
    if not specs:
        raise DataError(
            f"{path.name}: no column of numbers beside the time stamps. "
            "Give a file with measurements."
        )
    assert columns.times is not None
    found = survey(path, specs, options, describe=False)
    if found.record is not None:
        return found.record, None
    # As the commands read it: on an even clock, from which rows may be absent.
    spread = survey(path, specs, replace(options, takes_gaps=True), describe=False).record
    if spread is not None and spread.N == columns.times.size:
        return spread, None
    step = float(np.median(np.diff(columns.times)))
    found = survey(path, specs, replace(options, resample=step), describe=False)
    if found.record is None:
        raise DataError(str(found.faults[0]))
    return found.record, None if spread is not None else step


def stem_of(column: str) -> str:
    """A column's name without the unit at its end: `U_Mot (V)` gives `U_Mot`."""
    found = header_unit(column)
    return found.stem.strip() if found is not None and found.stem.strip() else column


def ascii_text(text: str) -> str:
    """Letters without their accents: `Öl` gives `Oel`."""
    folded = unicodedata.normalize("NFKD", text.translate(_UMLAUTS).replace("ß", "ss"))
    return folded.encode("ascii", "ignore").decode()


def identifier(text: str) -> str:
    """A Python name made of any text."""
    name = re.sub(r"\W+", "_", ascii_text(text)).strip("_")
    if not name or name[0].isdigit():
        name = f"x_{name}".rstrip("_")
    return f"{name}_" if name in _NO_NAMES else name


def free_name(wanted: str, taken: Iterable[str]) -> str:
    """`wanted`, or `wanted` with a number where the name is taken."""
    names, name, n = set(taken), wanted, 2
    while name in names:
        name, n = f"{wanted}_{n}", n + 1
    return name
