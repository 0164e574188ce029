"""Methods of a record that modules above it carry out.

Filters, clock offsets and other libraries' tables are functions of records, in modules that
import `Record`. As with `casid.presentation`, the one step upward is taken by name when a method is
called: `casid.data.record` imports none of them.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Self

from casid.presentation import present

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike


def _of(module: str, function: str) -> Any:
    return getattr(importlib.import_module(f"casid.data.{module}"), function)


class RecordMethods:
    """What a record does through `casid.data.preparation`, `alignment`, `reading` and figures."""

    __slots__ = ()

    def lowpass(self, cutoff_hz: float = 0.5, **options: Any) -> Self:
        """Return the record with every channel low-passed alike; see `casid.lowpass`."""
        filtered: Self = _of("preparation", "lowpass")(self, cutoff_hz, **options)
        return filtered

    def plot(self) -> Any:
        """Return a figure of the channels over the record's clock, the first eight of them."""
        return present(self, "figure")

    def decimate(self, factor: int) -> Self:
        """Return every `factor`-th sample behind an anti-alias filter; see `casid.decimate`."""
        thinned: Self = _of("preparation", "decimate")(self, factor)
        return thinned

    def detrend(self, order: int = 0) -> Self:
        """Return the record without mean (0) or straight line (1); see `casid.detrend`."""
        level: Self = _of("preparation", "detrend")(self, order)
        return level

    def align(
        self,
        other: Self,
        *,
        using: str,
        other_using: str | None = None,
        max_offset: float | None = None,
    ) -> Any:
        """Find the clock offset of another logger from a shared signal; see `casid.align`."""
        return _of("alignment", "align")(
            self, other, using=using, other_using=other_using, max_offset=max_offset
        )

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        *,
        units: Mapping[str, str] | None = None,
        time: str | None = None,
        Ts: float | None = None,
        resample: float | None = None,
        mark_missing: bool = False,
        name: str | None = None,
    ) -> Self:
        """Read a record from a pandas DataFrame, as `read_record` reads a file with its columns.

        Parameters
        ----------
        frame : a column a channel, and the time in a column or as the index: seconds, dates or
            durations. Columns of text are left out.
        units : column -> unit of its numbers (kept in SI); else the unit in the column's name,
            ``phi [deg]``, or none.
        time : the time column; found by its name, or the index, where not given.
        Ts : sample time [s] of a table without time; its clock starts at 0.
        resample : sample time [s] of a uniform grid for a table sampled irregularly.
        mark_missing : mark Inf as missing, as NaN is, instead of refusing it, and take every sample
            of an uneven clock at its own instant.
        name : default the frame's ``attrs["name"]``, or "frame".

        Raises
        ------
        DataError
            For a clock that is not uniform, columns that are missing, empty or not finite.
        UnitError
            For a unit that cannot be read.
        """
        record: Self = _of("reading.frames", "record_of_frame")(
            frame,
            None,
            units,
            _of("reading.survey", "ReadingOptions")(
                time=time,
                name=name,
                resample=resample,
                Ts=Ts,
                mark_missing=mark_missing,
                takes_gaps=mark_missing,
            ),
        )
        return record

    @classmethod
    def from_signals(
        cls,
        signals: Mapping[str, tuple[ArrayLike, ArrayLike]],
        units: Mapping[str, str],
        *,
        name: str = "record",
    ) -> Self:
        """A record of channels that have time vectors of their own; nothing is interpolated.

        Several rates, uneven clocks and clocks that start apart are one record so: every sample
        counts at its own instant, to within a tenth of its channel's interval.

        Parameters
        ----------
        signals : channel -> times (n,) [s], increasing, and values (n,).
        units : channel -> unit of its values; kept in SI.

        Raises
        ------
        DataError
            For lengths that differ, or times that do not increase.
        UnitError
            For a unit that cannot be read.
        """
        record: Self = _of("reading.frames", "record_of_signals")(signals, units, name=name)
        return record

    def to_frame(self) -> pd.DataFrame:
        """A DataFrame: the time [s] as index `t`, a column a channel (SI), NaN where missing.

        `attrs` has the units by column and the record's name, which `from_frame` reads again.
        """
        frame: pd.DataFrame = _of("reading.frames", "frame_of")(self)
        return frame

    def to_xarray(self) -> Any:
        """An xarray Dataset: a variable a channel (SI) over `t` [s], units in the attributes.

        Raises
        ------
        DataError
            If xarray is not installed: ``pip install "casid[xarray]"``.
        """
        return _of("reading.frames", "dataset_of")(self)
