"""What the options of a command request: records, their windows and columns, known values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from casid.cli.output import taken
from casid.cli.reading_options import ReadingRequest
from casid.errors import DataError, nearest

if TYPE_CHECKING:
    from casid.data.experiment import Experiment
    from casid.data.problem import Problem
    from casid.data.record import Record

CLOCK_FORMATS = ("hh:mm:ss", "hh:mm", "mm:ss")  # how times of day are written, for a unit
TIME = "t"  # --map t=column names the time column, where no channel has that name


class Mapping(NamedTuple):
    """`--map gyro=column` or `--map phi=roll:deg`: signal, column, unit of the column."""

    signal: str
    column: str
    unit: str | None

    @property
    def text(self) -> str:
        """`column` or `column:unit`, as a problem reads it."""
        return self.column if self.unit is None else f"{self.column}:{self.unit}"


def parse_mapping(text: str) -> Mapping:
    """Read `signal=column` or `signal=column:unit`.

    Raises
    ------
    DataError
        If a part is missing.
    """
    signal, equals, rest = text.partition("=")
    column, colon, unit = rest.rpartition(":") if ":" in rest else (rest, "", "")
    for written in CLOCK_FORMATS:  # t=Uhrzeit:hh:mm
        if rest.endswith(f":{written}"):
            column, unit = rest.removesuffix(f":{written}"), written
    parts = [signal.strip(), column.strip(), unit.strip()]
    if not equals or not all(parts[:2]) or (colon and not parts[2]):
        raise DataError(
            f"--map {text}: write it as signal=column or signal=column:unit, "
            "for example --map phi=roll:deg"
        )
    return Mapping(parts[0], parts[1], parts[2] or None)


def parse_setting(text: str, option: str = "--set") -> tuple[str, float]:
    """Read `name=value` of an option, a finite number in the unit that the model declares.

    Raises
    ------
    DataError
        If it is not.
    """
    name, equals, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not equals or not name.strip() or not math.isfinite(number):
        raise DataError(
            f"{option} {text}: write it as name=value with a finite number in the unit that "
            f"the model declares, for example {option} M=22.04"
        )
    return name.strip(), number


def names_in(text: str) -> list[str]:
    """The names of an option that takes several, separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


@dataclass(frozen=True, slots=True)
class Source:
    """One file named on the command line: load case, path and window [s]."""

    case: str | None
    path: Path
    window: tuple[float, float] | None

    def __str__(self) -> str:
        window = self.window
        if window is None:
            return str(self.path)
        return f"{self.path}@" + ":".join(f"{x:g}" if math.isfinite(x) else "" for x in window)


def source_of(text: str, common: tuple[float, float] | None = None) -> Source:
    """Read `case=path@start:stop`, the window by default the common one."""
    from casid.data.reading.sources import parse_case

    case, path, window = parse_case(text)
    return Source(case, path, window or common)


def refuse_overlap(sources: Sequence[Source]) -> None:
    """Refuse samples that are named twice: they would count twice, or be fitted and held out."""
    everything = (-math.inf, math.inf)
    for i, a in enumerate(sources):
        for b in sources[:i]:
            first, second = a.window or everything, b.window or everything
            overlap = max(first[0], second[0]) < min(first[1], second[1])
            if overlap and a.path.exists() and b.path.exists() and a.path.samefile(b.path):
                raise DataError(
                    f"{a.path} is given twice ({b} and {a}) with windows that overlap; name it "
                    "once, or give each its own window, for example run.csv@0:40 and run.csv@40:60"
                )


@dataclass(frozen=True, slots=True)
class Request:
    """The common options, read and checked against each other."""

    data: Sequence[str] = ()
    maps: Sequence[str] = ()
    settings: Sequence[str] = ()
    window: str | None = None
    hold_out: Sequence[str] = ()
    resample: float | None = None
    lowpass: float | None = None
    decimate: int = 1
    detrend: bool = False
    mapping: dict[str, Mapping] = field(default_factory=dict)
    reading: ReadingRequest = field(default_factory=ReadingRequest)

    def __post_init__(self) -> None:
        for text in self.maps:
            new = parse_mapping(text)
            old = self.mapping.get(new.signal)
            if old is not None:
                raise DataError(
                    f"--map names {new.signal!r} twice, from {old.column!r} and from "
                    f"{new.column!r}; keep one of them"
                )
            self.mapping[new.signal] = new
        if not self.data and not self.hold_out_files:
            for option, value in (
                ("--map", self.maps),
                ("--window", self.window),
                ("--resample", self.resample),
            ):
                if value:
                    raise DataError(
                        f"{option} belongs to a file, and none is given; name the data after the "
                        f"problem, or leave {option} out to use the problem's own example"
                    )

    @property
    def hold_out_files(self) -> list[str]:
        """What --hold-out names that is no number."""
        return [text for text in self.hold_out if not is_number(text)]

    def known(self, problem: Problem) -> dict[str, float]:
        """The values of --set, each a parameter of the problem that no load case contradicts."""
        out: dict[str, float] = {}
        names = list(problem.model.parameters)
        for text in self.settings:
            name, value = parse_setting(text)
            if name not in names:
                raise DataError(
                    f"--set {text}: problem {problem.name} has no parameter "
                    f"{name!r}{nearest(name, names)}"
                )
            model, parameter = problem.model, problem.model.parameters[name]
            lower, upper = (
                model.in_declared_units({name: end})[name]
                for end in (parameter.lower, parameter.upper)
            )
            if not lower <= value <= upper:
                raise DataError(
                    f"--set {text}: {value:g} lies outside the bounds of {name}, {lower:g} to "
                    f"{upper:g} {model.unit_of(name)}; give a value inside, in that unit, or widen "
                    "the bounds in the problem file"
                )
            if out.get(name, value) != value:
                raise DataError(
                    f"--set gives {name} twice, {out[name]:g} and {value:g}; keep one of them"
                )
            out[name] = value
        return out

    def prepare(self, record: Record) -> Record:
        """Low-pass, decimation, mean: in this order, on every record alike."""
        from casid.data import preparation

        if self.lowpass is not None:
            record = preparation.lowpass(record, self.lowpass)
        record = preparation.decimate(record, self.decimate)
        return preparation.detrend(record) if self.detrend else record

    def experiments(self, problem: Problem) -> tuple[list[Experiment], float | list[Experiment]]:
        """What is to be fitted and what is to be held out, read and prepared.

        Parameters
        ----------
        problem : with the values of --set known (`known_problem`).
        """
        from casid.data.reading.sources import parse_window

        window = parse_window(self.window) if self.window else None
        sources = [source_of(text, window) for text in self.data]
        aside = [source_of(text) for text in self.hold_out_files]
        share = self.share
        refuse_overlap([*sources, *aside])
        if sources:
            fitted = [self._read(problem, s) for s in sources]
        else:
            fitted = [replace(e, record=self.prepare(e.record)) for e in problem.examples()]
        return fitted, [self._read(problem, s) for s in aside] if aside else share

    @property
    def share(self) -> float:
        """What --hold-out gives as a number, 0 where it names files."""
        numbers = [float(text) for text in self.hold_out if is_number(text)]
        if len(self.hold_out) > 1 and numbers:
            raise DataError(
                f"--hold-out {' and '.join(self.hold_out)} contradict each other; give one share, "
                "or files"
            )
        if numbers and not 0.0 <= numbers[0] < 0.9:  # NaN is outside, too
            raise DataError(
                f"--hold-out {self.hold_out[0]}: a share of every record lies between 0 (fit "
                "everything) and 0.9, for example 0.3; or name a file"
            )
        return numbers[0] if numbers else 0.0

    def _read(self, problem: Problem, source: Source) -> Experiment:
        problem, mapping = with_time(problem, self.mapping)
        for text in self.settings:
            name, _ = parse_setting(text)
            if name in problem.load_cases.get(source.case or "", {}):
                raise DataError(
                    f"--set {text} contradicts load case {source.case!r}, which sets {name} too; "
                    "leave one of them out"
                )
        experiment = read_experiment(
            problem,
            source,
            {m.signal: m.text for m in mapping.values()},
            self.resample,
            self.reading,
        )
        return replace(experiment, record=self.prepare(experiment.record))


def request_of(given: dict[str, Any]) -> Request:
    """The common options of a command."""
    return Request(reading=taken(ReadingRequest, given), **given)


def read_experiment(
    problem: Problem,
    source: Source,
    mapping: dict[str, str],
    resample: float | None = None,
    reading: ReadingRequest | None = None,
) -> Experiment:
    """One record in the problem's channels, those beside the model's left out where they cannot be.

    Raises
    ------
    DataError
        As `Problem.read`, and for two channels of one column.
    """
    from casid.data.reading.columns import resolve
    from casid.data.reading.opening import open_table
    from casid.data.reading.several_clocks import on_one_clock
    from casid.diagnosis.evidence.records.recorded_channels import refuse_shared_columns

    reading = reading or ReadingRequest()
    form = reading.form if problem.form is None else problem.form.updated(reading.form)
    table = on_one_clock(open_table(source.path, form), problem.time)
    _, clock = resolve(table, {}, problem.time)
    problem = refuse_shared_columns(
        problem, mapping, table.columns, None if clock is None else clock.column
    )
    experiment = problem.read(
        source.path,
        mapping=mapping,
        window=source.window,
        case=source.case,
        resample=resample,
        form=form,
        mark_missing=reading.mark_missing,
        ignore=reading.ignore,
    )
    return _without_sparse_channels(problem, mapping, experiment)


def _without_sparse_channels(
    problem: Problem, mapping: dict[str, str], experiment: Experiment
) -> Experiment:
    """The experiment without channels beside the model's that lack samples the others have."""
    import numpy as np

    from casid.diagnosis.evidence.records.recorded_channels import left_out_by_clock

    record = experiment.record
    # Samples that no row of the file has do not count as holes of a slower clock; nor does the
    # further sample of a held input where two rows of the file lie in one sample.
    held = {n for n, entry in problem.model.inputs.items() if entry.hold == "zoh"}
    others = [n for n in record if n not in held] or list(record)
    empty = np.logical_and.reduce([record.is_missing(n) for n in others])
    specs = problem.columns(mapping)
    holes = {s.column: record.is_missing(n)[~empty] for n, s in specs.items() if n in record}
    fewer, notes = left_out_by_clock(problem, mapping, holes)
    if not notes:
        return experiment
    gone = [n for n in problem.recorded if n not in fewer.recorded]
    record = record.without(*gone)
    provenance = (*record.provenance[:-1], *notes)
    return replace(experiment, record=replace(record, provenance=provenance))


def with_time(problem: Problem, mapping: dict[str, Mapping]) -> tuple[Problem, dict[str, Mapping]]:
    """The problem with the time column of `--map t=column`, and the mapping without it."""
    model = problem.model
    if TIME not in mapping or TIME in {*model.inputs, *model.outputs, *problem.recorded}:
        return problem, mapping
    rest = {k: v for k, v in mapping.items() if k != TIME}
    return replace(problem, time=time_column(mapping[TIME])), rest


def time_column(mapping: Mapping) -> Any:
    """The time column of a mapping, as a problem takes it."""
    from casid.data.reading.columns import ColumnSpec

    return mapping.column if mapping.unit is None else ColumnSpec(mapping.column, mapping.unit)


def is_number(text: str) -> bool:
    """True if `text` reads as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
