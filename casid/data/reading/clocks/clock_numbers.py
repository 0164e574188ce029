"""Times of day that are written as plain numbers: 930 is half past nine, 93015 is 15 s later.

Read as a count of seconds, such a clock would leap by 40 at every full hour.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from casid.arrays import FloatArray
from casid.data.reading.clocks.even_clock import UNIFORM
from casid.data.reading.clocks.time_stamps import DAY, Stamps
from casid.errors import shell_option
from casid.model.quantities import count_text

if TYPE_CHECKING:
    import pandas as pd

    from casid.data.reading.tables import Table

FORMS = {"hh:mm": (2359, 60.0), "hh:mm:ss": (235959, 1.0)}
"""How such a clock is written: its last number, and the seconds of its last place."""
_FITTING = 0.8
"""Of the steps over a full hour (or minute), at least, that are the usual step on the clock; others
may be gaps. A heuristic."""
_BESIDE = 3
"""Steps within the hours (or minutes), at least, that say which step is the usual one."""
_DAYS = re.compile(r"(?:day|date|datum|tag|doy|day of year|julian day|jday)", re.IGNORECASE)


def of_clock_numbers(
    values: FloatArray, unit: str | None, column: str, days: FloatArray | None = None
) -> Stamps | None:
    """Seconds since midnight of times of day written as numbers; None for plain numbers.

    Without a unit they are taken for that where no number ends in 60 to 99 and the steps over the
    full hours (hhmm) or minutes (hhmmss) are as long as the others on the clock alone. The unit
    `hh:mm`, `hh:mm:ss` or `mm:ss` says so.

    Parameters
    ----------
    values : (N,) finite.
    days : (N,) the day of every row, where the file has it; else the clock begins a new day
        wherever it falls.
    """
    if unit == "mm:ss":
        seconds = _seconds(values, np.inf, 1.0)
        return None if seconds is None else Stamps(seconds, "minutes and seconds as numbers")
    for form, (last, place) in FORMS.items():
        if unit is not None and unit != form:
            continue
        seconds = _seconds(values, last, place)
        if seconds is None or (unit is None and not _is_clock(values, seconds)):
            continue
        said = f"{_IN_WORDS[form]} as numbers, {values[0]:g} read as {_shown(float(seconds[0]))}"
        if unit is None:
            others = f"seconds, {_option(column, 's')}"
            if form == "hh:mm":
                others += f", or minutes and seconds, {_option(column, 'mm:ss')}"
            said += f" (where {column!r} counts {others})"
        return _over_days(seconds, said, days)
    return None


_IN_WORDS = {"hh:mm": "hours and minutes", "hh:mm:ss": "hours, minutes and seconds"}


def _option(column: str, unit: str) -> str:
    return shell_option("--map", f"t={column}:{unit}")


def _shown(seconds: float) -> str:
    return f"{int(seconds // 3600)}:{int(seconds % 3600 // 60):02d}" + (
        f":{seconds % 60:02g}" if seconds % 60 else ""
    )


def _seconds(values: FloatArray, last: float, place: float) -> FloatArray | None:
    """Seconds since midnight; None where a number is no time of day."""
    whole = np.floor(values)
    if values.min() < 0 or whole.max() > last or (whole % 100 > 59).any():
        return None
    if place > 1.0:
        minutes = 60.0 * (whole // 100) + whole % 100
        return 60.0 * minutes if np.array_equal(whole, values) else None
    if (whole // 100 % 100 > 59).any() and np.isfinite(last):
        return None
    high = whole // 100
    minutes = high if not np.isfinite(last) else 60.0 * (high // 100) + high % 100
    return np.asarray(60.0 * minutes + values - 100 * high, dtype=np.float64)


def _is_clock(values: FloatArray, seconds: FloatArray) -> bool:
    """Whether steps over the hours are the usual ones on the clock, and longer as plain numbers."""
    over = np.diff(np.floor(values / 100)) != 0
    steps = np.diff(seconds)
    steps = np.where(steps < 0, steps + DAY, steps)
    if over.sum() < 1 or (~over).sum() < _BESIDE:
        return False
    usual = float(np.median(steps[~over]))
    fits = np.abs(steps - usual) <= UNIFORM * usual * (1 + 1e-9)
    return usual > 0 and bool(fits[over].mean() >= _FITTING) and bool(fits[~over].mean() > 0.5)


def _over_days(seconds: FloatArray, said: str, days: FloatArray | None) -> Stamps:
    """The stamps with the days added."""
    falls = np.diff(seconds) < 0
    passed = np.cumsum(np.concatenate(([False], falls))).astype(np.float64)
    if days is not None and days.size == seconds.size:
        counted = days - days[0]
        if (np.diff(seconds + DAY * counted) > 0).all():
            passed = counted
    if passed[-1]:
        said += f"; past midnight {count_text(int(np.sum(np.diff(passed) > 0)), 'time')}"
        said += ", days added"
    return Stamps(seconds + DAY * passed, f"{said}, seconds since midnight")


def day_numbers(table: Table, frame: pd.DataFrame, column: str) -> FloatArray | None:
    """The day (N,) of every row, from a column named for it; None where there is no such column.

    Its cells are whole numbers, a count of days or dates as 20250131; dates become days since the
    first row.
    """
    import pandas as pd

    named = [c for c in table.columns if c != column and _DAYS.fullmatch(re.sub(r"[_-]", " ", c))]
    if len(named) != 1:
        return None
    cells = frame[named[0]] if named[0] in frame else table.read(named)[named[0]]
    if cells.size != len(frame) or cells.dtype.kind not in "iuf" or cells.isna().any():
        return None
    values: Any = cells.to_numpy()
    if (values != np.floor(values)).any():
        return None
    if values.min() > 19_000_000 and values.max() < 21_010_000:  # 20250131
        dates = pd.to_datetime(pd.Series(values.astype(int).astype(str)), errors="coerce")
        if dates.isna().any():
            return None
        return np.asarray((dates - dates.iloc[0]).dt.days, dtype=np.float64)
    return np.asarray(values, dtype=np.float64)
