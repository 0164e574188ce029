"""Rows on an even clock that leaves some out: what is absent is missing, nothing interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casid.arrays import BoolArray, FloatArray
from casid.data.reading.clocks import OFF_GRID
from casid.data.sampling import gaps_of

if TYPE_CHECKING:
    from collections.abc import Mapping

SPARSEST = 20
"""Samples of an even clock for one row, at most: more would be a record of missing samples."""
FINEST = 5
"""Steps in the median interval of an irregular clock, at most: half of one is `OFF_GRID`."""


@dataclass(frozen=True, slots=True, eq=False)
class EvenClock:
    """An even clock that the rows of a file lie on, some of its instants left out.

    Attributes
    ----------
    Ts : s.
    places : (rows,) the sample of each row.
    off : s that a stamp lies off its sample, at most.
    is_finer : whether its step is chosen for stamps that run unevenly.
    """

    Ts: float
    places: NDArray[np.intp]
    off: float
    is_finer: bool = False

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
        self, values: Mapping[str, FloatArray], missing: Mapping[str, BoolArray]
    ) -> tuple[dict[str, FloatArray], dict[str, BoolArray]]:
        """Channels (rows,) on every sample of the clock, (N,), with what is missing of them."""
        absent = self.absent
        channels, masks = {}, {}
        for name, column in values.items():
            channels[name] = np.full(self.N, np.nan)
            channels[name][self.places] = column
            masks[name] = absent.copy()
            if name in missing:
                masks[name][self.places] = missing[name]
        return channels, masks

    def __str__(self) -> str:
        found = gaps_of(self.absent)
        if self.is_finer:
            return (
                "the clock is irregular: every sample counts at its own instant, to within "
                f"{self.off:.2g} s, on an even clock of {self.Ts:.6g} s"
            )
        return (
            f"{found.missing} of {self.N} rows are absent from an even clock of {self.Ts:.6g} s, "
            f"{found.longest} in a row at most: marked missing"
        )


def even_clock(times: FloatArray) -> EvenClock | None:
    """The even clock that stamps (N,) [s] lie on with rows absent; None where there is none.

    Every interval is a whole number of the shortest usual one, and every stamp lies within a tenth
    of it of its place (`OFF_GRID`, as for a clock without absent rows). Stamps that run otherwise
    lie as near to a finer clock, of up to a fifth of the median interval, each at a place of its
    own: what is measured then counts where it was measured, and a simulation has steps between.
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
    median = float(np.median(intervals))
    for parts in range(1, FINEST + 1):
        found = _on(times, median / parts, OFF_GRID * median)
        if found is not None:
            return found
    return None


def _on(times: FloatArray, Ts: float, nearest: float) -> EvenClock | None:
    """The clock of step `Ts` if all stamps lie so near to a sample of it, each to another."""
    if times[-1] - times[0] > SPARSEST * times.size * Ts:
        return None
    places = np.round((times - times[0]) / Ts).astype(np.intp)
    off = float(np.abs(times - times[0] - Ts * places).max())
    if off > nearest * (1 + 1e-9) or not (np.diff(places) > 0).all():
        return None
    return EvenClock(Ts, places, off, is_finer=True)
