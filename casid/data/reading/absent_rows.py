"""Rows that an even clock leaves out: their samples are missing, the others stay as they are."""

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


@dataclass(frozen=True, slots=True, eq=False)
class EvenClock:
    """An even clock that the rows of a file lie on, some of its instants left out.

    Attributes
    ----------
    Ts : s.
    places : (rows,) the sample of each row.
    off : s that a stamp lies off its sample, at most.
    """

    Ts: float
    places: NDArray[np.intp]
    off: float

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
        return (
            f"{found.missing} of {self.N} rows are absent from an even clock of {self.Ts:.6g} s, "
            f"{found.longest} in a row at most: marked missing"
        )


def even_clock(times: FloatArray) -> EvenClock | None:
    """The even clock that stamps (N,) [s] lie on with rows absent; None where there is none.

    Every interval is a whole number of the shortest usual one, and every stamp lies within a tenth
    of it of its place (`OFF_GRID`, as for a clock without absent rows).
    """
    intervals = np.diff(times)
    if not intervals.size or not (intervals > 0).all():
        return None
    # The median is that of whole steps while more than half of the rows follow one another.
    usual = intervals[intervals < 1.5 * np.quantile(intervals, 0.1)]
    steps = np.round(intervals / float(np.median(usual)))
    if steps.min() < 1 or steps.sum() > SPARSEST * times.size:
        return None
    places = np.concatenate([[0], np.cumsum(steps)]).astype(np.intp)
    slope, first = np.polyfit(places, times - times[0], 1)
    off = float(np.abs(times - times[0] - first - slope * places).max())
    if slope <= 0 or off > OFF_GRID * slope:
        return None
    return EvenClock(float(slope), places, off)
