"""The record: one uniformly sampled experiment."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casid.argument_types import methods_name_wrong_types
from casid.arrays import Array, BoolArray, FloatArray
from casid.data.record_methods import RecordMethods
from casid.errors import DataError, nearest
from casid.model.quantities import count_text, window_text
from casid.model.units import parse_unit, si_unit, to_si
from casid.pickling import PickledByFields
from casid.presentation import Presented


@methods_name_wrong_types()
@dataclass(frozen=True, slots=True, eq=False)
class Record(RecordMethods, Presented, PickledByFields):
    """One experiment, sampled uniformly; immutable, every change gives a new record.

    Attributes
    ----------
    channels : mapping of name to (N,) float64 array, SI units
        Copied on entry and made read-only.
    units : mapping of name to SI unit as text
    Ts : float
        Sample time [s].
    t0 : float
        Time of the first sample on the record's own clock [s].
    name : str
    missing : mapping of name to (N,) bool array
        True where the sample is to be ignored; a channel without a mask misses nothing. Samples
        that are not finite are allowed only where they are marked so.
    late : mapping of name to (N,) array
        By how much a sample was taken after its instant on the clock [s], where stamps run
        unevenly; a channel without was read at its instants. A held input stepped then.
    provenance : tuple of str
        One line of text a step: file with its sha256, unit conversions, filters, windows.
    clock : str
        Names the clock that `t` is read on. Windows of a record, or of a file, have it in common;
        a record that is made of arrays has one of its own.

    Raises
    ------
    DataError
        For channels of different lengths, fewer than two samples, samples that are not finite and
        not marked missing, or a sample time that is not positive.
    UnitError
        For a unit that cannot be read, or is not SI.

    Example
    -------
    >>> import casid
    >>> import numpy as np
    >>> roll = 0.1 * np.sin(0.2 * np.arange(400))
    >>> record = casid.Record({"phi": roll}, {"phi": "rad"}, Ts=0.1, name="roll")
    >>> record
    <Record roll: N = 400, 1 channel (phi), Ts = 0.1 s, 40 s long>
    >>> record.between(10.0, 30.0)
    <Record roll@10:30: N = 201, 1 channel (phi), Ts = 0.1 s, 20.1 s long>
    """

    channels: Mapping[str, FloatArray]
    units: Mapping[str, str]
    Ts: float
    t0: float = 0.0
    name: str = "record"
    missing: Mapping[str, BoolArray] = field(default_factory=dict)
    provenance: tuple[str, ...] = ()
    late: Mapping[str, FloatArray] = field(default_factory=dict)
    clock: str = ""

    def __post_init__(self) -> None:
        _check_clock(self.name, self.Ts, self.t0)
        if not self.channels:
            raise DataError(
                f"{self.name}: a record needs at least one channel. "
                "Give Record({'phi': values}, {'phi': 'rad'}, Ts=0.01)."
            )
        channels = {str(n): _column(self.name, str(n), v) for n, v in self.channels.items()}
        lengths = {n: v.size for n, v in channels.items()}
        if len(set(lengths.values())) > 1:
            raise DataError(
                f"{self.name}: channels differ in length: "
                f"{', '.join(f'{n} has {k}' for n, k in lengths.items())}. "
                "Cut them to the same samples, or resample them to one clock."
            )
        N = next(iter(lengths.values()))
        if N < 2:
            raise DataError(
                f"{self.name}: {count_text(N, 'sample')}; a record needs at least 2. "
                "Widen the window, or check that the file holds more than one row."
            )
        units = _checked_units(self.name, list(channels), self.units)
        missing = _checked_masks(self.name, channels, N, self.missing)
        late = _checked_lateness(self.name, channels, N, self.late)
        for channel, values in channels.items():
            _refuse_non_finite(self, channel, values, missing.get(channel))
        for array in (*channels.values(), *missing.values(), *late.values()):
            array.flags.writeable = False
        set_field = object.__setattr__
        set_field(self, "channels", MappingProxyType(channels))
        set_field(self, "units", MappingProxyType(units))
        set_field(self, "missing", MappingProxyType(missing))
        set_field(self, "late", MappingProxyType(late))
        set_field(self, "Ts", float(self.Ts))
        set_field(self, "t0", float(self.t0))
        set_field(self, "provenance", tuple(self.provenance))
        if not self.clock:
            set_field(self, "clock", _clock_of(self))

    # ------------------------------------------------------------------ reading it

    @property
    def N(self) -> int:
        """Number of samples."""
        return int(next(iter(self.channels.values())).size)

    @property
    def duration(self) -> float:
        """Length in time, N Ts [s]."""
        return self.N * self.Ts

    @property
    def t(self) -> FloatArray:
        """(N,) times of the samples on the record's own clock [s]."""
        return self.t0 + self.Ts * np.arange(self.N, dtype=np.float64)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels, in order."""
        return tuple(self.channels)

    def __getitem__(self, channel: str) -> FloatArray:
        """Return the (N,) samples of a channel, SI units."""
        self._require(channel)
        return self.channels[channel]

    def __contains__(self, channel: object) -> bool:
        return channel in self.channels

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __len__(self) -> int:
        return self.N

    def _require(self, channel: str) -> None:
        if channel not in self.channels:
            raise DataError(
                f"{self.name}: no channel {channel!r}; it holds {', '.join(self.names)}"
                f"{nearest(str(channel), self.names, is_listed=True)}"
            )

    def is_missing(self, channel: str) -> BoolArray:
        """Return the (N,) mask of a channel, True where the sample is to be ignored."""
        self._require(channel)
        mask = self.missing.get(channel)
        return np.zeros(self.N, dtype=bool) if mask is None else mask

    def filled(self, channel: str) -> FloatArray:
        """Return the (N,) samples with the missing ones joined by straight lines.

        Raises
        ------
        DataError
            If every sample is missing.
        """
        values, mask = self[channel], self.is_missing(channel)
        if not mask.any():
            return values
        if mask.all():
            raise DataError(
                f"{self.name}: every sample of {channel} is missing. "
                f"Leave the channel out with record.without({channel!r})."
            )
        k = np.arange(self.N)
        filled = np.array(values)
        filled[mask] = np.interp(k[mask], k[~mask], values[~mask])
        return filled

    def constant_channels(self) -> tuple[str, ...]:
        """Return the names of channels whose samples are all the same (missing ones apart)."""
        constant = []
        for channel, values in self.channels.items():
            kept = values[~self.is_missing(channel)]
            if kept.size == 0 or kept.min() == kept.max():
                constant.append(channel)
        return tuple(constant)

    # ------------------------------------------------------------------ changing it

    def _derive(self, step: str, /, **changes: Any) -> Record:
        return replace(self, provenance=(*self.provenance, step), **changes)

    def between(self, start: float, stop: float) -> Record:
        """Return the samples with start <= t <= stop, seconds of the record's own clock.

        The clock is kept: `t0` of the new record is the time of its first sample. Infinite limits
        leave that end open.

        Raises
        ------
        DataError
            If the window is empty, reaches outside the record, or keeps fewer than two samples.
        """
        end = self.t0 + (self.N - 1) * self.Ts
        span = f"{self.name} runs from {self.t0:.9g} to {end:.9g} s of its own clock"
        if not start < stop:
            raise DataError(
                f"window {window_text(start, stop)} s is empty or backward; {span}. "
                "Give the earlier time first."
            )
        slack = (1 + 1e-6) * self.Ts  # a record of N samples lasts N Ts
        outside = [x for x in (start, stop) if np.isfinite(x)]
        if any(x < self.t0 - slack or x > end + slack for x in outside):
            raise DataError(
                f"window {window_text(start, stop)} s reaches outside the record; {span}. "
                "Give a window inside that span, or leave an end open (12: or :194)."
            )
        tolerance = 1e-6  # of a sample: decimal limits meet their sample in spite of rounding
        lowest = max((start - self.t0) / self.Ts, 0.0)
        highest = min((stop - self.t0) / self.Ts, float(self.N - 1))
        first = int(np.ceil(lowest - tolerance))
        last = int(np.floor(highest + tolerance))
        if last - first < 1:
            raise DataError(
                f"window {window_text(start, stop)} s keeps "
                f"{count_text(max(last - first + 1, 0), 'sample')}; {span} "
                f"with Ts = {self.Ts:g} s. Widen the window to at least two samples."
            )
        cut = slice(first, last + 1)
        limits = window_text(start, stop)
        return self._derive(
            f"window {limits} s: samples {first} to {last}",
            channels={n: v[cut] for n, v in self.channels.items()},
            missing={n: m[cut] for n, m in self.missing.items()},
            late={n: s[cut] for n, s in self.late.items()},
            t0=self.t0 + first * self.Ts,
            name=f"{self.name}@{limits}",
        )

    def with_channel(self, channel: str, values: ArrayLike, unit: str) -> Record:
        """Return the record with a channel added or replaced; values in `unit`, kept in SI.

        Raises
        ------
        DataError
            If `values` is not (N,) and finite.
        UnitError
            If `unit` cannot be read.
        """
        array = _column(self.name, channel, values)
        if array.size != self.N:
            raise DataError(
                f"{self.name}: channel {channel} has {array.size} samples, the record {self.N}. "
                "Resample it to the record's clock first."
            )
        verb = "replaced" if channel in self.channels else "added"
        return self._derive(
            f"channel {channel} {verb} [{unit}]",
            channels={**self.channels, channel: to_si(array, unit)},
            units={**self.units, channel: si_unit(unit)},
            missing={n: m for n, m in self.missing.items() if n != channel},
            late={n: s for n, s in self.late.items() if n != channel},
        )

    def without(self, *names: str) -> Record:
        """Return the record without the named channels.

        Raises
        ------
        DataError
            If a channel is not there, or none would be left.
        """
        for channel in names:
            self._require(channel)
        kept = [n for n in self.channels if n not in names]
        return self._derive(
            f"left out {', '.join(names) or 'nothing'}",
            channels={n: self.channels[n] for n in kept},
            units={n: self.units[n] for n in kept},
            missing={n: m for n, m in self.missing.items() if n in kept},
            late={n: s for n, s in self.late.items() if n in kept},
        )

    def rename(self, names: Mapping[str, str]) -> Record:
        """Return the record with channels renamed, `{old: new}`.

        Raises
        ------
        DataError
            If an old name is not there, or two channels would share a name.
        """
        for old in names:
            self._require(old)
        new = [names.get(n, n) for n in self.channels]
        twice = sorted({n for n in new if new.count(n) > 1})
        if twice:
            raise DataError(
                f"{self.name}: renaming gives the name {', '.join(twice)} to two channels. "
                "Choose different names, or drop one with record.without(name)."
            )
        return self._derive(
            "renamed " + ", ".join(f"{a} to {b}" for a, b in names.items()),
            channels={names.get(n, n): v for n, v in self.channels.items()},
            units={names.get(n, n): u for n, u in self.units.items()},
            missing={names.get(n, n): m for n, m in self.missing.items()},
            late={names.get(n, n): s for n, s in self.late.items()},
        )

    def mark_missing(self, channel: str, mask: ArrayLike) -> Record:
        """Return the record with samples of a channel marked as to be ignored.

        Parameters
        ----------
        channel : str
        mask : (N,) bool array
            True where the sample is to be ignored; earlier marks stay.

        Raises
        ------
        DataError
            If the mask is not (N,) bool.
        """
        self._require(channel)
        marks = _mask(self.name, channel, mask, self.N) | self.is_missing(channel)
        return self._derive(
            f"{count_text(int(marks.sum()), 'sample')} of {channel} marked missing",
            missing={**self.missing, channel: marks},
        )

    # ------------------------------------------------------------------ printing it

    def __repr__(self) -> str:
        return (
            f"<Record {self.name}: N = {self.N}, {count_text(len(self.channels), 'channel')} "
            f"({', '.join(self.names)}), Ts = {self.Ts:.6g} s, {self.duration:.6g} s long>"
        )


def with_samples(record: Record, channel: str, values: Array) -> Record:
    """The record with other samples (N,) of a channel, SI units; it misses the same ones.

    Those missing need not be finite.
    """
    mask = record.is_missing(channel)
    finite = np.where(mask & ~np.isfinite(values), 0.0, values)
    new = record.with_channel(channel, finite, record.units[channel])
    return new.mark_missing(channel, mask) if mask.any() else new


def _clock_of(record: Record) -> str:
    """A name of the clock of samples that come from no file, a digest of them all."""
    text = hashlib.blake2b(repr((record.Ts, record.t0, record.names)).encode(), digest_size=16)
    for values in record.channels.values():
        text.update(np.ascontiguousarray(values).data)
    return text.hexdigest()


def _check_clock(name: str, Ts: object, t0: object) -> None:
    if not (isinstance(Ts, int | float | np.number) and np.isfinite(Ts) and Ts > 0):
        raise DataError(
            f"{name}: sample time Ts = {Ts!r} s. Give a positive number of seconds, "
            "for example Ts=0.01 for 100 Hz."
        )
    if not (isinstance(t0, int | float | np.number) and np.isfinite(t0)):
        raise DataError(
            f"{name}: time of the first sample t0 = {t0!r} s. Give a finite number of seconds."
        )


def _column(name: str, channel: str, values: ArrayLike) -> FloatArray:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise DataError(
            f"{name}: channel {channel} holds something else than numbers. "
            "Convert it to a one-dimensional array of floats."
        ) from None
    if array.ndim != 1:
        raise DataError(
            f"{name}: channel {channel} has shape {array.shape}, not (N,). "
            f"Give each channel by itself, for example values[:, 0]."
        )
    return array


def _checked_units(name: str, channels: list[str], units: Mapping[str, str]) -> dict[str, str]:
    without = [c for c in channels if c not in units]
    if without:
        raise DataError(
            f"{name}: no unit for {', '.join(without)}. "
            "Give each channel its SI unit as text, '1' where it has none."
        )
    foreign = [c for c in units if c not in channels]
    if foreign:
        raise DataError(
            f"{name}: a unit is given for {', '.join(map(str, foreign))}, which is no channel. "
            f"Channels are {', '.join(channels)}; remove the unit or add the channel."
        )
    for channel in channels:
        if not parse_unit(units[channel]).is_si:
            raise DataError(
                f"{name}: channel {channel} is given in {units[channel]!r}, a record holds SI. "
                f"Convert it with casid.model.units.to_si(values, {units[channel]!r}) and name the "
                f"unit {si_unit(units[channel])!r}, or add it with record.with_channel."
            )
    return {c: units[c] for c in channels}


def _mask(name: str, channel: str, mask: ArrayLike, N: int) -> BoolArray:
    array = np.array(mask)
    if array.dtype != np.bool_ or array.shape != (N,):
        raise DataError(
            f"{name}: the mask of {channel} has shape {array.shape} and type {array.dtype}. "
            f"Give a bool array of shape ({N},), True where the sample is to be ignored."
        )
    return array


def _checked_lateness(
    name: str, channels: Mapping[str, FloatArray], N: int, late: Mapping[str, ArrayLike]
) -> dict[str, FloatArray]:
    shifts = {c: np.array(s, dtype=np.float64) for c, s in late.items()}
    for channel, shift in shifts.items():
        if channel not in channels or shift.shape != (N,) or not np.isfinite(shift).all():
            raise DataError(
                f"{name}: the lateness of {channel!r} has shape {shift.shape}. Give ({N},) finite "
                f"numbers of seconds, of one of the channels {', '.join(channels)}."
            )
    return shifts


def _checked_masks(
    name: str, channels: Mapping[str, FloatArray], N: int, missing: Mapping[str, BoolArray]
) -> dict[str, BoolArray]:
    masks: dict[str, BoolArray] = {}
    for channel, mask in missing.items():
        if channel not in channels:
            raise DataError(
                f"{name}: a mask is given for {channel!r}, which is no channel. "
                f"Channels are {', '.join(channels)}; remove the mask."
            )
        marks = _mask(name, channel, mask, N)
        if marks.any():
            masks[channel] = marks
    return masks


def _refuse_non_finite(
    record: Record, channel: str, values: FloatArray, mask: BoolArray | None
) -> None:
    bad = ~np.isfinite(values)
    if mask is not None:
        bad &= ~mask
    if not bad.any():
        return
    first = int(np.argmax(bad))
    nans = int(np.isnan(values[bad]).sum())
    raise DataError(
        f"{record.name}: {channel} holds {count_text(int(bad.sum()), 'sample')} not finite "
        f"({nans} NaN, {int(bad.sum()) - nans} Inf), the first at k = {first} "
        f"(t = {record.t0 + first * record.Ts:g} s). Cut them with record.between(t0, t1), or mark "
        "them missing: Record(..., missing={name: ~numpy.isfinite(values)})."
    )
