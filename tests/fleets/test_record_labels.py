"""Assets and times of records: labels that no record has are refused, a few without are listed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from casid.errors import DataError
from casid.fleets.record_files import files_of
from casid.fleets.record_list import UNKNOWN, Labels, RecordList
from casid.fleets.screening import Screen
from tests.fleets.test_screening import TRUTH, screened
from tests.support.fleet_records import samples, write_problem, write_record


def listed(folder: Path, asset: str | None, time: str | None = None) -> RecordList:
    found = RecordList(None)
    found.add(files_of([folder]), Labels(asset, time))
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a_2025-01-01", "b_2025-02-01"):
        write_record(tmp_path / f"{name}.csv", samples(1, n=20))
    return tmp_path


@pytest.mark.parametrize(
    ("asset", "time", "says"),
    [
        ("ship{asset}_{time}.csv", None, "asset 'ship{asset}_{time}.csv' matches none of the 2"),
        ("{asset}_*.csv", "{time}.parquet", "time '{time}.parquet' matches none of the 2"),
        ("vessel", None, "asset 'vessel': none of the 2 records has such a column"),
        ("{asset}_*.csv", "started", "time 'started': none of the 2 records has such a column"),
        ("{time}_{asset}.csv", None, "'a' the first, are neither dates nor numbers"),
    ],
)
def test_labels_that_no_record_has_are_refused(folder: Path, asset, time, says) -> None:
    with pytest.raises(DataError) as raised:
        listed(folder, asset, time)
    assert says in str(raised.value)
    assert "; " in str(raised.value)  # and how to write them


def test_a_record_without_the_label_that_others_have_is_of_an_unknown_asset(folder: Path) -> None:
    write_record(folder / "noname.csv", samples(2, n=20))
    found = listed(folder, "{asset}_{time}.csv")
    assert [r.asset for r in found.records] == ["a", "b", UNKNOWN]


def test_columns_of_files_that_cannot_be_read_are_not_missed(tmp_path: Path) -> None:
    """Each of them is a row with its reason."""
    (tmp_path / "r.csv").write_text("")
    assert [r.asset for r in listed(tmp_path, "vessel").records] == [UNKNOWN]


def test_a_record_too_short_to_judge_or_of_noise_alone_is_no_adequate_one(tmp_path: Path) -> None:
    """It gets the full search, which says that it is undecided and why."""
    import casid

    problem = casid.load_problem(write_problem(tmp_path))
    path = write_record(tmp_path / "reference.csv", samples(1))
    screen = Screen.of(problem, problem.read(path), TRUTH, level=0.05)
    short = screened(screen, tmp_path, seed=3, n=12)
    assert short.passes(0.05)
    assert "too few to judge" in short.why
    noise = samples(4)
    noise["y"] = 0.02 * np.random.default_rng(5).standard_normal(200)
    noise["command"][:] = 1.0
    found = screen(problem.read(write_record(tmp_path / "noise.csv", noise)))
    assert found.passes(0.05)
    assert "may determine nothing" in found.why
