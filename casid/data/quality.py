"""What a record is worth before anything is estimated from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import FloatArray
from casid.data.channel_quality import ChannelCheck, channel_quality
from casid.data.findings import Finding
from casid.data.reading.clocks.even_clock import UNIFORM
from casid.data.reading.columns import Columns, ColumnSpec
from casid.data.reading.faults import ColumnSurvey, Survey
from casid.data.reading.file_format import FileFormat
from casid.data.reading.header_units import likely_reading
from casid.data.reading.survey import ReadingOptions, survey
from casid.data.record import Record
from casid.model.quantities import count_text
from casid.presentation import Presented

SCHEMA = "casid.check/1"


@dataclass(frozen=True, slots=True)
class Clock:
    """The time stamps: intervals [s], share outside 1 % of the median, and the largest distance
    of a stamp from the uniform grid [s]."""

    interval_min: float
    interval_median: float
    interval_max: float
    share_outside: float
    off_grid: float


@dataclass(frozen=True, slots=True, eq=False)
class CheckReport(Presented):
    """What `check` found; `str` is the report, `to_json` a dict.

    Attributes
    ----------
    N, Ts, t0, duration : samples, sample time [s], first instant and length [s] of the record; None
        where the file has no usable clock.
    clock : how even the time stamps are; None without any.
    channels : range, unit, resolution and missing samples of each.
    findings : what speaks against using it, each with a severity, a place and a remedy.
    t_last : the last stamp of the file [s], or the last sample where it was resampled.
    """

    name: str
    N: int | None
    Ts: float | None
    t0: float | None
    duration: float | None
    clock: Clock | None
    channels: tuple[ChannelCheck, ...]
    findings: tuple[Finding, ...]
    provenance: tuple[str, ...] = ()
    t_last: float | None = None

    @property
    def is_usable(self) -> bool:
        """True where no finding is an error."""
        return all(f.severity != "error" for f in self.findings)

    def to_json(self) -> dict[str, Any]:
        """Return the report as a dict of plain values, schema `casid.check/1`."""
        return {
            "schema": SCHEMA,
            "name": self.name,
            "usable": self.is_usable,
            "N": self.N,
            "Ts_s": self.Ts,
            "t0_s": self.t0,
            "duration_s": self.duration,
            "clock": asdict(self.clock) if self.clock else None,
            "channels": [asdict(c) for c in self.channels],
            "findings": [f.to_json() for f in self.findings],
            "provenance": list(self.provenance),
        }

    def __repr__(self) -> str:
        counts = [
            count_text(sum(f.severity == s for f in self.findings), s)
            for s in ("error", "warning", "note")
        ]
        return f"<CheckReport {self.name}: {', '.join(counts)}>"


@names_wrong_types()
def check(
    data: Record | str | Path,
    columns: Columns | None = None,
    *,
    time: str | ColumnSpec | None = None,
    window: tuple[float, float] | None = None,
    resample: float | None = None,
    Ts: float | None = None,
    form: FileFormat | None = None,
) -> CheckReport:
    """Look a record or a file over and report everything found, not only the first fault.

    Parameters
    ----------
    data : Record, or path of a file (which may carry a window, `run.csv@12:194`)
    columns, time, window, resample, Ts, form
        As `casid.read_record`; for files only.

    Returns
    -------
    CheckReport
        Faults of the file are findings of severity "error"; nothing is raised for them.

    Raises
    ------
    DataError
        If an option itself cannot be read.

    Notes
    -----
    The thresholds are heuristics, chosen so that each finding is worth a look: a plateau is four
    equal samples at an extreme, reached by more than one quantisation step; a spike stands off the
    median of its five neighbours by eight robust standard deviations and five times the 98 %
    quantile of that distance.

    Example
    -------
    >>> import casid
    >>> import numpy as np
    >>> clipped = np.clip(np.sin(0.1 * np.arange(400)), -1.0, 0.5)
    >>> casid.check(casid.Record({"phi": clipped}, {"phi": "rad"}, Ts=0.1, name="roll"))
    <CheckReport roll: 0 errors, 1 warning, 0 notes>
    """
    if isinstance(data, Record):
        found = _Read(data, data.name)
    else:
        options = ReadingOptions(time, window, resample=resample, Ts=Ts, form=form, takes_gaps=True)
        found = _read_file(data, columns, options)
    record, name, times, findings = found.record, found.name, found.times, list(found.findings)
    clock = _clock(times) if times is not None and times.size > 1 else None
    if record is None:
        return CheckReport(name, None, None, None, None, clock, (), tuple(findings))
    is_whole = times is not None and times.size == record.N
    if clock and is_whole and clock.off_grid > 0.5 * record.Ts and resample is None:
        findings.append(_drifting(clock))
    channels, noticed = _channels(record, found.units)
    findings += [*noticed, *_twins(record)]
    return CheckReport(
        name,
        record.N,
        record.Ts,
        record.t0,
        record.duration,
        clock,
        channels,
        tuple(sorted(findings, key=lambda f: _RANK[f.severity])),
        record.provenance,
        float(record.t[-1] if times is None or resample is not None else times[-1]),
    )


_RANK = {"error": 0, "warning": 1, "note": 2}


def _clock(times: FloatArray) -> Clock:
    intervals = np.diff(times)
    median = float(np.median(intervals))
    outside = np.abs(intervals - median) > UNIFORM * abs(median) * (1 + 1e-9)
    grid = np.linspace(times[0], times[-1], times.size)
    return Clock(
        float(intervals.min()),
        median,
        float(intervals.max()),
        float(outside.mean()),
        float(np.abs(times - grid).max()),
    )


@dataclass(frozen=True, slots=True)
class _Read:
    """What there is to look over; the time stamps [s] and findings of a file."""

    record: Record | None
    name: str
    times: FloatArray | None = None
    findings: tuple[Finding, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)  # channel -> unit in the file


def _read(found: Survey) -> _Read:
    faults = [Finding("error", f.column, f.text, f.remedy) for f in found.faults]
    faults += [Finding("warning", f.column, f.text, f.remedy) for f in found.doubts]
    faults += [Finding("note", None, f"{note}.", "") for note in found.notes]
    name = found.record.name if found.record else found.path.name
    return _Read(found.record, name, found.times, tuple(faults), found.units)


def _read_file(data: str | Path, columns: Columns | None, options: ReadingOptions) -> _Read:
    """A file looked over; a unit of two readings keeps no number from being judged."""
    found = survey(data, columns, options)
    if columns is not None:
        return _read(found)
    is_refused = any(f.kind == "unit" for f in found.faults)
    described = survey(data, {}, options) if is_refused else found
    numeric = [c for c in described.columns if c.kind == "numeric"]
    unclear = [c for c in numeric if c.unit is None and c.written]
    if not is_refused:
        read = _read(found)
        return replace(read, findings=(*read.findings, *(_unclear_unit(c, "1") for c in unclear)))
    spoilt = [c for c in described.columns if c.kind == "text" and c.remarks]  # numbers, and text
    taken = {c.name: c.unit or likely_reading(c.written) or "1" for c in (*numeric, *spoilt)}
    again = _read(survey(data, {name: ColumnSpec(name, u) for name, u in taken.items()}, options))
    doubts = [_unclear_unit(c, taken[c.name]) for c in unclear]
    return replace(again, findings=(*doubts, *again.findings))


def _unclear_unit(column: ColumnSurvey, taken: str) -> Finding:
    why = column.doubt or "its unit is not clear"
    as_what = "numbers as written" if taken == "1" else f"here taken as {taken}"
    return Finding(
        "warning",
        column.name,
        f"{why}; {as_what}.",
        f"A model's signal needs it, as in --map 'SIGNAL={column.name}:"
        f"{'UNIT' if taken == '1' else taken}'.",
    )


def _drifting(clock: Clock) -> Finding:
    return Finding(
        "warning",
        None,
        f"the clock drifts: a stamp lies {clock.off_grid:.4g} s off the uniform grid.",
        f"Resample onto Ts = {clock.interval_median:.6g} s, or use a shorter window.",
    )


def _channels(
    record: Record, written: Mapping[str, str]
) -> tuple[tuple[ChannelCheck, ...], list[Finding]]:
    """The numbers of every channel, and what is noticed of them."""
    found = [channel_quality(record, name, written.get(name, "")) for name in record.names]
    return tuple(numbers for numbers, _ in found), [f for _, noticed in found for f in noticed]


def _twins(record: Record) -> list[Finding]:
    constant = set(record.constant_channels())
    names = [n for n in record.names if n not in constant]
    seen: dict[bytes, str] = {}
    findings = []
    for name in names:
        key = record[name].tobytes()
        if key in seen:
            findings.append(
                Finding(
                    "warning",
                    name,
                    f"holds the same samples as {seen[key]}.",
                    "Check the mapping: two channels cannot share one sensor.",
                )
            )
        seen.setdefault(key, name)
    return findings
