"""Time stamps as seconds: dates, times of day, epochs, serial days, and the jumps of clocks."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from casid.arrays import FloatArray
from casid.data.reading.clocks.even_clock import UNIFORM
from casid.data.reading.file_format import ORDERS, FileFormat
from casid.data.reading.layout import MONTH, WEEKDAY
from casid.errors import DataError
from casid.model.quantities import count_text

if TYPE_CHECKING:
    import pandas as pd

DAY = 86400.0
_ISO = re.compile(r"\d{4}-\d{2}-\d{2}(?:[T ].*)?|\d{8}T\d{4,6}.*")
_CLOCK = r"(\d{1,3}):(\d{2})(?::(\d{2})(?:[.,](\d+))?)?\s*([AaPp]\.?[Mm]\.?)?"
_PATTERN = (
    r"(\d{1,4})(?:[-./ ]|\. )(\d{1,2}|[^\W\d]{3,9}\.?)[-./ ](\d{1,4})"
    rf"(?:[T ,;]+{_CLOCK}(?:\s*(Z|UTC|GMT|[+-]\d{{2}}:?\d{{2}}))?)?"
)
_TIME_OF_DAY = r"(\d{1,3}):(\d{2})(?::(\d{2}))?(?:[.,](\d+))?\s*([AaPp]\.?[Mm]\.?)?"
_MONTHS = {
    name: number
    for number, names in enumerate(
        "jan janv|feb fev fév|mar mär mrz maerz märz|apr avr|may mai|jun juin|jul juil|aug aoû aou"
        "|sep sept|oct okt|nov|dec dez déc".split("|"),
        start=1,
    )
    for name in names.split()
}
# (unit, smallest and largest value that is a time between 1990 and 2100)
_EPOCHS = ((1.0, "seconds"), (1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds"))
_FROM, _TO = 6.3e8, 4.1e9
_SERIAL = {"Excel": (32874.0, 73051.0, 25569.0), "MATLAB": (726834.0, 767011.0, 719529.0)}


class Stamps(NamedTuple):
    """Time stamps [s] since the first one's day or the first one, and what was done for them."""

    seconds: FloatArray
    text: str = ""
    origin: object = None


def of_dates(
    column: pd.Series[str], form: FileFormat, where: str, origin: object = None
) -> Stamps | None:
    """Seconds since the first of dates in text; None where the cells are no dates.

    Raises
    ------
    DataError
        Where day and month cannot be distinguished, or local time jumps and no zone is given.
    """
    import pandas as pd

    text = _day_first(column.str.strip())
    if _ISO.fullmatch(text.iloc[0]):
        stamps = pd.to_datetime(text, errors="coerce", format="ISO8601", utc=True)
        if stamps.notna().all():
            _require_unswapped(stamps, where)
            said = f"dates, first {text.iloc[0]}"
            zoned = bool(text.str.contains(r"(?:Z|[+-]\d{2}:?\d{2})$", regex=True).iloc[0])
            return _since_first(stamps, form, where, said, origin, is_local=not zoned)
    parts = text.str.extract(f"^{_PATTERN}$")
    if parts[0].isna().any():
        return None
    stamps, said = _in_one_order(parts, form, where, text.iloc[0])
    zone = parts[8]
    if zone.notna().any():
        offset = zone.fillna("Z").replace({"Z": "+0000", "UTC": "+0000", "GMT": "+0000"})
        digits = offset.str.replace(":", "")
        minutes = digits.str[1:3].astype(int) * 60 + digits.str[3:5].astype(int)
        sign = np.where(digits.str[0] == "-", -1, 1)
        stamps = stamps - pd.to_timedelta(sign * minutes, unit="m")
    return _since_first(stamps, form, where, said, origin, is_local=not zone.notna().any())


def _require_unswapped(stamps: pd.Series[pd.Timestamp], where: str) -> None:
    """Refuse dates that run forward only with day and month swapped where both are at most 12."""
    steps = stamps.diff().dt.total_seconds().to_numpy()[1:]
    if not np.any(steps < 0):
        return
    first = int(np.argmax(steps < 0)) + 1
    day, month = stamps.dt.day, stamps.dt.month
    can = day <= 12
    swapped = stamps.where(~can, stamps + _days_between(stamps, month, day))
    if np.all(swapped.diff().dt.total_seconds().to_numpy()[1:] > 0):
        raise DataError(
            f"{where}: day and month are swapped in the dates whose day is at most 12, as "
            f"spreadsheets leave them: {stamps.iloc[first - 1]:%Y-%m-%d} is followed by "
            f"{stamps.iloc[first]:%Y-%m-%d}, and swapped back all of them run forward. Write these "
            "dates anew; sorting the rows would mix them up."
        )


def _days_between(
    stamps: pd.Series[pd.Timestamp], day: pd.Series[int], month: pd.Series[int]
) -> pd.Series[pd.Timedelta]:
    """From each stamp to the one of that day and month in its year, at its time of day."""
    import pandas as pd

    parts = {"year": stamps.dt.year, "month": month.clip(upper=12), "day": day}
    return pd.to_datetime(pd.DataFrame(parts), utc=True) - stamps.dt.floor("D")


_WORDS = re.compile(rf"{WEEKDAY}?({MONTH})\s+(\d{{1,2}}),?\s+(.*)", re.IGNORECASE)
_YEAR_LAST = re.compile(r"(\S+(?:\s+[AaPp][Mm])?)\s+(?:([A-Z]{2,5})\s+)?(\d{4})")


def _day_first(text: pd.Series[str]) -> pd.Series[str]:
    """Dates in words as `3 Apr 2019 21:46:07`: those of C, of `date` and of e-mails.

    A zone in letters other than UTC and GMT is taken for local time; daylight saving time is
    corrected afterwards.
    """
    if not re.match(rf"(?:{WEEKDAY}|{MONTH})", text.iloc[0], re.IGNORECASE):
        return text
    return text.map(_date_in_words)


def _date_in_words(cell: str) -> str:
    words = _WORDS.fullmatch(cell)
    if words is None:
        return re.sub(rf"^{WEEKDAY}", "", cell, flags=re.IGNORECASE)
    month, day, rest = words.groups()
    last = _YEAR_LAST.fullmatch(rest)
    if last is None:
        return f"{day} {month} {rest}"
    zone = f" {last[2]}" if last[2] in {"UTC", "GMT"} else ""
    return f"{day} {month} {last[3]} {last[1]}{zone}"


def of_stamps(
    column: pd.Series[pd.Timestamp], form: FileFormat, where: str, origin: object = None
) -> Stamps:
    """Seconds since the first of stamps that the file holds as such."""
    is_local = column.dt.tz is None
    stamps = column.dt.tz_localize("UTC") if is_local else column.dt.tz_convert("UTC")
    return _since_first(
        stamps, form, where, f"dates, first {column.iloc[0]}", origin, is_local=is_local
    )


def _in_one_order(
    parts: pd.DataFrame, form: FileFormat, where: str, first: str
) -> tuple[pd.Series[pd.Timestamp], str]:
    """The dates in the one order of day, month and year that fits all cells."""
    readings: dict[str, pd.Series[pd.Timestamp]] = {}
    for order in ORDERS if form.dates is None else (form.dates,):
        stamps = _in_order(parts, order)
        if stamps is not None:
            readings[order] = stamps
    if not readings:
        asked = f" in the order {form.dates}" if form.dates else ""
        raise DataError(
            f"{where}: {first!r} is no date{asked}. Give the order of day, month and year with "
            "--dates dmy, mdy or ymd, or write ISO dates (2025-01-31 12:00:00)."
        )
    if "." in str(first).split(" ")[0] and "dmy" in readings:
        readings.pop("mdy", None)  # nobody writes month.day.year
    elapsed = {o: (s - s.iloc[0]).dt.total_seconds().to_numpy() for o, s in readings.items()}
    even = [o for o, t in elapsed.items() if _is_even(t)]
    orders = list(readings)
    same = all(np.array_equal(elapsed[o], elapsed[orders[0]]) for o in orders)
    if len(orders) > 1 and not same and len(even) == 1:
        orders = even
    if len(orders) > 1 and not same:
        raise DataError(
            f"{where}: dates such as {first!r} can be read as "
            f"{' and as '.join(_date_text(readings[o]) for o in orders)}, and no cell decides. "
            "Give the order of day, month and year with --dates dmy, mdy or ymd "
            "(FileFormat(dates='dmy'))."
        )
    chosen = orders[0]
    return readings[
        chosen
    ], f"dates read as {_in_words(chosen)}, first {_date_text(readings[chosen])}"


def _is_even(t: NDArray[np.floating[Any]]) -> bool:
    steps = np.diff(t)
    median = float(np.median(steps)) if steps.size else 0.0
    return median > 0 and bool(np.all(np.abs(steps - median) <= UNIFORM * median * (1 + 1e-9)))


def _date_text(stamps: pd.Series[pd.Timestamp]) -> str:
    return str(stamps.iloc[0].strftime("%d %B %Y"))


def _in_words(order: str) -> str:
    return {"dmy": "day, month, year", "mdy": "month, day, year", "ymd": "year, month, day"}[order]


def _in_order(parts: pd.DataFrame, order: str) -> pd.Series[pd.Timestamp] | None:
    """The dates in this order, None where a cell does not fit it."""
    import pandas as pd

    named = {letter: parts[order.index(letter)] for letter in "dmy"}
    month = named["m"].str.rstrip(".").str.casefold()
    words = ~month.str.isdigit()
    if words.any():
        if not words.all() or not month.str[:4].map(_month).notna().all():
            return None
        month = month.str[:4].map(_month).astype(int).astype(str)
    day, year = named["d"], named["y"]
    if not (day.str.isdigit().all() and year.str.isdigit().all()):
        return None
    if not (day.str.len().le(2).all() and year.str.len().isin([2, 4]).all()):
        return None
    years = year.astype(int)
    century = np.where(years < 70, 2000, 1900)
    years = years + np.where(years < 100, century, 0)
    dates = pd.to_datetime(
        pd.DataFrame({"year": years, "month": month.astype(int), "day": day.astype(int)}),
        errors="coerce",
    )
    seconds = _seconds(parts[[3, 4, 5, 6, 7]])
    if dates.isna().any() or seconds is None:
        return None
    return dates.dt.tz_localize("UTC") + pd.to_timedelta(np.round(seconds * 1e9), unit="ns")


def _month(text: str) -> int | None:
    return _MONTHS.get(text) or _MONTHS.get(text[:3])


def _seconds(parts: pd.DataFrame) -> FloatArray | None:
    """Seconds since midnight of hours, minutes, seconds, fraction and AM or PM."""
    hour, minute, second, fraction, half = (parts[c] for c in parts.columns)
    h = hour.fillna("0").astype(int)
    afternoon = half.notna()
    if afternoon.any():
        pm = half.fillna("").str.casefold().str.startswith("p")
        if not afternoon.all() or not h.between(1, 12).all():
            return None
        h = h % 12 + 12 * pm.astype(int)
    m, s = minute.fillna("0").astype(int), second.fillna("0").astype(int)
    if (m > 59).any() or (s > 60).any():
        return None
    rest = ("0." + fraction.fillna("0")).astype(float)
    return np.asarray(3600.0 * h + 60.0 * m + s + rest, dtype=np.float64)


def _since_first(
    stamps: pd.Series[pd.Timestamp],
    form: FileFormat,
    where: str,
    said: str,
    origin: object,
    *,
    is_local: bool,
) -> Stamps:
    """Seconds since the first, or since `origin`, the jumps of summer time taken out."""
    if is_local and form.time_zone is not None:
        stamps, said = _in_zone(stamps, form.time_zone, where, said)
    elif is_local:
        _refuse_clock_change(stamps, where)
    first: Any = stamps.iloc[0] if origin is None else origin
    seconds = np.asarray((stamps - first).dt.total_seconds(), dtype=np.float64)
    return Stamps(seconds, said, first)


def _in_zone(
    stamps: pd.Series[pd.Timestamp], zone: str, where: str, said: str
) -> tuple[pd.Series[pd.Timestamp], str]:
    """Local time as UTC."""
    naive = stamps.dt.tz_localize(None)
    try:
        local = naive.dt.tz_localize(zone, ambiguous="infer")
    except ValueError as error:
        raise DataError(
            f"{where}: the time stamps do not fit the clock of {zone} "
            f"({str(error).splitlines()[0]}). Give the zone in which they were written, or write "
            "them in UTC."
        ) from None
    utc = local.dt.tz_convert("UTC")
    shift = (naive - naive.iloc[0]) - (utc - utc.iloc[0])
    if shift.abs().max().total_seconds() > 0:
        k = int(np.argmax(shift.abs().to_numpy() > np.timedelta64(0)))
        hours = shift.iloc[k].total_seconds() / 3600
        said += (
            f"; the clock of {zone} was set {'forward' if hours > 0 else 'back'} by "
            f"{abs(hours):g} h before {naive.iloc[k]:%Y-%m-%d %H:%M:%S}, corrected"
        )
    else:
        said += f"; local time of {zone}"
    return utc, said


def _refuse_clock_change(stamps: pd.Series[pd.Timestamp], where: str) -> None:
    """Refuse a jump of one hour in the small hours of a Sunday in spring or autumn."""
    steps = stamps.diff().dt.total_seconds().to_numpy()[1:]
    if steps.size < 2:
        return
    median = float(np.median(steps))
    for jump, word in ((3600.0, "forward"), (-3600.0, "back")):
        near = np.abs(steps - median - jump) <= max(1.0, UNIFORM * abs(median))
        if not 0 < median < 3600.0 or not 0 < int(near.sum()) <= 4:
            continue
        for k in np.flatnonzero(near):
            before, after = stamps.iloc[int(k)], stamps.iloc[int(k) + 1]
            hour = before.hour if jump > 0 else after.hour
            if before.month in (3, 4, 9, 10, 11) and before.weekday() == 6 and hour <= 3:
                raise DataError(
                    f"{where}: the time stamps jump {word} by an hour from "
                    f"{before:%Y-%m-%d %H:%M:%S} to {after:%H:%M:%S}, as clocks do where summer "
                    f"time {'begins' if jump > 0 else 'ends'}. Name their zone, for example "
                    "--time-zone Europe/Berlin (FileFormat(time_zone='Europe/Berlin')), and the "
                    "jump is taken out; or take a window on one side of it."
                )


def of_times_of_day(column: pd.Series[str], unit: str | None, where: str) -> Stamps | None:
    """Seconds since midnight of `hh:mm:ss`, past midnight going on; None where they are no such.

    Raises
    ------
    DataError
        Where two numbers may be hours and minutes, or minutes and seconds.
    """
    parts = column.str.strip().str.extract(f"^{_TIME_OF_DAY}$")
    if parts[0].isna().any():
        return None
    said = "times of day"
    if parts[2].isna().all():
        first, fraction = parts[0].astype(int), parts[3]
        if unit == "mm:ss" or (unit is None and (first.gt(23).any() or fraction.notna().any())):
            elapsed = 60.0 * first + parts[1].astype(int)
            elapsed += ("0." + fraction.fillna("0")).astype(float)
            return Stamps(np.asarray(elapsed, dtype=np.float64), "minutes and seconds")
        if unit != "hh:mm" and parts[4].isna().all():
            raise DataError(
                f"{where}: {column.iloc[0]!r} may be hours and minutes, or minutes and seconds. "
                "Say which with --map t=COLUMN:hh:mm or --map t=COLUMN:mm:ss."
            )
        said = "hours and minutes"
    elif (parts[2].isna() & parts[3].notna()).any():
        return None
    values = _seconds(parts)
    if values is None:
        return None
    return _past_midnight(values, said)


def _past_midnight(seconds: FloatArray, said: str) -> Stamps:
    """The times continued over midnight, where the clock starts again."""
    steps = np.diff(seconds)
    median = float(np.median(steps)) if steps.size else 0.0
    over = (steps < 0) & (np.abs(steps + DAY - median) < max(0.5 * median, 1.0)) & (median > 0)
    if over.any():
        count = int(over.sum())
        seconds = seconds + DAY * np.concatenate(([0], np.cumsum(over)))
        said += f"; past midnight {count_text(count, 'time')}, a day added"
    return Stamps(seconds, f"{said}, seconds since midnight")


def of_large_numbers(
    values: NDArray[Any], unit: str | None, column: str, origin: Any = None
) -> Stamps | None:
    """Epochs and serial days, recognised by their size; None for plain numbers.

    `values` are integers or floats as the file has them, `unit` is None where it names none. A
    serial day is taken where its unit is days, its column is called a date, or its interval is a
    round number of seconds and no short one in days.
    """
    low, high = float(values.min()), float(values.max())
    median = float(np.median(np.diff(values))) if values.size > 1 else 0.0
    for factor, word in _EPOCHS:
        fits = {"s": 1.0, "ms": 1e-3, "us": 1e-6}.get(unit or "", factor) == factor
        if _FROM <= low * factor and high * factor <= _TO and fits:
            first = values[0] if origin is None else origin
            # The difference first: 1e18 nanoseconds are integers, as doubles good to 256 of them.
            return Stamps(
                np.asarray((values - first) * factor, dtype=np.float64),
                f"{word} since 1970, first {_iso(low * factor)}",
                first,
            )
    if unit not in (None, "d", "day", "days"):
        return None
    for program, (start, stop, epoch) in _SERIAL.items():
        named = unit is not None or re.search("date|datum", column, re.IGNORECASE)
        seconds = median * DAY
        is_round = abs(seconds - round(seconds, 1)) < 1e-4 * seconds
        is_plain = abs(median - float(f"{median:.2g}")) < 1e-5 * median
        if start <= low and high <= stop and (named or (is_round and not is_plain)):
            first = values[0] if origin is None else origin
            # A serial day in double precision is good to about a microsecond.
            elapsed = np.round((values - first) * DAY, 5)
            said = f"serial days of {program}, first {_iso((low - epoch) * DAY)}"
            return Stamps(elapsed, said, first)
    return None


def _iso(seconds: float) -> str:
    return str(np.datetime64(round(seconds * 1000), "ms"))
