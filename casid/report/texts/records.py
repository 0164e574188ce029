"""Records and checks of records as documents."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.data.channel_quality import ChannelCheck
from casid.data.findings import Finding
from casid.data.fir_filter import FirFilter
from casid.data.quality import CheckReport
from casid.data.record import Record
from casid.model.quantities import quantity_text
from casid.model.units import difference_from_si, from_si, to_si
from casid.report.document import Document, Labelled, Table


def check_document(found: CheckReport) -> Document:
    """Clock and channels of a record, and the findings."""
    parts: list[str | Labelled | Table] = []
    if found.N is not None and found.Ts is not None:
        text = (
            f"{found.N}, every Ts = {found.Ts:.6g} s ({1 / found.Ts:.6g} Hz), "
            f"{_duration_text(found.duration)} from t0 = {found.t0:.9g} s"
        )
        if found.t_last is not None:
            text += f", the last at {found.t_last:.9g} s"
        parts.append(("samples", text))
    if found.clock:
        c = found.clock
        text = (
            f"min {c.interval_min:.6g}, median {c.interval_median:.6g}, max {c.interval_max:.6g} "
            f"s; {100 * c.share_outside:.3g} % outside 1 % of the median"
        )
        parts.append(("intervals", text))
    if found.channels:
        head = "channel,unit,min,max,mean,rms,noise,step,run,band [Hz]".split(",")
        parts.append(Table(head, [_row(c) for c in found.channels], numbers=range(2, 10)))
    parts.append("  findings" if found.findings else "  findings   none")
    parts += [f"    {text}" for text in _findings(found.findings)]
    return Document(f"Check of {found.name}", parts, label=11)


def _duration_text(seconds: float | None) -> str:
    """Seconds, and beside them minutes, hours or days where there are many."""
    if seconds is None:
        return "no length"
    plain, read = f"{seconds:.6g} s", quantity_text(seconds, "s")
    return plain if read.endswith(" s") else f"{plain} ({read})"


def _row(c: ChannelCheck) -> tuple[str, ...]:
    """The numbers of a channel in the unit of the file; an rms about the zero of that unit."""
    unit, rms = c.shown_in, None
    zero = float(to_si(0.0, unit)) if unit != c.unit else 0.0
    if c.rms is not None and c.mean is not None:
        rms = math.sqrt(max(c.rms**2 - 2 * zero * c.mean + zero**2, 0.0))
    values = (
        None if x is None else float(from_si(x, unit)) for x in (c.minimum, c.maximum, c.mean)
    )
    steps = (
        None if x is None else float(difference_from_si(x, unit)) for x in (rms, c.noise, c.step)
    )
    numbers = map(_number, [*values, *steps])
    return (c.name, unit, *numbers, str(c.longest_run), _number(c.bandwidth_hz))


def _findings(findings: Sequence[Finding]) -> list[str]:
    """The findings as text, one of several channels where they are the same of each."""
    same: dict[tuple[str, str, str], list[Finding]] = {}
    for f in findings:
        same.setdefault((f.severity, f.text, f.remedy), []).append(f)
    return [
        str(replace(alike[0], channel=", ".join(f.channel for f in alike if f.channel) or None))
        for alike in same.values()
    ]


def _number(x: float | None) -> str:
    return "--" if x is None else f"{x:.4g}"


def record_document(record: Record) -> Document:
    """Samples, clock, channels and history of a record."""
    end = record.t0 + (record.N - 1) * record.Ts
    head = ("channel", "unit", "min", "max", "mean", "std", "missing")
    return Document(
        f"Record {record.name}",
        [
            ("samples", f"{record.N}, every Ts = {record.Ts:.6g} s ({1 / record.Ts:.6g} Hz)"),
            ("clock", f"{record.t0:g} to {end:g} s"),
            Table(head, _statistics(record), numbers=range(2, 7)),
            "  history",
            *(f"    {step}" for step in record.provenance or ("none",)),
        ],
    )


def _statistics(record: Record) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for channel, values in record.channels.items():
        mask = record.is_missing(channel)
        kept = values[~mask]
        numbers = ["--"] * 4
        if kept.size:
            numbers = [f"{x:.5g}" for x in (kept.min(), kept.max(), kept.mean(), kept.std())]
        rows.append((channel, record.units[channel], *numbers, str(int(mask.sum()))))
    return rows


def filter_document(fir: FirFilter, frequencies_hz: Sequence[float] = ()) -> Document:
    """The design, and the gain at DC, at given frequencies, and where it halves."""
    gains = [("gain at DC", f"{float(fir.gain(0.0)):.9f}")]
    gains += [(f"gain at {f:g} Hz", f"{float(fir.gain(f)):.4f}") for f in frequencies_hz]
    grid = np.linspace(0.0, 0.5 / fir.Ts, 4001)
    below = np.flatnonzero(fir.gain(grid) < 0.5)
    if below.size:
        gains.append(("gain 0.5 at", f"{grid[below[0]]:.4g} Hz"))
    title = f"{fir.design}; {fir.taps.size} taps, Ts = {fir.Ts:g} s, zero phase"
    return Document(title, gains, label=16)
