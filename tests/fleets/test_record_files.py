"""Where the records of a fleet lie: on this machine, or behind an address of fsspec."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pandas as pd
import pytest

import casid
from casid.errors import DataError
from casid.fleets.record_files import RecordFile, files_of, is_address, local, natural
from casid.fleets.record_list import Labels, RecordList, distinct_names
from tests.support.fleet_records import samples, write_problem, write_record

LABELS = "{asset}_{time}.csv"
OUTCOME = ["record", "asset", "when", "sha256", "samples", "verdict", "p", "parameters", "causes"]


@pytest.fixture
def records(tmp_path: Path) -> Path:
    for name in ("a_1", "a_2", "a_10"):
        write_record(tmp_path / "records" / f"{name}.csv", samples(3))
    return tmp_path / "records"


def archive(records: Path) -> Path:
    path = records.with_name("records.zip")
    with zipfile.ZipFile(path, "w") as file:
        for record in records.iterdir():
            file.write(record, f"inside/{record.name}")
    return path


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("s3://bucket/*.parquet", True),
        ("zip://*.csv::a.zip", True),
        ("file:///data/a.csv", True),
        ("voyages/*.parquet", False),
        ("C:" + "/voyages/a.csv", False),
    ],
)
def test_an_address_has_a_protocol(text: str, wanted: bool) -> None:
    assert is_address(text) is wanted


def test_numbers_in_names_sort_by_size(records: Path) -> None:
    assert [f.place.name for f in files_of(records)] == ["a_1.csv", "a_2.csv", "a_10.csv"]
    assert natural("run2") < natural("run10")


def test_files_of_one_name_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    """Each asset has its folder by default, and its records the same dates for names."""
    for place in ("A/1.csv", "B/1.csv", "B/2.csv"):
        write_record(tmp_path / place, samples(3, n=30))
    listed = RecordList(None)
    listed.add(files_of(tmp_path), Labels())
    assert sorted(listed.frame()["record"]) == ["2.csv", "A/1.csv", "B/1.csv"]
    assert distinct_names(["x/A/1.csv", "y/A/1.csv", "B/1.csv"]) == [
        "x/A/1.csv", "y/A/1.csv", "B/1.csv",
    ]  # fmt: skip


def test_a_pattern_inside_an_archive_names_its_files(records: Path) -> None:
    pytest.importorskip("fsspec")
    found = files_of(f"zip://inside/*.csv::{archive(records)}")
    assert [f.place.as_posix() for f in found] == [f"/inside/a_{n}.csv" for n in (1, 2, 10)]
    assert [Labels(LABELS).of(f) for f in found] == [("a", "1"), ("a", "2"), ("a", "10")]
    assert [f.size for f in found] == [f.size for f in files_of(records)]
    with local(found[0].path) as copy:
        assert copy.name == "a_1.csv"
        assert copy.read_bytes() == (records / "a_1.csv").read_bytes()
    assert not copy.exists()


def test_a_folder_of_an_address_is_that_of_the_machine(records: Path) -> None:
    pytest.importorskip("fsspec")
    found = files_of(records.as_uri())
    assert [f.place for f in found] == [f.place for f in files_of(records)]


@pytest.mark.slow
def test_a_fleet_behind_an_address_has_the_rows_of_one_on_this_machine(records: Path) -> None:
    pytest.importorskip("fsspec")
    problem = write_problem(records.parent)
    here = casid.fleet(problem, records, asset=LABELS)
    there = casid.fleet(problem, f"zip://inside/*::{archive(records)}", asset=LABELS)
    pd.testing.assert_frame_equal(here.records[OUTCOME], there.records[OUTCOME])
    assert set(there.records["verdict"]) == {"adequate"}


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("zip://*.csv::absent.zip", r"absent\.zip cannot be opened"),
        ("nosuch://a.csv", "check the address, and that the package of its protocol"),
    ],
)
def test_an_address_that_cannot_be_opened_says_so(address: str, message: str) -> None:
    pytest.importorskip("fsspec")
    with pytest.raises(DataError, match=message):
        files_of(address)


def test_asset_and_time_may_be_columns_of_the_files(tmp_path: Path) -> None:
    """Text and dates, the first value of each; a file without them is of an unknown asset."""
    for i, (ship, day) in enumerate(
        [("Ada", "2024-05-02"), ("Bo", "2024-05-01"), ("Ada", "2024-04-30")]
    ):
        data = samples(i, n=30)
        frame = pd.DataFrame(data).assign(ship=ship, started=f"{day} 06:00")
        frame.to_csv(tmp_path / f"{i}.csv", index=False)
    write_record(tmp_path / "3.csv", samples(3, n=30))
    listed = RecordList(None)
    listed.add(files_of(tmp_path), Labels("ship", "started"))
    found = [(r.asset, Path(r.path).name, r.is_dated) for r in listed.records]
    dated = [("Ada", "2.csv", True), ("Bo", "1.csv", True), ("Ada", "0.csv", True)]
    assert found == [*dated, ("unknown", "3.csv", True)]
    assert listed.records[0].when == pd.Timestamp("2024-04-30 06:00").timestamp()


@pytest.mark.slow
def test_a_fleet_by_columns_does_not_take_them_for_signals(tmp_path: Path) -> None:
    for i, heater in enumerate(["left", "right", "left"]):
        frame = pd.DataFrame(samples(i)).assign(heater=heater, day=float(3 - i))
        path = tmp_path / "records" / f"{i}.parquet"
        path.parent.mkdir(exist_ok=True)
        frame.to_parquet(path, index=False)
    found = casid.fleet(
        write_problem(tmp_path), tmp_path / "records", asset="heater", time="day", screen=False
    )
    assert list(found.records["asset"]) == ["left", "right", "left"]
    assert list(found.records["when"]) == [1.0, 2.0, 3.0]
    assert not found.refusals
    assert set(found.records["verdict"]) == {"adequate"}


def test_a_changed_file_is_noticed_by_its_size_or_time() -> None:
    listed = RecordList(None)
    listed.add([RecordFile("s3://b/a_1.csv", 10, 7)], Labels(LABELS))
    with pytest.raises(DataError, match="was changed after it was done"):
        listed.add([RecordFile("s3://b/a_1.csv", 10, 8)], Labels(LABELS))
