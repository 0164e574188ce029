"""Files that are no records are refused with the place and the remedy."""

from __future__ import annotations

import numpy as np
import pytest

from casid.data.quality import check
from casid.data.reading.clocks.even_clock import time_faults
from casid.data.reading.columns import ColumnSpec
from casid.data.reading.record_file import read_record
from casid.data.record import Record
from casid.errors import DataError
from tests.support.text_tables import T, rows


@pytest.mark.parametrize(
    ("text", "what", "remedy"),
    [
        ("", "the file is empty", "Export the measurement again"),
        ("\n\n", "no header and no samples", "Export the measurement again"),
        ("t,y\n", r"a header \(t, y\) and no samples", "Export the measurement again"),
        ("0,1\n1,2\n2,3\n", "no time column.*no line of names", "--map t=COLUMN"),
        ("t,y\n0,1\n", "1 sample; a record needs at least 2", "longer file"),
        ("t,y\n0,1,2\n1,2,3\n", "names 2 columns, the first row holds 3", "Give every column"),
        ("t,y\n0,1\n1,2,3,4\n2,3\n", "table is broken.*line 3", "as many values"),
        ("t,y\n0,a\n1,b\n", "no column of numbers", "with measurements"),
        ("t,y\n0,1\nx,2\n2,3\n", "'t'.*holds text in 1 of 3 cells.*line 3: 'x'", "Correct"),
        ("t,y\n0,1\n,2\n2,3\n", r"'t'.*1 empty or NaN, 0 Inf.*line 3", "give Ts"),
        ("t,y\n0,1\n1,off\n\n2,x\n", "'y'.*text in 2 of 3 cells.*line 3: 'off'", "Correct"),
        ("t,y\n0,1\n\n1,\n2,inf\n", r"'y'.*2 samples.*1 empty or NaN, 1 Inf.*line 4", "mark_miss"),
        (
            "t,y\n0,1\n1,2\n1,3\n0,2\n2,4\n",
            "stands still once.*runs backward once.*line 4",
            "Sort",
        ),
    ],
)
def test_a_file_that_is_no_record_is_refused_with_place_and_remedy(csv, text, what, remedy):
    with pytest.raises(DataError, match=f"(?s){what}") as caught:
        read_record(csv(text), {"y": "y"} if "off" in text else None)
    assert remedy in str(caught.value)
    assert "run.csv" in str(caught.value)


def test_a_path_that_is_no_file_is_refused_with_the_nearest(csv, tmp_path):
    csv(rows(T), "roll_21337.csv")
    with pytest.raises(DataError, match="Did you mean 'roll_21337.csv'"):
        read_record(tmp_path / "roll_2133.csv")
    with pytest.raises(DataError, match="The folder holds roll_21337.csv"):
        read_record(tmp_path / "zz.parquet")
    with pytest.raises(DataError, match="is a folder.*one of its files: roll_21337.csv"):
        read_record(tmp_path)
    with pytest.raises(DataError, match="there is no folder.*Check the path"):
        read_record(tmp_path / "nowhere" / "a.csv")


def test_columns_of_one_name_are_told_apart_by_their_numbers(csv):
    path = csv("t,y,y\n0,1,2\n1,2,3\n")
    assert read_record(path)["y#3"].tolist() == [2.0, 3.0]
    with pytest.raises(DataError, match="more than one column is named 'y'.*--map 'v=y#2'"):
        read_record(path, {"v": "y"})


def test_bytes_that_are_no_table_are_refused(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"t,y\n\0\0\0")
    with pytest.raises(DataError, match="not a text file.*UTF-8"):
        read_record(tmp_path / "a.csv")
    (tmp_path / "a.parquet").write_bytes(b"PAR1 no more")
    with pytest.raises(DataError, match="not a readable Parquet file.*as CSV"):
        read_record(tmp_path / "a.parquet")


def test_a_wrong_column_is_refused_with_the_nearest_and_all_there_are(csv):
    path = csv(rows(T))
    with pytest.raises(DataError, match="Did you mean 'phi_deg'.*holds t, phi_deg, force_N") as e:
        read_record(path, {"phi": "Phi_Deg"})
    assert "--map phi=phi_deg" in str(e.value)
    with pytest.raises(DataError, match="Did you mean 'phi_deg'"):  # as casid itself writes it
        read_record(path, {"phi_deg": "Roll"})
    with pytest.raises(DataError, match="no column 'clock' for t"):
        read_record(path, time="clock")


def test_the_nearest_column_is_no_time_stamp_and_none_that_is_taken(csv):
    path = csv(rows(T, header="Timestamp [s],Wave (cm),eta2"))
    with pytest.raises(DataError, match=r"for eta\. The file holds .* as in --map eta=COLUMN\.$"):
        read_record(path, {"eta": ColumnSpec("timestam"), "x": "eta2"})
    with pytest.raises(DataError, match="Did you mean 'eta2'.* as in --map eta=eta2"):
        read_record(path, {"eta": "eta"})
    with pytest.raises(DataError, match=r"for eta\. The file .* as in --map eta=COLUMN\.$"):
        read_record(path, {"eta": "eta", "x": "eta2"})


def test_a_parquet_file_written_with_its_index_is_read(tmp_path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    frame = pd.DataFrame({"y": [1.0, 2.0, 3.0]}, index=pd.Index([0.0, 0.5, 1.0], name="t"))
    frame.to_parquet(tmp_path / "a.parquet")
    assert read_record(tmp_path / "a.parquet").t.tolist() == [0.0, 0.5, 1.0]
    frame.index = pd.to_timedelta(frame.index, unit="s")
    frame.to_parquet(tmp_path / "b.parquet")
    assert read_record(tmp_path / "b.parquet").Ts == 0.5


def test_text_among_decimal_commas_is_found(csv):
    with pytest.raises(DataError, match="text in 1 of . cells.*line 3: 'xx'"):
        read_record(csv("t;y\n0,0;1,5\n0,1;xx\n0,2;2,5\n"))


def test_a_grid_far_too_coarse_is_refused_with_a_better_one(csv):
    with pytest.raises(DataError, match=r"Resample nearer to the median interval, resample=0\.1"):
        read_record(csv(rows(T)), resample=2.0)


def test_random_instants_are_refused_with_the_option_that_takes_them(csv):
    """Every sample is then found again within a tenth of the median interval of its stamp."""
    t = np.cumsum(np.random.default_rng(2).exponential(1.0, 30))
    path = csv(rows(t, t, header="t,y"))
    with pytest.raises(DataError, match="mark_missing=True takes every sample at its own instant"):
        read_record(path)
    found = read_record(path, mark_missing=True)
    there = ~found.is_missing("y")
    assert found["y"][there].tolist() == t.tolist()
    assert np.abs(found.t[there] - t + t[0] - found.t[0]).max() <= 0.1 * np.median(np.diff(t))


def test_an_empty_column_is_called_empty_by_name_with_what_to_do(csv):
    path = csv("t [s],F [N],y [m],remark\n" + "".join(f"{k},{k % 3},,\n" for k in range(9)))
    said = r"column 'y \[m\]' \(channel y\) is empty: none of its 9 cells.*--map y=COLUMN"
    with pytest.raises(DataError, match=said):
        read_record(path, {"F": "F [N]", "y": "y [m]"})
    (error,) = [
        f for f in check(path, {"F": "F [N]", "y": "y [m]"}).findings if f.severity == "error"
    ]
    assert "is empty" in error.text
    # Without a model, it is doubtful that what has a unit was not recorded; a remark is no signal.
    found = {f.channel: f for f in check(path).findings if "left out: it is empty" in f.text}
    assert found["y [m]"].severity == "warning"
    assert found[None].severity == "note"


def test_empty_cells_are_missing_samples_however_a_table_is_read(csv):
    text = "t,F [N],y [m]\n" + "".join(f"{k},{k % 3},{k if k % 4 else ''}\n" for k in range(12))
    record = read_record(csv(text))
    assert np.flatnonzero(record.is_missing("y [m]")).tolist() == [0, 4, 8]
    again = Record.from_frame(record.to_frame())
    assert np.array_equal(again.is_missing("y [m]"), record.is_missing("y [m]"))


def test_a_clock_without_fractions_of_a_second_is_not_called_disordered(csv):
    """Fifty rows a second under one stamp: the counts give the sample time that reads them."""
    clock = [f"09:{14 + k // 3000}:{k // 50 % 60:02d}" for k in range(17, 17 + 400)]
    path = csv("time;y [m]\n" + "".join(f"{t};{k}\n" for k, t in enumerate(clock)))
    with pytest.raises(DataError, match="no fractions of a second, 50 rows share") as caught:
        read_record(path)
    assert "--sample-time 0.02 (Ts=0.02) reads" in str(caught.value)
    assert read_record(path, Ts=0.02).N == 400
    # Thirty and a third rows a second.
    times = np.floor(np.arange(400) / (91 / 3))
    (fault,) = time_faults(times, "run")
    assert "30 to 31 rows share" in fault.text
    # One stamp among many that is there twice is disorder.
    (fault,) = time_faults(np.array([0, 1, 2, 2, 3, 4, 5, 5, 6.0]), "run")
    assert fault.remedy.startswith("Sort the file and drop doubled rows")


@pytest.mark.parametrize(
    ("first", "counted"),
    [("09:14:{:02d}", "since midnight"), ("2024-03-14 09:14:{:02d}", "since the first stamp")],
)
def test_a_window_outside_says_from_when_the_times_count(csv, first, counted):
    path = csv("time,y\n" + "".join(f"{first.format(k)},{k}\n" for k in range(20)))
    with pytest.raises(DataError, match=f"of its own clock, counted {counted}"):
        read_record(path, window=(100.0, 200.0))
    path = csv("t,y\n" + "".join(f"{k},{k}\n" for k in range(20)))
    with pytest.raises(DataError, match=r"of its own clock\. Give"):
        read_record(path, window=(100.0, 200.0))
