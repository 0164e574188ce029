"""Times of day written as numbers (930, 940, 950, 1000), and counts that only look like them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from casid.data.reading.record_file import read_record
from casid.data.reading.survey import survey
from casid.errors import DataError


def hhmm(minutes: np.ndarray) -> list[int]:
    """Minutes since midnight of the first day as 930 writes half past nine."""
    return [int(100 * (m // 60 % 24) + m % 60) for m in minutes]


def hhmmss(seconds: np.ndarray) -> list[int]:
    """Seconds since midnight as 93015 writes a quarter of a minute past half past nine."""
    return [int(10000 * (s // 3600 % 24) + 100 * (s // 60 % 60) + s % 60) for s in seconds]


def file_of(folder: Path, header: str, *columns: object) -> Path:
    path = folder / "run.csv"
    rows = zip(*columns, strict=True)  # type: ignore[call-overload]
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


@pytest.mark.parametrize("step", [1, 5, 10, 15, 20])
def test_hours_and_minutes_written_as_one_number_are_read(tmp_path: Path, step: int) -> None:
    """Read as seconds, 950 and 1000 would be five steps of 930 and 940 apart."""
    minutes = 9 * 60 + 30 + step * np.arange(100)
    path = file_of(tmp_path, "time,x", hhmm(minutes), np.sin(minutes))
    record = read_record(path)
    assert record.t0 == 34200
    assert record.Ts == pytest.approx(60 * step)
    (said,) = [line for line in record.provenance if "hours and minutes" in line]
    assert "930 read as 9:30" in said
    assert "--map t=time:s" in said


def test_hours_minutes_and_seconds_written_as_one_number_are_read(tmp_path: Path) -> None:
    seconds = 86400 - 100 + 5 * np.arange(60)
    record = read_record(file_of(tmp_path, "time,x", hhmmss(seconds), np.sin(seconds)))
    assert record.t == pytest.approx(seconds)


@pytest.mark.parametrize("first", [307, 20250130])
def test_a_column_of_days_beside_tells_how_many_pass(tmp_path: Path, first: int) -> None:
    """The clock falls once in a gap of two days: without the column that would be one night."""
    minutes = np.concatenate([22 * 60 + 10 * np.arange(12), 3 * 1440 + 10 * np.arange(12)])
    last = 20250202 if first > 1000 else first + 3
    days = np.where(minutes < 1440, first, last)
    path = file_of(tmp_path, "day,time,x", days, hhmm(minutes), np.sin(minutes))
    assert survey(path).times == pytest.approx(60.0 * minutes)


def test_a_unit_says_so_or_that_it_is_none(tmp_path: Path) -> None:
    minutes = 570 + 10 * np.arange(40)
    path = file_of(tmp_path, "time,x", hhmm(minutes), np.sin(minutes))
    seconds = read_record(path, time=("time", "s"), resample=10.0)
    assert seconds.t0 == 930
    irregular = np.array([570, 571, 600, 720, 725])
    path = file_of(tmp_path, "time,x", hhmm(irregular), np.sin(irregular))
    read = read_record(path, time=("time", "hh:mm"), resample=60.0)
    assert (read.t0, read.t[-1]) == (34200, 43500)
    path = file_of(tmp_path, "time,x", [950, 960, 970], [1, 2, 4])
    with pytest.raises(DataError, match=r"holds no times written hh:mm.*as in --map 't=COLUMN:s'"):
        read_record(path, time=("time", "hh:mm"))


@pytest.mark.parametrize(
    "counts",
    [
        10 * np.arange(100),  # 60 and 70 are no minutes
        100 * np.arange(20),  # on an even clock of 100 s
        np.arange(40),  # no hour is full
        np.array([0, 5, 10, 30, 120, 240, 400, 800]),  # uneven both ways
        np.array([0, 10, 20, 30, 40, 50, 100, 200, 300, 400]),
    ],
)
def test_a_plain_count_stays_one(tmp_path: Path, counts: np.ndarray) -> None:
    path = file_of(tmp_path, "time,x", counts, np.sin(counts))
    assert survey(path).times == pytest.approx(counts)
