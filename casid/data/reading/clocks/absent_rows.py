"""Rows on an even clock that leaves some out: what is absent is missing, nothing interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casid.arrays import BoolArray, FloatArray
from casid.data.reading.clocks.even_clock import OFF_GRID, jitter_text
from casid.data.sampling import gaps_of
from casid.model.quantities import are

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

SPARSEST = 20
"""Samples of an even clock for one row, at most: more would be a record of missing samples."""
FINEST = 5
"""Steps in the median interval of an irregular clock, at most: half of one is `OFF_GRID`."""
FINE = 20
"""The same of a short record, whose samples then lie within a fortieth of their places."""
FINE_AT_LEAST = 10
"""The same, at least: a record whose clock cannot be so fine is not a short one."""
SHORT = 4000
"""Samples of a short record, at most: to simulate them all costs little."""
FINEST_COMMON = 10
"""The same of the fastest of several clocks: how late one is to another is a bias."""
SHIFT = 0.01
"""Of a channel's own interval, that its samples lie off on average where a clock can be had so."""
CLOSEST = 0.05
"""Of a channel's samples, at most, that come so soon after another that both have one place."""
MOST = 0.95
"""Of the rows: a channel with more of them has the clock of the file, and no other one."""


@dataclass(frozen=True, slots=True, eq=False)
class EvenClock:
    """An even clock that the rows of a file lie on, some of its instants left out.

    Attributes
    ----------
    Ts : s.
    places : (rows,) the sample of each row.
    off : s that a stamp lies off its sample, at most.
    is_finer : whether its step is chosen for stamps that run unevenly.
    is_common : whether it is that of channels with clocks of their own; two rows of different
        channels may then have the same place.
    first : s from the first row's stamp to the first sample.
    late : (rows,) s that a stamp lies after its sample; None where the clock runs evenly.
    """

    Ts: float
    places: NDArray[np.intp]
    off: float
    is_finer: bool = False
    is_common: bool = False
    first: float = 0.0
    late: FloatArray | None = None

    @property
    def N(self) -> int:
        """Samples of the record."""
        return int(self.places[-1]) + 1

    @property
    def absent(self) -> BoolArray:
        """(N,) True at samples without a row."""
        out = np.ones(self.N, dtype=bool)
        out[self.places] = False
        return out

    def spread(
        self,
        values: Mapping[str, FloatArray],
        missing: Mapping[str, BoolArray],
        held: Collection[str] = (),
    ) -> tuple[dict[str, FloatArray], dict[str, BoolArray], dict[str, FloatArray]]:
        """Channels (rows,) on every sample of the clock, (N,), with what is missing of them.

        A channel that has two rows at one place has their mean there. A held one has there what
        flows in until the next sample, and at that one the last of its rows: their mean would act
        until its next step.

        Parameters
        ----------
        held : channels that stand from row to row, as a command does.

        Returns
        -------
        channels, masks : (N,) values, and where there is none.
        late : by how much each sample was taken after its instant [s], (N,); none on an even clock.
        """
        channels, masks, late = {}, {}, {}
        for name, column in values.items():
            there = ~missing[name] if name in missing else np.ones(column.size, dtype=bool)
            places = self.places[there]
            count = np.bincount(places, minlength=self.N)
            channels[name] = _mean(column[there], places, count)
            masks[name] = count == 0
            if self.late is None:
                continue
            late[name] = np.nan_to_num(_mean(self.late[there], places, count))
            if name in held and (count > 1).any():
                masks[name] &= ~_held_at_shared_places(
                    channels[name], late[name], column[there], self.late[there], places, self.Ts
                )
        return channels, masks, late

    def __str__(self) -> str:
        found = gaps_of(self.absent)
        if self.is_common:
            return (
                "the channels have clocks of their own: every sample counts at its own instant, "
                f"to within {self.off:.2g} s, on an even clock of {self.Ts:.6g} s"
            )
        if self.is_finer:
            return (
                "the clock is irregular: every sample counts at its own instant, to within "
                f"{self.off:.2g} s, on an even clock of {self.Ts:.6g} s"
            )
        if not found.missing:
            return (
                f"the stamps run unevenly, up to {self.off:.2g} s off an even clock of "
                f"{self.Ts:.6g} s: read as even"
            )
        return (
            f"{found.missing} of {self.N} rows {are(found.missing)} absent from an even clock of "
            f"{self.Ts:.6g} s, "
            f"{found.longest} in a row at most: marked missing"
        )


def _mean(rows: FloatArray, places: NDArray[np.intp], count: NDArray[np.intp]) -> FloatArray:
    """(N,) mean of the rows of each place, NaN where there is none."""
    total = np.bincount(places, rows, minlength=count.size)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _held_at_shared_places(
    channel: FloatArray,
    late: FloatArray,
    column: FloatArray,
    lateness: FloatArray,
    places: NDArray[np.intp],
    Ts: float,
) -> BoolArray:
    """Let a held column flow in as it did where several of its rows share a place; in place.

    The steps of these rows, each with its own lateness, leave their mean over the interval in the
    sample, and the last row's value in the next one. What flows in before the sample is that of
    its step, which comes as much earlier.

    Parameters
    ----------
    channel, late : (N,) what is corrected: values, and s after the instant.
    column, lateness, places : (rows,) values, s after the instant, samples.

    Returns
    -------
    (N,) True where the column has a value now, and may have had none.
    """
    added = np.zeros(channel.size, dtype=bool)
    step, shares = np.diff(column, prepend=column[:1]), lateness / Ts
    first, count = np.unique(places, return_index=True, return_counts=True)[1:]
    for begin, rows in zip(first[count > 1].tolist(), count[count > 1].tolist(), strict=True):
        mine, k = slice(begin, begin + rows), int(places[begin])
        last = float(column[mine][-1])
        early = float(-np.minimum(shares[mine], 0.0) @ step[mine])  # what flows in before the place
        channel[k], late[k] = last - float(np.maximum(shares[mine], 0.0) @ step[mine]), 0.0
        is_there = k > 0 and not np.isnan(channel[k - 1])
        rise = channel[k] - (channel[k - 1] if is_there else column[max(begin - 1, 0)])
        if early * rise > 0.0:
            late[k] = -Ts * early / rise
        else:
            channel[k] += early
        if k + 1 == channel.size or channel[k] == last:
            continue
        if np.isnan(channel[k + 1]):
            channel[k + 1], late[k + 1], added[k + 1] = last, 0.0, True
        elif channel[k + 1] != channel[k]:  # what is late is the step from the last row's value
            late[k + 1] *= (channel[k + 1] - last) / (channel[k + 1] - channel[k])
    return added


def even_clock(times: FloatArray, there: Mapping[str, BoolArray] | None = None) -> EvenClock | None:
    """The even clock that stamps (N,) [s] lie on with rows absent; None where there is none.

    Every interval is a whole number of the shortest usual one, and every stamp lies within a tenth
    of it of its place (`OFF_GRID`, as for a clock without absent rows). Stamps that run otherwise
    lie as near to a finer clock, of up to a fifth of the median interval, in a short record up to
    a twentieth: what is measured then counts where it was measured, and a simulation has steps
    between.

    Parameters
    ----------
    there : channel -> (N,) rows in which it has a value. Where channels have clocks of their own,
        each lies so near to a common clock by its own interval, of up to a tenth of the fastest's.
    """
    intervals = np.diff(times)
    if not intervals.size or not (intervals > 0).all():
        return None
    # The median is that of whole steps while more than half of the rows follow one another.
    usual = float(np.median(intervals[intervals < 1.5 * np.quantile(intervals, 0.1)]))
    steps = np.round(intervals / usual)
    if steps.min() >= 1 and steps.sum() <= SPARSEST * times.size:
        places = np.concatenate([[0], np.cumsum(steps)]).astype(np.intp)
        slope, first = np.polyfit(places, times - times[0], 1)
        off = float(np.abs(times - times[0] - first - slope * places).max())
        if slope > 0 and off <= OFF_GRID * slope:  # with or without rows that are absent
            return EvenClock(float(slope), places, off)
    own = [] if there is None else _own_clocks(times, list(there.values()))
    return _finer(times, own) if len(own) > 1 else _finer(times, [times])


def _own_clocks(times: FloatArray, there: Sequence[BoolArray]) -> list[FloatArray]:
    """The different sets of stamps of channels with more than two, the fastest first."""
    rows = {t.tobytes(): t for t in there if t.sum() > 2}
    if any(t.mean() > MOST for t in rows.values()):
        return []  # the clock is that channel's, and others miss samples
    return sorted((times[t] for t in rows.values()), key=_interval)


def _interval(times: FloatArray) -> float:
    """The interval [s] of a clock: its mean where it is even."""
    if jitter_text(times) is not None:
        return float(times[-1] - times[0]) / (times.size - 1)
    return float(np.median(np.diff(times)))


def _steps(intervals: float, rows: int, is_common: bool) -> list[int]:
    """The numbers of steps in an interval that are tried for a clock of so many intervals."""
    usual = range(1, (FINEST_COMMON if is_common else FINEST) + 1)
    several = [n for n in usual if intervals * n <= SPARSEST * rows]
    if is_common:
        return several
    most = int(SHORT / intervals)
    finest = min(FINE, most)
    if finest >= FINE_AT_LEAST:
        # Last, where stamps noted at random lie closer together than that clock tells apart.
        return [finest, *several, *([most] if most > finest else [])]
    return [*several, *range(FINEST + 1, finest + 1)]


def _finer(times: FloatArray, own: Sequence[FloatArray]) -> EvenClock | None:
    """The clock that each of several, or the only one, lies near to; None where there is none.

    It runs from a stamp of the fastest. Of those that are near enough it is the coarsest, with
    several clocks that on which no channel is late by more than `SHIFT` on average, or else that
    with the least.
    """
    step, intervals = _interval(own[0]), [_interval(t) for t in own]
    best, least = None, np.inf
    for parts in _steps(float(times[-1] - times[0]) / step, times.size, len(own) > 1):
        Ts = step / parts
        start = own[0][0] - Ts * np.ceil((own[0][0] - times[0]) / Ts - OFF_GRID)
        places = [np.round((t - start) / Ts) for t in own]
        errors = [t - start - Ts * p for t, p in zip(own, places, strict=True)]
        off = [float(np.abs(e).max()) for e in errors]
        if any((np.diff(p) < 1).mean() > CLOSEST for p in places) or any(
            e > OFF_GRID * dt * (1 + 1e-9) for e, dt in zip(off, intervals, strict=True)
        ):
            continue
        shift = max(abs(float(e.mean())) / dt for e, dt in zip(errors, intervals, strict=True))
        if shift < least:
            at = np.round((times - start) / Ts).astype(np.intp)
            first = float(start - times[0] + Ts * at[0])
            kind = {"is_finer": True, "is_common": len(own) > 1}
            late = times - start - Ts * at
            best = EvenClock(Ts, at - at[0], max(off), first=first, late=late, **kind)
            least = shift
        if least <= SHIFT or len(own) == 1:
            break
    return best
